# SPDX-License-Identifier: GPL-3.0-or-later
"""Solids with creases: outlines of lines and arcs, extruded or revolved, and a cube."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay, cKDTree
from solid import Solid, cut


@dataclass(frozen=True)
class Line:
    """A straight part of an outline; the solid is to its left."""

    start: tuple
    end: tuple

    def sampled(self, step):
        a, b = np.array(self.start, float), np.array(self.end, float)
        count = max(1, round(np.linalg.norm(b - a) / step))
        return a + np.linspace(0, 1, count + 1)[:, None] * (b - a)

    def normal(self, q):
        x, y = np.subtract(self.end, self.start)
        return np.tile(np.array([y, -x]) / np.hypot(x, y), (len(q), 1))


@dataclass(frozen=True)
class Arc:
    """A part of a circle between two angles; hollow where it turns clockwise."""

    center: tuple
    radius: float
    start: float
    end: float

    def sampled(self, step):
        length = abs(self.end - self.start) * self.radius
        turn = np.linspace(self.start, self.end, max(3, round(length / step)) + 1)
        around = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        return np.array(self.center) + self.radius * around

    def normal(self, q):
        out = np.asarray(q) - self.center
        length = np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12)
        return np.sign(self.end - self.start) * out / length


def cam():
    """An outline of arcs and lines that meet smoothly, at creases and in a hollow."""
    return [
        Line((-1.0, -0.6), (1.0, -0.6)),
        Arc((1.0, 0.0), 0.6, -np.pi / 2, np.pi / 2),
        Line((1.0, 0.6), (0.5, 0.6)),
        Arc((0.0, 0.6), 0.5, 0.0, -np.pi),
        Line((-0.5, 0.6), (-1.0, 0.6)),
        Line((-1.0, 0.6), (-1.0, -0.6)),
    ]


def spool():
    """The outline of a ring in radius and height: flanges, a hollow waist, a bore."""
    return [
        Line((0.25, -0.8), (1.0, -0.8)),
        Line((1.0, -0.8), (1.0, -0.5)),
        Arc((1.0, 0.0), 0.5, 3 * np.pi / 2, np.pi / 2),
        Line((1.0, 0.5), (1.0, 0.8)),
        Line((1.0, 0.8), (0.25, 0.8)),
        Line((0.25, 0.8), (0.25, -0.8)),
    ]


def knob():
    """The outline of a ring in radius and height: rounded edges, a hollow neck."""
    return [
        Line((0.2, 0.0), (0.8, 0.0)),
        Arc((0.8, 0.2), 0.2, -np.pi / 2, 0.0),
        Line((1.0, 0.2), (1.0, 0.4)),
        Arc((0.7, 0.4), 0.3, 0.0, np.pi / 2),
        Arc((0.7, 0.95), 0.25, 3 * np.pi / 2, np.pi),
        Line((0.45, 0.95), (0.45, 1.3)),
        Line((0.45, 1.3), (0.2, 1.3)),
        Line((0.2, 1.3), (0.2, 0.0)),
    ]


def _outline(segments, step):
    """Return the places of a closed outline (k, 2), and the segment of each side."""
    parts = [segment.sampled(step)[:-1] for segment in segments]
    sides = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    return np.concatenate(parts), sides


def extruded(name, segments, height, step):
    """Return the solid between two copies of an outline that runs counterclockwise."""
    outline, sides = _outline(segments, step)
    k, rows = len(outline), max(2, round(height / step)) + 1
    levels = np.linspace(0, height, rows)
    wall = np.concatenate([np.column_stack([outline, np.full(k, z)]) for z in levels])
    faces, piece = _bands(k, rows, sides, closed=False)
    inner, cap = _filled(outline, step)
    ends = []
    for number, row in enumerate((0, rows - 1)):
        first = len(wall) + number * len(inner)
        index = np.concatenate([row * k + np.arange(k), first + np.arange(len(inner))])
        ends.append(index[cap if number else cap[:, ::-1]])
    points = np.concatenate(
        [wall] + [np.column_stack([inner, np.full(len(inner), z)]) for z in (0, height)]
    )
    count = len(segments)
    pieces = [piece] + [np.full(len(cap), count + i) for i in range(2)]
    normals = [_on_wall(segment) for segment in segments]
    normals += [_constant((0, 0, -1)), _constant((0, 0, 1))]
    return Solid(
        name, points, np.concatenate([faces, *ends]), np.concatenate(pieces), normals
    )


def revolved(name, segments, turns, step):
    """Return the ring that an outline in radius and height makes around the axis."""
    outline, sides = _outline(segments, step)
    k = len(outline)
    angle = 2 * np.pi * np.arange(turns) / turns
    r, z = outline.T
    points = np.concatenate(
        [np.column_stack([r * np.cos(a), r * np.sin(a), z]) for a in angle]
    )
    faces, piece = _bands(k, turns, sides, closed=True)
    # Along the angle the band turns the other way than along the height.
    faces = faces[:, ::-1]
    return Solid(name, points, faces, piece, [_turned(s) for s in segments])


def cube(cells):
    """Return the cube from -1 to 1 over grids whose squares are cut at random."""
    axis = np.linspace(-1, 1, cells + 1)
    a, b = (g.ravel() for g in np.meshgrid(axis, axis, indexing="ij"))
    number = np.arange((cells + 1) ** 2).reshape(cells + 1, -1)
    square = [number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]]
    triangles = cut(np.stack(square, axis=-1).reshape(-1, 4))[0]
    points, faces, normals = [], [], []
    for i in range(3):
        for side in (-1, 1):
            part = np.empty((len(a), 3))
            part[:, i], part[:, (i + 1) % 3], part[:, (i + 2) % 3] = side, a, b
            turned = triangles if side > 0 else triangles[:, ::-1]
            faces.append(turned + len(points) * len(a))
            points.append(part)
            normals.append(_constant(side * np.eye(3)[i]))
    points = np.concatenate(points)
    points, index = np.unique(points.round(9), axis=0, return_inverse=True)
    piece = np.repeat(np.arange(6), len(triangles))
    return Solid("cube", points, index.ravel()[np.concatenate(faces)], piece, normals)


def _bands(k, rows, sides, *, closed):
    """Return triangles between rows of k places in a ring, and the side of each."""
    row, at = (g.ravel() for g in np.mgrid[: rows if closed else rows - 1, :k])
    after, above = (at + 1) % k, (row + 1) % rows
    square = np.stack(
        [row * k + at, row * k + after, above * k + after, above * k + at], axis=1
    )
    faces, owner = cut(square)
    return faces, sides[at[owner]]


def _filled(outline, step):
    """Return places inside an outline, and triangles over it and them."""
    low, high = outline.min(axis=0), outline.max(axis=0)
    axes = [np.arange(low[i], high[i], step) for i in range(2)]
    rng = np.random.default_rng(2)
    inner = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    inner = inner + rng.uniform(-0.25, 0.25, inner.shape) * step
    away = cKDTree(outline).query(inner)[0] > 0.6 * step
    inner = inner[away & _within(outline, inner)]
    places = np.concatenate([outline, inner])
    triangles = Delaunay(places).simplices
    corners = places[triangles]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    double = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    kept = _within(outline, corners.mean(axis=1)) & (np.abs(double) > 1e-9)
    triangles, double = triangles[kept], double[kept]
    return inner, np.where((double < 0)[:, None], triangles[:, ::-1], triangles)


def _within(outline, places):
    """Whether places (p, 2) are inside an outline (k, 2): rays cross it oddly often."""
    a, b = outline, np.roll(outline, -1, axis=0)
    x, y = places[:, :1], places[:, 1:]
    passed = (a[:, 1] > y) != (b[:, 1] > y)
    rise = np.where(a[:, 1] == b[:, 1], 1, b[:, 1] - a[:, 1])
    right = x < a[:, 0] + (y - a[:, 1]) / rise * (b[:, 0] - a[:, 0])
    return (passed & right).sum(axis=1) % 2 == 1


def _constant(normal):
    return lambda p: np.tile(np.array(normal, float), (len(p), 1))


def _on_wall(segment):
    return lambda p: np.column_stack([segment.normal(p[:, :2]), np.zeros(len(p))])


def _turned(segment):
    def normals(p):
        r = np.maximum(np.hypot(p[:, 0], p[:, 1]), 1e-12)
        flat = segment.normal(np.column_stack([r, p[:, 2]]))
        return np.column_stack(
            [flat[:, 0] * p[:, 0] / r, flat[:, 0] * p[:, 1] / r, flat[:, 1]]
        )

    return normals
