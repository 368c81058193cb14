# SPDX-License-Identifier: GPL-3.0-or-later
"""Charts and biquadratic patches, in batches (section 3 and Table 1 of the paper).

A batch holds the neighborhoods of m points as arrays of shape (k, m): neighbor by
point. All work runs along the points, so that every step is one array operation for
the whole batch, and a point's result does not depend on who shares its batch.

References
----------
[1] See `timescale`.
[2] T. Duff et al., "Building an Orthonormal Basis, Revisited", Journal of Computer
    Graphics Techniques 6 (2017).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from .inputs import BoolArray, FloatArray, IntArray, as_choice
from .surface import GridSurface
from .timescale import WEIGHTS, TimeScale

# The exponents of x and y that go with A1 ... A8 in Eq. (2).
TERMS = ((1, 0), (0, 1), (2, 0), (1, 1), (2, 1), (1, 2), (0, 2), (2, 2))

# Eq. (2) has eight unknowns.
LEAST_NEIGHBORS = len(TERMS)

# Neighbors a thousand times longer than wide are a line: no plane is theirs.
_LINE = 1e-6

# Share of each pivot added to it: it keeps a solution finite where neighbors do not
# determine all terms, and lies at the rounding of the sums it is added to.
_RIDGE = {np.dtype(np.float32): 3e-6, np.dtype(np.float64): 1e-10}


@dataclass(frozen=True)
class Patches:
    """The patches of m points, z(x, y) of Eq. (2) in a chart at each point.

    Lengths are in units of `reach`: multiply by it for object units.

    Attributes
    ----------
    u, v, n : (3, m)
        The axes of the charts; z is measured along n.
    reach : (m,) float64
        The distance of the farthest neighbor, in object units.
    x, y, z : (k, m)
        The neighbors in the charts; missing ones stand at the origin.
    coefficients : (8, m)
        A1 ... A8.
    valid : (m,) bool
        Whether there are eight neighbors and they span a plane.
    """

    u: FloatArray
    v: FloatArray
    n: FloatArray
    reach: FloatArray
    x: FloatArray
    y: FloatArray
    z: FloatArray
    coefficients: FloatArray
    valid: BoolArray

    def slopes(self, *, weights: str = "second_order") -> tuple[FloatArray, FloatArray]:
        """Return the diamond derivatives of z along x and y at the points, 2 x (m,).

        Notes
        -----
        The time scales are T1 = {x_j} and {0}, T2 = {y_j} and {0}. On the patch the
        paper's derivative is A1 + A3 (sigma1 + rho1), A2 + A7 (sigma2 + rho2), where
        a one-sided end leaves out the jump it does not have. The second-order
        weights remove the term of A3 and A7, at an end by the three-point
        difference: what remains is A1 and A2.
        """
        as_choice(weights, WEIGHTS, name="weights")
        a = self.coefficients
        if weights == "second_order":
            return a[0], a[1]
        return (
            a[0] + a[2] * sum(jumps(self.x)),
            a[1] + a[6] * sum(jumps(self.y)),
        )

    def normals(self, *, weights: str = "second_order") -> FloatArray:
        """Return N_TS, the cross product of the tangents, (m, 3) float64, unit.

        Rows that are not valid are zero.
        """
        a, b = self.slopes(weights=weights)
        normals = (self.n - a * self.u - b * self.v).astype(np.float64)
        normals /= np.sqrt((normals * normals).sum(axis=0))
        # Where, and not a product: an invalid row may hold nan.
        return np.where(self.valid, normals, 0.0).T

    def residuals(self) -> FloatArray:
        """Return z of the neighbors less z of the patch, (k, m), in units of reach."""
        left = self.z.copy()
        for coefficient, (i, j) in zip(self.coefficients, TERMS, strict=True):
            left -= coefficient * _power(self.x, i) * _power(self.y, j)
        return left

    @cached_property
    def condition(self) -> FloatArray:
        """(m,) float64, the condition number of the matrix of Eq. (3).

        With coordinates in units of reach; infinite where the neighbors leave some
        term open.
        """
        return np.linalg.cond(_design(self.x, self.y))

    def bundle(
        self, column: int = 0, origin: ArrayLike = (0.0, 0.0, 0.0)
    ) -> GridSurface:
        """Return the part of Table 1's bundle that belongs to one point.

        Parameters
        ----------
        column : int
            Which of the m points.
        origin : (3,) float
            Where that point is.

        Returns
        -------
        GridSurface
            The patch over N(i) x N(i), in object units and coordinates: T1 holds
            the x of the neighbors and zero, T2 the y.
        """
        T1 = TimeScale(np.unique(np.append(self.x[:, column], 0)))
        T2 = TimeScale(np.unique(np.append(self.y[:, column], 0)))
        x, y = np.meshgrid(T1.points, T2.points, indexing="ij")
        z = sum(
            a * _power(x, i) * _power(y, j)
            for a, (i, j) in zip(self.coefficients[:, column], TERMS, strict=True)
        )
        axes = np.stack([self.u[:, column], self.v[:, column], self.n[:, column]])
        reach = self.reach[column]
        points = np.stack([x, y, z], axis=-1) @ axes * reach + np.asarray(origin)
        return GridSurface(T1.points * reach, T2.points * reach, points)


def jumps(coordinate: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return sigma(0) and rho(0) of the time scales {x_j} and {0}, two (m,).

    Zero where there is no member on that side.
    """
    above = np.where(coordinate > 0, coordinate, np.inf).min(axis=0)
    below = np.where(coordinate < 0, coordinate, -np.inf).max(axis=0)
    return np.where(np.isinf(above), 0, above), np.where(np.isinf(below), 0, below)


