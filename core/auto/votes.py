# SPDX-License-Identifier: GPL-3.0-or-later
"""What the normals around a point say about its own, weighed in several ways."""

import numpy as np

from ..inputs import FloatArray
from ..patches.chart import along, least_eigenvectors
from .ladder import turn

# As in `patch`: weights fall to 2 % at the edge of a window. Beyond one and a half of
# the voters in it they are so small that nobody is asked.
_FALL, _ASKED = 4.0, 1.5

# A voter's plane agrees with the place of the point within the noise and this share of
# the widest window.
_TOLERANCE, _NOISE_SHARE = 0.02, 1.5

# Angles within which voters count as of one mind: sines squared.
_NARROW, _MIDDLE, _WIDE = (np.float32(np.sin(np.radians(a)) ** 2) for a in (10, 18, 30))

# Powers of what makes a voter steady, or one who disagrees: the foremost decides, but
# two who are nearly level both count, so that nothing hangs on rounding.
_STEADY, _APART = 3, 4

# The elected whose turns against all others are told: that of the point itself, of a
# window, of those who agree with its place, and of the steadiest.
_COMPARED = (0, 2, 5, 8)
_AGREED = 5

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
    voters = _Voters(offsets, normals, errors, noise)
    elected, facts = _elections(voters)
    for candidate in elected:
        facts += voters.support(candidate)
    for i, a in enumerate(elected):
        for j in _COMPARED:
            if i > j or (i not in _COMPARED and i != j):
                facts.append(turn(a, elected[j]))
    facts += [errors[0], errors[:6].mean(axis=0), errors.mean(axis=0)]
    facts += [errors.min(axis=0), 0.5 * np.log(voters.near[5] + _LEAST)]
    facts.append(np.log(np.float32(noise) ** 2 / voters.reach2 + np.float32(1e-5)))
    return np.stack(elected), np.stack(facts).astype(np.float32)


def _elections(voters):
    """Return the elected (3, m) under each rule, and how far voters are spread."""
    few, some, half, every = voters.sizes
    elected, facts = [np.ascontiguousarray(voters.normals[:, 0])], []
    polls = [voters.window(size) for size in (few, some, every)]
    trusted = voters.consent * voters.precise
    polls += [voters.window(size, trusted) for size in (some, half, every)]
    for voices in polls:
        axis, spread = voters.elect(voices)
        elected.append(axis)
        facts += spread
    agreed, consenting = elected[_AGREED], voters.window(half, voters.consent)
    around = voters.window(every, voters.consent)
    elected.append(voters.like_minded(agreed, around, _WIDE))
    doubt = (voters.errors + np.log1p(voters.aside2) + voters.near)[:half]
    steady, _ = voters.elect(np.exp(_STEADY * (doubt.min(axis=0) - doubt)))
    elected += [steady, voters.like_minded(steady, consenting, _NARROW)]
    # Where nobody disagrees all do alike.
    away = np.maximum(1 - along(agreed, voters.normals[:, :half]) ** 2, 0) + _LEAST
    against = away * trusted[:half] * voters.window(half)[:half]
    against /= against.max(axis=0)
    elected.append(voters.elect(against**_APART)[0])
    return elected, facts


class _Voters:
    """The normals around points, and how much each of them has to say.

    Attributes
    ----------
    near : (k, m)
        Squared distances, in units of the farthest.
    reach2 : (m,)
        That of the farthest.
    height2 : (k, m)
        Squared distances of the point from the plane of each voter, in the same units.
    aside2 : (k, m)
        The same in units of what is tolerated.
    consent, precise : (k, m)
        How well that plane passes through the point, and how sure the normal is.
    sizes : tuple of int
        The voters in each window.
    """

    def __init__(self, offsets, normals, errors, noise):
        every = len(errors)
        self.offsets, self.normals, self.errors = offsets, normals, errors
        self.sizes = every // 8, every // 4, every // 2, every
        square = np.einsum("ikm,ikm->km", offsets, offsets)
        self.reach2 = np.maximum(square[-1], 1e-30)
        self.near = square / self.reach2
        self._windows = {size: _window(self.near, size) for size in self.sizes}
        height = np.einsum("ikm,ikm->km", offsets, normals)
        self.height2 = height**2 / self.reach2
        noise2 = np.float32(_NOISE_SHARE * noise) ** 2 / self.reach2
        self.aside2 = self.height2 / (_TOLERANCE**2 + noise2)
        self.consent = 1 / (1 + self.aside2)
        self.precise = np.exp(-0.5 * errors)
        self.precise /= self.precise.max(axis=0)
        self._products = [
            normals[i] * normals[j]
            for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
        ]

    def window(self, size, share=None):
        """Return the weights of the voters in a window, or these times a share."""
        weights = self._windows[size]
        return weights if share is None else weights * share[: len(weights)]

    def elect(self, voices):
        """Return the axis nearest to all normals, and how far they are spread about it.

        The eigenvector of the greatest eigenvalue of the sum of n n': sides cancel out.
        """
        total = voices.sum(axis=0) + np.float32(1e-20)
        products = (product[: len(voices)] for product in self._products)
        tensor = [-(np.einsum("km,km->m", voices, p) / total) for p in products]
        tensor = [t.astype(np.float64) for t in tensor]
        axis, middle, largest = least_eigenvectors(*tensor)
        axis = axis.astype(np.float32)
        spread = np.log(np.maximum(-middle - largest, 0) + _LEAST)
        return axis, [spread, np.log(np.maximum(-largest, 0) + _LEAST)]

    def like_minded(self, start, voices, angle):
        """Return the axis of those who agree with it, starting from some axis."""
        axis, normals = start, self.normals[:, : len(voices)]
        for _ in range(2):
            alike = np.exp((along(axis, normals) ** 2 - 1) / angle)
            axis, _ = self.elect(voices * (alike + np.float32(1e-6)))
        return axis

    def support(self, candidate):
        """Return who shares the view of a candidate, and how well it fits the place.

        How many do, how far the point is from the planes of their normals, and from
        those of the candidate through their places.
        """
        voices = self.window(self.sizes[2])
        asked, total = len(voices), voices.sum(axis=0)
        cosine = along(candidate, self.normals[:, :asked])
        support = voices * np.exp((cosine**2 - 1) / _MIDDLE)
        shared = support.sum(axis=0)
        missed = np.einsum("km,km->m", support, self.height2[:asked])
        aside = along(candidate, self.offsets[:, :asked]) ** 2
        aside = np.einsum("km,km->m", support, aside) / self.reach2
        return [
            np.log(shared / total + 1e-3),
            np.log(missed / (shared + 1e-6 * total) + _LEAST),
            np.log(aside / total + _LEAST),
        ]


def _window(near, size):
    """Return the weights of the voters in a window as wide as `size` of them reach."""
    asked = min(len(near), int(_ASKED * size))
    return np.exp(-_FALL * near[:asked] / np.maximum(near[size - 1], 1e-12))
