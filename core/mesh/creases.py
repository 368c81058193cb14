# SPDX-License-Identifier: GPL-3.0-or-later
"""Edges at which a mesh is parted, because its faces turn there."""

import numpy as np
from numpy.typing import ArrayLike

from ..inputs import FloatArray, InputError, IntArray
from .faces import face_vectors, unit


def find_sharp_edges(points: FloatArray, faces: IntArray, angle: float) -> IntArray:
    """Return the edges whose two faces turn by more than an angle.

    Edges of more than two faces are among them, borders are not. Triangles without
    area turn from nobody.

    Parameters
    ----------
    points : (n, 3) float64
    faces : (m, 3) int
        Wound alike.
    angle : float
        In radians.

    Returns
    -------
    (e, 2) int, the smaller index first
    """
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    key = sides[:, 0] * np.int64(len(points)) + sides[:, 1]
    order = np.argsort(key, kind="stable")
    start = np.flatnonzero(np.diff(key[order], prepend=-1))
    count = np.diff(np.append(start, len(key)))
    normals = unit(face_vectors(points, faces))
    pair = start[count == 2]
    first, second = (normals[order[at] // 3] for at in (pair, pair + 1))
    cosine = np.where(
        (first == 0).all(axis=1) | (second == 0).all(axis=1),
        1.0,
        (first * second).sum(axis=1),
    )
    sharp = np.append(pair[cosine < np.cos(angle)], start[count > 2])
    return sides[order[np.sort(sharp)]]


def parting_edges(
    points: FloatArray, faces: IntArray, angle: float | None, given: ArrayLike | None
) -> IntArray:
    """Return the edges that part a mesh: given ones, and sharp ones where asked for.

    Parameters
    ----------
    angle : float or None
        See `find_sharp_edges`; None leaves these out.
    given : (e, 2) array_like of int or None

    Raises
    ------
    InputError
        When `given` is not pairs of vertices.
    """
    found: list[IntArray] = [np.empty((0, 2), dtype=np.int64)]
    if given is not None and np.size(given):
        edges = np.asarray(given)
        if edges.ndim != 2 or edges.shape[1] != 2 or edges.dtype.kind not in "iu":
            raise InputError(
                f"expected sharp edges of shape (e, 2) holding integers, "
                f"got {edges.shape} of {edges.dtype}"
            )
        if edges.min() < 0 or edges.max() >= len(points):
            raise InputError(
                f"expected ends of sharp edges from 0 to {len(points) - 1}, "
                f"got {edges.min()} to {edges.max()}"
            )
        found.append(edges.astype(np.int64))
    if angle is not None:
        found.append(find_sharp_edges(points, faces, angle))
    return np.concatenate(found)
