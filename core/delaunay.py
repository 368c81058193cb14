# SPDX-License-Identifier: GPL-3.0-or-later
"""The baseline N_D: area-weighted normals of a Delaunay triangulation (section 4).

References
----------
[1] See `timescale`.
"""

import numpy as np
from numpy.typing import ArrayLike

from .inputs import FloatArray, InputError, as_faces, as_numbers, as_points, extent_of
from .mesh.faces import unit, vertex_normals
from .neighbors.graph import NearestNeighbors, delaunay_simplices
from .patches.chart import along, principal_axes
from .patches.patch import precision
from .progress import Progress, silent
from .threads import in_threads

# Candidates for the Delaunay star of a point. On even samples a star has six
# vertices; on random ones, the farthest of its vertices is among the 24 nearest
# points in all but a few of a thousand cases.
_CANDIDATES = 24

# Stars that are closed drop out once they are more than a quarter.
_CROWDED = 0.75


def delaunay_normals(
    points: ArrayLike,
    *,
    faces: ArrayLike | None = None,
    parameters: ArrayLike | None = None,
    progress: Progress = silent,
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
    progress : callable, optional
        Called with the share done, 0 to 1. Whatever it raises ends the work.

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
    center = extent_of(points).center
    if faces is None:
        return _star_normals(points, center, progress)
    return vertex_normals(points - center, faces, weights="area")


def _star_normals(points, center, progress):
    """Return N_D of the points' own Delaunay stars, (n, 3)."""
    nearest = NearestNeighbors(points, center=center)
    count = min(_CANDIDATES, len(points) - 1)
    result = np.zeros(points.shape)
    dtype = precision(len(points))

    def work(rows):
        offsets, distance = nearest.offsets(rows, count)
        inverse = 1 / np.where(distance[:, -1] > 0, distance[:, -1], 1)
        scaled = np.empty(offsets.shape, dtype=dtype)
        np.multiply(offsets, inverse, out=scaled, casting="same_kind")
        result[rows] = _star_normal(scaled)

    runs = nearest.runs(count)
    for done in in_threads(work, runs, None):
        progress(done / len(runs))
    return result


def _star_normal(offsets):
    """Return N_D at the origin of each star, (m, 3), from (3, k, m) candidates."""
    offsets = _without_twins(offsets)
    count = np.count_nonzero(np.einsum("ikm,ikm->km", offsets, offsets), axis=0)
    u, v, _, spans = principal_axes(offsets, count)
    # Single precision is enough to tell who is next: its rounding only decides
    # between triangles that are equally good.
    x, y = (along(axis, offsets).astype(np.float32) for axis in (u, v))
    total = np.zeros(u.shape)
    for rows, a, b in _star(x, y):
        ax, ay, az = offsets[:, a, rows]
        bx, by, bz = offsets[:, b, rows]
        area = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        for axis, part in zip(total, area, strict=True):
            axis[rows] += part
    return np.where(spans[:, None], unit(total.T), 0)


def _without_twins(offsets):
    """Zero the candidates that share their place with a nearer one."""
    same = (offsets[:, 1:] == offsets[:, :-1]).all(axis=0)
    offsets[:, 1:][:, same] = 0
    return offsets


def _star(x, y):
    """Walk around the Delaunay stars of the origin among points of the plane.

    The nearest point is a Delaunay neighbor. From one neighbor the next to the left
    is the point that sees the edge from the origin to it under the largest angle:
    the circle through the three is empty. A walk that finds nobody to its left has
    come to a border; it goes on from its first point the other way around.

    Parameters
    ----------
    x, y : (k, m) float
        Points at the origin itself are not there.

    Yields
    ------
    rows : (r,) int
        Stars that have one more triangle.
    a, b : (r,) int
        Its other corners, counterclockwise.
    """
    square = x * x + y * y
    first = np.where(square > 0, square, np.inf).argmin(axis=0)
    border = yield from _walk(x, y, square, np.arange(len(first)), first)
    x, y, square, first = (a[..., border] for a in (x, y, square, first))
    for rows, a, b in _walk(x, -y, square, border, first):
        yield rows, b, a


def _walk(x, y, square, rows, first):
    """Walk counterclockwise from `first`; return the rows that come to a border."""
    border = [rows[:0]]
    here, walking = first, np.ones(len(rows), dtype=bool)
    cross, cotangent, product = np.empty((3, *x.shape), dtype=x.dtype)
    for _ in range(len(x)):
        column = np.arange(len(rows))
        ax, ay = x[here, column], y[here, column]
        np.multiply(ax, y, out=cross)
        cross -= np.multiply(ay, x, out=product)
        # Of the angle under which a point sees the edge, where it is to the left.
        np.subtract(square, np.multiply(ax, x, out=product), out=cotangent)
        cotangent -= np.multiply(ay, y, out=product)
        left = cross > 0
        with np.errstate(divide="ignore", invalid="ignore"):
            cotangent /= cross
        after = np.where(left, cotangent, np.inf).argmin(axis=0)
        on = left[after, column] & walking
        yield rows[on], here[on], after[on]
        border.append(rows[walking & ~on])
        walking = on & (after != first)
        here = after
        count = np.count_nonzero(walking)
        if not count:
            break
        if count < _CROWDED * len(rows):
            x, y, square = x[:, walking], y[:, walking], square[:, walking]
            cross, cotangent, product = np.empty((3, *x.shape), dtype=x.dtype)
            rows, first, here = rows[walking], first[walking], here[walking]
            walking = np.ones(count, dtype=bool)
    return np.concatenate(border)
