# SPDX-License-Identifier: GPL-3.0-or-later
"""Points whose neighbors lie on several sheets, and which neighbors are their own.

Where a surface crosses or nearly touches itself, or bends sharply, the nearest points
belong to different sheets and one patch through all of them follows none. Such points
show in the misfit of their patches. Each of them tries several planes, keeps the
neighbors that agree with a patch started there, and takes the start on which most
neighbors agree closely. Then the neighbors' normals join in: a point's own sheet is
the one whose normals agree with its patch too.

Residuals are angles here, height over distance, so that nothing depends on scale.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import Any

import numpy as np

from .chart import tangent_axes
from .graph import NearestNeighbors
from .inputs import BoolArray, FloatArray, IntArray
from .patch import CUBIC, precision
from .solver import Moments, cholesky_solve

QUADRATIC = CUBIC[:5]

# Candidates of a point: up to four sheets may meet, ten neighbors on each.
CANDIDATES = 40

# A point is looked at when its misfit is above a two-hundredth, or four times that of
# most points: clean smooth clouds stay far below, and in noise nearly all do.
_SUSPECT, _OVER_NOISE = 0.005, 4.0

# Residuals that agree: about a degree, or twice the noise.
_TOLERANCE = 0.02

# Where a patch over all neighbors misses them by more than this, any choice among them
# is better; elsewhere at least so many candidates must agree. A few that agree closely
# may be a facet below the sampling.
_HOPELESS, _AGREEING = 0.06, 12.0

# Starts that are followed to the end, of those tried.
_KEPT = 2
_NEAREST_FOR_PLANES, _MIRRORED = 4, 6

# Rounds of the second stage; in the last the consensus itself is cubic.
_ROUNDS = 3
_REWEIGHTINGS = 3

# What a neighbor's slopes weigh beside its height, when neighbors are chosen and in the
# patch that counts; they are known five times less well than heights.
_SLOPES_CHOOSING, _SLOPES_FITTING, _SLOPE_TOLERANCE = 0.3, 0.1, 5.0

# Ridges of patches whose neighbors are still being chosen, by the number of terms; of
# the last one. Ten of a thousand candidates may carry all the weight.
_RIDGE_CHOOSING = {len(QUADRATIC): 1e-3, len(CUBIC): 1e-2}
_RIDGE_FITTING = 1e-4

# Weights never vanish: a start on which nobody agrees must still have a patch.
_LEAST_WEIGHT = 1e-9

# Candidates nearer than that, in units of the farthest, count as being so far.
_LEAST_DISTANCE = 1e-12

# Points at a time: some fifty arrays of forty rows, in the cache.
_CHUNK = 1024


@dataclass(frozen=True)
class _Around:
    """The candidates of m points, (k, m), with offsets (3, k, m)."""

    index: IntArray
    offsets: FloatArray
    distance: FloatArray

    @property
    def directions(self):
        return self.offsets / self.distance

    @property
    def nearness(self):
        """Weights by distance alone."""
        return np.exp(-((1.8 * self.distance / self.distance[-1]) ** 2))


@dataclass(frozen=True)
class _Consensus:
    """Normals (3, m), how badly the candidates agree (m,), and who does (k, m)."""

    normals: FloatArray
    score: FloatArray
    consent: FloatArray


def suspects(misfit: FloatArray, valid: BoolArray) -> tuple[IntArray, float]:
    """Return the points that `separate` should look at, and the noise as an angle.

    Parameters
    ----------
    misfit : (n,)
        See `Patches.misfit`.
    valid : (n,) bool
    """
    noise = float(np.median(misfit[valid])) if valid.any() else 0.0
    bar = max(_SUSPECT, _OVER_NOISE * noise)
    return np.flatnonzero(valid & (misfit > bar)), noise


def separate(
    nearest: NearestNeighbors,
    normals: FloatArray,
    misfit: FloatArray,
    rows: IntArray,
    noise: float,
    *,
    run: Callable,
) -> FloatArray:
    """Return normals with those of some points made from their own sheet's neighbors.

    Parameters
    ----------
    nearest : NearestNeighbors
    normals : (n, 3) float64, unit, whatever their side
    misfit : (n,)
    rows : (r,) int
        The points to look at; see `suspects`.
    noise : float
        The misfit of most points.
    run : callable (work, chunks) -> None
        Calls work(chunk) for all chunks, in threads or not.

    Returns
    -------
    (n, 3) float64
    """
    order = rows[np.argsort(nearest.rank[rows], kind="stable")]
    chunks = [order[at : at + _CHUNK] for at in range(0, len(order), _CHUNK)]
    tolerance = max(_TOLERANCE, 2 * noise)
    hopeless = misfit > max(_HOPELESS, _OVER_NOISE * noise)
    count = min(CANDIDATES, len(normals) - 1)
    candidates = {id(chunk): nearest.neighbors(chunk, count)[0].T for chunk in chunks}
    first, now = normals, normals
    turned = np.ones(len(normals), dtype=bool)
    for stage in range(1 + _ROUNDS):
        after = now.copy()

        def work(chunk, stage=stage, now=now, after=after, turned=turned):
            index = candidates[id(chunk)]
            # Nothing changes for a point around which nothing has.
            active = turned[chunk] | turned[index].any(axis=0)
            own, index = chunk[active], index[:, active]
            if not len(own):
                return
            around = _look_around(nearest, own, index)
            found, agreeing = _one_stage(around, now, own, tolerance, stage)
            accepted = (agreeing >= _AGREEING) | hopeless[own]
            after[own] = np.where(accepted[:, None], found.T, first[own])

        run(work, chunks)
        turned = 1 - np.abs((now * after).sum(axis=1)) > tolerance**2 / 2
        now = after
    return now


def _look_around(nearest, rows, index):
    """Gather candidates in units of the farthest."""
    dtype = precision(len(nearest.points))
    offsets = np.moveaxis(nearest.points[index] - nearest.points[rows], -1, 0)
    distance = np.sqrt((offsets * offsets).sum(axis=0))
    reach = np.where(distance[-1] > 0, distance[-1], 1)
    offsets, distance = (
        np.ascontiguousarray(a / reach, dtype=dtype) for a in (offsets, distance)
    )
    return _Around(index, offsets, np.maximum(distance, _LEAST_DISTANCE))


def _one_stage(around, normals, rows, tolerance, stage):
    """Return new normals (3, m) and how many candidates agree with them, (m,)."""
    dtype = around.offsets.dtype
    own = np.ascontiguousarray(normals[rows].T, dtype=dtype)
    if stage == 0:
        starts = [own, *_planes(around)]
        best = _best_consensus(around, starts, tolerance, neighbors=None)
        reach, terms = len(CUBIC) + 2, None
    else:
        # Fewer equations are needed where the neighbors' slopes add two each.
        reach = len(CUBIC) - 1
        neighbors = np.ascontiguousarray(
            np.moveaxis(normals[around.index], -1, 0), dtype=dtype
        )
        terms = CUBIC if stage == _ROUNDS else QUADRATIC
        best = _best_consensus(
            around, [own], tolerance, neighbors=neighbors, terms=terms
        )
    slopes = None if stage == 0 else neighbors
    found = _patch_of_agreeing(around, best, reach, tolerance / 2, slopes)
    return found, best.consent.sum(axis=0)


def _planes(around):
    """Yield the planes through the point and two of its nearest, as normals (3, m)."""
    near = around.directions[:, :_NEAREST_FOR_PLANES]
    for i, j in combinations(range(near.shape[1]), 2):
        yield _unit(np.cross(near[:, i], near[:, j], axis=0))


def _best_consensus(around, starts, tolerance, *, neighbors, terms=QUADRATIC):
    """Follow the most promising starts and return the best consensus of each point.

    With the neighbors' normals, starts are these normals mirrored in the plane that
    halves the chord, which is exact on spheres; the point's own comes first.
    """
    options = {"neighbors": neighbors}
    if neighbors is None:
        mirrored, kept, tries = None, [], 1
    else:
        along = _dot(neighbors, around.directions)
        mirrored = neighbors - 2 * along * around.directions
        kept, tries = list(starts), 0
        starts = [mirrored[:, i] for i in range(min(_MIRRORED, mirrored.shape[1]))]
    weigh = _starting_weights(around, mirrored)
    scores = [
        _consent(around, start, weigh(start), tolerance, tries, **options).score
        for start in starts
    ]
    kept += _shortlist(starts, scores, _KEPT - len(kept))
    followed = [
        _consent(
            around,
            start,
            weigh(start),
            tolerance,
            _REWEIGHTINGS,
            terms=terms,
            **options,
        )
        for start in kept
    ]
    return _best_of(followed)


def _starting_weights(around, mirrored):
    """Return the weights of candidates when a plane is tried, as a function of it."""
    if mirrored is None:
        # Chords within some fifteen degrees of the plane.
        return lambda plane: (
            around.nearness
            * np.exp(-((_dot(around.directions, plane[:, None]) / 0.25) ** 2))
        )
    # Wider where the neighbors' normals have a say as well.
    return lambda plane: (
        around.nearness
        * np.exp(
            -((_dot(around.directions, plane[:, None]) / 0.5) ** 2)
            - ((1 - np.abs(_dot(mirrored, plane[:, None]))) / 0.15) ** 2
        )
    )


def _consent(around, start, weights, tolerance, rounds, *, neighbors, terms=QUADRATIC):
    """Reweight a patch by who agrees with it (Cauchy weights), starting from a plane.

    The score is the mean of log(1 + (residual / tolerance)^2) over all candidates:
    small where many agree closely, whatever the rest does. The tolerance is the final
    one from the first step; starting wide bends patches across sheets.
    """
    nearness = around.nearness
    scale = _spread(around.distance, nearness)
    ridge = _RIDGE_CHOOSING[len(terms)]
    normals = start
    for step in range(rounds + 1):
        normals, height, slope = _fit(
            around,
            normals,
            weights + _LEAST_WEIGHT,
            scale,
            terms,
            ridge,
            neighbors,
            _SLOPES_CHOOSING,
        )
        square = _square(around, height, slope, tolerance)
        if step < rounds:
            weights = nearness / (1 + square)
    # One far candidate must not outvote the rest.
    capped = np.log1p(np.minimum(square, 300))
    score = _sum(nearness, capped) / nearness.sum(axis=0)
    return _Consensus(normals, score, 1 / (1 + square))


def _patch_of_agreeing(around, consensus, reach, tolerance, neighbors):
    """Return the normals of cubic patches over the candidates that agree, (3, m).

    The patch reaches to the `reach`-th of them.
    """
    normals, consent = consensus.normals, consensus.consent
    for _ in range(_REWEIGHTINGS):
        agreeing = np.cumsum(consent > 0.25, axis=0)
        at = np.where(
            agreeing[-1] >= reach, (agreeing >= reach).argmax(axis=0), len(agreeing) - 1
        )
        farthest = np.take_along_axis(around.distance, at[None], axis=0)
        weights = np.exp(-((2 * around.distance / farthest) ** 2)) * consent
        weights += _LEAST_WEIGHT
        normals, height, slope = _fit(
            around,
            normals,
            weights,
            _spread(around.distance, weights),
            CUBIC,
            _RIDGE_FITTING,
            neighbors,
            _SLOPES_FITTING,
        )
        consent = 1 / (1 + _square(around, height, slope, tolerance))
    return normals


def _square(around, height, slope, tolerance):
    """Return squared residuals in units of what agrees, (k, m)."""
    square = (height / around.distance / tolerance) ** 2
    if slope is not None:
        square += (slope / (_SLOPE_TOLERANCE * tolerance)) ** 2
    return square


def _fit(around, normals, weights, scale, terms, ridge, neighbors, share):
    """Fit patches to heights, and to slopes where neighbors' normals are given.

    Parameters
    ----------
    normals : (3, m)
        Of the charts.
    weights : (k, m)
    scale : (m,)
        The unit of length.
    neighbors : (3, k, m) or None
        Normals of the candidates.
    share : float
        What their slopes weigh.

    Returns
    -------
    normals : (3, m)
    height : (k, m), residuals in object units
    slope : (k, m) or None
    """
    u, v = tangent_axes(normals)
    x, y, z = (_dot(around.offsets, axis[:, None]) / scale for axis in (u, v, normals))
    equations = _Equations(terms)
    equations.add(x, y, z, weights, (0, 0))
    slopes = None
    if neighbors is not None:
        slopes = _slopes(neighbors, u, v, normals)
        dx, dy, upright = slopes
        weighted = weights * (share * upright**2)
        equations.add(x, y, dx, weighted, (1, 0))
        equations.add(x, y, dy, weighted, (0, 1))
    coefficients = equations.solve(ridge * weights.sum(axis=0))
    height = (z - _derivative(x, y, terms, coefficients, (0, 0))) * scale
    slope = None
    if slopes is not None:
        off = [
            given - _derivative(x, y, terms, coefficients, which)
            for given, which in ((dx, (1, 0)), (dy, (0, 1)))
        ]
        # A normal that lies in the chart's plane has no slope, and agrees with none.
        slope = np.where(upright > _FLAT, np.hypot(*off) * upright, 1.0)
    return _unit(normals - coefficients[0] * u - coefficients[1] * v), height, slope


# Cosine between a neighbor's normal and the chart's below which it has no slopes.
_FLAT = 0.2


def _slopes(neighbors, u, v, normals):
    """Return the slopes that normals stand for in a chart, and their cosines to it."""
    a, b, c = (_dot(neighbors, axis[:, None]) for axis in (u, v, normals))
    upright = np.maximum(np.abs(c), _FLAT)
    down = -np.sign(c) / upright
    return down * a, down * b, np.where(np.abs(c) > _FLAT, upright, _FLAT)


class _Equations:
    """Normal equations of patches, from heights and from slopes."""

    def __init__(self, terms):
        self.terms = terms
        size = len(terms)
        self.matrix: list[list[Any]] = [[0.0] * (row + 1) for row in range(size)]
        self.right: list[Any] = [0.0] * size

    def add(self, x, y, values, weights, which):
        """Add equations for a derivative of z: (0, 0) z itself, (1, 0) along x."""
        moment, known = Moments(x, y, weights), Moments(x, y, weights * values)
        rows = [_differentiated(term, which) for term in self.terms]
        for row, (factor, (a, b)) in enumerate(rows):
            if not factor:
                continue
            self.right[row] = self.right[row] + factor * known(a, b)
            for column, (other, (c, d)) in enumerate(rows[: row + 1]):
                if other:
                    added = factor * other * moment(a + c, b + d)
                    self.matrix[row][column] = self.matrix[row][column] + added

    def solve(self, ridge):
        """Return the coefficients, a list of (m,).

        Divided by its binomial coefficient the ridge of a term is the same in all
        axes of the chart, so that patches turn with their points.
        """
        for row, (i, j) in enumerate(self.terms):
            self.matrix[row][row] = self.matrix[row][row] + ridge / comb(i + j, i)
        return cholesky_solve(self.matrix, self.right)


def _differentiated(term, which):
    """Return factor and exponents of a term's derivative."""
    (i, j), (along_x, along_y) = term, which
    factor = (i if along_x else 1) * (j if along_y else 1)
    return factor, (i - along_x, j - along_y)


