# SPDX-License-Identifier: GPL-3.0-or-later
"""What the normals around a point say about its own, weighed in several ways."""

import numpy as np

from ..inputs import FloatArray
from ..patches.chart import along, least_eigenvectors

# As in `patch`: weights fall to 2 % at the edge of a window.
_FALL = 4.0

# A voter's plane agrees with the place of the point within the noise and this share of
# the widest window.
_TOLERANCE, _NOISE_SHARE = 0.02, 1.5

# Angles within which voters count as of one mind: sines squared.
_NARROW, _MIDDLE, _WIDE = (np.float32(np.sin(np.radians(a)) ** 2) for a in (10, 18, 30))

_LEAST = np.float32(1e-6)


def count_votes(
    offsets: FloatArray, normals: FloatArray, errors: FloatArray, noise: float
) -> tuple[FloatArray, FloatArray]:
    """Return what the voters elect under each rule, and what tells the rules apart.

    Parameters
    ----------
    offsets : (3, k, m) float32
        Voters less the point, nearest first.
    normals : (3, k, m) float32
        Their normals, whatever their side.
    errors : (k, m) float32
        Logarithm of the squared error that each normal is thought to have.
    noise : float
        In the units of the offsets.

    Returns
    -------
    elected : (candidates, 3, m) float32, unit
    features : (features, m) float32
    """
    voters = len(errors)
    sizes = [voters // 8, voters // 4, voters // 2, voters]
    square = np.einsum("ikm,ikm->km", offsets, offsets)
    reach2 = np.maximum(square[-1], 1e-30)
    near = square / reach2
    height2 = np.einsum("ikm,ikm->km", offsets, normals) ** 2 / reach2
    tolerance2 = _TOLERANCE**2 + np.float32(_NOISE_SHARE * noise) ** 2 / reach2
    consent = 1 / (1 + height2 / tolerance2)
    weights = {
        size: np.exp(-_FALL * near / np.maximum(near[size - 1], 1e-12))
        for size in sizes
    }
    precise = np.exp(-0.5 * errors)
    precise /= precise.max(axis=0)
    products = [
        normals[i] * normals[j]
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    ]

    def elect(voices):
        return _elect(products, voices)

    found, features = [np.ascontiguousarray(normals[:, 0])], []
    for size in sizes:
        elected, spread = elect(weights[size])
        found.append(elected)
        features += spread
    for size in sizes[1:]:
        elected, spread = elect(weights[size] * consent * precise)
        found.append(elected)
        features += spread
    start = found[6]
    for size, angle in ((sizes[2], _NARROW), (sizes[2], _MIDDLE), (voters, _WIDE)):
        found.append(
            _like_minded(elect, normals, start, weights[size] * consent, angle)
        )
    score = errors + np.log1p(height2 / tolerance2) + near
    steady = _pick(normals, score[: sizes[2]].argmin(axis=0))
    found.append(steady)
    found.append(
        _like_minded(elect, normals, steady, weights[sizes[2]] * consent, _NARROW)
    )
    away = 1 - along(found[8], normals) ** 2
    other = _pick(
        normals,
        (away * consent * weights[sizes[2]] * precise)[: sizes[2]].argmax(axis=0),
    )
    found.append(other)
    found.append(_like_minded(elect, normals, other, weights[sizes[2]], _MIDDLE))
    voices = weights[sizes[2]]
    total = voices.sum(axis=0)
    for candidate in found:
        support = voices * np.exp((along(candidate, normals) ** 2 - 1) / _MIDDLE)
        features.append(np.log(support.sum(axis=0) / total + 1e-3))
        missed = (support * height2).sum(axis=0) / (support.sum(axis=0) + 1e-6 * total)
        features.append(np.log(missed + _LEAST))
        aside = along(candidate, offsets) ** 2 / reach2
        features.append(np.log((support * aside).sum(axis=0) / total + _LEAST))
    for i, a in enumerate(found):
        for j in (0, 3, 6, 8):
            if i > j or (i not in (0, 3, 6, 8) and i != j):
                turned = 1 - sum(x * y for x, y in zip(a, found[j], strict=True)) ** 2
                features.append(np.log(np.maximum(turned, 0) + _LEAST))
    features += [errors[0], errors[:6].mean(axis=0), errors.mean(axis=0)]
    features += [errors.min(axis=0), 0.5 * np.log(near[5] + _LEAST)]
    features.append(np.log(np.float32(noise) ** 2 / reach2 + np.float32(1e-5)))
    return np.stack(found), np.stack(features).astype(np.float32)


def _pick(vectors, at):
    """Return one vector of each column, (3, m)."""
    return np.take_along_axis(vectors, at[None, None], axis=1)[:, 0]


def _elect(products, voices):
    """Return the axis nearest to all normals, and how far they are spread about it.

    The eigenvector of the greatest eigenvalue of the sum of n n': sides cancel out.
    """
    total = voices.sum(axis=0) + np.float32(1e-20)
    tensor = [-(np.einsum("km,km->m", voices, p) / total) for p in products]
    tensor = [t.astype(np.float64) for t in tensor]
    axis, middle, largest = least_eigenvectors(*tensor)
    axis = axis.astype(np.float32)
    spread = np.log(np.maximum(-middle - largest, 0) + _LEAST)
    return axis, [spread, np.log(np.maximum(-largest, 0) + _LEAST)]


def _like_minded(elect, normals, start, voices, angle):
    """Return the axis of those who agree with it, starting from some axis."""
    axis = start
    for _ in range(2):
        alike = np.exp((along(axis, normals) ** 2 - 1) / angle)
        axis, _ = elect(voices * (alike + np.float32(1e-6)))
    return axis
