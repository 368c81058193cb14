# SPDX-License-Identifier: GPL-3.0-or-later
"""Patches of many sizes and kinds at every point, and what tells them apart."""

from math import factorial

import numpy as np

from ..inputs import FloatArray, IntArray
from ..neighbors.graph import NearestNeighbors
from ..patches.chart import along, least_eigenvectors, tangent_axes
from ..patches.patch import CUBIC
from ..patches.solver import RIDGE, NormalEquations, cholesky_solve

# Kinds of patches: through the point itself, which is good where points are exact, or
# with a constant term, where they are not.
PLANE, QUADRATIC, THROUGH, ABOVE = "plane", "quadratic", "cubic through", "cubic"
_TERMS = {
    QUADRATIC: ((0, 0), *CUBIC[:5]),
    THROUGH: CUBIC,
    ABOVE: ((0, 0), *CUBIC),
}

Steps = dict[int, tuple[str, ...]]

# Numbers of neighbors, each step a fifth or two wider than the one before, and the
# patches to choose among. A plane is fitted at every step, for what it tells.
EXACT: Steps = {
    10: (PLANE,),
    16: (QUADRATIC,),
    24: (THROUGH,),
    36: (QUADRATIC,),
}
NOISY: Steps = {
    10: (PLANE,),
    19: (),
    36: (QUADRATIC,),
    54: (QUADRATIC, ABOVE),
    81: (QUADRATIC,),
    122: (QUADRATIC, ABOVE),
}

# As in `patch`: weights fall to 2 % at the farthest neighbor.
_FALL = 4.0

# Squares of angles and of shares below this are all alike: a thousandth of a radian.
_LEAST = np.float32(1e-6)


