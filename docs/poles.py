# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture of poles and labels in docs/method.md.

    PYTHONPATH=. .venv/bench/bin/python docs/poles.py

A slice through the Delaunay tetrahedra of a bowl of two sheets: outside and inside, and
for some of the points the two poles with their empty spheres.
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np

from core.neighbors.graph import NearestNeighbors
from core.orient.poles import delaunay_complex, find_poles, label_poles

mpl.use("Agg")
from matplotlib import pyplot
from matplotlib.collections import PolyCollection

PICTURE = Path(__file__).parent / "images" / "poles.png"
OUTSIDE, INSIDE = "#dce9f5", "#f3c79f"
POINTS, THICKNESS = 2600, 0.2
# Where to show poles, by the angle in the slice and the sheet.
SHOWN = ((-0.6, "outer"), (0.25, "inner"), (0.95, "outer"))


def bowl():
    """Return points on two half spheres and their outward normals."""
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(POINTS, 3))
    normals[:, 2] = -np.abs(normals[:, 2])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = normals.copy()
    inner = rng.uniform(size=POINTS) < (1 - THICKNESS) ** 2 / (1 + (1 - THICKNESS) ** 2)
    points[inner] *= 1 - THICKNESS
    normals[inner] *= -1
    angle = 2 * np.pi * rng.uniform(size=POINTS // 6)
    radius = np.sqrt(rng.uniform((1 - THICKNESS) ** 2, 1, len(angle)))
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * radius], 1)
    return np.concatenate([points, rim]), np.concatenate(
        [normals, np.tile([0.0, 0, 1], (len(rim), 1))]
    )


def slices(points, corners):
    """Return the tetrahedra that the plane y = 0 cuts, and their cuts there."""
    y = points[corners][:, :, 1]
    cut = np.flatnonzero((y.min(axis=1) < 0) & (y.max(axis=1) > 0))
    polygons = []
    for cell in cut:
        ends = points[corners[cell]]
        pairs = [
            (i, j) for i in range(4) for j in range(i) if y[cell, i] * y[cell, j] < 0
        ]
        at = np.array(
            [
                (ends[i] * y[cell, j] - ends[j] * y[cell, i])
                / (y[cell, j] - y[cell, i])
                for i, j in pairs
            ]
        )[:, [0, 2]]
        around = at - at.mean(axis=0)
        polygons.append(at[np.argsort(np.arctan2(around[:, 1], around[:, 0]))])
    return cut, polygons


def main():
    """Draw the picture."""
    points, normals = bowl()
    distance, _ = NearestNeighbors(points).others(6, points)
    spacing = distance[:, -1]
    cells = delaunay_complex(points, spacing)
    labels = label_poles(points, normals, spacing)
    above, below, _ = find_poles(cells, points, normals)
    whole = np.flatnonzero((cells.corners < len(points)).all(axis=1))
    figure, axes = pyplot.subplots(figsize=(8, 4.6), dpi=130)
    axes.set_facecolor(OUTSIDE)
    cut, polygons = slices(points, cells.corners[whole])
    outside = labels.cells[whole[cut]] > 0
    colors = np.where(outside, OUTSIDE, INSIDE)
    axes.add_collection(
        PolyCollection(
            polygons, facecolors=colors, edgecolors="#8894a0", linewidths=0.3
        )
    )
    near = np.abs(points[:, 1]) < 0.03
    axes.plot(*points[near][:, [0, 2]].T, ".", color="#20303c", markersize=3)
    for angle, sheet in SHOWN:
        _draw_poles(axes, points, cells, (above, below), labels.cells, angle, sheet)
    axes.set(xlim=(-1.45, 1.45), ylim=(-1.3, 0.35), aspect="equal")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.text(0, 0.15, "outside", ha="center", color="#30506e")
    axes.text(
        0, -0.9, "inside", ha="center", va="center", color="#7a3c0a", weight="bold"
    )
    figure.tight_layout()
    figure.savefig(PICTURE, metadata={"Software": None})


def _draw_poles(axes, points, cells, poles, label, angle, sheet):
    """Draw a point near the slice, its poles, and their spheres in the slice."""
    radius = 1 if sheet == "outer" else 1 - THICKNESS
    target = radius * np.array([np.sin(angle), 0, -np.cos(angle)])
    row = int(((points - target) ** 2).sum(axis=1).argmin())
    axes.plot(*points[row, [0, 2]], "o", color="black", markersize=5)
    for corner in poles:
        cell = corner[row] // 4
        center, size = cells.centers[cell], cells.radii[cell]
        color = "#2a6fb0" if label[cell] > 0 else "#c2560c"
        across = np.sqrt(max(size**2 - center[1] ** 2, 0))
        axes.add_patch(
            pyplot.Circle(center[[0, 2]], across, fill=False, color=color, lw=1.2)
        )
        axes.plot(*center[[0, 2]], "D", color=color, markersize=5)
        axes.plot(*np.stack([points[row], center])[:, [0, 2]].T, color=color, lw=1)


if __name__ == "__main__":
    main()
