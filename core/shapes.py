# SPDX-License-Identifier: GPL-3.0-or-later
"""Analytic surfaces with exact normals, and even samples of them.

References
----------
[1] See `timescale`; phi1 and phi2 are the surfaces of its section 4.
[2] C. Yuksel, "Sample Elimination for Generating Poisson Disk Sample Sets",
    Computer Graphics Forum 34 (2015).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .inputs import FloatArray, InputError, IntArray, as_choice

# Candidates for every sample kept: [2] finds little gain beyond five.
_OVERSAMPLING = 5


@dataclass(frozen=True)
class Shape:
    """A parametric surface phi: [t0, t1] x [s0, s1] -> R^3.

    Attributes
    ----------
    point : callable (t, s) -> (..., 3)
    tangents : callable (t, s) -> two (..., 3)
        The partial derivatives of `point`, up to positive factors of product one
        (which keep a pole finite and change neither normal nor area).
    domain : ((t0, t1), (s0, s1))
    side : +1 or -1
        Which side of the cross product of the tangents is called outward.
    wraps : (bool, bool)
        Whether the surface closes along t, along s.
    """

    name: str
    point: Callable
    tangents: Callable
    domain: tuple[tuple[float, float], tuple[float, float]]
    side: int = 1
    wraps: tuple[bool, bool] = (False, False)

    def normal(self, t: ArrayLike, s: ArrayLike) -> FloatArray:
        """Return exact unit normals, (..., 3); zero where the surface is singular."""
        cross = self.side * np.cross(*self.tangents(t, s))
        length = np.linalg.norm(cross, axis=-1, keepdims=True)
        return np.divide(cross, length, out=np.zeros_like(cross), where=length > 0)

    def area_element(self, t: ArrayLike, s: ArrayLike) -> FloatArray:
        """Return |phi_t x phi_s|, the area of the surface per area of parameters."""
        return np.linalg.norm(np.cross(*self.tangents(t, s)), axis=-1)

    def sample(
        self, n: int, seed: int = 0, *, even: bool = True, by: str = "area"
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Draw exactly n points.

        Parameters
        ----------
        n : int
        seed : int
        even : bool
            Thin five times as many candidates to a blue-noise set (no two samples
            closer than need be) by weighted sample elimination [2]; otherwise the
            points are independent.
        by : "area" | "parameters"
            What the samples are uniform in. Elimination spreads them on the surface
            or in the parameter domain.

        Returns
        -------
        points (n, 3), normals (n, 3), parameters (n, 2) float64
        """
        if n < 1:
            raise InputError(f"expected at least 1 sample, got {n}")
        as_choice(by, ("area", "parameters"), name="by")
        rng = np.random.default_rng(seed)
        count = n * _OVERSAMPLING if even else n
        if by == "area":
            parameters = self._uniform(count, rng)
            spread = self.point(*parameters.T)
        else:
            low, high = np.array(self.domain).T
            parameters = spread = rng.uniform(low, high, (count, 2))
        if even:
            parameters = parameters[thin(spread, n)]
        return self.point(*parameters.T), self.normal(*parameters.T), parameters

    def grid(self, n1: int, n2: int) -> FloatArray:
        """Return parameters on a regular n1 x n2 grid over the domain, (n1, n2, 2)."""
        axes = [
            np.linspace(low, high, n)
            for (low, high), n in zip(self.domain, (n1, n2), strict=True)
        ]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)

    def _uniform(self, count, rng):
        """Draw parameters by rejection, so that the points are uniform by area."""
        low, high = np.array(self.domain).T
        # The grid's maximum may miss the true one by a little: 5 % covers it on
        # surfaces whose area element is as smooth as these.
        bound = 1.05 * self.area_element(*np.moveaxis(self.grid(512, 512), -1, 0)).max()
        kept, found = [], 0
        while found < count:
            trial = rng.uniform(low, high, (2 * count, 2))
            chance = rng.uniform(0, bound, 2 * count)
            trial = trial[chance < self.area_element(*trial.T)]
            kept.append(trial)
            found += len(trial)
        return np.concatenate(kept)[:count]


