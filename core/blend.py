# SPDX-License-Identifier: GPL-3.0-or-later
"""The normal of a point as a mean of time-scale normals, and the weights of the mean.

Two rounds. First patches of many sizes and kinds are fitted to a neighborhood; then
the normals around a point elect its own under several rules. In both, a small
perceptron turns facts that know no scale into weights, and the normal is the weighted
mean: what is learned only chooses. `tests/benchmarks/train.py` makes the nets.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from .chart import along
from .coarse import block_means, halvings
from .graph import NearestNeighbors
from .inputs import BoolArray, FloatArray, IntArray
from .ladder import EXACT, NOISY, fit_ladder, turn
from .scale import NARROWEST
from .votes import count_votes

# From this noise on, in spacings, patches are fitted as for noisy points.
NOISY_FROM = 0.05

# Patches that miss their neighbors by less, as an angle, are right as they are.
_SETTLED = 0.002

# A blend stands where it turns the normal at hand by more than that many times the
# error it expects of itself: less is no evidence against a patch that fits closely. By
# more than twenty degrees it is another side of a crease, and stands.
_EVIDENT, _ANOTHER_SIDE = 1.5, 20.0

# Normals that vote about one.
VOTERS = {"exact": 32, "noisy": 48}

# Points in one go: fifty arrays of as many rows as there are neighbors.
CHUNK = 512

_LAYER = ("matrix", "offset")

# Columns of a product of matrices: larger ones OpenBLAS gives to threads of its own,
# which get in the way of ours.
_COLUMNS = 32

# An error of ten degrees is trusted by half.
_TRUST = 10.0

# Squared degrees below which errors are all alike.
LEAST_ERROR = 0.05


@dataclass(frozen=True)
class Net:
    """A perceptron with two hidden layers, from features to weights and an error.

    Attributes
    ----------
    mean, scale : (f,) float32
        What features are centered and divided by.
    layers : list of (matrix, offset)
    error : (h + 1,) float32
        Of the logarithm of the squared error, linear in the last hidden layer.
    """

    mean: FloatArray
    scale: FloatArray
    layers: list[tuple[FloatArray, FloatArray]]
    error: FloatArray

    def hidden(self, features: FloatArray) -> FloatArray:
        """Return the last hidden layer for features (f, m), (h, m)."""
        x = (features - self.mean[:, None]) * (1 / self.scale)[:, None]
        for matrix, offset in self.layers[:-1]:
            x = _layer(matrix, offset, x)
            x = np.maximum(x, np.float32(0.01) * x)
        return x

    def blend(
        self, features: FloatArray, candidates: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the blend of candidates (c, 3, m), their weights, and its error.

        Returns
        -------
        normals : (3, m), unit
        weights : (c, m)
        error : (m,), the logarithm of the expected squared error in degrees
        """
        hidden = self.hidden(features)
        matrix, offset = self.layers[-1]
        scores = _layer(matrix, offset, hidden)
        weights = np.exp(scores - scores.max(axis=0))
        weights /= weights.sum(axis=0)
        error = _layer(self.error[:-1, None], self.error[-1:], hidden)[0]
        normals = np.einsum("cm,cim->im", weights, aligned(candidates))
        length = np.sqrt((normals * normals).sum(axis=0))
        return normals / np.where(length > 0, length, 1), weights, error


def _layer(matrix, offset, x):
    """Return what a layer makes of its input (i, m), before it is bent, (o, m).

    In double precision, and rounded: in single precision a column hangs on which
    others are beside it.
    """
    result = np.empty((matrix.shape[1], x.shape[1]), dtype=x.dtype)
    double = matrix.T.astype(np.float64)
    for at in range(0, x.shape[1], _COLUMNS):
        part = slice(at, at + _COLUMNS)
        result[:, part] = double @ x[:, part].astype(np.float64)
    result += offset[:, None]
    return result


def aligned(candidates: FloatArray) -> FloatArray:
    """Return candidates (c, 3, m) on the side of the first."""
    side = np.einsum("cim,im->cm", candidates, candidates[0])
    return candidates * np.where(side < 0, np.float32(-1), np.float32(1))[:, None]


@cache
def nets() -> dict[str, Net]:
    """Return the nets that come with the package, by name."""
    with np.load(Path(__file__).with_name("blend.npz")) as file:
        return {name: _net(file, name) for name in file["names"].tolist()}


def _net(file, name):
    layers = [
        tuple(file[f"{name}_{part}{i}"].astype(np.float32) for part in _LAYER)
        for i in range(3)
    ]
    mean, scale, error = (file[f"{name}_{part}"] for part in ("mean", "scale", "error"))
    return Net(mean, scale, layers, error)


