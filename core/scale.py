# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a patch should reach, and with which terms: what the data ask for."""

import numpy as np

from .graph import NearestNeighbors
from .inputs import FloatArray
from .patch import BIQUADRATIC, CUBIC, Patches, fit_patches, solve_on_disk

# The patches to choose from. Cubic ones are far ahead where points are exact; under
# noise their slopes vary twice as much, and wide biquadratic ones take over.
# Each with the order of its slopes and steps that widen it by a fifth: finer ones
# change the error by less than the choice can tell.
CANDIDATES = {
    "cubic": (CUBIC, 3, (16, 24, 36, 54, 81, 122, 182)),
    "biquadratic": (BIQUADRATIC, 2, (24, 36, 54, 81, 122, 182, 273, 410, 615)),
}
_DEFAULT = ("cubic", 16)

# Points that are asked: enough for a mean square within a few per cent.
_SAMPLES = 1024

# Slopes this uncertain (10 degrees) say that the chart itself has turned into the
# noise: residuals no longer tell how wrong the normals are, only that they are.
_LOST = np.radians(10) ** 2


def choose_scale(nearest: NearestNeighbors) -> tuple[str, int]:
    """Choose one kind of patch and one number of neighbors for a whole cloud.

    Returns
    -------
    patch : "cubic" | "biquadratic"
    neighbors : int

    Notes
    -----
    The mean square error of the slopes at k neighbors is variance plus squared bias.
    The variance follows from the residuals. The bias shows in the difference between
    the slopes at k and at the step before: what exceeds the difference of the two
    variances is b(k) - b(k'), and as the leading bias of a patch of order p grows
    with the reach to the p, b(k') = b(k) (k'/k)^(p/2). Steps lost in the noise are
    out of the choice.
    """
    best, least = (*_DEFAULT,), np.inf
    for patch, (terms, order, steps) in CANDIDATES.items():
        fitting = tuple(k for k in steps if 4 * k <= len(nearest.points))
        for k, error, variance in _errors(nearest, terms, order, fitting):
            # Where all is lost in the noise, the least variance is the best bet.
            score = error if variance < _LOST else 1 + variance
            if score < least:
                best, least = (patch, k), score
    patch, neighbors = best
    return patch, min(neighbors, len(nearest.points) - 1)


def _errors(nearest, terms, order, steps):
    """Yield k, mean square error and variance of the slopes at each step."""
    if len(steps) < 2:
        return
    fits = _fits(nearest, terms, steps)
    valid = np.logical_and.reduce([fit.valid for fit in fits])
    if not valid.any():
        return
    # The median: patches across a crease or two sheets have residuals that are no
    # noise.
    variance = [
        np.median(_variance(fit, k)[valid]) for fit, k in zip(fits, steps, strict=True)
    ]
    normals = [fit.normals()[valid] for fit in fits]
    for i, k in enumerate(steps):
        # The first step has none before it: its bias follows from the second's.
        now = max(i, 1)
        turned = 1 - (normals[now] * normals[now - 1]).sum(axis=1) ** 2
        change = np.minimum(turned, _LOST).mean()
        excess = max(0.0, change - (variance[now - 1] - variance[now]))
        shrinks = (steps[now - 1] / steps[now]) ** (order / 2)
        bias = excess / (1 - shrinks) ** 2 * (shrinks**2 if i == 0 else 1)
        yield k, variance[i] + bias, variance[i]


def _fits(nearest, terms, steps):
    """Return the patches of the points that are asked at each step."""
    rows = nearest.order[:: max(1, len(nearest.points) // _SAMPLES)]
    index, distance = nearest.neighbors(rows, steps[-1])
    return [_fit(nearest, rows, index[:, :k], distance[:, k - 1], terms) for k in steps]


def _fit(nearest, rows, index, reach, terms):
    offsets = nearest.points[index] - nearest.points[rows][:, None]
    offsets /= np.where(reach > 0, reach, 1)[:, None, None]
    return fit_patches(
        np.ascontiguousarray(offsets.transpose(2, 1, 0)), reach, terms=terms
    )


def _variance(patches: Patches, k: int) -> FloatArray:
    """Return the variance of both slopes together, from the residuals, (m,)."""
    slopes, residual = solve_on_disk(patches.terms, k)
    return patches.misfit**2 * slopes / residual
