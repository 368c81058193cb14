# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a patch should reach: the number of neighbors that the data ask for."""

import numpy as np

from .graph import NearestNeighbors
from .patch import LEAST_NEIGHBORS, fit_patches

# Each step widens a patch by a fifth: finer steps change the error by less than the
# choice can tell.
LADDER = (16, 24, 36, 54, 81, 122, 182, 273, 410)

# Points that are asked: enough for a mean square within a few per cent.
_SAMPLES = 1024

# In a disk filled evenly with k neighbors at noise s (in units of the reach) the
# least-squares slopes of Eq. (2) have variances that add up to this times s^2/k:
# 2 / (E[x^2] - E[x^2 y^2]^2 / E[x^2 y^4]) = 2 / (1/4 - (1/24)^2 * 64).
_SLOPE_VARIANCE = 14.4

# Slopes this uncertain (10 degrees) say that the chart itself has turned into the
# noise: residuals no longer tell how wrong the normals are, only that they are.
_LOST = np.radians(10) ** 2


def choose_neighbors(nearest: NearestNeighbors) -> tuple[int, float]:
    """Choose one number of neighbors for a whole cloud.

    Parameters
    ----------
    nearest : NearestNeighbors

    Returns
    -------
    neighbors : int
    noise : float
        Standard deviation of the points about their patches, in object units.

    Notes
    -----
    The mean square error of the slopes at k neighbors is variance plus squared bias.
    The variance follows from the residuals. The bias shows in the difference between
    the slopes at k and at the step of the ladder before: what exceeds the difference
    of the two variances is b(k) - b(k'), and as the leading bias grows with the area
    of a patch, b(k') = b(k) k'/k. Steps lost in the noise are out of the choice.
    """
    n = len(nearest.points)
    ladder = [k for k in LADDER if k <= n // 4] or [min(LADDER[0], n - 1)]
    rows = nearest.order[:: max(1, n // _SAMPLES)]
    fits = [_fit(nearest, rows, *found) for found in _nested(nearest, rows, ladder)]
    valid = np.logical_and.reduce([fit.valid for fit in fits])
    if not valid.any():
        return ladder[0], 0.0
    variance, noise = np.array(
        [_variance(fit, k) for fit, k in zip(fits, ladder, strict=True)]
    ).swapaxes(0, 1)
    normals = [fit.normals()[valid] for fit in fits]
    error = [variance[0][valid].mean()]
    for i in range(1, len(ladder)):
        change = 1 - (normals[i] * normals[i - 1]).sum(axis=1) ** 2
        expected = variance[i - 1][valid] - variance[i][valid]
        growth = 1 - ladder[i - 1] / ladder[i]
        bias = max(0.0, (change - expected).mean()) / growth**2
        error.append(variance[i][valid].mean() + bias)
    lost = [v[valid].mean() > _LOST for v in variance]
    best = int(np.argmin(np.where(lost, np.inf, error))) if not all(lost) else -1
    return ladder[best], float(np.median(noise[best][valid]))


def _nested(nearest, rows, ladder):
    """Yield the neighbors of the rows for each step of the ladder, from one query."""
    index, distance = nearest.neighbors(rows, ladder[-1])
    for k in ladder:
        yield index[:, :k], distance[:, k - 1]


def _fit(nearest, rows, index, reach):
    offsets = nearest.points[index] - nearest.points[rows][:, None]
    offsets /= np.where(reach > 0, reach, 1)[:, None, None]
    return fit_patches(np.ascontiguousarray(offsets.transpose(2, 1, 0)), reach)


def _variance(patches, k):
    """Return the variance of the slopes and the noise in object units, 2 x (m,)."""
    free = max(1, k - LEAST_NEIGHBORS)
    square = (patches.residuals() ** 2).sum(axis=0) / free
    return _SLOPE_VARIANCE * square / k, np.sqrt(square) * patches.reach
