# SPDX-License-Identifier: GPL-3.0-or-later
"""Exact cylinders in a mesh of a machine part, whose normals are known in closed form.

Means of faces, of the original too, are off by up to half of what the faces turn.
Where a mesh was sampled from a cylinder, its vertices tell the normals exactly.
"""

from dataclasses import dataclass

import numpy as np

from core.mesh.averages import Averages
from core.mesh.faces import Triangles, angles_between, squares, unit

# A cylinder passes all vertices of a neighborhood and of what grows out of it within
# that, in edges; their means of faces look where it does within so many degrees.
_NEAR, _LOOKING = 1e-3, 8.0
# Edges of a neighborhood, and vertices of the least cylinder.
_RINGS, _LEAST = 3, 40
# Radii between these, in edges: larger ones are planes, which faces know exactly.
_RADII = (1.0, 100.0)


@dataclass(frozen=True)
class Cylinder:
    """A cylinder: a place on its axis, the unit axis, and the radius."""

    center: np.ndarray
    axis: np.ndarray
    radius: float

    def across(self, points):
        """Return the parts of points (n, 3) that are at right angles to the axis."""
        offset = points - self.center
        return offset - (offset @ self.axis)[:, None] * self.axis

    def misses(self, points):
        """Return how far points (n, 3) are from the cylinder, (n,)."""
        return np.abs(np.sqrt(squares(self.across(points))) - self.radius)


def fit_cylinder(points, normals):
    """Return the Cylinder through points (n, 3) that look along normals (n, 3)."""
    _, directions = np.linalg.eigh(normals.T @ normals)
    axis, plane = directions[:, 0], directions[:, 1:]
    middle = points.mean(axis=0)
    # |p|² = 2 p c + r² - |c|² is linear in the center c and in what is left.
    flat = (points - middle) @ plane
    system = np.column_stack([2 * flat, np.ones(len(flat))])
    found, *_ = np.linalg.lstsq(system, squares(flat), rcond=None)
    radius = np.sqrt(max(found[2] + found[:2] @ found[:2], 0.0))
    return Cylinder(middle + plane @ found[:2], axis, float(radius))


def cylinder_normals(points, faces):
    """Return the exact normals of vertices on cylinders, (n, 3), zero elsewhere.

    Parameters
    ----------
    points, faces : (n, 3), (m, 3)
        Parted along creases.
    """
    mesh = Triangles(points, faces)
    averages = Averages(len(points), faces)
    guide = mesh.vertex_normals("angle")
    edge = mesh.mean_edge
    found = np.zeros(points.shape)
    free = averages.degree > 0
    for seed in np.flatnonzero(averages.inner):
        if not free[seed]:
            continue
        near = _around(averages.joined, seed, free, _RINGS)
        if len(near) < _LEAST // 2:
            continue
        cylinder = fit_cylinder(points[near], guide[near])
        if not _RADII[0] < cylinder.radius / edge < _RADII[1]:
            continue
        if cylinder.misses(points[near]).max() > _NEAR * edge:
            continue
        part = _on(cylinder, points, guide, free, edge)
        if seed not in part:
            continue
        part = part[_joined_to(averages.joined, part, seed)]
        if len(part) >= _LEAST:
            normals = unit(cylinder.across(points[part]))
            side = np.sign((normals * guide[part]).sum(axis=1))
            found[part] = normals * side[:, None]
            free[part] = False
    return found


def _around(joined, seed, free, rings):
    """Return the free vertices within so many edges of a seed."""
    reached = np.array([seed])
    for _ in range(rings):
        rows = joined[reached]
        reached = np.unique(np.append(reached, rows.indices))
        reached = reached[free[reached]]
    return reached


def _on(cylinder, points, guide, free, edge):
    """Return the free vertices on a cylinder that look as it does."""
    near = np.flatnonzero(free & (cylinder.misses(points) < _NEAR * edge))
    normals = unit(cylinder.across(points[near]))
    turned = angles_between(normals, guide[near])
    return near[np.minimum(turned, 180 - turned) < _LOOKING]


def _joined_to(joined, part, seed):
    """Return which vertices of a part hang together with the seed."""
    from scipy.sparse.csgraph import connected_components

    _, label = connected_components(joined[part][:, part], directed=False)
    return label == label[part == seed]
