# SPDX-License-Identifier: GPL-3.0-or-later
"""The baseline N_D: area-weighted normals of a Delaunay triangulation (section 4).

References
----------
[1] See `timescale`.
"""

import numpy as np
from numpy.typing import ArrayLike

from .faces import unit, vertex_normals
from .graph import NearestNeighbors, delaunay_simplices
from .inputs import FloatArray, InputError, as_faces, as_numbers, as_points
from .patch import principal_axes

# Candidates for the Delaunay star of a point. On even samples a star has six
# vertices; on random ones, the farthest of its vertices is among the 24 nearest
# points in all but a few of a thousand cases.
_CANDIDATES = 24

_CHUNK = 8192


def delaunay_normals(
    points: ArrayLike,
    *,
    faces: ArrayLike | None = None,
    parameters: ArrayLike | None = None,
) -> FloatArray:
    """Return area-weighted vertex normals of a Delaunay triangulation.

    Parameters
    ----------
    points : (n, 3) array_like of float
    faces : (m, 3) array_like of int, optional
        A triangulation that is there already: a mesh's own.
    parameters : (n, 2) array_like of float, optional
        Parameters of the points: the triangulation is the Delaunay triangulation of
        these, in the plane, lifted to the points.

    Returns
    -------
    (n, 3) float64, unit; zero where a point has no triangle of any area.

    Raises
    ------
    InputError
        When both triangulations are given, or shapes do not fit.

    Notes
    -----
    From the points alone the triangulation is local: each point's star in the
    Delaunay triangulation of its nearest points, projected to the plane of least
    variance there. Neighboring stars need not agree on their edges, and the side
    of these normals is arbitrary.
    """
    points = as_points(points, least=3)
    if faces is not None and parameters is not None:
        raise InputError("expected faces or parameters, got both")
    if parameters is not None:
        parameters = as_numbers(parameters, name="parameters")
        if parameters.shape != (len(points), 2) or not np.isfinite(parameters).all():
            raise InputError(
                f"expected finite parameters of shape ({len(points)}, 2), "
                f"got {parameters.shape}"
            )
        faces = delaunay_simplices(parameters)
    elif faces is not None:
        faces = as_faces(faces, len(points))
    centered = points - points.mean(axis=0)
    if faces is None:
        return _star_normals(centered)
    return vertex_normals(centered, faces, weights="area")


def _star_normals(points):
    """Return N_D of the points' own Delaunay stars, (n, 3)."""
    nearest = NearestNeighbors(points)
    count = min(_CANDIDATES, len(points) - 1)
    result = np.zeros(points.shape)
    for start in range(0, len(points), _CHUNK):
        rows = nearest.order[start : start + _CHUNK]
        index, distance = nearest.neighbors(rows, count)
        offsets = np.moveaxis(points[index] - points[rows][:, None], -1, 0)
        reach = distance[:, -1]
        scale = np.where(reach > 0, reach, 1)
        result[rows] = _star_normal(offsets / scale[:, None])
    return result


def _star_normal(offsets):
    """Return N_D at the origin of each star, (m, 3), from (3, m, k) candidates."""
    offsets = _without_twins(offsets)
    there = (offsets != 0).any(axis=0)
    u, v, _, spans = principal_axes(offsets.swapaxes(1, 2), there.sum(axis=1))
    x = np.einsum("im,imk->mk", u, offsets)
    y = np.einsum("im,imk->mk", v, offsets)
    order = np.argsort(np.arctan2(y, x), axis=1, kind="stable")
    x, y, there = (np.take_along_axis(a, order, axis=1) for a in (x, y, there))
    alive = _star(x, y, there)
    _, after = _neighbors_alive(alive)
    # A gap of half a turn or more is a border: no triangle closes it.
    gap = x * np.take_along_axis(y, after, 1) - y * np.take_along_axis(x, after, 1)
    fan = np.take_along_axis(offsets, order[None], axis=2)
    cross = np.cross(fan, np.take_along_axis(fan, after[None], axis=2), axis=0)
    total = np.where(alive & (gap > 0), cross, 0).sum(axis=2)
    return np.where(spans[:, None], unit(total.T), 0)


def _without_twins(offsets):
    """Zero the candidates that share their place with a nearer one."""
    same = (offsets[:, :, 1:] == offsets[:, :, :-1]).all(axis=0)
    offsets = offsets.copy()
    offsets[:, :, 1:][:, same] = 0
    return offsets


def _star(x, y, there):
    """Find the Delaunay neighbors of the origin among points of the plane.

    Inversion takes the circles through the origin to lines: the Delaunay neighbors
    become the vertices of the convex hull of the inverted points and the origin.
    Sorted by angle these points are a star-shaped polygon. A vertex that is reflex
    between its present neighbors lies in the hull of the others, so all such
    vertices can be struck out at once; when none is left, the hull is.

    Parameters
    ----------
    x, y : (m, k) float, each row by increasing angle
    there : (m, k) bool

    Returns
    -------
    (m, k) bool
    """
    square = x * x + y * y
    alive = there & (square > 0)
    square = np.where(alive, square, 1)
    p, q = x / square, y / square
    while True:
        before, after = _neighbors_alive(alive)
        ax, ay = (np.take_along_axis(c, before, axis=1) for c in (p, q))
        bx, by = (np.take_along_axis(c, after, axis=1) for c in (p, q))
        turn = (p - ax) * (by - q) - (q - ay) * (bx - p)
        # Beside a gap of half a turn or more the hull goes on to the origin.
        beside_gap = (ax * q - ay * p <= 0) | (p * by - q * bx <= 0)
        struck = alive & (turn <= 0) & ~beside_gap
        if not struck.any():
            return alive
        alive &= ~struck


def _neighbors_alive(alive):
    """Return, around each row's circle, who is alive before and after, 2 x (m, k)."""
    k = alive.shape[1]
    twice = np.concatenate([alive, alive], axis=1)
    place = np.where(twice, np.arange(2 * k), -1)
    before = np.maximum.accumulate(place, axis=1)[:, k - 1 : 2 * k - 1] % k
    place = np.where(twice, np.arange(2 * k), 2 * k)
    after = np.minimum.accumulate(place[:, ::-1], axis=1)[:, ::-1][:, 1 : k + 1] % k
    return before, after
