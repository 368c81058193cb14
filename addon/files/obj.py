# SPDX-License-Identifier: GPL-3.0-or-later
"""OBJ: every line is kept; only normals and the references to them change."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .shape import COLORS, FileError, Polygons, Shape, checked

_ENCODING = "latin-1"


@dataclass(frozen=True)
class Lines:
    """The lines of a file, those of its faces, and the faces as they were read."""

    lines: list[str]
    faces: list[int]
    polygons: Polygons | None


def read(path: Path) -> Shape:
    """Read vertices, their colors, faces and normals."""
    text = path.read_bytes().decode(_ENCODING).replace("\r\n", "\n")
    lines = text.replace("\\\n", " ").split("\n")
    of_kind: dict[str, list[int]] = {"v": [], "vn": [], "f": []}
    seen = []  # How many vertices and normals stand above each face.
    for at, line in enumerate(lines):
        kind = line.split(None, 1)[:1]
        if kind and kind[0] in of_kind:
            of_kind[kind[0]].append(at)
            if kind[0] == "f":
                seen.append((len(of_kind["v"]), len(of_kind["vn"])))
    table = _numbers(lines, of_kind["v"])
    if not len(table) or table.shape[1] < 3:
        raise FileError("expected vertices of three coordinates, got none")
    given = _numbers(lines, of_kind["vn"])
    corners, at_normals, sizes = _faces(lines, of_kind["f"], seen)
    polygons = Polygons(corners, sizes) if len(sizes) else None
    columns = {}
    if table.shape[1] >= 6:
        columns = dict(zip(COLORS, table[:, -3:].T, strict=True))
    kept = Lines(lines, of_kind["f"], polygons)
    shape = checked(Shape(table[:, :3], polygons, None, columns, kept))
    normals = _vertex_normals(len(table), given, corners, at_normals)
    return Shape(shape.points, polygons, normals, columns, kept)


def _numbers(lines, rows):
    """Return the numbers behind the first word of lines, (n, c)."""
    if not rows:
        return np.empty((0, 0))
    try:
        width = len(lines[rows[0]].split("#")[0].split())
        columns = range(1, width)
        return np.loadtxt((lines[at] for at in rows), usecols=columns, ndmin=2)
    except ValueError:
        raise FileError(
            f"expected as many numbers on each line {lines[rows[0]].split()[0]}, "
            "got other ones"
        ) from None


def _faces(lines, rows, seen):
    """Return the points and normals of all corners (0-based, -1 for none), sizes."""
    corners, normals, sizes = [], [], []
    for at, (points_above, normals_above) in zip(rows, seen, strict=True):
        tokens = lines[at].split("#")[0].split()[1:]
        try:
            for token in tokens:
                point, *rest = token.split("/")
                corners.append(_index(point, points_above))
                has_normal = len(rest) == 2 and rest[1]
                normals.append(_index(rest[1], normals_above) if has_normal else -1)
        except ValueError:
            raise FileError(
                f"line {at + 1}: expected a face, got {lines[at][:60]!r}"
            ) from None
        sizes.append(len(tokens))
    return tuple(np.array(a, dtype=np.int64) for a in (corners, normals, sizes))


def _index(text, above):
    """Return an index from 0 of one from 1, or of one that counts backward."""
    number = int(text)
    if number == 0 or abs(number) > 2**62:
        raise ValueError(text)
    return number - 1 if number > 0 else above + number


def _vertex_normals(count, given, corners, at_normals):
    """Return the mean of the normals at the corners of each vertex, or None."""
    if given.shape[1:] != (3,):
        return None
    used = at_normals >= 0
    if not used.any():
        return given if len(given) == count else None
    if at_normals.max() >= len(given):
        raise FileError(
            f"expected {at_normals.max() + 1} normals, to which faces refer, "
            f"got {len(given)}"
        )
    vectors, at = given[at_normals[used]], corners[used]
    total = np.stack([np.bincount(at, axis, count) for axis in vectors.T], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.zeros_like(total), where=length > 0)


def write(path: Path, shape: Shape) -> None:
    """Write a shape, with all other lines where it came from an OBJ file."""
    kept = shape.kept
    said = [f"vn {x:.9g} {y:.9g} {z:.9g}" for x, y, z in shape.normals.tolist()]
    if isinstance(kept, Lines):
        lines = _rewritten(kept, shape.polygons, said)
    else:
        lines = [*_vertices(shape), *said, *_face_lines(shape.polygons), ""]
    path.write_bytes("\n".join(lines).encode(_ENCODING, "replace"))


def _rewritten(kept, polygons, said):
    lines: list[Any] = list(kept.lines)
    if kept.polygons is not None:
        ends = np.cumsum(polygons.sizes).tolist()
        corners, before = polygons.corners.tolist(), kept.polygons.corners.tolist()
        start = 0
        for at, end in zip(kept.faces, ends, strict=True):
            now, then = corners[start:end], before[start:end]
            tokens = lines[at].split("#")[0].split()[1:]
            if now != then:
                # Turned around, a corner takes its texture coordinate along.
                of_point = dict(zip(then, tokens, strict=True))
                tokens = [of_point[point] for point in now]
            pairs = zip(tokens, now, strict=True)
            lines[at] = "f " + " ".join(_corner(*pair) for pair in pairs)
            start = end
    first = kept.faces[0] if kept.faces else len(lines) - (lines[-1] == "")
    head = [line for line in lines[:first] if line.split(None, 1)[:1] != ["vn"]]
    tail = [line for line in lines[first:] if line.split(None, 1)[:1] != ["vn"]]
    return head + said + tail


def _corner(token, point):
    """Return a face's reference to a point with the normal of the same number."""
    parts = [*token.split("/"), "", ""]
    return f"{parts[0]}/{parts[1]}/{point + 1}"


def _vertices(shape):
    columns = [*shape.points.T]
    if set(COLORS) <= set(shape.columns):
        colors = [np.asarray(shape.columns[name]) for name in COLORS]
        columns += [
            c / np.iinfo(c.dtype).max if c.dtype.kind == "u" else c for c in colors
        ]
    said = [column.astype("U").tolist() for column in columns]
    return ["v " + " ".join(row) for row in zip(*said, strict=True)]


def _face_lines(polygons):
    if polygons is None:
        return []
    corners = [f"{i}//{i}" for i in (polygons.corners + 1).tolist()]
    ends = np.cumsum(polygons.sizes).tolist()
    return [
        "f " + " ".join(corners[end - size : end])
        for size, end in zip(polygons.sizes.tolist(), ends, strict=True)
    ]
