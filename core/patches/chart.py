# SPDX-License-Identifier: GPL-3.0-or-later
"""Axes that follow a neighborhood, for whole batches of them.

Arrays are component by component, (3, m), so that each step is one operation along
all points.

References
----------
[1] T. Duff et al., "Building an Orthonormal Basis, Revisited", Journal of Computer
    Graphics Techniques 6 (2017).
"""

import numpy as np

from ..inputs import BoolArray, FloatArray, IntArray

# Neighbors a thousand times longer than wide are a line: no plane is theirs.
_LINE = 1e-6


def principal_axes(
    offsets: FloatArray, count: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Return axes that follow each neighborhood.

    Parameters
    ----------
    offsets : (3, k, m)
    count : (m,) int
        How many of the k are there.

    Returns
    -------
    u, v, n : (3, m), of the dtype of `offsets`
        Orthonormal and right-handed. n is the direction of least variance, u and v
        lie between the other two principal axes, at 45 degrees to each.
    spans : (m,) bool
        Whether the neighborhood spans a plane.

    Notes
    -----
    The terms of Eq. (2) span another space in other axes of the same plane, so axes
    must come from the neighbors if patches are to turn with their points. Diagonals
    of the principal axes serve best: along the greatest variance Eq. (2) lacks the
    cube, which between the axes x^2 y and x y^2 stand in for; and at a border,
    whose tangent is a principal axis, both time scales keep members on both sides.
    """
    # The point itself, at the origin, belongs to its neighborhood.
    total = (count + 1).astype(offsets.dtype)
    mean = offsets.sum(axis=1) / total
    covariance = [
        (np.einsum("km,km->m", offsets[i], offsets[j]) / total - mean[i] * mean[j])
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    ]
    # Few numbers a point: double precision costs little here and tells a narrow
    # neighborhood from a line. Which way the axes turn in the plane is not so exact.
    exact = [c.astype(np.float64) for c in covariance]
    normal, middle, largest = least_eigenvectors(*exact)
    n = normal.astype(offsets.dtype)
    u, v = _turned_between(*tangent_axes(n), *covariance)
    spans = (largest > 0) & (middle > _LINE * largest)
    return u, v, n, spans


def _turned_between(u, v, xx, xy, xz, yy, yz, zz):
    """Turn axes (3, m) in their plane until both have the same variance."""
    cu = (
        xx * u[0] + xy * u[1] + xz * u[2],
        xy * u[0] + yy * u[1] + yz * u[2],
        xz * u[0] + yz * u[1] + zz * u[2],
    )
    along = sum(a * b for a, b in zip(u, cu, strict=True))
    mixed = sum(a * b for a, b in zip(v, cu, strict=True))
    across = (
        xx * v[0] ** 2
        + yy * v[1] ** 2
        + zz * v[2] ** 2
        + 2 * (xy * v[0] * v[1] + xz * v[0] * v[2] + yz * v[1] * v[2])
    )
    angle = np.arctan2(2 * mixed, along - across) / 2 + np.pi / 4
    cosine, sine = np.cos(angle), np.sin(angle)
    return cosine * u + sine * v, cosine * v - sine * u


def least_eigenvectors(xx, xy, xz, yy, yz, zz):
    """Solve symmetric 3 x 3 eigenproblems in closed form, array by array.

    Returns
    -------
    vectors : (3, m), unit, of the smallest eigenvalue
    middle, largest : (m,), the other eigenvalues
    """
    mean = (xx + yy + zz) / 3
    a, b, c = xx - mean, yy - mean, zz - mean
    spread = np.sqrt((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
    safe = np.where(spread > 0, spread, 1)
    determinant = (
        a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    )
    # det((A - mean)/spread)/2 is the cosine of three times the angle that gives the
    # roots of the characteristic polynomial.
    angle = np.arccos(np.clip(determinant / (2 * safe**3), -1, 1)) / 3
    least = mean + 2 * spread * np.cos(angle + 2 * np.pi / 3)
    largest = mean + 2 * spread * np.cos(angle)
    middle = 3 * mean - least - largest
    # A - least has rank two: the cross product of two of its rows is the vector, and
    # the longest of the three is the one that rounding hurts least.
    a, b, c = xx - least, yy - least, zz - least
    crosses = (
        (xy * yz - xz * b, xz * xy - a * yz, a * b - xy * xy),
        (xy * c - xz * yz, xz * xz - a * c, a * yz - xy * xz),
        (b * c - yz * yz, yz * xz - xy * c, xy * yz - b * xz),
    )
    best, *others = (np.stack(cross) for cross in crosses)
    most = (best * best).sum(axis=0)
    for cross in others:
        square = (cross * cross).sum(axis=0)
        best = np.where(square > most, cross, best)
        most = np.maximum(square, most)
    # A neighborhood alike in all directions has no such vector: any will do.
    best[2, most == 0] = 1
    return best / np.sqrt(np.where(most > 0, most, 1)), middle, largest


def tangent_axes(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return u, v that complete unit vectors (3, m) to right-handed charts [1]."""
    x, y, z = normal
    sign = np.where(z >= 0, 1, -1).astype(normal.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    u = np.stack([1 + sign * x * x * a, sign * b, -sign * x])
    v = np.stack([b, sign + y * y * a, -y])
    return u, v


def along(axis: FloatArray, offsets: FloatArray) -> FloatArray:
    """Return the coordinates of (3, k, m) offsets along axes (3, m), (k, m)."""
    result = axis[0] * offsets[0]
    result += axis[1] * offsets[1]
    result += axis[2] * offsets[2]
    return result
