# SPDX-License-Identifier: GPL-3.0-or-later
"""Least squares for polynomials in x and y, in many small neighborhoods at once.

Every entry of a matrix is an array over all points, (m,): making the matrices and
solving them are operations along the points.
"""

from functools import cache

import numpy as np

from ..inputs import FloatArray

# The exponents of x and y in each term of a polynomial.
Terms = tuple[tuple[int, int], ...]

# Share of each pivot added to it: it keeps a solution finite where neighbors do not
# determine all terms, and lies at the rounding of the sums it is added to.
RIDGE = {np.dtype(np.float32): 3e-6, np.dtype(np.float64): 1e-10}


class NormalEquations:
    """Weighted normal equations of z(x, y), from its heights and from its slopes.

    Parameters
    ----------
    terms : tuple of (int, int)
    x, y, z : (k, m)
        k places for each of m points.
    weights : (k, m)

    Attributes
    ----------
    matrix : (terms, terms, m)
    right : (terms, m)
    """

    def __init__(
        self,
        terms: Terms,
        x: FloatArray,
        y: FloatArray,
        z: FloatArray,
        weights: FloatArray,
    ) -> None:
        self.terms, self.x = terms, x
        size, (k, m) = len(terms), x.shape
        highest = 2 * max(j for _, j in terms)
        self._powers = np.empty((highest + 1, k, m), dtype=x.dtype)
        self._powers[0], self._powers[1] = 1, y
        for j in range(2, highest + 1):
            np.multiply(self._powers[j - 1], y, out=self._powers[j])
        # The right side is one more row: elimination treats it like the others.
        self._system = np.empty((size + 1, size, m), dtype=x.dtype)
        self.matrix, self.right = self._system[:-1], self._system[-1]
        heights = (0, 0)
        _, i, j = differentiated(terms, heights)
        moments = self._moments(weights, _ranges(terms, (heights,), products=True))
        self.matrix[:] = moments[i[:, None] + i, j[:, None] + j]
        self.right[:] = self._moments(weights * z, _ranges(terms, (heights,)))[i, j]

    def add_slopes(self, dx: FloatArray, dy: FloatArray, weights: FloatArray) -> None:
        """Add equations for the derivatives of z along x and y, (k, m) each."""
        known = {(1, 0): dx, (0, 1): dy}
        moments = self._moments(weights, _ranges(self.terms, (*known,), products=True))
        for which, slope in known.items():
            factor, i, j = differentiated(self.terms, which)
            factor = factor.astype(slope.dtype)[:, None]
            product = moments[i[:, None] + i, j[:, None] + j]
            product *= factor[:, None] * factor
            self.matrix += product
            moment = self._moments(weights * slope, _ranges(self.terms, (which,)))
            self.right += factor * moment[i, j]

    def _moments(self, weighted, ranges):
        """Return the sums w x^i y^j over the places, [i, j] -> (m,), in ranges of j."""
        shape = (len(ranges), max(high for _, high in ranges), weighted.shape[1])
        result = np.empty(shape, dtype=weighted.dtype)
        for i, (low, high) in enumerate(ranges):
            if i:
                weighted = weighted * self.x
            powers, here = self._powers[low:high], result[i, low:high]
            np.einsum("km,jkm->jm", weighted, powers, out=here)
        return result

    def solve(self) -> FloatArray:
        """Return the coefficients, (terms, m); the equations are used up."""
        return cholesky_solve(self._system)


@cache
def differentiated(terms, which):
    """Return a derivative of each term, factor x^i y^j: three (terms,).

    `which` is (0, 0) for the terms themselves, (1, 0) for derivatives along x, (0, 1)
    along y. Where the factor is zero, so are the exponents.
    """
    i, j = np.array(terms).T
    factor = np.where(which[0], i, 1) * np.where(which[1], j, 1)
    there = factor != 0
    return factor, (i - which[0]) * there, (j - which[1]) * there


@cache
def _ranges(terms, derivatives, products=False):
    """Return for each i the range of j, low and high, in x^i y^j.

    In derivatives of the terms, or in the products of any two terms of one.
    """
    found = set()
    for factor, i, j in (differentiated(terms, which) for which in derivatives):
        there = list(zip(i[factor != 0], j[factor != 0], strict=True))
        others = there if products else [(0, 0)]
        found |= {(a + c, b + d) for a, b in there for c, d in others}
    rows = [[j for i, j in found if i == row] for row in range(max(found)[0] + 1)]
    return [(min(row), max(row) + 1) if row else (0, 0) for row in rows]


def cholesky_solve(system: FloatArray) -> FloatArray:
    """Solve symmetric positive systems, all points at once.

    Parameters
    ----------
    system : (size + 1, size, m)
        The matrices, of which only the lower triangles count, and the right sides as
        one more row. They are overwritten.

    Returns
    -------
    (size, m)
    """
    size, dtype = system.shape[1], system.dtype
    matrix = system[:-1]
    # Rounding may leave less of a pivot than a ridge put there, or less than nothing.
    floor = np.einsum("iim->im", matrix) * dtype.type(RIDGE[dtype])
    floor += np.finfo(dtype).tiny
    inverse = np.empty_like(floor)
    for i in range(size):
        inverse[i] = 1 / np.sqrt(np.maximum(matrix[i, i], floor[i]))
        # What is above the diagonal is carried along: fewer operations, on more.
        system[i + 1 :, i] *= inverse[i]
        below = matrix[i + 1 :, i]
        system[i + 1 :, i + 1 :] -= system[i + 1 :, i, None] * below
    solution = system[-1]
    for i in reversed(range(size)):
        solution[i] *= inverse[i]
        solution[:i] -= matrix[i, :i] * solution[i]
    return solution
