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

from ..inputs import BoolArray, FloatArray, IntArray
from ..neighbors.graph import NearestNeighbors
from ..patches.chart import along
from ..patches.scale import NARROWEST
from .coarse import block_means, halvings
from .ladder import EXACT, NOISY, fit_ladder, turn
from .nets import nets
from .votes import count_votes

# From this noise on, in spacings, patches are fitted as for noisy points.
_NOISY_FROM = 0.05

# Patches that miss their neighbors by less, as an angle, are right as they are.
_SETTLED = 0.002

# The normal at hand stands where a blend turns it by less than so many times what its
# patch misses its neighbors by, as an angle, and what the blend expects to err: on a
# smooth surface patches are more precise. Between half and one and a half of that, one
# goes over into the other, so that nothing hangs on rounding.
_MISSED, _EVIDENT = 2.0, 3.0

# Points in one go: fifty arrays of as many rows as there are neighbors.
CHUNK = 512

# Where more than this share of the points is open, all are looked at, in the long runs
# that are made for so many neighbors: that is faster by a quarter.
_MOST, _RUN = 0.5, 16

# Normals that vote about one.
VOTERS = {"exact": 32, "noisy": 48}

# An error of ten degrees is trusted by half.
_TRUST = 10.0

# Squared degrees below which errors are all alike.
LEAST_ERROR = 0.05


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
        open_: BoolArray | None,
    ) -> None:
        """Write normals (3, m), errors and scales of points that are open, or all."""
        if open_ is not None:
            chosen = open_[rows]
            rows, normals = rows[chosen], normals[:, chosen]
            error, scale = error[chosen], scale[chosen]
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
    """

    name = "exact"

    def __init__(
        self,
        nearest: NearestNeighbors,
        field: Field,
        normals: FloatArray,
        misfit: FloatArray,
    ) -> None:
        self.nearest, self.field = nearest, field
        self._normals, self._misfit = normals, misfit
        self.open = (normals != 0).any(axis=1) & (misfit > _SETTLED)
        self.rows = np.flatnonzero(self.open)

    def first_chunks(self) -> list[IntArray]:
        """Return the points that one patch does not settle, chunk by chunk.

        Where these are most, all points: those that stand together find their
        neighbors so much faster.
        """
        if len(self.rows) > _MOST * len(self.open):
            return self.nearest.runs(_RUN)
        order = self.rows[np.argsort(self.nearest.rank[self.rows], kind="stable")]
        return _split(order)

    second_chunks = first_chunks

    def start(self) -> tuple[Field, Field]:
        """Return the fields that the two rounds write to."""
        return self.field.copy(), self.field.copy()

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
        index, _ = self.nearest.neighbors(rows, VOTERS["exact"] - 1)
        index = np.concatenate([rows[:, None], index], axis=1).T
        points = self.nearest.points
        elected, features = _elected(points, points[rows], index, first, 0.0)
        own = self.field.normals[rows].T.astype(np.float32)
        facts = [error_of_misfit(self._misfit[rows])]
        facts += [turn(own, candidate) for candidate in elected]
        return np.concatenate([elected, [own]]), np.concatenate([features, facts])

    def settled(
        self, rows: IntArray, normals: FloatArray, error: FloatArray
    ) -> FloatArray:
        """Return normals (3, m) after both rounds, or those at hand, or between."""
        own, missed = self.field.normals[rows].T, self._misfit[rows]
        bar = np.minimum(_MISSED * missed, _EVIDENT * np.radians(np.exp(error / 2)))
        cosine = along(own, normals)
        turned = np.sqrt(np.maximum(1 - cosine * cosine, 0)) / np.maximum(bar, 1e-9)
        share = np.clip(1.5 - turned, 0, 1) * np.where(cosine < 0, -1, 1)
        mixed = share * own + (1 - np.abs(share)) * normals
        return mixed / np.sqrt((mixed * mixed).sum(axis=0))

    def first_rows(self, rows: IntArray) -> IntArray:
        """Return the rows of the first round that belong to some of the second."""
        return rows


class Noisy:
    """A cloud with noise, and the means of blocks of its points.

    Patches are fitted to the means, of blocks as large as the noise asks for; their
    normals then vote at every point.

    Parameters
    ----------
    nearest : NearestNeighbors
    level, noise : float
        See `coarse.noise_in_spacings`.
    coarse : NearestNeighbors, optional
        The means, where there are more than those of the points. Scales are then left
        out.
    """

    name, open = "noisy", None

    def __init__(
        self,
        nearest: NearestNeighbors,
        level: float,
        noise: float,
        *,
        coarse: NearestNeighbors | None = None,
    ) -> None:
        label: IntArray | None = np.zeros(len(nearest), dtype=np.int64)
        if coarse is None:
            coarse, label = coarse_cloud(nearest, level)
        self.nearest, self.coarse, self._label = nearest, coarse, label
        self._level, self._noise = level, noise
        self.rows = nearest.order

    def first_chunks(self) -> list[IntArray]:
        """Return the means, chunk by chunk."""
        return _split(self.coarse.order)

    def second_chunks(self) -> list[IntArray]:
        """Return the points, chunk by chunk."""
        return _split(self.nearest.order)

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
        elected, features = _elected(
            self.coarse.points, places, index.T, first, self._noise
        )
        return elected, self._with_level(features)

    def settled(
        self, _rows: IntArray, normals: FloatArray, _error: FloatArray
    ) -> FloatArray:
        """Return normals (3, m) after both rounds: these."""
        return normals

    def first_rows(self, rows: IntArray) -> IntArray:
        """Return the means whose blocks hold some points."""
        return rows if self._label is None else self._label[rows]

    def _with_level(self, features):
        row = np.full((1, features.shape[1]), np.log(self._level + 0.01))
        return np.concatenate([features, row.astype(np.float32)])


def coarse_cloud(
    nearest: NearestNeighbors, level: float
) -> tuple[NearestNeighbors, IntArray | None]:
    """Return the neighbors of the means of blocks, and the block of each point.

    Without blocks each point is its own mean.
    """
    times = halvings(len(nearest), level)
    if times is None or not is_enough(2**times):
        return nearest, None
    means, label = block_means(nearest.points, times)
    return NearestNeighbors(means), label


def blend(cloud: Exact | Noisy, run: Callable) -> Field:
    """Return the field of a cloud after both rounds.

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
        normals = cloud.settled(rows, normals, error)
        scale = first.scale[cloud.first_rows(rows)]
        second.put(rows, normals, error, scale, cloud.open)

    run(vote, cloud.second_chunks())
    return second


def first_round(cloud: Exact | Noisy, field: Field, run: Callable) -> None:
    """Write the normals of the first round into a field; see `blend`."""
    net = nets()[f"{cloud.name} fit"]

    def fit(rows):
        candidates, reach, features = cloud.candidates(rows)
        normals, weights, error = net.blend(features, candidates)
        scale = (weights * reach).sum(axis=0)
        field.put(rows, normals, error, scale, cloud.open)

    run(fit, cloud.first_chunks())


def _elected(points, places, index, first, noise):
    """Return what the normals of some points (k, m) elect at places (m, 3)."""
    offsets = np.moveaxis(points[index] - places, -1, 0).astype(np.float32)
    normals = np.moveaxis(first.normals[index], -1, 0).astype(np.float32)
    return count_votes(
        np.ascontiguousarray(offsets),
        np.ascontiguousarray(normals),
        first.error[index],
        noise,
    )


def _split(rows):
    return [rows[at : at + CHUNK] for at in range(0, len(rows), CHUNK)]
