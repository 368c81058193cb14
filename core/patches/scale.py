# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a patch should reach, and with which terms: what the data ask for."""

from typing import Any

import numpy as np

from ..inputs import FloatArray
from .asked import EVERY, Asked
from .patch import BIQUADRATIC, CUBIC, Patches, fit_patches, solve_on_disk
from .solver import Terms

# The patches to choose from. Cubic ones are far ahead where points are exact; under
# noise their slopes vary twice as much, and wide biquadratic ones take over.
# Each with the order of its slopes and steps that widen it by a fifth: finer ones
# change the error by less than the choice can tell.
CANDIDATES = {
    "cubic": (CUBIC, 3, (16, 24, 36, 54, 81, 122, 182)),
    "biquadratic": (BIQUADRATIC, 2, (24, 36, 54, 81, 122, 182, 273, 410, 615)),
}
NARROWEST = 16
_DEFAULT = ("cubic", NARROWEST)

# With every step variance falls and bias grows: where the bias alone is more than the
# least error so far, the steps beyond are no better. That is said only where variance
# is less than a fifth of both errors: noise shows as bias, too.
_CLEAR = 0.2

# Slopes this uncertain (10 degrees) say that the chart itself has turned into the
# noise: residuals no longer tell how wrong the normals are, only that they are.
_LOST = np.radians(10) ** 2


def choose_scale(asked: Asked) -> tuple[str, int]:
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
    out of the choice, and so are those beyond one whose bias alone is too much.
    """
    best, least, varies = (*_DEFAULT,), np.inf, np.inf
    for patch, (terms, order, steps) in CANDIDATES.items():
        fitting = tuple(k for k in steps if k <= asked.count // EVERY)
        for k, error, variance in _errors(asked, terms, order, fitting):
            # Where all is lost in the noise, the least variance is the best bet.
            score = error if variance < _LOST else 1 + variance
            if score < least:
                best, least, varies = (patch, k), score, variance
            clear = variance < _CLEAR * error and varies < _CLEAR * least
            if clear and error - variance > least:
                break
    patch, neighbors = best
    return patch, min(neighbors, asked.count - 1)


def _errors(asked, terms, order, steps):
    """Yield k, mean square error and variance of the slopes at each step."""
    valid: Any = True
    before = None
    for k in steps:
        fit = patches_of(asked, k, terms)
        valid = valid & fit.valid
        if not valid.any():
            return
        # The median: patches across a crease or two sheets have residuals that are
        # no noise.
        now = k, fit.normals(), np.median(_variance(fit, k)[valid])
        if before is not None:
            shrinks = (before[0] / k) ** (order / 2)
            bias = _bias(before, now, valid, shrinks)
            if before[0] == steps[0]:
                # The first step has none before it: its bias follows from this one's.
                yield before[0], before[2] + bias * shrinks**2, before[2]
            yield k, now[2] + bias, now[2]
        before = now


def _bias(before, now, valid, shrinks):
    """Return the squared bias of a step from what it changes."""
    turned = 1 - (before[1] * now[1])[valid].sum(axis=1) ** 2
    change = np.minimum(turned, _LOST).mean()
    return max(0.0, change - (before[2] - now[2])) / (1 - shrinks) ** 2


def patches_of(asked: Asked, k: int, terms: Terms) -> Patches:
    """Return the Patches of all points that are asked, with k neighbors."""
    offsets, reach = asked.around(k)
    return fit_patches(offsets, reach, terms=terms)


def _variance(patches: Patches, k: int) -> FloatArray:
    """Return the variance of both slopes together, from the residuals, (m,)."""
    slopes, residual = solve_on_disk(patches.terms, k)
    return patches.misfit**2 * slopes / residual