def _derivative(x, y, terms, coefficients, which):
    """Return a derivative of patches at (k, m) places; (0, 0) is the height."""
    # Horner's rule: the terms of each power of x, by rising powers of y.
    along_y: dict[int, dict[int, Any]] = {}
    for coefficient, term in zip(coefficients, terms, strict=True):
        factor, (i, j) = _differentiated(term, which)
        if factor:
            along_y.setdefault(i, {})[j] = factor * coefficient
    return _horner({i: _horner(along_y[i], y) for i in along_y}, x)


def _horner(coefficients, x):
    """Return the sum of coefficients[i] x^i over the i that are there."""
    degree = max(coefficients)
    total = coefficients[degree]
    for i in range(degree - 1, -1, -1):
        total = total * x + coefficients.get(i, 0.0)
    return total


def _shortlist(starts, scores, keep):
    """Return the `keep` best starts of each point, a list of (3, m)."""
    order = np.argsort(np.stack(scores), axis=0, kind="stable")[:keep]
    stacked = np.stack(starts)
    return [np.take_along_axis(stacked, at[None, None], axis=0)[0] for at in order]


def _best_of(found):
    """Return the consensus with the least score, point by point."""
    best = found[0]
    for other in found[1:]:
        better = other.score < best.score
        best = _Consensus(
            *(
                np.where(better, a, b)
                for a, b in (
                    (other.normals, best.normals),
                    (other.score, best.score),
                    (other.consent, best.consent),
                )
            )
        )
    return best


def _spread(distance, weights):
    """Return the weighted root mean square distance, (m,)."""
    return np.sqrt(_sum(weights, distance**2) / weights.sum(axis=0))


def _dot(a, b):
    """Return the products of vectors whose components come first."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _sum(a, b):
    """Return the sum of products over the neighbors, (m,)."""
    return np.einsum("km,km->m", a, b)


def _unit(vectors):
    """Return vectors (3, m) at length one; zero ones point along z."""
    length = np.sqrt((vectors * vectors).sum(axis=0))
    up = np.zeros_like(vectors)
    up[2] = 1
    return np.where(length > 0, vectors / np.where(length > 0, length, 1), up)