def fit_patches(
    offsets: FloatArray,
    reach: FloatArray,
    *,
    chart: str = "principal",
    exact: bool = False,
) -> Patches:
    """Fit the patch of Eq. (2) to each neighborhood by least squares.

    Parameters
    ----------
    offsets : (3, k, m) float32 or float64
        Neighbors less their point, in units of `reach`; zero where one is missing.
    reach : (m,) float64
        The distance of the farthest neighbor, in object units.
    chart : "principal" | "global"
            Axes that follow the neighborhood, or the axes of the input.
    exact : bool
        Solve by singular values instead of normal equations: slower, and exact to
        rounding however badly the neighbors are placed.

    Returns
    -------
    Patches
    """
    count = (offsets != 0).any(axis=0).sum(axis=0)
    u, v, normal, spans = principal_axes(offsets, count)
    if chart == "global":
        u, v, normal = (np.broadcast_to(e[:, None], u.shape) for e in np.eye(3))
    x, y, z = (_along(axis, offsets) for axis in (u, v, normal))
    coefficients = _least_squares(x, y, z) if exact else _normal_equations(x, y, z)
    valid = (count >= LEAST_NEIGHBORS) & spans & np.isfinite(coefficients).all(axis=0)
    return Patches(u, v, normal, reach, x, y, z, coefficients, valid)


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
    # Few numbers a point from here on: double precision costs little and tells a
    # narrow neighborhood from a line.
    covariance = [c.astype(np.float64) for c in covariance]
    n, middle, largest = _least_eigenvectors(*covariance)
    u, v = _turned_between(*tangent_axes(n), *covariance)
    spans = (largest > 0) & (middle > _LINE * largest)
    return *(axis.astype(offsets.dtype) for axis in (u, v, n)), spans


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


