# SPDX-License-Identifier: GPL-3.0-or-later
"""OFF as text, with the normals (N) and colors (C) that its first word announces."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .shape import COLORS, FileError, Polygons, Shape, as_bytes, checked, checked_count

_KEY = re.compile(r"(ST)?(C)?(N)?(4)?(n)?OFF")


@dataclass(frozen=True)
class Rest:
    """What follows the corners on the lines of the faces, such as their colors."""

    behind: list[str]
    polygons: Polygons


def read(path: Path) -> Shape:
    """Read vertices, their normals and colors, and faces."""
    text = path.read_text("latin-1")
    lines = [line.partition("#")[0].strip() for line in text.split("\n")]
    lines = [line for line in lines if line]
    key, _, rest = (lines[0] if lines else "").partition(" ")
    found = _KEY.fullmatch(key)
    if not found:
        raise FileError("expected an OFF file, which begins with OFF")
    if "BINARY" in rest.upper():
        raise FileError("expected OFF as text, got a binary one")
    _, colors, normals, four, many = found.groups()
    if four or many or found[1]:
        raise FileError(f"expected points in space, got {key}")
    lines = ([rest] if rest.strip() else []) + lines[1:]
    count, faces = _counts(lines[:1])
    checked_count(count + faces, 1, len(lines) - 1, "vertices and faces")
    table = _table(lines[1 : 1 + count], 6 if normals else 3)
    columns = {}
    if colors and table.shape[1] >= (9 if normals else 6):
        first = 6 if normals else 3
        columns = dict(
            zip(COLORS, as_bytes(table[:, first : first + 3]).T, strict=True)
        )
    corners, sizes, behind = _faces(lines[1 + count : 1 + count + faces])
    polygons = Polygons(corners, sizes) if len(sizes) else None
    kept = Rest(behind, polygons) if polygons is not None else None
    given = table[:, 3:6] if normals else None
    return checked(Shape(table[:, :3], polygons, given, columns, kept))


def _counts(lines):
    words = lines[0].split() if lines else []
    if len(words) < 2 or not all(word.isdecimal() for word in words[:2]):
        raise FileError("expected the numbers of vertices and faces, got none")
    return int(words[0]), int(words[1])


def _table(lines, least):
    try:
        table = np.loadtxt(lines, ndmin=2) if lines else np.empty((0, least))
    except ValueError:
        raise FileError("expected as many numbers on each line of a vertex") from None
    if table.shape[1] < least or not len(table):
        raise FileError(f"expected vertices of {least} numbers, got {table.shape[1]}")
    return table


def _faces(lines):
    corners: list[int] = []
    sizes, behind = [], []
    for line in lines:
        words = line.split()
        try:
            size = int(words[0])
            if not 0 <= size < len(words):
                raise ValueError(line)
            corners += map(int, words[1 : 1 + size])
            sizes.append(size)
        except ValueError:
            raise FileError(f"expected a face, got the line {line[:60]!r}") from None
        behind.append(" ".join(words[1 + size :]))
    try:
        return np.array(corners, np.int64), np.array(sizes, np.int64), behind
    except OverflowError:
        raise FileError("expected faces over points that are there") from None


def write(path: Path, shape: Shape) -> None:
    """Write a shape with normals; colors of faces stay where it was OFF before."""
    colored = set(COLORS) <= set(shape.columns)
    faces = shape.polygons
    columns: list[Any] = [*shape.points.T, *shape.normals.T]
    if colored:
        rgb = as_bytes(np.stack([shape.columns[name] for name in COLORS], axis=1))
        columns += [*rgb.T, np.full(len(rgb), 255, "u1")]
    said = [column.astype("U").tolist() for column in columns]
    lines = [("C" if colored else "") + "NOFF"]
    lines.append(f"{len(shape.points)} {0 if faces is None else len(faces.sizes)} 0")
    lines += map(" ".join, zip(*said, strict=True))
    path.write_text("\n".join([*lines, *_face_lines(shape), ""]), "latin-1")


def _face_lines(shape):
    faces = shape.polygons
    if faces is None:
        return
    sizes = faces.sizes.tolist()
    behind = shape.kept.behind if isinstance(shape.kept, Rest) else [""] * len(sizes)
    corners, at = faces.corners.tolist(), 0
    for size, rest in zip(sizes, behind, strict=True):
        words = [size, *corners[at : at + size], *([rest] if rest else [])]
        yield " ".join(map(str, words))
        at += size