@dataclass(frozen=True)
class Field:
    """Normals of points, and how far they can be trusted.

    Attributes
    ----------
    normals : (n, 3) float64, unit
    error : (n,) float32
        Logarithm of the expected squared error, in degrees.
    scale : (n,) float32
        The reach of the patches, in object units.
    """

    normals: FloatArray
    error: FloatArray
    scale: FloatArray

    @property
    def confidence(self) -> FloatArray:
        """(n,) float32: a half where ten degrees of error are expected, one at none."""
        return confidence_of(self.error)


def confidence_of(error: FloatArray) -> FloatArray:
    """Return 1 / (1 + e^2 / 100) from the logarithm of squared errors in degrees."""
    doubt = np.exp(error)
    doubt /= _TRUST**2
    doubt += 1
    return np.reciprocal(doubt, out=doubt)


def error_of_misfit(misfit: FloatArray) -> FloatArray:
    """Return the logarithm of the squared error that a patch shows by itself."""
    # In place: of so many points every array counts.
    error = np.degrees(misfit, dtype=np.float32)
    error *= error
    error += LEAST_ERROR
    return np.log(error, out=error)


def unsettled(misfit: FloatArray, valid: BoolArray) -> IntArray:
    """Return the points whose patch misses its neighbors."""
    return np.flatnonzero(valid & (misfit > _SETTLED))


def refine_exact(
    nearest: NearestNeighbors,
    field: Field,
    misfit: FloatArray,
    rows: IntArray,
    run: Callable,
) -> Field:
    """Return a field with the normals of some points blended anew.

    Parameters
    ----------
    nearest : NearestNeighbors
    field : Field
        By patches of one size.
    misfit : (n,)
        Of these patches.
    rows : (r,) int
    run : callable (work, chunks) -> None
        Calls work(chunk) for all chunks, in threads or not.
    """
    if not len(rows):
        return field
    chunks = chunks_of(nearest, rows)
    first = Growing(field)

    def fit(chunk):
        first.put(chunk, *fitted_exact(nearest, field, misfit, chunk))

    run(fit, chunks)
    final = Growing(field)

    def vote(chunk):
        normals, error = voted_exact(nearest, first, chunk)
        scale, before = first.scale[chunk], field.normals[chunk].T
        bar = np.minimum(_EVIDENT**2 * np.exp(error), _ANOTHER_SIDE**2)
        kept = _squared_angle(normals, before) < bar
        normals = np.where(kept, before, normals)
        final.put(chunk, normals, np.where(kept, field.scale[chunk], scale), error)

    run(vote, chunks)
    return Field(final.normals, final.error, final.scale)


def estimate_noisy(
    nearest: NearestNeighbors,
    level: float,
    noise: float,
    run: Callable,
    *,
    coarse: NearestNeighbors | None = None,
) -> Field:
    """Return the field of points with noise.

    Patches are fitted to the means of blocks of points, as many as the noise asks for;
    their normals then vote at every point.

    Parameters
    ----------
    nearest : NearestNeighbors
    level, noise : float
        See `coarse.noise_in_spacings`.
    run : see `refine_exact`
    coarse : NearestNeighbors, optional
        The means, where there are more than those of the points. Scales are then left
        out.
    """
    label = np.zeros(len(nearest), dtype=np.int64)
    if coarse is None:
        coarse, label = coarse_cloud(nearest, level)
    first = Growing(count=len(coarse.points))

    def fit(chunk):
        first.put(chunk, *fitted_noisy(coarse, level, chunk))

    run(fit, chunks_of(coarse, coarse.order))
    final = Growing(count=len(nearest.points))

    def vote(chunk):
        normals, error = voted_noisy(nearest, coarse, first, level, noise, chunk)
        own = chunk if label is None else label[chunk]
        final.put(chunk, normals, first.scale[own], error)

    run(vote, chunks_of(nearest, nearest.order))
    return Field(final.normals, final.error, final.scale)


def is_enough(count: int) -> bool:
    """Whether so many points can be told noisy or not, and have neighbors to blend."""
    return count > max(NOISY)


def is_noisy(level: float, neighbors: int) -> bool:
    """Whether a cloud is to be treated as a noisy one.

    Parameters
    ----------
    level : float
        See `coarse.noise_in_spacings`.
    neighbors : int
        As many as the best patches of one size have. Where points are few the surface
        bends as noise does; there, however, the narrowest patches are the best.
    """
    return level >= NOISY_FROM and neighbors > NARROWEST


