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
from dataclasses import dataclass, fields
from itertools import combinations
from math import comb
from typing import Any

import numpy as np

from ..inputs import BoolArray, FloatArray, IntArray
from ..neighbors.graph import NearestNeighbors
from .chart import along, tangent_axes
from .patch import CUBIC, MEDIAN_OF, precision
from .solver import NormalEquations, differentiated

QUADRATIC = CUBIC[:5]

# Candidates of a point: up to four sheets may meet, ten neighbors on each.
CANDIDATES = 40

# A point is looked at when its misfit is above a two-hundredth, or four times that of
# most points: clean smooth clouds stay far below, and in noise nearly all do.
_SUSPECT, _OVER_NOISE = 0.005, 4.0

# Steps of the misfit of most points, an octave has so many, and the one of the least
# number of single precision, below which all are zero.
_STEPS, _ZERO = 8, 8 * 150

# Up to here, with some room, the misfit of most points moves no bar.
NO_MATTER = 0.8 * _SUSPECT / _OVER_NOISE

# Residuals that agree: about a degree, or twice the noise.
_TOLERANCE = 0.02

# Where a patch over all neighbors misses them by more than this, any choice among them
# is better; elsewhere at least so many candidates must agree. A few that agree closely
# may be a facet below the sampling.
_HOPELESS, _AGREEING = 0.06, 12.0

# Starts that are followed, of those tried: three for one step do as well as two that
# are followed to the end, for less.
_KEPT = 3
_NEAREST_FOR_PLANES, _MIRRORED = 4, 6

# Rounds of the second stage; in the last the consensus itself is cubic.
_ROUNDS = 3
STAGES = 1 + _ROUNDS

# How many agreeing candidates the patches of each stage reach to: fewer equations are
# needed once the neighbors' slopes add two each.
_REACH = (len(CUBIC) + 2, *[len(CUBIC) - 1] * _ROUNDS)

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

# Points at a time, and columns: several starts of each stand side by side where points
# are few. The arrays of forty rows stay in the cache.
_CHUNK, _COLUMNS = 1024, 2048


@dataclass(frozen=True)
class _Around:
    """The candidates of m points.

    Attributes
    ----------
    offsets, directions : (3, k, m)
    distance : (k, m)
    nearness : (k, m)
        Weights by distance alone.
    neighbors, mirrored : (3, k, m) or None
        The normals of the candidates, where these have a say, and the same mirrored
        in the plane that halves the chord.
    """

    offsets: FloatArray
    directions: FloatArray
    distance: FloatArray
    nearness: FloatArray
    neighbors: FloatArray | None
    mirrored: FloatArray | None

    def times(self, count):
        """Return the same for `count` starts of every point, start by start."""
        if count == 1:
            return self
        return _each(self, lambda array: np.concatenate([array] * count, axis=-1))

    def only(self, columns):
        """Return the same for some of the points, (m,) bool."""
        return _some(self, columns)


@dataclass(frozen=True)
class _Consensus:
    """Normals (3, m), how badly the candidates agree (m,), and who does (k, m)."""

    normals: FloatArray
    score: FloatArray
    consent: FloatArray

    def only(self, columns):
        """Return the same for some of the points, (m,) bool."""
        return _some(self, columns)


def _some(batch, columns):
    if columns.all():
        return batch
    at = np.flatnonzero(columns)
    return _each(batch, lambda array: np.take(array, at, axis=-1))


def _each(batch, change):
    """Return a batch with every array changed."""
    arrays = (getattr(batch, field.name) for field in fields(batch))
    return type(batch)(*(a if a is None else change(a) for a in arrays))