def thin(points: FloatArray, n: int) -> IntArray:
    """Choose n of the points so that they are spread evenly over their surface.

    Weighted sample elimination [2]: points are dropped where their neighbors crowd
    them most. In each round the local maxima of the crowding go together, which
    leaves the result of the one-by-one method nearly unchanged and needs only tens
    of rounds of array operations.

    Parameters
    ----------
    points : (m, 2) or (m, 3) float, m >= n

    Returns
    -------
    (n,) int, increasing
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    reach = 2 * _disk_radius(tree, n)
    pairs = tree.query_pairs(reach, output_type="ndarray")
    distance = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    crowding = (1 - distance / reach) ** 8
    a = np.concatenate([pairs[:, 0], pairs[:, 1]])
    b = np.concatenate([pairs[:, 1], pairs[:, 0]])
    crowding = np.concatenate([crowding, crowding])
    alive = np.ones(len(points), dtype=bool)
    while (surplus := alive.sum() - n) > 0:
        weight = np.bincount(a, crowding, minlength=len(points))
        weight[~alive] = -1
        most = np.zeros(len(points))
        np.maximum.at(most, a, weight[b])
        # Only the more crowded part may go in a round, as one by one it would.
        bar = np.quantile(weight[alive], 0.7)
        worst = np.flatnonzero(alive & (weight >= most) & (weight >= bar))
        worst = worst[np.argsort(-weight[worst], kind="stable")][:surplus]
        alive[worst] = False
        keep = alive[a] & alive[b]
        a, b, crowding = a[keep], b[keep], crowding[keep]
    return np.flatnonzero(alive)


def _disk_radius(tree, n):
    """Return the disk radius of n samples packed as densely as hexagons.

    The area that the candidates cover is read off their own spacing: in a uniform
    sample of density D the mean squared distance to the k-th neighbor is k/(pi D).
    """
    k = 6
    points = tree.data
    some = points[:: max(1, len(points) // 4096)]
    distance = tree.query(some, k=k + 1)[0][:, -1]
    area = np.pi * np.mean(distance**2) / k * len(points)
    return np.sqrt(area / (2 * np.sqrt(3) * n))


def add_noise(points: FloatArray, share: float, seed: int = 0) -> FloatArray:
    """Add Gaussian noise of standard deviation share x bounding-box diagonal."""
    diagonal = np.linalg.norm(np.ptp(points, axis=0))
    rng = np.random.default_rng(seed)
    return points + rng.normal(0, share * diagonal, np.shape(points))


def _vectors(*components):
    return np.stack(np.broadcast_arrays(*components), axis=-1)


def _phi1(t, s):
    return _vectors(t * s**2, t**2 * s, 1 - np.hypot(t, s))


def _phi1_tangents(t, s):
    r = np.hypot(t, s)
    r = np.where(r > 0, r, 1)
    return (
        _vectors(s**2, 2 * t * s, -t / r),
        _vectors(2 * t * s, t**2, -s / r),
    )


_GROWTH = np.log(1.16)


def _phi2(t, s):
    e = 1.16**s
    c = 1 + np.cos(t)
    return _vectors(e * np.cos(s) * c, -e * np.sin(s) * c, -2 * e * (1 + np.sin(t)))


def _phi2_tangents(t, s):
    e = 1.16**s
    c, d = 1 + np.cos(t), -np.sin(t)
    return (
        _vectors(e * np.cos(s) * d, -e * np.sin(s) * d, -2 * e * np.cos(t)),
        _vectors(
            e * c * (_GROWTH * np.cos(s) - np.sin(s)),
            -e * c * (_GROWTH * np.sin(s) + np.cos(s)),
            -2 * _GROWTH * e * (1 + np.sin(t)),
        ),
    )


def _plane(t, s):
    return _vectors(t, s, np.zeros_like(t))


def _plane_tangents(t, s):
    zero, one = np.zeros_like(t * s), np.ones_like(t * s)
    return _vectors(one, zero, zero), _vectors(zero, one, zero)


def _paraboloid(t, s):
    return _vectors(t, s, (t**2 + s**2) / 2)


def _paraboloid_tangents(t, s):
    zero, one = np.zeros_like(t * s), np.ones_like(t * s)
    return _vectors(one, zero, t), _vectors(zero, one, s)


def _sphere(t, s):
    """t is the cosine of the polar angle, so that equal areas have equal shares."""
    r = np.sqrt(np.maximum(0, 1 - t**2))
    return _vectors(r * np.cos(s), r * np.sin(s), t)


def _sphere_tangents(t, s):
    # Times r along t and divided by r along s: finite at the poles.
    r = np.sqrt(np.maximum(0, 1 - t**2))
    return (
        _vectors(-t * np.cos(s), -t * np.sin(s), r),
        _vectors(-np.sin(s), np.cos(s), np.zeros_like(r * s)),
    )


_TORUS = 1.0, 0.35


def _torus(t, s):
    R, r = _TORUS
    ring = R + r * np.cos(s)
    return _vectors(ring * np.cos(t), ring * np.sin(t), r * np.sin(s))


def _torus_tangents(t, s):
    R, r = _TORUS
    ring = R + r * np.cos(s)
    return (
        _vectors(-ring * np.sin(t), ring * np.cos(t), np.zeros_like(ring * t)),
        _vectors(-r * np.sin(s) * np.cos(t), -r * np.sin(s) * np.sin(t), r * np.cos(s)),
    )


_BUMPS = 0.12, 6.0


def _bumpy(t, s):
    d = _sphere(t, s)
    height, frequency = _BUMPS
    return d * (1 + height * np.sin(frequency * d).prod(-1, keepdims=True))


def _bumpy_tangents(t, s):
    d = _sphere(t, s)
    height, frequency = _BUMPS
    sine, cosine = np.sin(frequency * d), np.cos(frequency * d)
    radius = 1 + height * sine.prod(-1, keepdims=True)
    x, y, z = np.moveaxis(sine, -1, 0)
    slope = height * frequency * cosine * _vectors(y * z, x * z, x * y)
    return tuple(
        (slope * a).sum(-1, keepdims=True) * d + radius * a
        for a in _sphere_tangents(t, s)
    )


_TURN = (0.0, 2 * np.pi)
_UNIT = (-1.0, 1.0)

PHI1 = Shape("phi1", _phi1, _phi1_tangents, (_UNIT, _UNIT))
PHI2 = Shape("phi2", _phi2, _phi2_tangents, (_TURN, (-15.0, 6.0)), wraps=(True, False))
PLANE = Shape("plane", _plane, _plane_tangents, (_UNIT, _UNIT))
PARABOLOID = Shape("paraboloid", _paraboloid, _paraboloid_tangents, (_UNIT, _UNIT))
SPHERE = Shape("sphere", _sphere, _sphere_tangents, (_UNIT, _TURN), -1, (False, True))
TORUS = Shape("torus", _torus, _torus_tangents, (_TURN, _TURN), 1, (True, True))
BUMPY = Shape("bumpy", _bumpy, _bumpy_tangents, (_UNIT, _TURN), -1, (False, True))

ALL = {
    shape.name: shape for shape in (PHI1, PHI2, PLANE, PARABOLOID, SPHERE, TORUS, BUMPY)
}
