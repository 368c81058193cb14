# SPDX-License-Identifier: GPL-3.0-or-later
"""What a file of points or of a mesh holds, whatever its format."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np


class FileError(Exception):
    """A file that cannot be used; the text is one sentence with the reason."""


@dataclass(frozen=True)
class Polygons:
    """Faces with any number of corners.

    Attributes
    ----------
    corners : (c,) int64
        Points of all faces, one face after the other.
    sizes : (m,) int64
        The number of corners of each face.
    """

    corners: Any
    sizes: Any

    @classmethod
    def of_rows(cls, rows: Any) -> "Polygons":
        """Make faces of (m, k) corners."""
        rows = np.asarray(rows, dtype=np.int64)
        return cls(rows.ravel(), np.full(len(rows), rows.shape[1]))

    @property
    def starts(self) -> Any:
        """(m,) int64, where in `corners` each face begins."""
        return np.cumsum(self.sizes) - self.sizes

    @cached_property
    def face_of_triangle(self) -> Any:
        """(t,) int64, the face that each triangle is a part of."""
        return np.repeat(np.arange(len(self.sizes)), np.maximum(self.sizes - 2, 0))

    @cached_property
    def triangles(self) -> Any:
        """(t, 3) int64, each face as a fan from its first corner."""
        parts = np.maximum(self.sizes - 2, 0)
        face = self.face_of_triangle
        nth = np.arange(len(face)) - np.repeat(np.cumsum(parts) - parts, parts)
        first = self.starts[face]
        at = np.stack([first, first + nth + 1, first + nth + 2], axis=1)
        return self.corners[at]

    def turned(self, which: Any) -> "Polygons":
        """Return the faces with some (m,) bool of them wound the other way around.

        Each keeps its first corner.
        """
        face = np.repeat(np.arange(len(self.sizes)), self.sizes)
        start, size = self.starts[face], self.sizes[face]
        nth = np.arange(len(face)) - start
        mirrored = start + np.where(nth == 0, 0, size - nth)
        at = np.where(which[face], mirrored, np.arange(len(face)))
        return Polygons(self.corners[at], self.sizes)


@dataclass(frozen=True)
class Shape:
    """Points, faces and whatever else a file has for each point.

    Attributes
    ----------
    points : (n, 3) float32 or float64
        In the order and precision of the file; rows that are not finite stay.
    polygons : Polygons or None
    normals : (n, 3) float or None
    columns : mapping of str to (n,) array
        The rest, by name: red, green, blue, intensity, ...
    kept : object
        What its format needs to write the file again as it was.
    suffix : str
        Of the file's name, in small letters.
    """

    points: Any
    polygons: Polygons | None = None
    normals: Any = None
    columns: Mapping[str, Any] = field(default_factory=dict)
    kept: Any = None
    suffix: str = ""

    @property
    def faces(self) -> Any:
        """(t, 3) int64 triangles, or None for points alone."""
        if self.polygons is None or not len(self.polygons.triangles):
            return None
        return self.polygons.triangles


def checked(shape: Shape) -> Shape:
    """Return the shape when its faces refer to points that are there."""
    if shape.polygons is None or not len(shape.polygons.corners):
        return shape
    low, high = shape.polygons.corners.min(), shape.polygons.corners.max()
    if low < 0 or high >= len(shape.points):
        wrong = low if low < 0 else high
        raise FileError(
            f"expected faces over points 0 to {len(shape.points) - 1}, "
            f"got a face with point {wrong}"
        )
    return shape


def checked_count(count: int, each: int, available: int, what: str) -> int:
    """Return a count of a header when the file is long enough for it.

    Parameters
    ----------
    count : int
    each : int
        Bytes that each takes at least.
    available : int
        Bytes that are there.
    what : str
        What is counted, in plural.
    """
    if count < 0 or count * max(each, 1) > available:
        raise FileError(
            f"expected {count:,} {what}, which its header announces, "
            f"got a file that ends before ({available:,} bytes left)"
        )
    return count


def looks_unit(vectors: Any) -> bool:
    """Whether (n, 3) numbers are normals: all of length one, or zero, and not all."""
    with np.errstate(all="ignore"):
        square = (np.asarray(vectors, dtype=np.float64) ** 2).sum(axis=1)
        unit = np.abs(square - 1) < 0.02
        return bool(unit.any() and (unit | (square == 0) | np.isnan(square)).all())


def as_bytes(colors: Any) -> Any:
    """Return colors 0..255 as uint8, of bytes, of words, or of shares 0..1."""
    colors = np.asarray(colors)
    if colors.dtype.kind == "f":
        top = 1.0 if np.nanmax(colors, initial=0) <= 1 else 255.0
        return np.clip(np.nan_to_num(colors) * (255 / top) + 0.5, 0, 255).astype("u1")
    if colors.dtype.itemsize > 1 and colors.max(initial=0) > 255:
        return (colors >> 8).astype("u1")
    return np.clip(colors, 0, 255).astype("u1")


COLORS = ("red", "green", "blue")
NORMALS = ("nx", "ny", "nz")