def suspects(
    misfit: FloatArray, valid: BoolArray, noise: float | None = None
) -> tuple[IntArray, float]:
    """Return the points that `separate` should look at, and the noise as an angle.

    Parameters
    ----------
    misfit : (n,)
        See `Patches.misfit`.
    valid : (n,) bool
    noise : float, optional
        Where it is known, from more points than these.
    """
    if noise is None:
        every = -(-len(misfit) // MEDIAN_OF)
        known = misfit[::every][valid[::every]]
        noise = float(np.median(known, overwrite_input=True)) if len(known) else 0.0
        noise = float(_of_step(_steps(noise)))
    bar = max(_SUSPECT, _OVER_NOISE * noise)
    return np.flatnonzero(valid & (misfit > bar)), noise


def _steps(misfit):
    """Return misfits in steps of a twelfth, so that parts say the same as all."""
    with np.errstate(divide="ignore"):
        steps = np.round(_STEPS * np.log2(misfit)) + _ZERO
    return np.maximum(steps, 0).astype(np.int64)


def _of_step(step):
    return np.where(step > 0, 2.0 ** ((step - _ZERO) / _STEPS), 0.0)


def counts_of_steps(misfit: FloatArray) -> IntArray:
    """Return how many misfits there are of each step: those of parts can be added."""
    return np.bincount(_steps(misfit), minlength=2 * _ZERO)


def noise_of_counts(counts: IntArray) -> float:
    """Return the noise that `suspects` finds, from the counts of all points."""
    half = np.searchsorted(np.cumsum(counts), counts.sum() / 2)
    return float(_of_step(half)) if counts.any() else 0.0


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
    parts = [slice(at, at + _CHUNK) for at in range(0, len(order), _CHUNK)]
    tolerance = max(_TOLERANCE, 2 * noise)
    hopeless = misfit[order] > max(_HOPELESS, _OVER_NOISE * noise)
    count = min(CANDIDATES, len(normals) - 1)
    candidates = np.empty((len(order), count), dtype=np.int32)

    def look_up(part):
        candidates[part] = nearest.neighbors(order[part], count)[0]

    run(look_up, parts)
    now = normals.copy()
    turned = np.ones(len(normals), dtype=bool)
    for stage in range(STAGES):
        before = now[order]
        after = before.copy()

        def work(part, stage=stage, after=after):
            own, index = order[part], candidates[part].T
            # Nothing changes for a point around which nothing has.
            active = turned[own] | turned[index].any(axis=0)
            if not active.any():
                return
            own, index = own[active], index[:, active]
            others = None if stage == 0 else now[index]
            around = _look_around(nearest, own, index, others)
            best = _agreed(around, now[own], tolerance, stage)
            agreeing = best.consent.sum(axis=0)
            accepted = (agreeing >= _AGREEING) | hopeless[part][active]
            found = normals[own]
            if accepted.any():
                around, best = around.only(accepted), best.only(accepted)
                patch = _patch_of_agreeing(around, best, _REACH[stage], tolerance / 2)
                found[accepted] = patch.T
            after[part][active] = found

        run(work, parts)
        turned[:] = False
        turned[order] = 1 - np.abs((before * after).sum(axis=1)) > tolerance**2 / 2
        now[order] = after
    return now


def _look_around(nearest, rows, index, neighbors):
    """Gather candidates in units of the farthest."""
    dtype = precision(nearest.cloud)
    offsets = nearest.toward(index, rows)
    distance = np.sqrt((offsets * offsets).sum(axis=0))
    reach = np.where(distance[-1] > 0, distance[-1], 1)
    offsets, distance = ((a / reach).astype(dtype) for a in (offsets, distance))
    distance = np.maximum(distance, _LEAST_DISTANCE)
    nearness = np.exp(-((1.8 * distance / distance[-1]) ** 2))
    directions, mirrored = offsets / distance, None
    if neighbors is not None:
        neighbors = np.ascontiguousarray(np.moveaxis(neighbors, -1, 0), dtype=dtype)
        mirrored = neighbors - 2 * _dot(neighbors, directions) * directions
    return _Around(offsets, directions, distance, nearness, neighbors, mirrored)


def _agreed(around, normals, tolerance, stage):
    """Return the consensus that a stage comes to."""
    own = np.ascontiguousarray(normals.T, dtype=around.offsets.dtype)
    if stage == 0:
        starts = np.stack([own, *_planes(around)], axis=1)
        return _best_consensus(around, starts, None, tolerance, QUADRATIC)
    terms = CUBIC if stage == _ROUNDS else QUADRATIC
    return _best_consensus(around, None, own, tolerance, terms)


def _planes(around):
    """Yield the planes through the point and two of its nearest, as normals (3, m)."""
    near = around.directions[:, :_NEAREST_FOR_PLANES]
    for i, j in combinations(range(near.shape[1]), 2):
        yield _unit(np.cross(near[:, i], near[:, j], axis=0))


def _best_consensus(around, starts, own, tolerance, terms):
    """Follow the most promising starts and return the best consensus of each point.

    Parameters
    ----------
    starts : (3, s, m) or None
        Normals to try; without, the neighbors' normals mirrored, which is exact on
        spheres.
    own : (3, m) or None
        A normal that is followed anyway.
    """
    if starts is None:
        starts = around.mirrored[:, :_MIRRORED]
    tried = _consent(around, starts, tolerance, 0, QUADRATIC)
    kept = _shortlist(starts, tried.score, _KEPT - (own is not None))
    if own is not None:
        kept = np.concatenate([own[:, None], kept], axis=1)
    return _best_of(_consent(around, kept, tolerance, 1, terms))


def _consent(around, starts, tolerance, rounds, terms):
    """Reweight patches by who agrees with them, starting from planes (3, s, m).

    Returns
    -------
    _Consensus
        Of every start, (s, m).
    """
    points = starts.shape[2]
    step = max(1, _COLUMNS // points)
    parts = []
    for at in range(0, starts.shape[1], step):
        part = starts[:, at : at + step]
        count = part.shape[1]
        found = _reweighted(
            around.times(count), part.reshape(3, -1), tolerance, rounds, terms
        )
        parts.append([a.reshape(*a.shape[:-1], count, points) for a in found])
    return _Consensus(*(np.concatenate(a, axis=-2) for a in zip(*parts, strict=True)))


def _reweighted(around, normals, tolerance, rounds, terms):
    """Reweight patches by who agrees with them (Cauchy weights), starting from planes.

    The score is the mean of log(1 + (residual / tolerance)^2) over all candidates:
    small where many agree closely, whatever the rest does. The tolerance is the final
    one from the first step; starting wide bends patches across sheets.

    Returns
    -------
    normals (3, m), score (m,), consent (k, m)
        See `_Consensus`.
    """
    weights = _starting_weights(around, normals)
    scale = _spread(around.distance, around.nearness)
    for step in range(rounds + 1):
        weights += _LEAST_WEIGHT
        normals, residuals = _fit(
            around,
            normals,
            weights,
            scale,
            terms=terms,
            ridge=_RIDGE_CHOOSING[len(terms)],
            share=_SLOPES_CHOOSING,
        )
        square = residuals(tolerance)
        consent = 1 / (1 + square)
        if step < rounds:
            weights = around.nearness * consent
    # One far candidate must not outvote the rest.
    capped = np.log1p(np.minimum(square, 300, out=square), out=square)
    score = _sum(around.nearness, capped) / around.nearness.sum(axis=0)
    return normals, score, consent


def _starting_weights(around, plane):
    """Return the weights of candidates when a plane (3, m) is tried."""
    off = along(plane, around.directions)
    if around.mirrored is None:
        # Chords within some fifteen degrees of the plane.
        return around.nearness * np.exp(-((off / 0.25) ** 2))
    # Wider where the neighbors' normals have a say as well.
    unlike = 1 - np.abs(along(plane, around.mirrored))
    return around.nearness * np.exp(-((off / 0.5) ** 2) - (unlike / 0.15) ** 2)


def _patch_of_agreeing(around, consensus, reach, tolerance):
    """Return the normals of cubic patches over the candidates that agree, (3, m).

    The patch reaches to the `reach`-th of them; those that agree with it make the
    one that counts.
    """
    first, residuals = _fit_agreeing(
        around, consensus.normals, consensus.consent, reach
    )
    consent = 1 / (1 + residuals(tolerance))
    return _fit_agreeing(around, first, consent, reach)[0]


def _fit_agreeing(around, normals, consent, reach):
    """Fit cubic patches, to the `reach`-th of the candidates that agree; see `_fit`."""
    agreeing = np.cumsum(consent > 0.25, axis=0)
    at = np.where(
        agreeing[-1] >= reach, (agreeing >= reach).argmax(axis=0), len(agreeing) - 1
    )
    farthest = np.take_along_axis(around.distance, at[None], axis=0)
    weights = np.exp(-((2 * around.distance / farthest) ** 2)) * consent
    weights += _LEAST_WEIGHT
    return _fit(
        around,
        normals,
        weights,
        _spread(around.distance, weights),
        terms=CUBIC,
        ridge=_RIDGE_FITTING,
        share=_SLOPES_FITTING,
    )


def _fit(around, normals, weights, scale, *, terms, ridge, share):
    """Fit patches to heights, and to slopes where neighbors' normals are given.

    Parameters
    ----------
    normals : (3, m)
        Of the charts.
    weights : (k, m)
    scale : (m,)
        The unit of length.
    share : float
        What slopes weigh.

    Returns
    -------
    normals : (3, m)
    residuals : callable (tolerance) -> (k, m)
        Squared residuals in units of what agrees.
    """
    u, v = tangent_axes(normals)
    x, y, z = (along(axis / scale, around.offsets) for axis in (u, v, normals))
    equations = NormalEquations(terms, x, y, z, weights)
    slopes = None
    if around.neighbors is not None:
        slopes = dx, dy, upright = _slopes(around.neighbors, u, v, normals)
        equations.add_slopes(dx, dy, weights * (share * upright**2))
    # Divided by its binomial coefficient the ridge of a term is the same in all axes
    # of the chart, so that patches turn with their points.
    total = ridge * weights.sum(axis=0)
    for row, (i, j) in enumerate(terms):
        equations.matrix[row, row] += total / comb(i + j, i)
    coefficients = equations.solve()

    def residuals(tolerance):
        height = z - _derivative(x, y, terms, coefficients, (0, 0))
        height *= scale / tolerance
        height /= around.distance
        square = np.square(height, out=height)
        if slopes is not None:
            a = dx - _derivative(x, y, terms, coefficients, (1, 0))
            b = dy - _derivative(x, y, terms, coefficients, (0, 1))
            slope = (a * a + b * b) * upright**2
            # A normal in the chart's plane has no slope, and agrees with none.
            slope[upright <= _FLAT] = 1.0
            slope *= 1 / (_SLOPE_TOLERANCE * tolerance) ** 2
            square += slope
        return square

    return _unit(normals - coefficients[0] * u - coefficients[1] * v), residuals


# Cosine between a neighbor's normal and the chart's below which it has no slopes.
_FLAT = 0.2


def _slopes(neighbors, u, v, normals):
    """Return the slopes that normals stand for in a chart, and their cosines to it."""
    a, b, c = (along(axis, neighbors) for axis in (u, v, normals))
    upright = np.maximum(np.abs(c), _FLAT)
    down = -1 / np.copysign(upright, c)
    a *= down
    b *= down
    return a, b, upright


def _derivative(x, y, terms, coefficients, which):
    """Return a derivative of patches at (k, m) places; (0, 0) is the height."""
    # Horner's rule: the terms of each power of x, by rising powers of y.
    along_y: dict[int, dict[int, Any]] = {}
    for coefficient, factor, i, j in zip(
        coefficients, *differentiated(terms, which), strict=True
    ):
        if factor:
            along_y.setdefault(i, {})[j] = int(factor) * coefficient
    return _horner({i: _horner(along_y[i], y) for i in along_y}, x)


def _horner(coefficients, x):
    """Return the sum of coefficients[i] x^i over the i that are there."""
    degree = max(coefficients)
    total = coefficients[degree]
    for i in range(degree - 1, -1, -1):
        total = total * x
        if i in coefficients:
            total += coefficients[i]
    return total


def _shortlist(starts, scores, keep):
    """Return the `keep` best (3, keep, m) of the starts (3, s, m) of each point."""
    order = np.argsort(scores, axis=0, kind="stable")[:keep]
    return np.take_along_axis(starts, order[None], axis=1)


def _best_of(followed):
    """Return the consensus with the least score, point by point."""
    best = followed.score.argmin(axis=0)[None]
    return _Consensus(
        np.take_along_axis(followed.normals, best[None], axis=1)[:, 0],
        np.take_along_axis(followed.score, best, axis=0)[0],
        np.take_along_axis(followed.consent, best[None], axis=1)[:, 0],
    )


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
