# SPDX-License-Identifier: GPL-3.0-or-later
"""What a PLY file announces: elements, their properties, the order of bytes."""

from dataclasses import dataclass, replace
from typing import Any, BinaryIO

import numpy as np

from .shape import FileError

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4",
    "uint": "u4", "float": "f4", "double": "f8", "int8": "i1", "uint8": "u1",
    "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4",
    "float64": "f8",
}  # fmt: skip
NAMES = {
    "i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int",
    "u4": "uint", "f4": "float", "f8": "double",
}  # fmt: skip
_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 1 << 20


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
        kind = NAMES[self.type]
        if self.count:
            kind = f"list {NAMES[self.count]} {kind}"
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


def header_text(header: Header) -> bytes:
    """Return the header of a file."""
    lines = ["ply", f"format {header.format} 1.0", *header.comments]
    for element in header.elements:
        lines.append(f"element {element.name} {element.count}")
        lines += [item.said for item in element.properties]
    return "\n".join([*lines, "end_header", ""]).encode("latin-1")
