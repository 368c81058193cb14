# SPDX-License-Identifier: GPL-3.0-or-later
"""STL, text and binary: triangles whose corners are joined where they coincide."""

import re
from pathlib import Path

import numpy as np

from .shape import FileError, Polygons, Shape, checked_count

_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("extra", "<u2")])
_HEADER = 80
_NUMBER = rb"[-+.\dA-Za-z]+"
_VERTEX = re.compile(rb"vertex\s+(%b)\s+(%b)\s+(%b)" % ((_NUMBER,) * 3))


def read(path: Path) -> Shape:
    """Read triangles; corners in one place become one point, in order of appearance."""
    data = path.read_bytes()
    corners = _text(data) if _is_text(data) else _binary(data)
    if not len(corners):
        raise FileError("expected triangles, got none")
    # Zeros of either sign are one place.
    key = np.ascontiguousarray(corners + 0.0)
    raw = key.view(np.dtype((np.void, key.dtype.itemsize * 3)))[:, 0]
    _, first, inverse = np.unique(raw, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    faces = rank[inverse.ravel()].reshape(-1, 3)
    return Shape(corners[first[order]], Polygons.of_rows(faces))


def _is_text(data):
    # Binary files may begin with "solid" too; their length follows from their count.
    if data.lstrip()[:5].lower() != b"solid":
        return False
    count = int.from_bytes(data[_HEADER : _HEADER + 4], "little")
    return len(data) != _HEADER + 4 + count * _RECORD.itemsize


def _binary(data):
    if len(data) < _HEADER + 4:
        raise FileError("expected an STL file, got one without a whole header")
    count = int.from_bytes(data[_HEADER : _HEADER + 4], "little")
    left = len(data) - _HEADER - 4
    checked_count(count, _RECORD.itemsize, left, "triangles")
    rows = np.frombuffer(data, _RECORD, count, _HEADER + 4)
    return rows["corners"].reshape(-1, 3)


def _text(data):
    found = _VERTEX.findall(data)
    if data.count(b"vertex") != len(found) or len(found) % 3:
        raise FileError("expected three vertices of three numbers for each facet")
    try:
        return np.array([tuple(map(float, row)) for row in found]).reshape(-1, 3)
    except ValueError:
        raise FileError("expected numbers behind each vertex") from None


def write(path: Path, shape: Shape) -> None:
    """Write triangles, each with its own normal: STL has none for points."""
    faces = shape.faces
    if faces is None:
        raise FileError("STL holds triangles: choose .ply for points alone")
    rows = np.zeros(len(faces), _RECORD)
    corners = shape.points[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    rows["normal"] = np.divide(normal, length, where=length > 0, out=normal * 0)
    rows["corners"] = corners
    with path.open("wb") as file:
        file.write(b"normals and winding repaired".ljust(_HEADER))
        file.write(len(rows).to_bytes(4, "little"))
        file.write(rows.tobytes())
