# SPDX-License-Identifier: GPL-3.0-or-later
"""Normal equations of many small least-squares problems, entry by entry.

Each entry of a matrix is an array over all points, (m,), so that making the matrices
and solving them are operations along the points.
"""

import numpy as np

from .inputs import FloatArray

# Share of each pivot added to it: it keeps a solution finite where neighbors do not
# determine all terms, and lies at the rounding of the sums it is added to.
RIDGE = {np.dtype(np.float32): 3e-6, np.dtype(np.float64): 1e-10}


class Moments:
    """Sums w x^i y^j over the neighbors, each made once when it is asked for.

    Parameters
    ----------
    x, y, weights : (k, m)
    """

    def __init__(self, x: FloatArray, y: FloatArray, weights: FloatArray) -> None:
        self.x, self.y, self.weights = x, y, weights
        self._weighted = [weights]
        self._powers: list[FloatArray] = [y]
        self._sums: dict[tuple[int, int], FloatArray] = {}

    def __call__(self, i: int, j: int) -> FloatArray:
        """Return the sum of w x^i y^j, (m,)."""
        if (i, j) not in self._sums:
            while len(self._weighted) <= i:
                self._weighted.append(self._weighted[-1] * self.x)
            while len(self._powers) < j:
                self._powers.append(self._powers[-1] * self.y)
            left = self._weighted[i]
            self._sums[i, j] = (
                np.einsum("km,km->m", left, self._powers[j - 1])
                if j
                else left.sum(axis=0)
            )
        return self._sums[i, j]


def cholesky_solve(
    matrix: list[list[FloatArray]], right: list[FloatArray]
) -> list[FloatArray]:
    """Solve symmetric positive systems, entry by entry over all points at once.

    Parameters
    ----------
    matrix : lower triangle, matrix[i][j] (m,) for j <= i
    right : list of (m,)

    Returns
    -------
    list of (m,)
    """
    size = len(right)
    factor, inverse = _cholesky(matrix)
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


def _cholesky(matrix):
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
        pivot = entries[i]
        for entry in row:
            pivot = pivot - entry * entry
        # Rounding may leave less than a ridge put there, or less than nothing.
        dtype = pivot.dtype
        floor = entries[i] * dtype.type(RIDGE[dtype]) + np.finfo(dtype).tiny
        inverse.append(1 / np.sqrt(np.maximum(pivot, floor)))
        factor.append(row)
    return factor, inverse
