# SPDX-License-Identifier: GPL-3.0-or-later
"""The normal of a point as a mean of time-scale normals, and the weights of the mean.

Two rounds. First patches of many sizes and kinds are fitted to a neighborhood; then
the normals around a point elect its own under several rules. In both, a small
perceptron turns facts that know no scale into weights, and the normal is the weighted
mean: what is learned only chooses. `tests/benchmarks/train.py` makes the nets.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..inputs import FloatArray, IntArray
from ..neighbors.graph import NearestNeighbors
from ..patches.chart import along
from ..patches.scale import NARROWEST
from .coarse import block_means, halvings
from .ladder import EXACT, NOISY, fit_ladder, turn
from .nets import nets
from .votes import count_votes

# From this noise on, in spacings, patches are fitted as for noisy points.
_NOISY_FROM = 0.05

# Patches that miss their neighbors by less than most do are right as they are, between
# these angles: on flat faces a neighbor beyond a crease shows in little more. Up to one
# and a half of that blends gain weight, so that nothing hangs on rounding.
_SETTLED = 0.002, 0.005

# The logarithm of the squared error, in degrees, from which on votes gain weight, up to
# one more: they hardly change what is expected to err by less than three degrees.
_CLEAR = 2.0

# Nor what patches miss by less than this angle; up to twice of it votes gain weight.
_BENT = 0.01

# As far as votes are expected to err less than the blend they stand; and, up to one
# more, where the blend is expected to err by sixteen degrees: nothing is to be lost.
_HOPELESS = 5.5

# The normal at hand stands where a blend turns it by less than so many times what its
# patch misses its neighbors by, as an angle, and what the blend expects to err: on a
# smooth surface patches are more precise. Between half and one and a half of that, one
# goes over into the other.
_MISSED, _EVIDENT = 2.25, 3.0

# Points in one go: fifty arrays of as many rows as there are neighbors.
CHUNK = 2048

# Normals that vote about one.
VOTERS = {"exact": 32, "noisy": 48}

# An error of ten degrees is trusted by half.
_TRUST = 10.0

# Squared degrees below which errors are all alike.
LEAST_ERROR = 0.05


# What others say of points: their normals (3, m), and the errors expected of these.
Vote = Callable[[IntArray], tuple[FloatArray, FloatArray]]


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
        doubt = np.exp(self.error)
        doubt /= _TRUST**2
        doubt += 1
        return np.reciprocal(doubt, out=doubt)

    def copy(self) -> "Field":
        """Return a field of its own, to be written to."""
        return Field(self.normals.copy(), self.error.copy(), self.scale.copy())

    def put(
        self,
        rows: IntArray,
        normals: FloatArray,
        error: FloatArray,
        scale: FloatArray,
    ) -> None:
        """Write normals (3, m), errors and scales of some points."""
        self.normals[rows] = normals.T
        self.error[rows] = error
        self.scale[rows] = scale


def empty_field(count: int) -> Field:
    """Return a field to be written to, of zeros."""
    error, scale = np.zeros((2, count), dtype=np.float32)
    return Field(np.zeros((count, 3)), error, scale)


def error_of_misfit(misfit: FloatArray) -> FloatArray:
    """Return the logarithm of the squared error that a patch shows by itself."""
    # In place: of so many points every array counts.
    error = np.degrees(misfit, dtype=np.float32)
    error *= error
    error += LEAST_ERROR
    return np.log(error, out=error)


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
    return level >= _NOISY_FROM and neighbors > NARROWEST


def points_of_block(neighbors: int, patch: str) -> float:
    """Return how many points a block may have for the shape of a cloud.

    Where quadratic patches are the best of one size, the surface is smooth as far as
    they reach: with blocks so large the widest patches of the ladder reach as far.

    Parameters
    ----------
    neighbors : int
    patch : str
        The best for the whole cloud: see `Settings`.
    """
    return neighbors / max(NOISY) if patch == "biquadratic" else 1.0


class Exact:
    """A cloud whose points are exact, and its field by patches of one size.

    Parameters
    ----------
    nearest : NearestNeighbors
    field : Field
        With points told apart by sheets.
    normals : (n, 3) float64
        As the patches had them before.
    misfit : (n,)
        Of these patches.
    typical : float, optional
        The median misfit of the whole cloud.
    """

    name = "exact"

    def __init__(
        self,
        nearest: NearestNeighbors,
        field: Field,
        normals: FloatArray,
        misfit: FloatArray,
        typical: float = np.inf,
    ) -> None:
        self.nearest, self.field = nearest, field
        self._normals, self._misfit = normals, misfit
        self._settled_below = float(np.clip(typical, *_SETTLED))
        open_ = (normals != 0).any(axis=1) & (misfit > self._settled_below)
        self.rows = nearest.order[open_[nearest.order]]

    def first_chunks(self) -> list[IntArray]:
        """Return the points that one patch does not settle, chunk by chunk."""
        return _split(self.rows)

    second_chunks = first_chunks

    def start(self) -> tuple[Field, Field]:
        """Return the fields that the two rounds write to.

        The second is the one at hand: of it a chunk reads its own rows alone, and
        before it writes them.
        """
        return self.field.copy() if len(self.rows) else self.field, self.field

    def candidates(self, rows: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what the first round chooses among, its reach, and features.

        The normals at hand come first, before and after points are told apart.
        """
        fitted, reach, features = fit_ladder(self.nearest, rows, EXACT)
        own = self.field.normals[rows].T.astype(np.float32)
        before = self._normals[rows].T.astype(np.float32)
        facts = [error_of_misfit(self._misfit[rows]), turn(own, before)]
        facts += [turn(own, candidate) for candidate in fitted]
        scale = self.field.scale[rows]
        return (
            np.concatenate([[own, before], fitted]),
            np.concatenate([[scale, scale], reach]),
            np.concatenate([features, facts]),
        )

    def votes(self, first: Field, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return what the second round chooses among, and features.

        Last comes the normal at hand, which may stand after all.
        """
        index, offsets = self.nearest.around(rows, VOTERS["exact"] - 1)
        # The point itself votes as well.
        index = np.concatenate([rows[None], index])
        offsets = np.concatenate([np.zeros((3, 1, len(rows))), offsets], axis=1)
        elected, features = _elected(offsets, index, first, 0.0)
        own = self.field.normals[rows].T.astype(np.float32)
        facts = [error_of_misfit(self._misfit[rows])]
        facts += [turn(own, candidate) for candidate in elected]
        return np.concatenate([elected, [own]]), np.concatenate([features, facts])

    def first_rows(self, rows: IntArray) -> IntArray:
        """Return the rows of the first round that belong to some of the second."""
        return rows

    def first(
        self, rows: IntArray, normals: FloatArray, error: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return normals (3, m) and errors after the first round.

        Between blends and what patches say that miss by little.
        """
        own, missed = self.field, self._misfit[rows] / self._settled_below
        stays = np.clip(3 - 2 * missed, 0, 1)
        error = error + stays * (own.error[rows] - error)
        return _between(normals, own.normals[rows].T, stays), error

    def second(
        self, first: Field, rows: IntArray, vote: Vote
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return normals (3, m), errors and scales after the second round.

        Between those of the first and the elected ones; or those at hand stand.
        """
        normals, error = first.normals[rows].T, first.error[rows]
        doubt = np.clip(error - _CLEAR, 0, 1)
        doubt = np.maximum(doubt, np.clip(self._misfit[rows] / _BENT - 1, 0, 1))
        asked = np.flatnonzero(doubt > 0)
        if len(asked):
            elected, expected = vote(rows[asked])
            before, blended = error[asked], normals[:, asked]
            share = np.clip((before - expected + 1) / 2, 0, 1)
            share = np.maximum(share, np.clip(before - _HOPELESS, 0, 1)) * doubt[asked]
            normals[:, asked] = _between(blended, elected, share)
            error[asked] += share * (expected - before)
        return self._settled(rows, normals, error), error, first.scale[rows]

    def _settled(self, rows, normals, error):
        """Return normals (3, m), or those at hand, or between."""
        own, missed = self.field.normals[rows].T, self._misfit[rows]
        bar = np.minimum(_MISSED * missed, _EVIDENT * np.radians(np.exp(error / 2)))
        cosine = along(own, normals)
        turned = np.sqrt(np.maximum(1 - cosine * cosine, 0)) / np.maximum(bar, 1e-9)
        return _between(normals, own, np.clip(1.5 - turned, 0, 1))


class Noisy:
    """A cloud with noise, and the means of blocks of its points.

    Patches are fitted to the means, of blocks as large as the noise asks for; their
    normals then vote at every point.

    Parameters
    ----------
    nearest : NearestNeighbors
    level, noise : float
        See `coarse.noise_in_spacings`.
    least : float
        Points of a block at least: see `points_of_block`.
    coarse : NearestNeighbors, optional
        The means, where there are more than those of the points. Scales are then left
        out.
    """

    name = "noisy"

    def __init__(
        self,
        nearest: NearestNeighbors,
        level: float,
        noise: float,
        *,
        least: float = 1.0,
        coarse: NearestNeighbors | None = None,
    ) -> None:
        label: IntArray | None = np.zeros(len(nearest), dtype=np.int64)
        if coarse is None:
            coarse, label = coarse_cloud(nearest, level, least)
        self.nearest, self.coarse, self._label = nearest, coarse, label
        self._level, self._noise = level, noise
        self.rows = nearest.order

    def first_chunks(self) -> list[IntArray]:
        """Return the means, chunk by chunk."""
        return _split(self.coarse.order)

    def second_chunks(self) -> list[IntArray]:
        """Return the points, chunk by chunk."""
        return _split(self.rows)

    def start(self) -> tuple[Field, Field]:
        """Return the fields that the two rounds write to."""
        return empty_field(len(self.coarse)), empty_field(len(self.nearest))

    def candidates(self, rows: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what the first round chooses among at means, its reach, and features.

        What stands at the middle of the ladder comes first: it says which side is
        which.
        """
        fitted, reach, features = fit_ladder(self.coarse, rows, NOISY)
        middle = len(fitted) // 2
        order = [middle, *(i for i in range(len(fitted)) if i != middle)]
        return fitted[order], reach[order], self._with_level(features)

    def votes(self, first: Field, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return what the second round chooses among at points, and features."""
        places = self.nearest.points[rows]
        _, index = self.coarse.tree.query(places, k=VOTERS["noisy"])
        offsets = np.take(self.coarse.points, index.T, axis=0) - places
        offsets = np.moveaxis(offsets, -1, 0)
        elected, features = _elected(offsets, index.T, first, self._noise)
        return elected, self._with_level(features)

    def first(
        self, _rows: IntArray, normals: FloatArray, error: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return normals (3, m) and errors after the first round: the blends."""
        return normals, error

    def second(
        self, first: Field, rows: IntArray, vote: Vote
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return normals (3, m), errors and scales after the second round."""
        return *vote(rows), first.scale[self.first_rows(rows)]

    def first_rows(self, rows: IntArray) -> IntArray:
        """Return the means whose blocks hold some points."""
        return rows if self._label is None else self._label[rows]

    def _with_level(self, features):
        row = np.full((1, features.shape[1]), np.log(self._level + 0.01))
        return np.concatenate([features, row.astype(np.float32)])


def coarse_cloud(
    nearest: NearestNeighbors, level: float, least: float = 1.0
) -> tuple[NearestNeighbors, IntArray | None]:
    """Return the neighbors of the means of blocks, and the block of each point.

    Without blocks each point is its own mean.
    """
    times = halvings(len(nearest), level, least)
    if times is None or not is_enough(2**times):
        return nearest, None
    means, label = block_means(nearest.points, times)
    return NearestNeighbors(means), label


def blend(cloud: Exact | Noisy, run: Callable) -> Field:
    """Return the field of a cloud after both rounds; one it has is used up.

    Parameters
    ----------
    run : callable (work, chunks) -> None
        Calls work(chunk) for all chunks, in threads or not.
    """
    first, second = cloud.start()
    first_round(cloud, first, run)
    net = nets()[f"{cloud.name} vote"]

    def vote(rows):
        elected, features = cloud.votes(first, rows)
        normals, _, error = net.blend(features, elected)
        return normals, error

    def decide(rows):
        second.put(rows, *cloud.second(first, rows, vote))

    run(decide, cloud.second_chunks())
    return second


def first_round(cloud: Exact | Noisy, field: Field, run: Callable) -> None:
    """Write the normals of the first round into a field; see `blend`."""
    net = nets()[f"{cloud.name} fit"]

    def fit(rows):
        candidates, reach, features = cloud.candidates(rows)
        normals, weights, error = net.blend(features, candidates)
        scale = (weights * reach).sum(axis=0)
        field.put(rows, *cloud.first(rows, normals, error), scale)

    run(fit, cloud.first_chunks())


def _elected(offsets, index, first, noise):
    """Return what the normals of points (k, m) elect where offsets (3, k, m) begin."""
    normals = np.moveaxis(np.take(first.normals, index, axis=0), -1, 0)
    return count_votes(
        offsets.astype(np.float32, order="C"),
        normals.astype(np.float32, order="C"),
        first.error[index],
        noise,
    )


def _between(a, b, share):
    """Return what lies between directions (3, m), whatever their sides."""
    share = np.where(along(a, b) < 0, -share, share)
    mixed = (1 - np.abs(share)) * a + share * b
    return mixed / np.sqrt((mixed * mixed).sum(axis=0))


def _split(rows):
    return [rows[at : at + CHUNK] for at in range(0, len(rows), CHUNK)]
