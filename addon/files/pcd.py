# SPDX-License-Identifier: GPL-3.0-or-later
"""PCD of the Point Cloud Library: text, binary, compressed; every field kept."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .shape import COLORS, FileError, Shape, checked_count

NORMALS = ("normal_x", "normal_y", "normal_z")
_TYPES = {"F": "f", "I": "i", "U": "u"}
_SIZES = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
_LONGEST_HEADER = 1 << 16
_NO_VIEWPOINT = "0 0 0 1 0 0 0"
# A reference of LZF takes two or three bytes and stands for 264 at most.
_DENSEST = 132


@dataclass(frozen=True)
class Cloud:
    """The fields of a file, with what its header says beside them.

    Attributes
    ----------
    rows : (n,) structured array
        Names are made different where the file repeats them, as it does padding.
    names : tuple of str, as in the file
    width, height : int
    viewpoint : str
    data : str
        "ascii", "binary" or "binary_compressed".
    """

    rows: Any
    names: tuple[str, ...]
    width: int
    height: int
    viewpoint: str
    data: str


def read(path: Path) -> Shape:
    """Read points, normals and all other fields."""
    data = path.read_bytes()
    header, at = _header(data)
    dtype = _dtype(header)
    width, height = (_whole(header, key) for key in ("WIDTH", "HEIGHT"))
    count = _whole(header, "POINTS") if "POINTS" in header else width * height
    if width * height != count:
        raise FileError(f"expected {width} x {height} points, got a count of {count}")
    kind = " ".join(header["DATA"]).lower()
    body = memoryview(data)[at:]
    if kind == "ascii":
        rows = _text(bytes(body), dtype, count)
    elif kind == "binary":
        checked_count(count, dtype.itemsize, len(body), "points")
        rows = np.frombuffer(body, dtype, count)
    elif kind == "binary_compressed":
        rows = _compressed(body, dtype, count)
    else:
        raise FileError(f"expected DATA ascii, binary or binary_compressed, got {kind}")
    viewpoint = " ".join(header.get("VIEWPOINT", [])) or _NO_VIEWPOINT
    names = tuple(header["FIELDS"])
    return _shape(Cloud(rows, names, width, height, viewpoint, kind))


def _header(data):
    """Return the words behind each key, and where the data begin."""
    header: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in header:
        end = data.find(b"\n", at, _LONGEST_HEADER)
        if end < 0:
            raise FileError("expected a header of PCD that ends with DATA")
        words = data[at:end].decode("latin-1").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            header[words[0].upper()] = words[1:]
    missing = {"FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT"} - set(header)
    if missing:
        raise FileError(f"expected {min(missing)} in the header of PCD, got none")
    return header, at


def _whole(header, key):
    words = header[key]
    if len(words) != 1 or not words[0].isdecimal() or len(words[0]) > 18:
        raise FileError(f"expected a whole number as {key}, got {' '.join(words)[:40]}")
    return int(words[0])


def _dtype(header):
    fields: list[Any] = []
    names, sizes, types = (header[key] for key in ("FIELDS", "SIZE", "TYPE"))
    counts = header.get("COUNT", ["1"] * len(names))
    if not names or not len(names) == len(sizes) == len(types) == len(counts):
        raise FileError("expected SIZE, TYPE and COUNT for each of the FIELDS")
    for name, size, kind, count in zip(names, sizes, types, counts, strict=True):
        known = size.isdecimal() and int(size) in _SIZES.get(kind, ())
        if not known or not count.isdecimal() or int(count) > 1 << 20:
            raise FileError(f"expected a field of numbers, got {name} {size} {kind}")
        shape = () if int(count) == 1 else (int(count),)
        unique = name if name not in {f[0] for f in fields} else f"{name} {len(fields)}"
        fields.append((unique, f"<{_TYPES[kind]}{size}", shape))
    return np.dtype(fields)


def _text(body, dtype, count):
    lines = [line for line in body.decode("latin-1").split("\n") if line.strip()]
    checked_count(count, 1, len(lines), "lines of points")
    rows = np.empty(count, dtype)
    width = sum(
        dtype[name].shape[0] if dtype[name].shape else 1 for name in dtype.names
    )
    try:
        table = np.loadtxt(lines[:count], ndmin=2, comments=None) if count else None
    except ValueError:
        raise FileError(f"expected {width} numbers on each line") from None
    if table is None:
        return rows
    if table.shape[1] != width:
        raise FileError(f"expected {width} numbers on each line, got {table.shape[1]}")
    at = 0
    for name in dtype.names:
        kind, shape = dtype[name].base, dtype[name].shape
        size = shape[0] if shape else 1
        values = table[:, at : at + size]
        if kind.kind != "f":
            limits = np.iinfo(kind)
            if not ((values >= limits.min) & (values <= limits.max)).all():
                raise FileError(f"expected values of {name} that its type can hold")
        with np.errstate(over="ignore"):
            rows[name] = values.reshape(count, *shape)
        at += size
    return rows


def _compressed(body, dtype, count):
    if len(body) < 8:
        raise FileError("expected compressed points, got a file that ends before")
    packed, size = (int(v) for v in np.frombuffer(body[:8], "<u4"))
    checked_count(packed, 1, len(body) - 8, "bytes of compressed points")
    if size != count * dtype.itemsize or size > packed * _DENSEST:
        raise FileError(
            f"expected {count * dtype.itemsize:,} bytes of points, got {size:,}"
        )
    data = decompressed(bytes(body[8 : 8 + packed]), size)
    rows, at = np.empty(count, dtype), 0
    # Field by field: all x, all y, ...
    for name in dtype.names:
        each = np.dtype((dtype[name].base, dtype[name].shape))
        rows[name] = np.frombuffer(data, each, count, at)
        at += count * dtype[name].itemsize
    return rows


def decompressed(data: bytes, size: int) -> bytes:
    """Return what LZF made into `data`, `size` bytes.

    A byte below 32 precedes that many literal bytes and one; others begin a reference
    to what came before: three bits of length, thirteen of distance.
    """
    out = bytearray()
    at, end = 0, len(data)
    try:
        while at < end and len(out) <= size:
            code = data[at]
            at += 1
            if code < 32:
                out += data[at : at + code + 1]
                at += code + 1
                continue
            length = code >> 5
            if length == 7:
                length += data[at]
                at += 1
            back = ((code & 31) << 8) + data[at] + 1
            at += 1
            length += 2
            start = len(out) - back
            if start < 0:
                raise IndexError
            # A reference may reach into what it makes itself.
            piece = out[start : start + length]
            while len(piece) < length:
                piece += piece[: length - len(piece)]
            out += piece
    except IndexError:
        raise FileError("expected compressed points, got damaged ones") from None
    if len(out) != size:
        raise FileError(f"expected {size:,} bytes of points, got {len(out):,}")
    return bytes(out)


def _shape(cloud):
    rows = cloud.rows
    plain = [name for name in rows.dtype.names if not rows.dtype[name].shape]
    if not {"x", "y", "z"} <= set(plain):
        raise FileError("expected fields x, y and z, got " + " ".join(cloud.names)[:60])
    columns = {name: np.ascontiguousarray(rows[name]) for name in plain}
    points = np.stack([columns.pop(name) for name in "xyz"], axis=1)
    if points.dtype.kind != "f":
        points = points.astype(np.float64)
    normals = None
    if set(NORMALS) <= set(columns):
        normals = np.stack([columns.pop(name) for name in NORMALS], axis=1)
    for name in ("rgb", "rgba"):
        if name in columns and columns[name].dtype.itemsize == 4:
            packed = columns.pop(name).view("u4")
            for shift, color in zip((16, 8, 0), COLORS, strict=True):
                columns[color] = (packed >> shift & 255).astype("u1")
    columns = {name: v for name, v in columns.items() if not name.startswith("_")}
    return Shape(points, None, normals, columns, cloud)


def write(path: Path, shape: Shape) -> None:
    """Write fields and normals: as text where it was text before, else binary."""
    cloud = shape.kept if isinstance(shape.kept, Cloud) else _new(shape)
    rows, names = _with_normals(cloud, shape)
    kind = "ascii" if cloud.data == "ascii" else "binary"
    fields = [rows.dtype[name] for name in rows.dtype.names]
    header = {
        "VERSION": ["0.7"],
        "FIELDS": names,
        "SIZE": [str(field.base.itemsize) for field in fields],
        "TYPE": [field.base.kind.upper() for field in fields],
        "COUNT": [str(field.shape[0] if field.shape else 1) for field in fields],
        "WIDTH": [str(cloud.width)],
        "HEIGHT": [str(cloud.height)],
        "VIEWPOINT": [cloud.viewpoint],
        "POINTS": [str(len(rows))],
        "DATA": [kind],
    }
    lines = [f"{key} {' '.join(words)}\n" for key, words in header.items()]
    with path.open("wb") as file:
        file.write(
            "".join(["# .PCD v0.7 - Point Cloud Data file format\n", *lines]).encode()
        )
        file.write(rows.tobytes() if kind == "binary" else _lines(rows))


def _with_normals(cloud, shape):
    """Return rows and names with normals, as precise as x."""
    old = cloud.rows.dtype
    kind = "<f8" if old["x"].itemsize == 8 else "<f4"
    added = [name for name in NORMALS if name not in old.names]
    fields = [(name, old[name]) for name in old.names]
    rows = np.empty(len(cloud.rows), fields + [(name, kind) for name in added])
    for name in old.names:
        rows[name] = cloud.rows[name]
    for name, values in zip(NORMALS, shape.normals.T, strict=True):
        rows[name] = values
    return rows, [*cloud.names, *added]


def _lines(rows):
    columns = []
    for name in rows.dtype.names:
        values = rows[name].reshape(len(rows), -1)
        columns += [column.astype("U").tolist() for column in values.T]
    lines = map(" ".join, zip(*columns, strict=True))
    return "".join(line + "\n" for line in lines).encode("ascii")


def _new(shape):
    """Return the fields of a shape from another format."""
    columns = dict(zip("xyz", shape.points.T, strict=True)) | dict(shape.columns)
    if set(COLORS) <= set(columns):
        r, g, b = (np.asarray(columns.pop(name)).astype("u4") & 255 for name in COLORS)
        columns["rgb"] = (r << 16 | g << 8 | b).view("f4")
    columns = {name.replace(" ", "_"): values for name, values in columns.items()}
    fields = [
        (name, values.dtype.newbyteorder("<") if values.dtype.kind != "b" else "<u1")
        for name, values in columns.items()
    ]
    rows = np.empty(len(shape.points), fields)
    for name, values in columns.items():
        rows[name] = values
    names = tuple(columns)
    return Cloud(rows, names, len(rows), 1, _NO_VIEWPOINT, "binary")
