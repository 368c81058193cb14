# SPDX-License-Identifier: GPL-3.0-or-later
"""What the bridge reads of an object: shape, corners and surface, as arrays."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core.mesh.faces import unit
from ...core.progress import Progress, silent
from .arrays import Array

# Points that are looked up between two words of progress.
_CHUNK = 10_000


@dataclass(frozen=True)
class Geometry:
    """The shape of an object as it stands in the world.

    Attributes
    ----------
    points : (n, 3) float64
    faces : (m, 3) int32 or None
        Triangles, counterclockwise seen from their front, mirrored objects too.
    matrix : (3, 3) float64
        From the object's axes to the world's.
    """

    points: Array
    faces: Array | None
    matrix: Array

    def nearest(self, place: Any) -> int:
        """Return which point is nearest to a place of the world."""
        return int(np.square(self.points - np.asarray(place)).sum(axis=1).argmin())

    def first_along(self, start: Any, direction: Any) -> int:
        """Return the point that a ray from a place of the world meets first.

        Of those about as near to the ray as the nearest, the one in front.
        """
        way = unit(np.asarray(direction, dtype=np.float64))
        offset = self.points - np.asarray(start)
        ahead = offset @ way
        beside = np.linalg.norm(offset - ahead[:, None] * way, axis=1)
        beside[ahead <= 0] = np.inf
        # A hundredth of the size is about what a pointer covers.
        near = beside <= beside.min() + 0.01 * np.ptp(self.points, axis=0).max()
        return int(np.where(near & (ahead > 0), ahead, np.inf).argmin())

    def to_object(self, normals: Array) -> Array:
        """Turn (n, 3) normals of the world into unit normals of the object.

        Normals go by the inverse transpose, which keeps their side when mirrored.
        """
        return unit(times(normals, self.matrix))

    def to_world(self, normals: Array) -> Array:
        """Turn (n, 3) normals of the object into unit normals of the world."""
        return unit(times(normals, np.linalg.inv(self.matrix)))


@dataclass(frozen=True)
class Corners:
    """Normals of a mesh that edges part.

    Attributes
    ----------
    normals, valid : (c, 3) float64, (c,) bool
        Of the corners of faces.
    edges : (e,) bool
        Which edges part the mesh.
    """

    normals: Array
    valid: Array
    edges: Array


@dataclass(frozen=True)
class Surface:
    """The faces of an object in the world, as a source of true normals.

    Attributes
    ----------
    tree : BVHTree
        Of the triangles less `center`: it works in single precision.
    center : (3,) float64
    corners, normals : (m, 3, 3) float64
        Places of the triangles' corners less `center`, and the normals there.
    """

    tree: Any
    center: Array
    corners: Array
    normals: Array

    def normals_near(self, points: Array, progress: Progress = silent) -> Array:
        """Return unit normals of the surface nearest to points (n, 3)."""
        found: list[Any] = []
        for start in range(0, len(points), _CHUNK):
            progress(start / len(points))
            part = points[start : start + _CHUNK] - self.center
            # The tree answers one point at a time.
            found += [self.tree.find_nearest(point) for point in part.tolist()]
        at = np.array([place for place, _, _, _ in found])
        row = np.array([index for _, _, index, _ in found])
        return unit(_mixed(at, self.corners[row], self.normals[row]))


def times(rows: Array, matrix: Array) -> Array:
    """Return rows (n, 3) times a matrix (3, 3).

    What is made for large matrices takes ten times as long for these. Most objects
    are neither turned nor scaled.
    """
    if np.array_equal(matrix, np.eye(3)):
        return rows
    result: Array = np.einsum("ij,jk->ik", rows, matrix)
    return result


def _mixed(at: Array, corners: Array, values: Array) -> Array:
    """Interpolate values (n, 3, 3) at corners (n, 3, 3) of triangles at places in them.

    A corner's share is the area of the triangle that the place makes with the others.
    """
    spokes = corners - at[:, None]
    cross = np.cross(np.roll(spokes, -1, axis=1), np.roll(spokes, -2, axis=1))
    area = np.linalg.norm(cross, axis=2)
    return (area[:, :, None] * values).sum(axis=1)