def fitted_exact(nearest, field, misfit, rows):
    """Return normals (3, m), reach and error of the first round, for exact points."""
    candidates, reach, features = exact_candidates(nearest, field, misfit, rows)
    return _blended(nets()["exact fit"], candidates, reach, features)


def fitted_noisy(coarse, level, rows):
    """Return normals (3, m), reach and error of the first round, for noisy points."""
    candidates, reach, features = noisy_candidates(coarse, level, rows)
    return _blended(nets()["noisy fit"], candidates, reach, features)


def _blended(net, candidates, reach, features):
    normals, weights, error = net.blend(features, candidates)
    return normals, (weights * reach).sum(axis=0), error


def voted_exact(nearest, first, rows):
    """Return normals (3, m) and error of the second round, for exact points."""
    elected, features = exact_votes(nearest, first, rows)
    normals, _, error = nets()["exact vote"].blend(features, elected)
    return normals, error


def voted_noisy(nearest, coarse, first, level, noise, rows):
    """Return normals (3, m) and error of the second round, for noisy points."""
    elected, features = noisy_votes(nearest, coarse, first, level, noise, rows)
    normals, _, error = nets()["noisy vote"].blend(features, elected)
    return normals, error


def exact_candidates(nearest, field, misfit, rows):
    """Return what the first round chooses among at exact points, and its features.

    The normals at hand come first: they may be those of a point's own sheet.
    """
    candidates, reach, features = fit_ladder(nearest, rows, EXACT)
    own = field.normals[rows].T.astype(np.float32)
    turns = [turn(own, candidate) for candidate in candidates]
    facts = [error_of_misfit(misfit[rows]), field.error[rows], *turns]
    return (
        np.concatenate([own[None], candidates]),
        np.concatenate([field.scale[rows][None], reach]),
        np.concatenate([features, np.stack(facts)]),
    )


def noisy_candidates(coarse, level, rows):
    """Return what the first round chooses among at noisy points, and its features."""
    candidates, reach, features = fit_ladder(coarse, rows, NOISY)
    # What stands at the middle of the ladder comes first: it says which side is which.
    middle = len(candidates) // 2
    order = [middle, *(i for i in range(len(candidates)) if i != middle)]
    return candidates[order], reach[order], _with_level(features, level)


def exact_votes(nearest, first, rows):
    """Return what the second round chooses among at exact points, and its features."""
    index, _ = nearest.neighbors(rows, VOTERS["exact"] - 1)
    index = np.concatenate([rows[:, None], index], axis=1).T
    return _votes(nearest.points, nearest.points[rows], index, first, 0.0)


def noisy_votes(nearest, coarse, first, level, noise, rows):
    """Return what the second round chooses among at noisy points, and its features."""
    _, index = coarse.tree.query(nearest.points[rows], k=VOTERS["noisy"])
    elected, features = _votes(
        coarse.points, nearest.points[rows], index.T, first, noise
    )
    return elected, _with_level(features, level)


def coarse_cloud(nearest, level):
    """Return the neighbors of the means of blocks, and the block of each point."""
    times = halvings(len(nearest), level)
    if times is None or not is_enough(2**times):
        return nearest, None
    means, label = block_means(nearest.points, times)
    return NearestNeighbors(means), label


def _votes(points, places, index, first, noise):
    offsets = np.moveaxis(points[index] - places, -1, 0).astype(np.float32)
    normals = np.moveaxis(first.normals[index], -1, 0).astype(np.float32)
    return count_votes(
        np.ascontiguousarray(offsets),
        np.ascontiguousarray(normals),
        first.error[index],
        noise,
    )


def _squared_angle(a, b):
    """Return squared angles in degrees between directions (3, m)."""
    return np.degrees(np.arccos(np.minimum(np.abs(along(a, b)), 1))) ** 2


def _with_level(features, level):
    row = np.full((1, features.shape[1]), np.log(level + 0.01), dtype=np.float32)
    return np.concatenate([features, row])


def chunks_of(nearest, rows):
    """Split rows, those that stand together together."""
    order = rows[np.argsort(nearest.rank[rows], kind="stable")]
    return [order[at : at + CHUNK] for at in range(0, len(order), CHUNK)]


class Growing:
    """A field that is written chunk by chunk."""

    def __init__(self, field=None, *, count=0):
        if field is None:
            self.normals = np.zeros((count, 3))
            self.error, self.scale = np.zeros((2, count), dtype=np.float32)
        else:
            self.normals, self.error, self.scale = (
                a.copy() for a in (field.normals, field.error, field.scale)
            )

    def put(self, rows, normals, scale, error):
        """Write normals (3, m), scale and error of some points."""
        self.normals[rows] = normals.T
        self.scale[rows] = scale
        self.error[rows] = error
