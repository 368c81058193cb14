# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors against the distance to a crease: a cube, fandisk, and a scanned edge."""

import importlib.util
from itertools import pairwise

import clouds
import numpy as np
import peers
from scipy.spatial import cKDTree

from core import Settings, estimate_normals

# In spacings: a spacing is the side of the square that a point has for itself.
BANDS = (0, 0.5, 1, 2, 3, 5, 10, np.inf)
SIZE = 18

# Faces that turn by more than that meet in a crease, and in one that is hardly seen.
_SHARP, _SLIGHT = 30, 5


def shapes():
    """Yield name, points, true normals and distance to a crease, in spacings."""
    yield "cube", *_cube(50_000)
    found = clouds.vertices_and_faces("fandisk")
    if found is not None:
        points, normals, sharp, slight = _fandisk(*found, 100_000)
        yield "fandisk", points, normals, sharp
        # Points without a distance are not counted.
        clear = np.where(slight >= 2, sharp, np.nan)
        yield "fandisk, away from slight creases", points, normals, clear
    path = clouds.DATA / "scan" / "fin90_with_PCA_normals.xyz"
    if path.exists():
        scanned, exact, normals, distance = _edge(np.loadtxt(path)[:, :3])
        yield "fin90", scanned, normals, distance
        yield "fin90, noise taken off", exact, normals, distance


def methods():
    """Return what takes points to normals, by name."""
    found = {
        "ours, auto": lambda points: (
            estimate_normals(points, settings=Settings(orientation="none")).normals
        )
    }
    for label, name in (("PCA (Open3D)", "Open3D"), ("jets (CGAL)", "CGAL jet")):
        module, prepare = peers.METHODS[name]
        if importlib.util.find_spec(module) is not None:
            found[f"{label}, {SIZE}"] = _peer(prepare)
    return found


def _peer(prepare):
    def run(points):
        normals = prepare(points, SIZE)()
        return np.asarray(normals() if callable(normals) else normals)

    return run


def table():
    """Return the rows of errors by band, in degrees, for docs/accuracy.md."""
    heads = [
        f"{low:g} to {high:g}" if np.isfinite(high) else f"over {low:g}"
        for low, high in pairwise(BANDS)
    ]
    lines = [
        f"| shape | method | {' | '.join(heads)} | largest beyond 2 |",
        "|---|---|" + "---|" * (len(heads) + 1),
    ]
    for shape, points, truth, distance in shapes():
        for name, method in methods().items():
            cosine = np.abs((method(points) * truth).sum(axis=1)).clip(0, 1)
            angle = np.degrees(np.arccos(cosine))
            cells = []
            for low, high in pairwise(BANDS):
                there = (distance >= low) & (distance < high)
                cells.append(
                    f"{np.sqrt((angle[there] ** 2).mean()):.2f}" if there.any() else "-"
                )
            beyond = angle[distance >= 2]
            cells.append(f"{beyond.max():.2f}" if len(beyond) else "-")
            lines.append(f"| {shape} | {name} | {' | '.join(cells)} |")
    return lines


def _cube(count):
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (count, 3))
    axis, side = rng.integers(3, size=count), rng.choice([-1.0, 1.0], count)
    normals = np.zeros((count, 3))
    normals[np.arange(count), axis] = side
    points[np.arange(count), axis] = side
    distance = np.sort(1 - np.abs(points), axis=1)[:, 1]
    return points, normals, distance / np.sqrt(24 / count)


def _fandisk(vertices, faces, count):
    """Return a sample of a mesh, and the distances to its sharp and slight creases."""
    import training

    rng = np.random.default_rng(3)
    points, normals = training.sample_mesh(vertices, faces, count, rng)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1).sum() / 2
    unit = cross / np.linalg.norm(cross, axis=1, keepdims=True)
    sides = [faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]
    edges = np.sort(np.concatenate(sides), axis=1)
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort(edges.T)
    edges, owner = edges[order], owner[order]
    same = (edges[1:] == edges[:-1]).all(axis=1)
    first, second = owner[:-1][same], owner[1:][same]
    turn = np.degrees(np.arccos((unit[first] * unit[second]).sum(axis=1).clip(-1, 1)))
    ends, spacing = vertices[edges[:-1][same]], np.sqrt(area / count)
    slight = (turn > _SLIGHT) & (turn <= _SHARP)
    return (
        points,
        normals,
        _distance(points, ends[turn > _SHARP], spacing),
        _distance(points, ends[slight], spacing),
    )


def _distance(points, ends, spacing):
    """Return how far points are from edges (e, 2, 3), in spacings."""
    places = []
    for start, end in ends:
        steps = max(2, int(np.linalg.norm(end - start) / (0.1 * spacing)))
        places.append(np.linspace(start, end, steps))
    return cKDTree(np.concatenate(places)).query(points)[0] / spacing


def _edge(scanned):
    """Return points as scanned and on their curves, normals and distance to the edge.

    Two bent sheets stand on the x and z axes and meet at right angles near the y axis,
    along which they are straight. Nobody knows the surface: a polynomial of degree four
    through each side stands for it.
    """
    exact, normals = scanned.copy(), np.zeros_like(scanned)
    upright = scanned[:, 2] > scanned[:, 0]
    curves = []
    for side, along, across in ((~upright, 0, 2), (upright, 2, 0)):
        place = scanned[side, along]
        curve = np.polynomial.Polynomial.fit(place, scanned[side, across], 4)
        exact[side, across] = curve(place)
        normals[side, along], normals[side, across] = -curve.deriv()(place), 1
        curves.append(curve)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    x = z = 0.0
    for _ in range(20):
        x, z = curves[1](z), curves[0](x)
    near = cKDTree(scanned).query(scanned, k=9)[0][:, -1]
    spacing = np.median(near) * np.sqrt(np.pi / 8)
    distance = np.hypot(exact[:, 0] - x, exact[:, 2] - z)
    return scanned, exact, normals, distance / spacing
