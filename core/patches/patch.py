# SPDX-License-Identifier: GPL-3.0-or-later
"""Charts and patches, in batches (section 3 and Table 1 of the paper).

A batch holds the neighborhoods of m points as arrays of shape (k, m): neighbor by
point. All work runs along the points, so that every step is one array operation for
the whole batch, and a point's result does not depend on who shares its batch.

References
----------
[1] See `timescale`.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..inputs import BoolArray, FloatArray, as_choice
from ..surface import GridSurface
from ..timescale import WEIGHTS, TimeScale
from .chart import along, principal_axes
from .solver import RIDGE, NormalEquations

# The exponents of x and y in the terms of a patch. The first is Eq. (2), A1 ... A8;
# the second has the cubes that Eq. (2) lacks instead of x^2 y^2, so that its slopes
# err by the cube of the reach and not by its square.
BIQUADRATIC = ((1, 0), (0, 1), (2, 0), (1, 1), (2, 1), (1, 2), (0, 2), (2, 2))
CUBIC = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))

# Eq. (2) has eight unknowns.
LEAST_NEIGHBORS = len(BIQUADRATIC)

# Weights fall to exp(-4), 2 %, at the farthest neighbor: near points matter most to
# a slope at the center, and nothing jumps when the farthest is another one.
_FALL = 4.0

# Up to here fits run in double precision; beyond, their time counts, and the spacing of
# so many points leaves rounding in single precision far below the error of a patch.
_DOUBLE_UP_TO = 50_000

# Medians are taken over so many patches at most: more say the same, and take memory.
MEDIAN_OF = 1_000_000


def precision(count: int) -> np.dtype:
    """Return the dtype in which the neighborhoods of so many points are fitted."""
    return np.dtype(np.float64 if count <= _DOUBLE_UP_TO else np.float32)


@dataclass(frozen=True)
class Patches:
    """The patches of m points, z(x, y) in a chart at each point.

    Lengths are in units of `reach`: multiply by it for object units.

    Attributes
    ----------
    u, v, n : (3, m)
        The axes of the charts; z is measured along n.
    reach : (m,) float64
        The distance of the farthest neighbor, in object units.
    x, y, z : (k, m)
        The neighbors in the charts; missing ones stand at the origin.
    terms : tuple of (int, int)
        The exponents of x and y in each term; the first two are x and y.
    coefficients : (terms, m)
        A1 ... A8 of Eq. (2) where the terms are its own.
    misfit : (m,)
        Root mean square of the residuals over that of the distances, weighted as
        the fit: how far, as an angle, the neighbors lie from the patch.
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
    terms: tuple[tuple[int, int], ...]
    coefficients: FloatArray
    misfit: FloatArray
    valid: BoolArray

    def slopes(self, *, weights: str = "second_order") -> tuple[FloatArray, FloatArray]:
        """Return the diamond derivatives of z along x and y at the points, 2 x (m,).

        Notes
        -----
        The time scales are T1 = {x_j} and {0}, T2 = {y_j} and {0}. On the patch of
        Eq. (2) the paper's derivatives are A1 + A3 (sigma1 + rho1) and
        A2 + A7 (sigma2 + rho2), where a one-sided end leaves out the jump it does not
        have. The second-order weights remove what the jumps add, at an end by the
        three-point difference: what remains is A1 and A2.
        """
        as_choice(weights, WEIGHTS, name="weights")
        if weights == "second_order":
            return self.coefficients[0], self.coefficients[1]
        along_x = self._quotient(jumps(self.x), 0)
        along_y = self._quotient(jumps(self.y), 1)
        return along_x, along_y

    def _quotient(self, ends, axis):
        """Return (z(sigma) - z(rho)) / (sigma - rho) on an axis of the chart, (m,)."""
        sigma, rho = ends
        # (sigma^i - rho^i) / (sigma - rho), without the division.
        quotients = {1: 1.0, 2: sigma + rho, 3: sigma**2 + sigma * rho + rho**2}
        return sum(
            a * quotients[exponents[axis]]
            for a, exponents in zip(self.coefficients, self.terms, strict=True)
            if exponents[1 - axis] == 0
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

    @property
    def noise(self) -> FloatArray:
        """(m,), the standard deviation of the noise that explains the misfit.

        In object units. In the sum of squares each term of the patch takes one
        degree of freedom, which an even disk of as many neighbors tells.
        """
        _, square = solve_on_disk(self.terms, max(len(self.x), len(self.terms) + 1))
        return self.misfit * self.reach / np.sqrt(square)

    def residuals(self) -> FloatArray:
        """Return z of the neighbors less z of the patch, (k, m), in units of reach."""
        return self.z - _heights(self.x, self.y, self.terms, self.coefficients)

    @cached_property
    def condition(self) -> FloatArray:
        """(m,) float64, the condition number of the matrix of Eq. (3), not weighted.

        With coordinates in units of reach; infinite where the neighbors leave some
        term open.
        """
        return np.linalg.cond(_design(self.x, self.y, self.terms))

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
        z = _heights(x, y, self.terms, self.coefficients[:, column])
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
    terms: tuple[tuple[int, int], ...] = CUBIC,
    chart: str = "principal",
) -> Patches:
    """Fit a patch to each neighborhood by least squares, near points weighing more.

    Parameters
    ----------
    offsets : (3, k, m) float32 or float64
        Neighbors less their point, in units of `reach`; zero where one is missing.
    reach : (m,) float64
        The distance of the farthest neighbor, in object units.
    terms : tuple of (int, int)
        `CUBIC` or `BIQUADRATIC`.
    chart : "principal" | "global"
        Axes that follow the neighborhood, or, as Table 1 has it, the axes of the
        input; there neighbors are not weighted, and Eq. (3) is solved by singular
        values: slower, and exact to rounding however badly the neighbors are placed.

    Returns
    -------
    Patches
    """
    square = np.einsum("ikm,ikm->km", offsets, offsets)
    count = np.count_nonzero(square, axis=0)
    u, v, normal, spans = principal_axes(offsets, count)
    if chart == "global":
        u, v, normal = (np.broadcast_to(e[:, None], u.shape) for e in np.eye(3))
    x, y, z = (along(axis, offsets) for axis in (u, v, normal))
    if chart == "global":
        weights = np.ones_like(square)
        coefficients = _least_squares(x, y, z, terms)
        missed = (z - _heights(x, y, terms, coefficients)) ** 2
        left = missed.sum(axis=0)
    else:
        weights = np.exp(-_FALL * square)
        coefficients, left = _normal_equations(x, y, z, weights, terms)
    total = np.einsum("km,km->m", weights, square)
    misfit = np.sqrt(np.maximum(left, 0) / np.where(total > 0, total, 1))
    valid = (count >= LEAST_NEIGHBORS) & spans & np.isfinite(coefficients).all(axis=0)
    return Patches(u, v, normal, reach, x, y, z, terms, coefficients, misfit, valid)