def _least_eigenvectors(xx, xy, xz, yy, yz, zz):
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
    """Return u, v that complete unit vectors (3, m) to right-handed charts [2]."""
    x, y, z = normal
    sign = np.where(z >= 0, 1, -1).astype(normal.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    u = np.stack([1 + sign * x * x * a, sign * b, -sign * x])
    v = np.stack([b, sign + y * y * a, -y])
    return u, v


def _along(axis, offsets):
    """Return the coordinates of (3, k, m) offsets along axes (3, m), (k, m)."""
    result = axis[0] * offsets[0]
    result += axis[1] * offsets[1]
    result += axis[2] * offsets[2]
    return result


def _power(x, exponent):
    return np.ones_like(x) if exponent == 0 else x**exponent


def _design(x, y):
    """Return the matrices of Eq. (3), (m, k, 8) float64."""
    columns = [_power(x, i) * _power(y, j) for i, j in TERMS]
    return np.stack(columns, axis=-1).swapaxes(0, 1).astype(np.float64)


def _least_squares(x, y, z):
    """Solve Eq. (3) by singular values; the smallest solution where it has many."""
    inverse = np.linalg.pinv(_design(x, y), rcond=1e-12)
    return np.einsum("mik,km->im", inverse, z.astype(np.float64))


def _normal_equations(x, y, z):
    """Solve Eq. (3) by normal equations and a Cholesky factorization.

    Every entry of the 8 x 8 matrices is a moment, the sum of x^i y^j, and many
    entries share one: 22 sums fill the matrix.
    """
    xs, ys = _powers(x, 4), _powers(y, 4)
    moments = {}

    def moment(i, j):
        if (i, j) not in moments:
            if i and j:
                moments[i, j] = np.einsum("km,km->m", xs[i], ys[j])
            else:
                moments[i, j] = (xs[i] if i else ys[j]).sum(axis=0)
        return moments[i, j]

    matrix = [
        [moment(a + c, b + d) for c, d in TERMS[: row + 1]]
        for row, (a, b) in enumerate(TERMS)
    ]
    zx = [z, z * x, z * xs[2]]
    right = [
        np.einsum("km,km->m", zx[i], ys[j]) if j else zx[i].sum(axis=0)
        for i, j in TERMS
    ]
    return np.stack(_cholesky_solve(matrix, right))


def _powers(x, top):
    """Return x to the powers 1 ... top, by exponent."""
    powers = {1: x}
    for exponent in range(2, top + 1):
        powers[exponent] = powers[exponent - 1] * x
    return powers


def _cholesky_solve(matrix, right):
    """Solve symmetric positive systems, entry by entry over all points at once.

    Parameters
    ----------
    matrix : lower triangle, matrix[i][j] (m,) for j <= i
    right : list of (m,)

    Returns
    -------
    list of (m,)
    """
    size, dtype = len(right), right[0].dtype
    ridge = dtype.type(_RIDGE[dtype])
    factor, inverse = _cholesky(matrix, ridge)
    forward: list[np.ndarray] = []
    for i in range(size):
        entry = right[i]
        for t in range(i):
            entry = entry - factor[i][t] * forward[t]
        forward.append(entry * inverse[i])
    solution = list(forward)
    for i in reversed(range(size)):
        entry = forward[i]
        for t in range(i + 1, size):
            entry = entry - factor[t][i] * solution[t]
        solution[i] = entry * inverse[i]
    return solution


def _cholesky(matrix, ridge):
    """Factor lower triangles; return the part below the diagonal, and 1/diagonal."""
    factor: list[list[np.ndarray]] = []
    inverse: list[np.ndarray] = []
    for i, entries in enumerate(matrix):
        row: list[np.ndarray] = []
        for j in range(i):
            entry = entries[j]
            for t in range(j):
                entry = entry - row[t] * factor[j][t]
            row.append(entry * inverse[j])
        pivot = entries[i] * (1 + ridge)
        for entry in row:
            pivot = pivot - entry * entry
        # Rounding may leave less than the ridge put there, or less than nothing.
        floor = entries[i] * ridge + np.finfo(ridge.dtype).tiny
        inverse.append(1 / np.sqrt(np.maximum(pivot, floor)))
        factor.append(row)
    return factor, inverse
