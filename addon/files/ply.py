# SPDX-License-Identifier: GPL-3.0-or-later
"""PLY: text and binary, both byte orders, every element and property kept."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from .shape import COLORS, NORMALS, FileError, Polygons, Shape, checked, checked_count

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4",
    "uint": "u4", "float": "f4", "double": "f8", "int8": "i1", "uint8": "u1",
    "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4",
    "float64": "f8",
}  # fmt: skip
_NAMES = {
    "i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int",
    "u4": "uint", "f4": "float", "f8": "double",
}  # fmt: skip
_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 1 << 20
_FACES = ("vertex_indices", "vertex_index")


@dataclass(frozen=True)
class Property:
    """A number for each row of an element, or a list of them.

    Attributes
    ----------
    name, type : str
        The type as numpy writes it, without the order of its bytes.
    count : str or None
        The type of a list's length; None for a single number.
    """

    name: str
    type: str
    count: str | None = None

    @property
    def least(self) -> int:
        """Bytes that it takes at least."""
        return np.dtype(self.count or self.type).itemsize

    @property
    def said(self) -> str:
        """The line of the header."""
        kind = _NAMES[self.type]
        if self.count:
            kind = f"list {_NAMES[self.count]} {kind}"
        return f"property {kind} {self.name}"


@dataclass(frozen=True)
class Element:
    """Rows of properties, under a name.

    `data` has an (n,) array for each property, or (values, sizes) for one of lists.
    """

    name: str
    count: int
    properties: tuple[Property, ...] = ()
    data: Any = None

    @property
    def has_lists(self) -> bool:
        """Whether rows differ in length."""
        return any(item.count for item in self.properties)

    def dtype(self, order: str) -> np.dtype:
        """Return the type of a row without lists."""
        return np.dtype([(item.name, order + item.type) for item in self.properties])


@dataclass(frozen=True)
class Header:
    """What a file announces: its elements, and where the first begins."""

    format: str
    comments: tuple[str, ...]
    elements: tuple[Element, ...]
    size: int = 0

    @property
    def order(self) -> str:
        """The order of the bytes, as numpy writes it."""
        return _ORDERS[self.format]


def read_header(file: BinaryIO) -> Header:
    """Read the header of an open file."""
    head = file.read(_LONGEST_HEADER)
    if not head.startswith(b"ply"):
        raise FileError("expected a PLY file, which begins with ply")
    end = head.find(b"end_header")
    size = head.find(b"\n", end) + 1
    if end < 0 or size == 0:
        raise FileError("expected a header that ends with end_header")
    text = head[:end].decode("latin-1")
    lines = [line.strip() for line in text.replace("\r", "\n").split("\n")]
    kind, comments, elements = "", [], []
    for line in filter(None, lines[1:]):
        word, _, rest = line.partition(" ")
        if word == "format":
            kind = rest.partition(" ")[0]
        elif word in ("comment", "obj_info"):
            comments.append(line)
        elif word == "element":
            elements.append(_element(rest.split(), line))
        elif word == "property" and elements:
            item = _property(rest.split(), line)
            old = elements[-1]
            if item.name in {other.name for other in old.properties}:
                raise FileError(f"expected property {item.name} once, got it twice")
            elements[-1] = replace(old, properties=(*old.properties, item))
        else:
            raise FileError(f"expected a header of PLY, got the line {line[:60]!r}")
    if kind not in _ORDERS:
        raise FileError(f"expected one of the formats {', '.join(_ORDERS)}, got {kind}")
    return Header(kind, tuple(comments), tuple(elements), size)


def _element(words, line):
    if len(words) != 2 or not words[1].isdecimal() or len(words[1]) > 18:
        raise FileError(f"expected the count of an element, got the line {line[:60]!r}")
    return Element(words[0], int(words[1]))


def _property(words, line):
    *kinds, name = words or [""]
    if len(kinds) == 3 and kinds[0] == "list":
        kinds = kinds[1:]
    elif len(kinds) != 1:
        kinds = ["?"]
    if not all(kind in _TYPES for kind in kinds):
        raise FileError(f"expected the type of a property, got the line {line[:60]!r}")
    *count, kind = (_TYPES[kind] for kind in kinds)
    if count and count[0][0] == "f":
        raise FileError(
            f"expected whole numbers as lengths, got the line {line[:60]!r}"
        )
    return Property(name, kind, *count)


def read(path: Path) -> Shape:
    """Read the vertices, their properties and the faces."""
    with path.open("rb") as file:
        header = read_header(file)
        file.seek(header.size)
        body = file.read()
    find = _text_elements if header.format == "ascii" else _binary_elements
    header = replace(header, elements=tuple(find(header, body)))
    return shape_of(header)


def shape_of(header: Header) -> Shape:
    """Return the Shape of elements that have been read."""
    vertex = vertex_element(header)
    columns = dict(vertex.data)
    points = np.stack([_native(columns.pop(name)) for name in "xyz"], axis=1)
    normals = None
    if set(NORMALS) <= set(columns):
        normals = np.stack([_native(columns.pop(name)) for name in NORMALS], axis=1)
    columns = {name: _native(values) for name, values in columns.items()}
    return checked(Shape(points, _polygons(header), normals, columns, header))


def vertex_element(header: Header) -> Element:
    """Return the element of the vertices, with plain numbers x, y and z."""
    for element in header.elements:
        if element.name == "vertex":
            names = {item.name for item in element.properties}
            if not {"x", "y", "z"} <= names:
                raise FileError("expected vertices with x, y and z")
            if element.has_lists:
                raise FileError("expected vertices without lists of numbers")
            return element
    raise FileError("expected an element vertex, got none")


def _native(values):
    """Return numbers in the byte order of this machine; coordinates as floats."""
    return np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("="))


def _polygons(header):
    for element in header.elements:
        for item in element.properties:
            if element.name == "face" and item.name in _FACES and item.count:
                values, sizes = element.data[item.name]
                return Polygons(values.astype(np.int64), sizes.astype(np.int64))
    return None


def _binary_elements(header: Header, body: bytes) -> Iterator[Element]:
    at = 0
    for element in header.elements:
        each = sum(item.least for item in element.properties)
        checked_count(element.count, each, len(body) - at, f"rows of {element.name}")
        if element.has_lists:
            data, at = _rows_with_lists(element, header.order, body, at)
        else:
            dtype = element.dtype(header.order)
            rows = np.frombuffer(body, dtype, element.count if each else 0, at)
            data = {name: rows[name] for name in dtype.names or ()}
            at += rows.nbytes
        yield replace(element, data=data)


def _rows_with_lists(element, order, body, at):
    """Return the data of an element with lists, and where the next one begins."""
    starts, sizes = _row_places(element, order, body, at)
    data = {}
    octets = np.frombuffer(body, "u1")
    offset = starts
    for item in element.properties:
        kind = np.dtype(order + item.type)
        if item.count is None:
            data[item.name] = _gathered(octets, offset, kind)
            offset = offset + kind.itemsize
            continue
        size = sizes[item.name]
        first = np.repeat(offset + np.dtype(item.count).itemsize, size)
        nth = np.arange(len(first)) - np.repeat(np.cumsum(size) - size, size)
        data[item.name] = _gathered(octets, first + nth * kind.itemsize, kind), size
        offset = offset + np.dtype(item.count).itemsize + size * kind.itemsize
    return data, int(offset[-1]) if len(offset) else at


def _gathered(octets, places, kind):
    """Return the numbers that begin at some places of the bytes."""
    if not len(places):
        return np.empty(0, kind)
    return octets[places[:, None] + np.arange(kind.itemsize)].view(kind)[:, 0]


def _row_places(element, order, body, at):
    """Return where each row begins, (m,), and the lengths of its lists by name."""
    names = [item.name for item in element.properties if item.count]
    if not element.count:
        return np.empty(0, np.int64), dict.fromkeys(names, np.empty(0, np.int64))
    found = _alike(element, order, body, at) or _one_by_one(element, order, body, at)
    starts, sizes = found
    return starts, dict(zip(names, sizes, strict=True))


def _alike(element, order, body, at):
    """Return the places of rows whose lists are as long as those of the first."""
    fields: list[Any] = []
    first = _one_by_one(replace(element, count=1), order, body, at)[1]
    lengths = iter(first)
    for number, item in enumerate(element.properties):
        if item.count:
            fields.append((f"count {number}", order + item.count))
            fields.append((f"list {number}", order + item.type, int(next(lengths)[0])))
        else:
            fields.append((item.name, order + item.type))
    dtype = np.dtype(fields)
    if element.count * dtype.itemsize > len(body) - at:
        return None
    rows = np.frombuffer(body, dtype, element.count, at)
    counts = [rows[name] for name in dtype.names or () if name.startswith("count ")]
    if any((count != count[0]).any() for count in counts):
        return None
    starts = at + dtype.itemsize * np.arange(element.count, dtype=np.int64)
    return starts, [count.astype(np.int64) for count in counts]


def _one_by_one(element, order, body, at):
    """Return the places of rows of any lengths, by a walk from row to row."""
    kinds = [
        (item.count and np.dtype(order + item.count), np.dtype(item.type).itemsize)
        for item in element.properties
    ]
    byteorder: Any = "big" if order == ">" else "little"
    starts: list[int] = []
    sizes: list[list[int]] = [[] for count, _ in kinds if count]
    for _ in range(element.count):
        starts.append(at)
        lists = iter(sizes)
        for count, each in kinds:
            if not count:
                at += each
                continue
            end = at + count.itemsize
            size = int.from_bytes(body[at:end], byteorder, signed=count.kind == "i")
            next(lists).append(checked_count(size, each, len(body) - end, "corners"))
            at = end + size * each
        if at > len(body):
            checked_count(element.count, at, len(body), f"rows of {element.name}")
    return np.array(starts), [np.array(size, dtype=np.int64) for size in sizes]


def _text_elements(header: Header, body: bytes) -> Iterator[Element]:
    lines = [line for line in body.decode("latin-1").split("\n") if line.strip()]
    at = 0
    for element in header.elements:
        checked_count(element.count, 1, len(lines) - at, f"lines of {element.name}")
        rows = lines[at : at + element.count]
        at += element.count
        try:
            data = _lists_of_lines if element.has_lists else _numbers_of_lines
            yield replace(element, data=data(element, rows))
        except (ValueError, OverflowError):
            raise FileError(
                f"expected {len(element.properties)} numbers on each line of "
                f"{element.name}, got something else"
            ) from None


def _numbers_of_lines(element, rows):
    kinds = element.properties
    if not rows:
        return {item.name: np.empty(0, item.type) for item in kinds}
    table = np.loadtxt(rows, ndmin=2, comments=None, usecols=range(len(kinds)))
    return {
        item.name: _exactly(column, item.type)
        for item, column in zip(kinds, table.T, strict=True)
    }


def _exactly(values, kind):
    """Return numbers as a type that can hold them."""
    with np.errstate(over="ignore"):
        return _whole(values, kind) if kind[0] != "f" else values.astype(kind)


def _whole(values, kind):
    limits = np.iinfo(kind)
    if not ((values >= limits.min) & (values <= limits.max)).all():
        raise ValueError("out of range")
    return values.astype(kind)


def _lists_of_lines(element, rows):
    data: dict[str, Any] = {
        item.name: ([], []) if item.count else [] for item in element.properties
    }
    for row in rows:
        tokens = iter(row.split())
        for item in element.properties:
            number = next(tokens, "")
            if item.count is None:
                data[item.name].append(float(number))
                continue
            values, sizes = data[item.name]
            sizes.append(int(number))
            if not 0 <= sizes[-1] <= len(row):
                raise ValueError("out of range")
            values += [float(next(tokens, "")) for _ in range(sizes[-1])]
    return {
        item.name: (
            (
                _exactly(np.array(data[item.name][0], dtype=float), item.type),
                np.array(data[item.name][1], dtype=np.int64),
            )
            if item.count
            else _exactly(np.array(data[item.name], dtype=float), item.type)
        )
        for item in element.properties
    }


def write(path: Path, shape: Shape) -> None:
    """Write a shape, as it was where it came from a PLY file."""
    header = shape.kept if isinstance(shape.kept, Header) else _new(shape)
    header = _with_normals(header, shape.normals)
    if shape.polygons is not None:
        header = _with_faces(header, shape.polygons)
    with path.open("wb") as file:
        file.write(header_text(header))
        for element in header.elements:
            file.write(_encoded(element, header))


def header_text(header: Header) -> bytes:
    """Return the header of a file."""
    lines = ["ply", f"format {header.format} 1.0", *header.comments]
    for element in header.elements:
        lines.append(f"element {element.name} {element.count}")
        lines += [item.said for item in element.properties]
    return "\n".join([*lines, "end_header", ""]).encode("latin-1")


def with_normals(element: Element) -> Element:
    """Return the element of vertices with places for normals, as precise as x."""
    known = {item.name: item for item in element.properties}
    kind = known["x"].type if known["x"].type[0] == "f" else "f4"
    added = tuple(Property(name, kind) for name in NORMALS if name not in known)
    return replace(element, properties=element.properties + added)


def _with_normals(header, normals):
    vertex = with_normals(vertex_element(header))
    kinds = {item.name: item.type for item in vertex.properties}
    data = dict(vertex.data)
    for name, values in zip(NORMALS, normals.T, strict=True):
        data[name] = values.astype(kinds[name])
    return _replaced(header, replace(vertex, data=data))


def _replaced(header, element):
    elements = (element if e.name == element.name else e for e in header.elements)
    return replace(header, elements=tuple(elements))


def _with_faces(header, polygons):
    for element in header.elements:
        for item in element.properties:
            if element.name == "face" and item.name in _FACES and item.count:
                corners = polygons.corners.astype(item.type)
                data = dict(element.data) | {item.name: (corners, polygons.sizes)}
                return _replaced(header, replace(element, data=data))
    return header


def _new(shape):
    """Return the header and elements of a shape from another format."""
    columns = dict(zip("xyz", shape.points.T, strict=True)) | {
        name.replace(" ", "_"): _storable(name, values)
        for name, values in shape.columns.items()
    }
    kinds = tuple(Property(name, v.dtype.str[1:]) for name, v in columns.items())
    elements = [Element("vertex", len(shape.points), kinds, columns)]
    if shape.polygons is not None:
        faces = shape.polygons
        kind = "u1" if faces.sizes.max(initial=0) < 256 else "i4"
        data = {_FACES[0]: (faces.corners.astype("i4"), faces.sizes)}
        item = Property(_FACES[0], "i4", kind)
        elements.append(Element("face", len(faces.sizes), (item,), data))
    return Header("binary_little_endian", (), tuple(elements))


def _storable(name, values):
    """Return values as a type that PLY has."""
    if name in COLORS and values.dtype.kind == "f" and values.max(initial=0) > 1:
        return values.astype("u1")
    if values.dtype.str[1:] in _NAMES:
        return values
    if values.dtype.kind in "ib" and np.abs(values).max(initial=0) < 2**31:
        return values.astype("i4")
    return values.astype("f8")


def _encoded(element, header):
    if header.format == "ascii":
        return _as_text(element)
    if not element.has_lists:
        rows = np.empty(element.count, element.dtype(header.order))
        for item in element.properties:
            rows[item.name] = element.data[item.name]
        return rows.tobytes()
    return _as_bytes(element, header.order)


def _as_text(element):
    columns = []
    for item in element.properties:
        values = element.data[item.name]
        if item.count:
            values, sizes = values
            said, ends = values.astype("U").tolist(), np.cumsum(sizes).tolist()
            columns.append(
                [
                    " ".join([str(size), *said[end - size : end]])
                    for size, end in zip(sizes.tolist(), ends, strict=True)
                ]
            )
        else:
            columns.append(values.astype("U").tolist())
    lines = map(" ".join, zip(*columns, strict=True))
    return "".join(line + "\n" for line in lines).encode("ascii")


def _as_bytes(element, order):
    """Return the bytes of rows that differ in length."""
    parts = []  # dtype, values, row of each value, place within the list
    length = np.zeros(element.count, np.int64)
    rows = np.arange(element.count)
    for item in element.properties:
        values, sizes = element.data[item.name], np.ones(element.count, np.int64)
        if item.count:
            values, sizes = values
            kind = np.dtype(order + item.count)
            parts.append((kind, sizes.astype(kind), rows, length.copy()))
            length += kind.itemsize
        kind = np.dtype(order + item.type)
        row = np.repeat(rows, sizes)
        nth = np.arange(len(row)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        parts.append(
            (kind, values.astype(kind), row, length[row] + nth * kind.itemsize)
        )
        length += sizes * kind.itemsize
    octets = np.empty(length.sum(), "u1")
    starts = np.cumsum(length) - length
    for kind, values, row, offset in parts:
        places = (starts[row] + offset)[:, None] + np.arange(kind.itemsize)
        octets[places] = values.view("u1").reshape(-1, kind.itemsize)
    return octets.tobytes()
