# SPDX-License-Identifier: GPL-3.0-or-later
"""Noisy and stepped meshes: means over many faces, as wide as the mesh bears.

Means over more and more faces stand beside the normals that the mesh would have
without noise. To tell which are best, the mesh is shaken: noise as large as that found
is added to its vertices, and what a normal then moves by is its variance; what it
differs from a mean over half as many rounds by, less what noise explains, tells its
bias.
"""

import numpy as np

from ..inputs import BoolArray, FloatArray
from .averages import Averages, area_vectors, ladder
from .clean import Clean
from .faces import Triangles, squares, unit

# Small meshes are shaken more often, so that all are shaken about as many vertices.
_SHAKES, _SHAKEN = 8, 400_000

# Candidates count by this power of their risks; the best alone is right less often than
# the better ones together.
_SHARPNESS, _LEAST_RISK = 3, 1e-10

# Rounds of means over which variances are gathered: a vertex alone knows little. What
# is gathered of noise then still scatters by that share, 0.25 to 0.6 from shake to
# shake on spheres, cubes and rough surfaces.
_GATHERED, _SCATTER = 6, 0.45

# A bias is at least and at most so many times the difference to half as many rounds.
# It is twice that where it grows with the square of the reach, and more where details
# are rounded off already and it no longer does.
_BIAS = (2.0, 4.0)

# Half as many rounds leave at least that share of a bias: of a mean, and of one
# sharpened, whose bias grows no faster than with the fourth power of the reach.
_HALF, _HALF_SHARPENED = 0.5, 0.25


def best_smoothed(
    mesh: Triangles, averages: Averages, sums: FloatArray, clean: Clean, shake: float
) -> tuple[FloatArray, BoolArray]:
    """Return the normals of a noisy mesh, and at which vertices they are smooth ones.

    Parameters
    ----------
    sums : (n, 3) float32
        See `area_vectors`.
    clean : Clean
        What the normals are as if there were no noise.
    shake : float
        Standard deviation of the noise, in object units.
    """
    at_vertex, by_area = _shaken(mesh, sums, clean.weights, shake)
    # What noise does to patches is much the same as to means of the faces there.
    still = averages.means(_variance(at_vertex)[:, None], _GATHERED)[:, 0]
    blend = _Blend(clean.normals, still)
    plain = _Run(averages, blend, _HALF)
    sharpened = _Run(averages, blend, _HALF_SHARPENED)
    for rounds, means, sharper in ladder(averages, by_area):
        if rounds == 0:
            # All that they lack is the other weights.
            left, _, variance = _compare(averages, at_vertex, means)
            blend.add(means[:, :3], left + variance, smooth=False)
        plain.take(means)
        if sharper is not None:
            sharpened.take(sharper)
    plain.finish()
    sharpened.finish()
    return blend.normals, blend.smooth


def _shaken(mesh, sums, weights, shake):
    """Return fields of a mesh beside the same with more noise, (n, 3 + 3 s) float32.

    Returns
    -------
    at_vertex : normals, means of those of the faces by `weights`
    by_area : sums of area vectors, as in `sums`
    """
    rng = np.random.default_rng(0)
    normals, areas = [mesh.vertex_normals(weights)], [sums]
    for _ in range(int(np.clip(_SHAKEN // len(mesh.points), 1, _SHAKES))):
        moved = mesh.points + rng.normal(0, shake, mesh.points.shape)
        other = Triangles(moved, mesh.faces)
        normals.append(other.vertex_normals(weights))
        areas.append(area_vectors(other))
    return (
        np.concatenate(normals, axis=1, dtype=np.float32),
        np.concatenate(areas, axis=1),
    )


def _variance(fields):
    """Return the mean squared distance of shaken fields to the first, (n,)."""
    first = fields[:, :3]
    shaken = range(3, fields.shape[1], 3)
    return sum(squares(fields[:, i : i + 3] - first) for i in shaken) / len(shaken)


def _compare(averages, before, fields):
    """Return what noise does not explain of a step from fields to the next ones.

    Returns
    -------
    left : (n,) float32
        The squared difference less that by noise. Where that could be chance it is
        moved toward the mean of the mesh, as far as it could.
    mean : float
        The mean of the mesh, or zero.
    variance : (n,) float32
        What noise does to the next ones.
    """
    step = fields - before
    parts = [squares(step[:, :3]), _variance(step), _variance(fields)]
    turned, by_noise, variance = averages.means(np.stack(parts, axis=1), _GATHERED).T
    left = turned - by_noise
    mean = float(left.mean())
    chance = (_SCATTER * by_noise) ** 2
    varied = max(float(left.var() - chance.mean()), 0.0)
    total = varied + chance
    known = np.divide(varied, total, out=np.zeros_like(total), where=total > 0)
    return np.maximum(mean + known * (left - mean), 0), max(mean, 0.0), variance


class _Blend:
    """The mean of fields of normals, those of less risk counting more."""

    def __init__(self, normals, risk):
        weight = _weight(risk)
        self._total = weight[:, None] * normals
        self._weight = weight
        self._smooth = np.zeros(len(normals))

    def add(self, normals, risk, *, smooth):
        """Take a field in, (n, 3), with its risk, (n,)."""
        weight = _weight(risk)
        self._total += weight[:, None] * normals
        self._weight += weight
        if smooth:
            self._smooth += weight

    @property
    def normals(self):
        return unit(self._total)

    @property
    def smooth(self):
        """(n,) bool, where means that reach beyond a vertex count for most."""
        return 2 * self._smooth > self._weight


def _weight(risk):
    # Rounding of single precision is no evidence that there is no risk.
    return np.maximum(risk, _LEAST_RISK).astype(np.float64) ** -_SHARPNESS


class _Run:
    """Fields of normals in the order of their reach, each beside those shaken.

    The first has no other to be compared with: it is not blended in. Each other one is
    when the next is there, or at the end.

    Parameters
    ----------
    half : float
        The least share of a bias that half as many rounds leave.
    """

    def __init__(self, averages, blend, half):
        self._averages = averages
        self._blend = blend
        self._half = half
        self._last: FloatArray | None = None
        self._variance: FloatArray | None = None
        self._bias, self._mean = 0.0, 0.0

    def take(self, fields):
        """Take the next fields, (n, 3 + 3 s)."""
        if self._last is not None:
            left, mean, variance = _compare(self._averages, self._last, fields)
            # Where everything is rounded off, differences become small again.
            bias = np.maximum(self._bias, _growth(self._mean, mean) * np.sqrt(left))
            self._blend_last(np.maximum(self._bias, self._half * bias))
            self._bias, self._mean, self._variance = bias, mean, variance
        self._last = fields

    def finish(self):
        """Blend the last fields in."""
        self._blend_last(self._bias)

    def _blend_last(self, bias):
        if self._last is not None and self._variance is not None:
            risk = bias**2 + self._variance
            self._blend.add(self._last[:, :3], risk, smooth=True)


def _growth(before, now):
    """Return how many times the last difference a bias is, by two squared differences.

    The sum of differences that grow by the same factor from rung to rung.
    """
    if before <= 0 or now <= 0:
        return _BIAS[0]
    factor = np.sqrt(now / before)
    return float(np.clip(1 / (1 - 1 / factor), *_BIAS)) if factor > 1 else _BIAS[1]
