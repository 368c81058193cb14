# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes of exact solids: smooth ones, organic ones, and parts with creases.

Every solid is made of smooth pieces that know their normals everywhere. A face belongs
to one piece, and the true normal at a corner is that of the face's piece at the vertex:
so the truth at a crease is two normals, not their mean.
"""

from dataclasses import replace

import numpy as np
from parts import Arc, Line, cam, cube, extruded, knob, revolved, spool
from scipy.spatial import ConvexHull, Delaunay
from solid import Solid, cut

from core.mesh.faces import face_vectors, unit


def smooth_solids():
    """Yield the smooth and organic solids."""
    yield _radial("sphere", 2500, lambda d: np.ones(len(d)))
    yield _torus()
    yield _radial("bumpy", 6000, lambda d: 1 + 0.12 * np.sin(6 * d).prod(axis=1))
    yield netted("blobs", _blobs, 44)
    yield replace(netted("creature", _creature, 60), cells=48)


def creased_solids():
    """Yield the parts with creases."""
    yield cube(16)
    yield extruded("cylinder", [Arc((0, 0), 1.0, 0, 2 * np.pi)], 1.6, 0.12)
    corner = [(0, 0), (2, 0), (2, 0.8), (0.8, 0.8), (0.8, 2), (0, 2)]
    ell = [Line(a, b) for a, b in zip(corner, corner[1:] + corner[:1], strict=True)]
    yield extruded("L-shape", ell, 0.9, 0.1)
    yield extruded("cam", cam(), 0.7, 0.07)
    yield revolved("spool", spool(), 72, 0.08)


def unseen_solids():
    """Yield solids on which no threshold was set."""
    yield _ellipsoid(np.array([1.6, 1.0, 0.45]))
    yield _radial(
        "wavy",
        9000,
        lambda d: 1 + 0.03 * np.sin(14 * d[:, 0]) * np.sin(14 * d[:, 1] + 1),
    )
    yield _terrain()
    yield _radial(
        "star",
        7000,
        lambda d: (
            1
            + 0.12 * np.cos(5 * np.arctan2(d[:, 1], d[:, 0])) * (1 - d[:, 2] ** 2) ** 2
            + 0.05 * np.sin(9 * d[:, 2])
        ),
    )
    yield revolved("knob", knob(), 90, 0.05)


def _radial(name, count, radius):
    """Return a star-shaped solid over points spread evenly on the sphere."""
    i = np.arange(count) + 0.5
    z, turn = 1 - 2 * i / count, np.pi * (1 + np.sqrt(5)) * i
    # Spirals are too regular to be met in practice.
    rng = np.random.default_rng(3)
    d = np.stack([np.sqrt(1 - z * z) * f(turn) for f in (np.cos, np.sin)] + [z], axis=1)
    d = unit(d + rng.normal(0, 0.35 / np.sqrt(count), d.shape))
    faces = ConvexHull(d).simplices
    inward = (face_vectors(d, faces) * d[faces[:, 0]]).sum(axis=1) < 0
    faces[inward] = faces[inward, ::-1]

    def field(p):
        length = np.linalg.norm(p, axis=1)
        return length - radius(p / np.maximum(length, 1e-12)[:, None])

    return _of_field(name, d * radius(d)[:, None], faces, field)


def _torus(count=5000, big=1.0, small=0.35):
    """Return a torus over a Delaunay triangulation of its scattered parameters."""
    n1 = int(np.sqrt(count * big / small))
    n2 = count // n1
    rng = np.random.default_rng(5)
    i, j = np.divmod(np.arange(n1 * n2), n2)
    u = (i + rng.uniform(0, 0.6, i.shape)) / n1
    v = (j + rng.uniform(0, 0.6, i.shape)) / n2
    tiles = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)]
    plane = np.concatenate(
        [np.stack([(u + a) * n1, (v + b) * n2], axis=1) for a, b in tiles]
    )
    triangles = Delaunay(plane).simplices
    middle = plane[triangles].mean(axis=1) / (n1, n2)
    inside = ((middle >= 0) & (middle < 1)).all(axis=1)
    faces = triangles[inside] % len(u)
    u, v = 2 * np.pi * u, 2 * np.pi * v
    ring = big + small * np.cos(v)
    points = np.stack([ring * np.cos(u), ring * np.sin(u), small * np.sin(v)], axis=1)

    def field(p):
        return np.hypot(np.hypot(p[:, 0], p[:, 1]) - big, p[:, 2]) - small

    solid = _of_field("torus", points, faces, field)
    truth = solid.normals[0](points[faces].mean(axis=1))
    side = (face_vectors(points, faces) * truth).sum(axis=1)
    turned = np.where((side < 0)[:, None], faces[:, ::-1], faces)
    return _of_field("torus", points, turned, field)


def _ellipsoid(axes):
    """Return a ball stretched along its axes."""
    ball = _radial("ball", 4000, lambda d: np.ones(len(d)))

    def field(p):
        return np.linalg.norm(p / axes, axis=1) - 1

    return _of_field("ellipsoid", ball.points * axes, ball.faces, field)


def _terrain(rows=70):
    """Return an open height field over a grid that is a little uneven."""
    rng = np.random.default_rng(4)
    axis = np.linspace(-3, 3, rows)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    grid += rng.uniform(-0.02, 0.02, grid.shape)

    def normals(p):
        x, y = p[:, 0], p[:, 1]
        ridge = np.cos(3 * x + y)
        along_x = 0.68 * np.cos(1.7 * x) * np.cos(1.3 * y) + 0.45 * ridge
        along_y = -0.52 * np.sin(1.7 * x) * np.sin(1.3 * y) + 0.15 * ridge
        return unit(np.stack([-along_x, -along_y, np.ones_like(x)], axis=1))

    x, y = grid.T
    height = 0.4 * np.sin(1.7 * x) * np.cos(1.3 * y) + 0.15 * np.sin(3 * x + y)
    number = np.arange(rows**2).reshape(rows, rows)
    square = [number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]]
    faces = cut(np.stack(square, axis=-1).reshape(-1, 4))[0]
    piece = np.zeros(len(faces), dtype=int)
    points = np.column_stack([grid, height])
    return Solid("terrain", points, faces, piece, [normals])


def _blobs(p):
    centers = np.array([(0, 0, 0), (0.75, 0.1, 0), (-0.2, 0.7, 0.2), (0.1, -0.3, 0.75)])
    radii = np.array([0.5, 0.42, 0.4, 0.35])
    square = ((p[:, None] - centers) ** 2).sum(axis=2)
    total = np.exp(-2.5 * (square / radii**2 - 1)).sum(axis=1)
    return -np.log(np.maximum(total, 1e-300)) / 8


def _creature(p):
    """A body with head, limbs and tail, smoothly joined."""
    bones = [
        ((0, 0, 0), (0.8, 0, 0.1), 0.30),
        ((0.8, 0, 0.1), (1.15, 0, 0.45), 0.2),
        ((1.15, 0, 0.45), (1.4, 0, 0.4), 0.17),
        ((0.05, 0.15, 0), (0.0, 0.3, -0.7), 0.10),
        ((0.05, -0.15, 0), (0.0, -0.3, -0.7), 0.10),
        ((0.75, 0.15, 0), (0.85, 0.28, -0.65), 0.09),
        ((0.75, -0.15, 0), (0.85, -0.28, -0.65), 0.09),
        ((0, 0, 0.1), (-0.7, 0, 0.5), 0.08),
    ]
    total = np.zeros(len(p))
    for start, end, radius in bones:
        a, b = np.array(start, float), np.array(end, float)
        share = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        distance = np.linalg.norm(p - a - share[:, None] * (b - a), axis=1) - radius
        total += np.exp(-18 * distance)
    return -np.log(np.maximum(total, 1e-300)) / 18


def gradient(field, points, step=1e-5):
    """Return the gradient of a field by central differences, (n, 3)."""
    steps = step * np.eye(3)
    return np.stack(
        [(field(points + e) - field(points - e)) / (2 * step) for e in steps], axis=1
    )


def projected(field, points, rounds=6):
    """Move points to the zero of a field along its gradient."""
    for _ in range(rounds):
        slope = gradient(field, points)
        length = np.maximum((slope * slope).sum(axis=1), 1e-12)
        points = points - (field(points) / length)[:, None] * slope
    return points


def _of_field(name, points, faces, field):
    def normals(p):
        return unit(gradient(field, projected(field, p)))

    piece = np.zeros(len(faces), dtype=int)
    return Solid(name, points, faces, piece, [normals], field)


def netted(name, field, cells):
    """Return a smooth solid over a surface net whose vertices lie on the surface."""
    points, faces = surface_net(field, box_of(field), cells)
    return _of_field(name, projected(field, points), faces, field)


def box_of(field):
    """Return low and high corners of the solid, with a margin."""
    axis = np.linspace(-2.5, 2.5, 64)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    grid = grid.reshape(-1, 3)
    inside = grid[field(grid) < 0]
    return inside.min(axis=0) - 0.15, inside.max(axis=0) + 0.15


def voxel_grid(box, cells):
    """Return the places of a grid over a box, (a, b, c, 3), and their distance."""
    low, high = box
    step = (high - low).max() / cells
    counts = np.ceil((high - low) / step).astype(int) + 1
    axes = [low[i] + step * np.arange(counts[i]) for i in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1), step


def surface_net(field, box, cells):
    """Return a surface net of a field's zero: points (n, 3), faces (m, 3).

    One vertex in each cell that the surface passes, at the mean of its crossings with
    the cell's edges, and a square over each grid edge that it crosses, as the voxel
    remeshers of modelling programs make them.
    """
    grid, step = voxel_grid(box, cells)
    values = field(grid.reshape(-1, 3)).reshape(grid.shape[:3])
    inside = values < 0
    shape = np.array(values.shape) - 1
    total, count = np.zeros((*shape, 3)), np.zeros(tuple(shape))
    squares = []
    for axis in range(3):
        low = [slice(None)] * 3
        high = [slice(None)] * 3
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        a, b = values[tuple(low)], values[tuple(high)]
        crossed = np.argwhere((a < 0) != (b < 0))
        va, vb = a[tuple(crossed.T)], b[tuple(crossed.T)]
        place = crossed.astype(float)
        place[:, axis] += va / (va - vb)
        one, two = (axis + 1) % 3, (axis + 2) % 3
        around = []
        for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1)):
            cell = crossed.copy()
            cell[:, one] -= di
            cell[:, two] -= dj
            np.add.at(total, tuple(cell.T), place)
            np.add.at(count, tuple(cell.T), 1)
            around.append(np.ravel_multi_index(cell.T, tuple(shape)))
        square = np.stack(around, axis=1)
        outward = inside[tuple(low)][tuple(crossed.T)]
        squares.append(np.where(outward[:, None], square[:, ::-1], square))
    squares = np.concatenate(squares)
    used, corner = np.unique(squares, return_inverse=True)
    corner = corner.reshape(squares.shape)
    place = total.reshape(-1, 3)[used] / count.reshape(-1)[used, None]
    faces = np.concatenate([corner[:, [0, 1, 2]], corner[:, [0, 2, 3]]])
    points = grid[0, 0, 0] + step * place
    middle = points[faces].mean(axis=1)
    side = (face_vectors(points, faces) * gradient(field, middle)).sum()
    return points, faces if side > 0 else faces[:, ::-1]
