# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes of exact solids: smooth ones, organic ones, and parts with creases.

Every solid is made of smooth pieces that know their normals everywhere. A face belongs
to one piece, and the true normal at a corner is that of the face's piece at the vertex:
so the truth at a crease is two normals, not their mean.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull, Delaunay, cKDTree

from core.mesh.faces import face_vectors, unit

# What a turn of a normal weighs beside a distance, as a share of the solid's size, when
# a face looks for its piece: both sides of a crease are near, one faces as it does.
_TURN_WEIGHT = 0.1


@dataclass(frozen=True)
class Solid:
    """A clean mesh on an exact surface.

    Attributes
    ----------
    points, faces : (n, 3) float64, (m, 3) int
    piece : (m,) int
        Which of the pieces each face belongs to.
    normals : list of callables (p, 3) -> (p, 3)
        The unit normals of the pieces.
    field : callable (p, 3) -> (p,) or None
        Negative inside, zero on the surface of smooth solids.
    cells : int
        Voxels along the longest side, so that the thinnest part is three wide.
    """

    name: str
    points: np.ndarray
    faces: np.ndarray
    piece: np.ndarray
    normals: Sequence[Callable]
    field: Callable | None = None
    cells: int = 32

    @property
    def creased(self):
        return len(self.normals) > 1

    def corner_truth(self, points, faces, piece):
        """Return the normals of the faces' pieces at their corners, (m, 3, 3)."""
        truth = np.empty((len(faces), 3, 3))
        for number, normals in enumerate(self.normals):
            at = piece == number
            truth[at] = normals(points[faces[at]].reshape(-1, 3)).reshape(-1, 3, 3)
        return truth

    def pieces_near(self, points, faces):
        """Return the pieces of the faces of another mesh of the same solid."""
        size = _TURN_WEIGHT * np.ptp(self.points, axis=0).max()
        own, other = (
            np.hstack([p[f].mean(axis=1), size * unit(face_vectors(p, f))])
            for p, f in ((self.points, self.faces), (points, faces))
        )
        return self.piece[cKDTree(own).query(other)[1]]

    def sharp_edges(self):
        """Return the edges (e, 2) between faces whose pieces meet at an angle."""
        ends, first, second = paired_sides(self.faces)
        apart = self.piece[first] != self.piece[second]
        ends, first, second = ends[apart], first[apart], second[apart]
        middle = self.points[ends].mean(axis=1)
        cosine = np.empty(len(ends))
        for i, (p, a, b) in enumerate(zip(middle, first, second, strict=True)):
            one, two = (self.normals[self.piece[f]](p[None])[0] for f in (a, b))
            cosine[i] = one @ two
        return ends[cosine < np.cos(np.radians(20))]


def paired_sides(faces):
    """Return the sides that two faces share: ends (s, 2), both faces (s,) each."""
    sides = np.sort(
        np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1
    )
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort(sides.T)
    sides, owner = sides[order], owner[order]
    same = np.flatnonzero((sides[1:] == sides[:-1]).all(axis=1))
    return sides[same], owner[same], owner[same + 1]


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
    yield extruded("cam", _cam(), 0.7, 0.07)
    yield revolved("spool", _spool(), 72, 0.08)


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
    yield revolved("knob", _knob(), 90, 0.05)


# Smooth solids


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
    faces = _cut(np.stack(square, axis=-1).reshape(-1, 4))[0]
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


# Solids with creases


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


def _cam():
    """An outline of arcs and lines that meet smoothly, at creases and in a hollow."""
    return [
        Line((-1.0, -0.6), (1.0, -0.6)),
        Arc((1.0, 0.0), 0.6, -np.pi / 2, np.pi / 2),
        Line((1.0, 0.6), (0.5, 0.6)),
        Arc((0.0, 0.6), 0.5, 0.0, -np.pi),
        Line((-0.5, 0.6), (-1.0, 0.6)),
        Line((-1.0, 0.6), (-1.0, -0.6)),
    ]


def _spool():
    """The outline of a ring in radius and height: flanges, a hollow waist, a bore."""
    return [
        Line((0.25, -0.8), (1.0, -0.8)),
        Line((1.0, -0.8), (1.0, -0.5)),
        Arc((1.0, 0.0), 0.5, 3 * np.pi / 2, np.pi / 2),
        Line((1.0, 0.5), (1.0, 0.8)),
        Line((1.0, 0.8), (0.25, 0.8)),
        Line((0.25, 0.8), (0.25, -0.8)),
    ]


def _knob():
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
    triangles = _cut(np.stack(square, axis=-1).reshape(-1, 4))[0]
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
    faces, owner = _cut(square)
    return faces, sides[at[owner]]


def _cut(squares):
    """Return the squares as triangles, cut at random, and the square of each."""
    turn = np.random.default_rng(1).random(len(squares)) < 0.5
    squares = np.where(turn[:, None], np.roll(squares, 1, axis=1), squares)
    faces = np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])
    return faces, np.tile(np.arange(len(squares)), 2)


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
