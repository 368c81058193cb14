# SPDX-License-Identifier: GPL-3.0-or-later
"""Which closed pieces of a mesh lie inside others."""

import numpy as np

from ..inputs import BoolArray, FloatArray, IntArray

# Pairs of a ray and a triangle that are looked at together.
_CHUNK = 2_000_000
# An arbitrary turn (a unit quaternion): rays then miss the edges of upright boxes.
_TURN = (0.82, 0.37, -0.29, 0.32)


def depths(
    points: FloatArray, faces: IntArray, piece: IntArray, closed: BoolArray
) -> IntArray:
    """Return how many closed pieces lie around each.

    Parameters
    ----------
    points : (n, 3) float64
    faces : (m, 3) int
    piece : (m,) int
        The piece of each triangle, counted from 0.
    closed : (p,) bool
        Pieces without a border; the others lie around nothing and have depth 0.

    Returns
    -------
    (p,) int

    Notes
    -----
    From the middle of one triangle of each piece a ray runs along an axis. It leaves
    what is around it through an odd number of triangles.
    """
    walls = np.flatnonzero(closed[piece])
    first = walls[np.unique(piece[walls], return_index=True)[1]]
    corners = (points - points.mean(axis=0))[faces[walls]] @ _turn().T
    start = corners.mean(axis=1)[np.searchsorted(walls, first)]
    inner, outer = piece[first], piece[walls]
    result = np.zeros(len(closed), dtype=np.int64)
    for ray, wall in _near(corners, start[:, 1]):
        hit = (inner[ray] != outer[wall]) & _hits(corners[wall], start[ray])
        key = ray[hit] * np.int64(len(closed)) + outer[wall[hit]]
        found, times = np.unique(key, return_counts=True)
        around = found[times % 2 == 1] // len(closed)
        result += np.bincount(inner[around], minlength=len(closed))
    return result


def _turn():
    """Return a rotation by no angle in particular, (3, 3)."""
    w, x, y, z = np.array(_TURN) / np.linalg.norm(_TURN)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def _near(corners, level):
    """Yield pairs of ray and triangle that meet the same height, some rays at a time.

    Triangles are sorted by size class and lower end, so that those a ray may meet lie
    together.

    Parameters
    ----------
    corners : (w, 3, 3) float64
    level : (r,) float64, the second coordinate of each ray

    Yields
    ------
    ray, triangle : (k,) int
        All pairs of a ray at a time.
    """
    low, high = corners[:, :, 1].min(axis=1), corners[:, :, 1].max(axis=1)
    least = max(float(np.median(high - low)), 1e-300)
    size = np.ceil(np.log2(np.maximum((high - low) / least, 1))).astype(np.int64)
    order = np.lexsort((low, size))
    begins, ends = [], []
    for kind in np.unique(size):
        at, to = np.searchsorted(size[order], [kind, kind + 1])
        here = low[order[at:to]]
        begins.append(at + np.searchsorted(here, level - least * 2.0**kind))
        ends.append(at + np.searchsorted(here, level, side="right"))
    begin, end = np.stack(begins, axis=1), np.stack(ends, axis=1)
    total = np.cumsum((end - begin).sum(axis=1))
    part = total // _CHUNK
    for rays in np.split(np.arange(len(level)), np.flatnonzero(np.diff(part)) + 1):
        count = (end[rays] - begin[rays]).ravel()
        shift = np.repeat(begin[rays].ravel() - np.cumsum(count) + count, count)
        wall = order[np.arange(count.sum()) + shift]
        ray = np.repeat(np.repeat(rays, begin.shape[1]), count)
        meets = (low[wall] <= level[ray]) & (level[ray] < high[wall])
        yield ray[meets], wall[meets]


def _hits(corners, start):
    """Whether rays along the first axis pass through triangles ahead, (k,) bool."""
    a, b, c = (corners[:, i] - start for i in range(3))

    def side(p, q):
        return p[:, 1] * q[:, 2] - p[:, 2] * q[:, 1]

    u, v, w = side(b, c), side(c, a), side(a, b)
    within = ((u > 0) == (v > 0)) & ((v > 0) == (w > 0))
    total = u + v + w
    ahead = (u * a[:, 0] + v * b[:, 0] + w * c[:, 0]) * np.sign(total) > 0
    return within & ahead & (total != 0)
