# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors against the distance to a crease: a cube and fandisk."""

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

# Faces that turn by more than that meet in a crease.
_SHARP = np.radians(30)


def shapes():
    """Yield name, points, true normals and distance to a crease, in spacings."""
    yield "cube", *_cube(50_000)
    found = clouds.vertices_and_faces("fandisk")
    if found is not None:
        yield "fandisk", *_fandisk(*found, 100_000)


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
    """Return a sample of a mesh, and the distance to edges where faces turn sharply."""
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
    sharp = (unit[first] * unit[second]).sum(axis=1) < np.cos(_SHARP)
    ends = vertices[edges[:-1][same][sharp]]
    spacing = np.sqrt(area / count)
    places = []
    for start, end in ends:
        steps = max(2, int(np.linalg.norm(end - start) / (0.1 * spacing)))
        places.append(np.linspace(start, end, steps))
    distance = cKDTree(np.concatenate(places)).query(points)[0]
    return points, normals, distance / spacing