def fit_ladder(
    nearest: NearestNeighbors, rows: IntArray, steps: Steps
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit the patches of all steps to the neighborhoods of some points.

    Returns
    -------
    normals : (candidates, 3, m) float32, unit
        Of the patches listed in `steps`, in their order.
    reach : (candidates, m) float32
        The distance of their farthest neighbors, in object units.
    features : (features, m) float32
        Logarithms of shares and of squared angles: they depend neither on the size of
        the cloud nor on how it is turned.
    """
    offsets, _ = nearest.offsets(rows, max(steps))
    # From coordinates alone: a part of a cloud has the same as all of it.
    ends = offsets[:, [k - 1 for k in steps]]
    distance = dict(zip(steps, np.sqrt((ends * ends).sum(axis=0)), strict=True))
    reach = distance[max(steps)]
    reach = np.where(reach > 0, reach, 1)
    offsets = (offsets / reach).astype(np.float32)
    square = np.einsum("ikm,ikm->km", offsets, offsets)
    normals, reaches, features = [], [], []
    before: dict[str, FloatArray] = {}
    for k, kinds in steps.items():
        width = np.maximum(distance[k] / reach, 1e-6).astype(np.float32)
        features.append(np.log(width))
        weights = np.exp(square[:k] * (-_FALL / width**2))
        plane, facts = _plane(offsets[:, :k], weights, width)
        features += facts
        fitted, facts = _patches(
            offsets[:, :k], weights, width, plane, [x for x in kinds if x != PLANE]
        )
        features += facts
        found = {PLANE: plane} | fitted
        for kind, normal in found.items():
            if kind in before:
                features.append(turn(normal, before[kind]))
            if kind != PLANE:
                features.append(turn(normal, plane))
            if kind in kinds:
                normals.append(normal)
                reaches.append(width * reach.astype(np.float32))
        before |= found
    return np.stack(normals), np.stack(reaches), np.stack(features)


def _log(share):
    return np.log(np.maximum(share, 0) + _LEAST)


def turn(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the logarithm of the squared sine between directions (3, m)."""
    # From the cross product: one less the squared cosine of what is nearly alike is
    # little but rounding.
    x, y, z = (a[i] * b[j] - a[j] * b[i] for i, j in ((1, 2), (2, 0), (0, 1)))
    return _log(x * x + y * y + z * z)


def _plane(offsets, weights, width):
    """Return the plane of least squares and what tells about it.

    The point itself belongs to its neighborhood, with weight one.
    """
    total = 1 + weights.sum(axis=0)
    weighted = [weights * offset for offset in offsets]
    mean = [w.sum(axis=0) / total for w in weighted]
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    covariance = [
        (
            np.einsum("km,km->m", weighted[i], offsets[j]) / total - mean[i] * mean[j]
        ).astype(np.float64)
        for i, j in pairs
    ]
    normal, middle, largest = least_eigenvectors(*covariance)
    least = covariance[0] + covariance[3] + covariance[5] - middle - largest
    largest = np.maximum(largest, 1e-30)
    normal = normal.astype(np.float32)
    height = sum(n * m for n, m in zip(normal, mean, strict=True))
    aside = sum(m * m for m in mean) - height**2
    facts = [
        _log((least / largest).astype(np.float32)),
        _log((middle / largest).astype(np.float32)),
        _log(aside / width**2),
        _log(height**2 / width**2),
    ]
    return normal, facts


def _patches(offsets, weights, width, plane, kinds):
    """Return the normals of patches in the chart of a plane, and what they miss."""
    if not kinds:
        return {}, []
    u, v = tangent_axes(plane)
    x, y, z = (along(axis, offsets) / width for axis in (u, v, plane))
    terms = max((_TERMS[kind] for kind in kinds), key=len)
    terms = terms if (0, 0) in terms else ((0, 0), *terms)
    equations = NormalEquations(terms, x, y, z, weights)
    matrix, right = equations.matrix, equations.right
    whole = np.einsum("km,km,km->m", weights, z, z)
    spread = matrix[1, 1] + matrix[2, 2]
    found, facts = {}, []
    for kind in kinds:
        rows = [terms.index(term) for term in _TERMS[kind]]
        system = np.concatenate([matrix[np.ix_(rows, rows)], right[None, rows]])
        if _TERMS[kind][0] == (0, 0):
            # The point itself, which the patch need not meet.
            system[0, 0] += 1
        for i in range(len(rows)):
            system[i, i] *= 1 + np.float32(RIDGE[np.dtype(np.float32)])
        solution = cholesky_solve(system)
        left = whole - np.einsum("im,im->m", solution, right[rows])
        facts.append(_log(left / spread))
        by_term = dict(zip(_TERMS[kind], solution, strict=True))
        if kind == QUADRATIC:
            facts.append(_log(by_term[0, 0] ** 2))
            facts.append(_log(_bending(by_term)))
        a, b = by_term[1, 0], by_term[0, 1]
        normal = plane - a * u - b * v
        length = np.sqrt((normal * normal).sum(axis=0))
        normal = normal / np.where(length > 0, length, 1)
        found[kind] = np.where(np.isfinite(normal).all(axis=0), normal, plane)
    return found, facts


def _bending(by_term):
    """Return the squared norm of the second derivatives, whatever the axes."""
    return sum(
        factorial(i) * factorial(j) * by_term[i, j] ** 2
        for i, j in ((2, 0), (1, 1), (0, 2))
    )


def local_noise(offsets: FloatArray) -> FloatArray:
    """Return the noise that quadratic patches leave over neighbors, (m,).

    Parameters
    ----------
    offsets : (3, k, m) float64
        In units of their reach; so is the noise.
    """
    _, count, m = offsets.shape
    offsets = offsets.astype(np.float32)
    weights = np.exp(-_FALL * np.einsum("ikm,ikm->km", offsets, offsets))
    width = np.ones(m, dtype=np.float32)
    plane, _ = _plane(offsets, weights, width)
    _, (left, *_) = _patches(offsets, weights, width, plane, (QUADRATIC,))
    # Of the weighted squares of an even disk the patch takes its unknowns' share.
    spread = (weights * (offsets**2).sum(axis=0)).sum(axis=0)
    total = weights.sum(axis=0) + 1
    free = max(1 - len(_TERMS[QUADRATIC]) * 2 / count, 0.2)
    return np.sqrt(np.exp(left) * spread / total / free)