def _power(x, exponent):
    return np.ones_like(x) if exponent == 0 else x**exponent


def _heights(x, y, terms, coefficients):
    """Return z(x, y) of patches, whatever their places' shape."""
    return sum(
        a * _power(x, i) * _power(y, j)
        for a, (i, j) in zip(coefficients, terms, strict=True)
    )


def _design(x, y, terms):
    """Return the matrices of Eq. (3), (m, k, terms) float64."""
    columns = [_power(x, i) * _power(y, j) for i, j in terms]
    return np.stack(columns, axis=-1).swapaxes(0, 1).astype(np.float64)


def _least_squares(x, y, z, terms):
    """Solve Eq. (3) by singular values; the smallest solution where it has many."""
    inverse = np.linalg.pinv(_design(x, y, terms), rcond=1e-12)
    return np.einsum("mik,km->im", inverse, z.astype(np.float64))


def _normal_equations(x, y, z, weights, terms):
    """Solve weighted least squares by normal equations, entry by entry.

    Returns
    -------
    coefficients : (terms, m)
    left : (m,)
        The weighted sum of squared residuals, z'Wz - b'a, without residuals.
    """
    equations = NormalEquations(terms, x, y, z, weights)
    right = equations.right.copy()
    ridge = x.dtype.type(RIDGE[x.dtype])
    for row in range(len(terms)):
        equations.matrix[row, row] *= 1 + ridge
    solution = equations.solve()
    explained = np.einsum("im,im->m", solution, right)
    return solution, np.einsum("km,km,km->m", weights, z, z) - explained


@cache
def solve_on_disk(
    terms: tuple[tuple[int, int], ...], count: int
) -> tuple[float, float]:
    """Return how noise of variance one spreads into a patch over an even disk.

    Parameters
    ----------
    terms : tuple of (int, int)
    count : int
        Neighbors, spread over the unit disk as the seeds of a sunflower.

    Returns
    -------
    slopes : float
        The variance of both slopes together.
    misfit : float
        The expected square of `Patches.misfit`.
    """
    rank = np.arange(1, count + 1)
    radius, angle = np.sqrt(rank / count), np.pi * (3 - np.sqrt(5)) * rank
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    weights = np.exp(-_FALL * radius**2)
    design = _design(x[:, None], y[:, None], terms)[0]
    weighted = design * weights[:, None]
    ridge = RIDGE[np.dtype(np.float64)]
    normal = design.T @ weighted
    solve = np.linalg.solve(normal + ridge * np.diag(np.diag(normal)), weighted.T)
    # The noise of the point itself shifts all neighbors alike.
    noise = np.eye(count) + 1
    missed = np.eye(count) - design @ solve
    left = np.trace(missed.T @ (weights[:, None] * missed) @ noise)
    slopes = np.trace(solve[:2] @ noise @ solve[:2].T)
    return float(slopes), float(left / (weights * radius**2).sum())
