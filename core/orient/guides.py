# SPDX-License-Identifier: GPL-3.0-or-later
"""Sides that something else decides: a place, other normals, a mesh, the own faces."""

import numpy as np
from numpy.typing import ArrayLike

from ..inputs import FloatArray, InputError, IntArray, as_faces, as_normals, as_points
from ..mesh.faces import face_vectors, unit, vertex_normals
from ..neighbors.graph import NearestNeighbors

# Samples of a mesh for each point that asks for its nearest place, and at most.
_SAMPLES, _MOST = 8, 2_000_000


def agreeing(normals: FloatArray, directions: FloatArray) -> IntArray:
    """Return the signs that turn normals to the side of the directions, (n,) int8."""
    return np.where((normals * directions).sum(axis=1) < 0, -1, 1).astype(np.int8)


def toward(points: FloatArray, viewpoint: ArrayLike | None) -> FloatArray:
    """Return directions from points to a place or to one place each, (n, 3) float64."""
    if viewpoint is None:
        raise InputError('expected a viewpoint for orientation "viewpoint", got none')
    place = np.asarray(viewpoint, dtype=np.float64)
    if place.shape not in ((3,), points.shape) or not np.isfinite(place).all():
        raise InputError(
            f"expected a finite viewpoint of shape (3,) or {points.shape}, "
            f"got {place.shape}"
        )
    return place - points


def face_directions(points: FloatArray, faces: IntArray | None) -> FloatArray:
    """Return the sides of the faces at vertices, (n, 3) float64.

    Loose vertices take that of the nearest vertex with a face.
    """
    if faces is None:
        raise InputError('expected faces for orientation "faces", got none')
    guide = vertex_normals(points, faces, weights="angle")
    has_face = (guide != 0).any(axis=1)
    if has_face.any() and not has_face.all():
        guided = np.flatnonzero(has_face)
        _, at = NearestNeighbors(points[guided]).tree.query(points[~has_face])
        guide[~has_face] = guide[guided[at]]
    return guide


def reference_normals(
    reference: ArrayLike | tuple[ArrayLike, ArrayLike] | None, points: FloatArray
) -> FloatArray:
    """Return the normals that those of points should agree with, (n, 3) float64.

    Parameters
    ----------
    reference : (n, 3) array_like of float, or (vertices, faces)
        Normals, or a mesh: that of the nearest place on it counts.
    points : (n, 3) float64
    """
    if reference is None:
        raise InputError('expected reference normals for orientation "reference"')
    if isinstance(reference, tuple) and [np.ndim(a) for a in reference] == [2, 2]:
        vertices = as_points(reference[0], name="vertices of the reference")
        faces = as_faces(reference[1], len(vertices))
        if faces is None:
            raise InputError("expected a reference with at least one face, got none")
        return _nearest_on(vertices, faces, points)
    return as_normals(np.asarray(reference), len(points), name="reference normals")


def _nearest_on(vertices, faces, points):
    """Return the normals of the nearest of many places on a mesh, (n, 3)."""
    corners = vertices[faces] - points.mean(axis=0)
    area = np.linalg.norm(face_vectors(vertices, faces), axis=1).sum() / 2
    count = min(_SAMPLES * max(len(points), len(faces)), _MOST)
    side = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    steps = np.ceil(side / max(np.sqrt(2 * area / count), 1e-300))
    steps = np.clip(steps, 1, np.sqrt(_MOST)).astype(np.int64)
    face, places = _lattice(corners, steps)
    _, at = NearestNeighbors(places).tree.query(points - points.mean(axis=0))
    return unit(face_vectors(vertices, faces))[face[at]]


def _lattice(corners, steps):
    """Return triangle (s,) and place (s, 3) of the middles of all parts of triangles.

    Each is parted into steps**2 small ones, row by row from its first corner: row r
    has 2 r + 1, every other one upside down.
    """
    count = steps**2
    face = np.repeat(np.arange(len(steps)), count)
    number = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    row = np.sqrt(number + 0.5).astype(np.int64)
    column = number - row**2
    down = column % 2
    size = 1 / steps[face]
    along = (row + (2 - down) / 3) * size
    across = (column // 2 + (1 + down) / 3) * size
    a, b, c = (corners[face, i] for i in range(3))
    return face, a + along[:, None] * (b - a) + across[:, None] * (c - b)
