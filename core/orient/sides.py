# SPDX-License-Identifier: GPL-3.0-or-later
"""The outward side of every point of a cloud, from the poles of a part of it.

A cloud is made fit for `poles`: noise is smoothed away, what is dense is thinned, lone
points are left out. What the poles say of these *representatives* is mended where the
smooth surface around contradicts it, and taken back to all points.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ..inputs import FloatArray, IntArray
from ..neighbors.graph import NearestNeighbors
from ..patches.chart import tangent_axes
from ..progress import Progress, between, silent
from .mending import Surface, mend
from .poles import label_poles

# Representatives at most: the triangulation and what follows take some 30 microseconds
# for each.
_MOST = 30_000

# Sheets are told apart when they are farther from each other than 0.85 of the distance
# to the sixth representative. Where more than one of fifty points sees two that are
# nearer, there are up to so many times more representatives.
_TOLD_APART, _FEW, _TIMES = 0.85, 0.02, 6.0

# What sees them: representatives that face the same way, or the opposite, to within
# eight degrees, and yet stand off by this share of their distance. A surface that bends
# as far has turned further. So many points look.
_ALIKE, _OFF, _LOOKING = 0.99, 0.15, 20_000
# A tetrahedron and one point more.
_FEWEST = 5

# Points asked for spacing and noise, and the numbers of neighbors they look at.
_SAMPLES = 1000
_LADDER = (8, 16, 32, 64, 128, 256, 512)

# A neighborhood of eight is thick when the points stand off their surface by more
# than this share of its radius: the poles of a cloud that thick turn at random.
_THICK = 0.1
# Wider neighborhoods are wide enough to see the noise when they are this flat.
_FLAT = 0.22

# Fits reach four times the noise: less leaves bumps that look like sheets, more joins
# sheets that are apart. Representatives stand a third of the reach apart.
_REACH = 4.0
_APART = 0.33
_ROUNDS = 2

# Points of a clean cloud closer than a quarter of its spacing see each other under any
# angle: one of them is enough.
_TWIN = 0.25

# A point is lone when its neighbors are this many times farther than theirs are, and
# off the surface when its neighbors stand this steeply above or below it.
_LONE = 4.0
_STEEP = 0.25

# Points listen to so many representatives.
_HEARD_BY = 6

_CHUNK = 100_000
_FIT_CHUNK = 2048

# Where the progress stands when the cloud is made fit, and when the poles have spoken
# and been heard; within the first of these, when representatives are chosen.
_SMOOTHED, _HEARD = 0.3, 0.9
_CHOSEN = 0.5

Result = TypeVar("Result")
Other = TypeVar("Other")


@dataclass(frozen=True)
class Sides:
    """Signs of normals, and how sure they are.

    Attributes
    ----------
    signs : (n,) int8
    confidence : (n,) float64
        0 (a guess) to 1 (all evidence agrees).
    noise : float
        Standard deviation of the points about their surface, in object units; 0 where
        they were taken as they are.
    open : bool
        Whether the outside reaches both sides of the surface.
    piece : (n,) int
        The connected piece of each point, counted from 0.
    disagreeing : float
        Share of the neighbors on one smooth surface that face opposite sides.
    narrow : bool
        Whether sheets are so close that the representatives do not tell them apart.
    """

    signs: IntArray
    confidence: FloatArray
    noise: float
    open: bool
    piece: IntArray
    disagreeing: float
    narrow: bool


def find_sides(
    points: FloatArray,
    normals: FloatArray,
    *,
    nearest: NearestNeighbors | None = None,
    most: int = _MOST,
    workers: int = -1,
    progress: Progress = silent,
) -> Sides | None:
    """Find the signs that turn normals outward.

    Parameters
    ----------
    points : (n, 3) float64
    normals : (n, 3) float64, unit
    nearest : NearestNeighbors, optional
        Of the points, where there is one already.
    most : int
        About how many representatives are triangulated at most.
    workers : int
        Threads of the searches for neighbors; -1 takes all cores.
    progress : callable
        Called with the share done, 0 to 1, in the calling thread.

    Returns
    -------
    Sides, or None where the points have no tetrahedra: too few, or in a plane.
    """
    if len(points) < _FEWEST or _is_flat(points):
        return None
    nearest = nearest or NearestNeighbors(points)
    spacing, noise = measure(nearest, normals)
    if not spacing > 0:
        return None
    told = between(progress, 0.0, _SMOOTHED)
    chosen, narrow = _chosen(nearest, normals, spacing, noise, most)
    told(_CHOSEN)
    place, facing = nearest.points[chosen], normals[chosen]
    if noise:
        reach = _reach(spacing, noise)
        told = between(told, _CHOSEN, 1.0)
        place, facing = smooth(
            nearest, place, facing, reach, workers=workers, progress=told
        )
    progress(_SMOOTHED)
    solid, far = _solid(place, facing)
    if solid.sum() < _FEWEST:
        return None

    def look():
        surface = Surface.through(place, facing)
        heard = Hearing.of(
            nearest,
            normals,
            place,
            facing,
            noise=noise,
            workers=workers,
            progress=between(progress, _SMOOTHED, _HEARD),
        )
        return surface, heard, surface.pieces()[heard.index[:, 0]]

    labels, (surface, heard, piece) = _both(
        lambda: label_poles(place[solid], facing[solid], far[solid]),
        look,
        apart=workers != 1,
    )
    if labels is None:
        return None
    progress(_HEARD)
    said, clarity = np.ones(len(chosen), dtype=np.int8), np.zeros(len(chosen))
    said[solid], clarity[solid] = labels.signs, labels.clarity
    trust = 0.3 if noise else 1.0
    signs, sure = mend(surface, place, facing, said, clarity, trust=trust)
    found, confidence = heard.vote(signs, sure)
    if not noise:
        found[chosen], confidence[chosen] = signs, sure
    disagreeing = surface.disagreement(signs)
    return Sides(found, confidence, noise, labels.open, piece, disagreeing, narrow)


def _reach(spacing, noise):
    """Return how far the fits reach that smooth a cloud."""
    return max(_REACH * noise, 2.5 * spacing)


def _chosen(nearest, normals, spacing, noise, most):
    """Return representatives (m,), and whether sheets are too close for them."""
    points = nearest.points
    reach = _reach(spacing, noise)
    apart = max(_APART * reach, 1.5 * spacing) if noise else _TWIN * spacing
    if len(points) > most:
        # A surface at an angle meets three cells where an upright one meets two: so
        # wide, they are about as many as allowed where the cloud is even.
        apart = max(apart, 1.2 * spacing * np.sqrt(len(points) / most))
    chosen = representatives(points, apart, most)
    if noise or len(chosen) > len(points) / 2:
        return chosen, False
    closer = _gap(nearest, normals, chosen) / _TOLD_APART
    if closer < 1 / np.sqrt(_TIMES):
        return chosen, True
    if closer < 1:
        chosen = representatives(points, closer * apart, int(most / closer**2))
    return chosen, False


def _gap(nearest, normals, chosen):
    """Return how far sheets are from each other where representatives see two.

    In units of the distance to the sixth of them; infinite where hardly any do.
    """
    points, place, facing = nearest.points, nearest.points[chosen], normals[chosen]
    rows = nearest.order[:: -(-len(points) // _LOOKING)]
    here = points[rows]
    count = min(_HEARD_BY, len(place))
    distance, index = NearestNeighbors(place).tree.query(
        here, k=np.arange(1, count + 1)
    )
    theirs = facing[index]
    alike = np.abs(np.einsum("mkc,mc->mk", theirs, normals[rows])) > _ALIKE
    height = np.abs(np.einsum("mkc,mkc->mk", here[:, None] - place[index], theirs))
    other = alike & (height > _OFF * distance)
    if other.any(axis=1).mean() < _FEW:
        return np.inf
    return np.median(height[other]) / np.median(distance[:, -1])


def _both(
    first: Callable[[], Result], second: Callable[[], Other], *, apart: bool
) -> tuple[Result, Other]:
    """Return what both do, at the same time where they may run in threads apart.

    The triangulation keeps one core busy; another has time for all the rest.
    """
    if not apart:
        return first(), second()
    with ThreadPoolExecutor(1) as pool:
        begun = pool.submit(first)
        done = second()
        return begun.result(), done


def _is_flat(points):
    """Whether all points lie in one plane to within rounding."""
    centered = points - points.mean(axis=0)
    spread = np.linalg.eigvalsh(centered.T @ (centered / len(points)))
    return not spread[0] > 1e-14 * spread[2]


def measure(nearest: NearestNeighbors, normals: FloatArray) -> tuple[float, float]:
    """Measure a cloud by a sample of its points.

    Returns
    -------
    spacing : float
        The side of the square that each point has for itself.
    noise : float
        Standard deviation of the points along the normals; 0 where it is well below
        the spacing.

    Notes
    -----
    Heights are medians: half of the eight nearest points belong to the same sheet
    even where another sheet is closer than two spacings.
    """
    rows, n = _sample(nearest.points), len(nearest)
    first, *wider = [k for k in _LADDER if k <= n // 4] or [min(4, n - 1)]
    # Most clouds are clean, and their few neighbors found without a tree of all.
    index, distance = nearest.neighbors(rows, first)
    height = _heights(nearest.points, normals, rows, index)
    spacing = float(np.median(distance[:, -1])) * np.sqrt(np.pi / first)
    if _is_thin(height, distance, _THICK) or not wider:
        return spacing, 0.0
    distance, index = nearest.others(wider[-1], nearest.points[rows])
    height = _heights(nearest.points, normals, rows, index)
    for k in wider:
        if _is_thin(height[:, :k], distance[:, :k], _FLAT):
            break
    return spacing, float(np.median(_thickness(height[:, :k])))


def _heights(points, normals, rows, index):
    """Return how far neighbors (m, k) are from the tangent planes of some points."""
    offset = points[index] - points[rows][:, None]
    return np.abs(np.einsum("mkc,mc->mk", offset, normals[rows]))


def _is_thin(height, distance, share):
    """Whether most neighborhoods are thinner than a share of their radius."""
    far = np.maximum(distance[:, -1], 1e-300)
    return bool(np.median(_thickness(height) / far) < share)


def _thickness(height):
    # The median of |a - b| is 1/1.05 for normal a and b of deviation one.
    return 1.05 * np.median(height, axis=1)


def _sample(points):
    """Choose about a thousand points by their place alone, (m,) int."""
    order = np.arange(len(points))
    if len(points) > _SAMPLES:
        size = np.abs(points).max()
        key = np.modf(1e4 * (points @ np.array([1.0, 1.618, 2.414])) / size)[0]
        order = np.argpartition(np.abs(key), _SAMPLES)[:_SAMPLES]
    return order[np.lexsort(points[order].T)]


def representatives(points: FloatArray, apart: float, most: int) -> IntArray:
    """Choose points about `apart` from each other, farther if they would be too many.

    Returns
    -------
    (m,) int, sorted by place; not more than `most` by much
    """
    while True:
        rows = _one_a_cell(points, apart)
        if len(rows) <= 1.1 * most:
            break
        apart *= max(1.1, np.sqrt(len(rows) / most))
    rows = rows[np.lexsort(points[rows].T)]
    # Points of two cells can be as close as they like.
    pairs = NearestNeighbors(points[rows]).tree.query_pairs(
        0.5 * apart, output_type="ndarray"
    )
    keep = np.ones(len(rows), dtype=bool)
    keep[pairs.max(axis=1, initial=0)[: len(pairs)]] = False
    return rows[keep]


def _one_a_cell(points, size):
    """Return the point nearest to the middle of each filled cell of a grid, (m,)."""
    scaled = (points - points.min(axis=0)) / size
    cell = np.floor(scaled)
    width = cell.max(axis=0) + 1
    if width.prod() > 2.0**53:
        # Cells so small that hardly two points share one.
        return np.arange(len(points))
    off = ((scaled - cell - 0.5) ** 2).sum(axis=1)
    key = ((cell[:, 0] * width[1] + cell[:, 1]) * width[2] + cell[:, 2]).astype(
        np.int64
    )
    order = np.argsort(key)
    key = key[order]
    starts = np.flatnonzero(np.append(True, key[1:] != key[:-1]))
    least = np.minimum.reduceat(off[order], starts)
    number = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(key))))
    best = np.flatnonzero(off[order] == least[number])
    best, number = order[best], number[best]
    if len(best) > len(starts):
        # Equally near ones, as on grids: the first by place, whatever their order.
        sort = np.lexsort((*points[best].T, number))
        best, number = best[sort], number[sort]
        best = best[np.append(True, number[1:] != number[:-1])]
    return best


def smooth(
    nearest: NearestNeighbors,
    place: FloatArray,
    facing: FloatArray,
    reach: float,
    *,
    workers: int = -1,
    progress: Progress = silent,
) -> tuple[FloatArray, FloatArray]:
    """Project points onto quadratic fits to the cloud around them.

    Parameters
    ----------
    place, facing : (m, 3) float64
        Points near the cloud, and about their normals.
    reach : float
        Radius of the fits in dense parts of the cloud; elsewhere more, for the number
        of neighbors is the same everywhere.

    Returns
    -------
    place, facing : (m, 3) float64
    """
    place, facing = place.copy(), facing.copy()
    tree = nearest.tree
    some = place[:: max(1, len(place) // 200)]
    inside = np.median(tree.query_ball_point(some, reach, return_length=True))
    count = min(int(np.clip(inside, 12, 800)), len(nearest.points))
    for turn in range(_ROUNDS):
        for at in range(0, len(place), _FIT_CHUNK):
            progress((turn + at / len(place)) / _ROUNDS)
            part = slice(at, at + _FIT_CHUNK)
            distance, index = tree.query(place[part], k=count, workers=workers)
            place[part], facing[part] = _project(
                nearest.points[index], distance, place[part], facing[part]
            )
    return place, facing


def _project(around, distance, place, facing):
    """Move points (m, 3) along their normals onto fits to (m, k, 3) neighbors."""
    reach = np.maximum(distance[:, -1:], 1e-300)
    axes = np.stack([*tangent_axes(facing.T), facing.T])
    local = np.einsum("mkc,acm->amk", around - place[:, None], axes) / reach
    x, y, z = local
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    weighted = design * np.exp(-((1.8 * distance / reach) ** 2))[:, None]
    matrix = weighted @ design.transpose(0, 2, 1)
    # Keeps fits finite where neighbors leave a term open.
    matrix[:, range(6), range(6)] += 1e-9 * matrix[:, :1, 0]
    found = np.linalg.solve(matrix, weighted @ z[..., None])[..., 0]
    normal = (axes[2] - found[:, 1] * axes[0] - found[:, 2] * axes[1]).T
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return place + np.clip(found[:, :1], -1, 1) * reach * facing, normal


def _solid(place, facing):
    """Find the points that belong to a surface.

    Returns
    -------
    solid : (m,) bool
        False for lone points and for those that stand off the points around.
    far : (m,) float64
        The distance to the sixth neighbor.
    """
    count = min(8, len(place) - 1)
    distance, index = NearestNeighbors(place).others(count, place)
    far = distance[:, min(6, count) - 1]
    lone = far > _LONE * np.median(far[index], axis=1)
    height = np.abs(
        np.einsum("mkc,mc->mk", place[index] - place[:, None], facing)[:, :6]
    )
    slope = np.median(height / np.maximum(distance[:, :6], 1e-300), axis=1)
    # Where the whole cloud is steep, as coarse samples are, none of it is special.
    steep = slope > np.clip(6 * np.median(slope), _STEEP, 0.6)
    return ~(lone | steep), far


@dataclass(frozen=True)
class Hearing:
    """Which representatives each of n points hears, and how well, (n, k) each.

    Attributes
    ----------
    index : int32
        The nearest representatives, nearest first.
    weight : float32
        Largest for those on one sheet with the point, together at most 1; negative
        where the normals, as they were given, point to opposite sides.
    """

    index: IntArray
    weight: FloatArray

    @classmethod
    def of(
        cls,
        nearest: NearestNeighbors,
        normals: FloatArray,
        place: FloatArray,
        facing: FloatArray,
        *,
        noise: float,
        workers: int = -1,
        progress: Progress = silent,
    ) -> "Hearing":
        """Look for the representatives, at `place` with normals `facing`, (m, 3)."""
        points, order = nearest.points, nearest.order
        shape = len(points), min(_HEARD_BY, len(place))
        all_index = np.empty(shape, dtype=np.int32)
        all_weight = np.empty(shape, dtype=np.float32)
        tree, level = NearestNeighbors(place).tree, (place * facing).sum(axis=1)
        for at in range(0, len(points), _CHUNK):
            progress(at / len(points))
            # Points that are near each other ask the same leaves of the tree.
            part = order[at : at + _CHUNK]
            here = points[part]
            found = tree.query(here, k=np.arange(1, shape[1] + 1), workers=workers)
            distance, index = (np.asarray(a) for a in found)
            far = np.maximum(distance[:, -1:], 1e-300)
            theirs = np.take(facing, index, axis=0)
            height = np.einsum("mkc,mc->mk", theirs, here) - np.take(level, index)
            height /= 0.35 * far + 2 * noise
            distance /= far
            weight = np.exp(-(height * height) - distance * distance)
            weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
            weight *= np.einsum("mkc,mc->mk", theirs, normals[part])
            all_index[part], all_weight[part] = index, weight
        return cls(all_index, all_weight)

    def vote(self, signs: IntArray, sure: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return signs (n,) int8 and confidences (n,) by those of the m heard."""
        said = (signs * (0.05 + sure)).astype(np.float32)
        net = np.zeros(len(self.index), dtype=np.float64)
        for column in range(self.index.shape[1]):
            net += self.weight[:, column] * said[self.index[:, column]]
        return np.where(net < 0, -1, 1).astype(np.int8), np.minimum(np.abs(net), 1)
