# SPDX-License-Identifier: GPL-3.0-or-later
"""Noisy and stepped meshes: means over many faces, as wide as the mesh bears.

Means over more and more faces stand beside the normals that the mesh would have
without noise. To tell which are best, the mesh is shaken: noise as large as that found
is added to its vertices, and what a normal then moves by is its variance; what it
differs from a mean over half as many rounds by, less what noise explains, is its bias.
"""

import numpy as np

from ..inputs import BoolArray, FloatArray
from .averages import Averages, area_vectors, ladder
from .clean import Clean
from .faces import Triangles, squares, unit

# A bias is twice the difference to half as many rounds, where it grows with the square
# of the reach; noise may differ by half from what one shake shows.
_BIAS, _EXPLAINED = 2.0, 1.5

# Candidates count by this power of their risks; the best alone is right less often than
# the better ones together.
_SHARPNESS, _LEAST_RISK = 3, 1e-10

# Rounds of means over which variances are gathered: a vertex alone knows little.
_GATHERED = 6


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
    still = squares(at_vertex[:, 3:] - at_vertex[:, :3])
    # What noise does to patches is much the same as to means of the faces there.
    blend = _Blend(clean.normals, averages.means(still[:, None], _GATHERED)[:, 0])
    unbent = _Run(averages, 1.0)
    unbent.risk(at_vertex)
    plain, sharpened = _Run(averages, _BIAS**2), _Run(averages, _BIAS**2)
    for rounds, means, sharper in ladder(averages, by_area):
        if rounds == 0:
            blend.add(means, unbent.risk(means), smooth=False)
        blend.add(means, plain.risk(means), smooth=True)
        if sharper is not None:
            blend.add(sharper, sharpened.risk(sharper), smooth=True)
    return blend.normals, blend.smooth


def _shaken(mesh, sums, weights, shake):
    """Return fields of a mesh beside the same with more noise, (n, 6) float32 each.

    Returns
    -------
    at_vertex : normals, means of those of the faces by `weights`
    by_area : sums of area vectors, as in `sums`
    """
    rng = np.random.default_rng(0)
    moved = mesh.points + rng.normal(0, shake, mesh.points.shape)
    other = Triangles(moved, mesh.faces)
    normals = [each.vertex_normals(weights) for each in (mesh, other)]
    return (
        np.concatenate(normals, axis=1, dtype=np.float32),
        np.concatenate([sums, area_vectors(other)], axis=1),
    )


class _Blend:
    """The mean of fields of normals, those of less risk counting more."""

    def __init__(self, normals, risk):
        weight = _weight(risk)
        self._total = weight[:, None] * normals
        self._weight = weight
        self._smooth = np.zeros(len(normals))

    def add(self, pair, risk, *, smooth):
        """Take the first field of a pair in, with its risk, (n,) or None."""
        if risk is None:
            return
        weight = _weight(risk)
        self._total += weight[:, None] * pair[:, :3]
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
    """Fields of normals in the order of their reach, each with that of a shaken mesh.

    Parameters
    ----------
    factor : float
        The squared bias of a field over its squared difference to the one before.
    """

    def __init__(self, averages, factor):
        self._averages = averages
        self._factor = factor
        self._before = None
        self._bias = 0.0

    def risk(self, pair):
        """Return the risk of the next pair, bias² plus variance; not of the first."""
        before, self._before = self._before, pair
        if before is None:
            return None
        step = pair - before
        parts = [step[:, :3], step[:, 3:] - step[:, :3], pair[:, 3:] - pair[:, :3]]
        turned, by_noise, variance = self._averages.means(
            np.stack([squares(part) for part in parts], axis=1), _GATHERED
        ).T
        left = np.maximum(turned - _EXPLAINED * by_noise, 0)
        # Where everything is rounded off, differences become small again.
        self._bias = np.maximum(self._bias, self._factor * left)
        return self._bias + variance
