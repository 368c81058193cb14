# SPDX-License-Identifier: GPL-3.0-or-later
"""Points that stand for a cloud, as far apart as its noise and its sheets ask for."""

import numpy as np

from ..inputs import FloatArray, IntArray
from ..neighbors.graph import NearestNeighbors
from .smoothing import reach_of_fits

# Points asked for spacing and noise, and the numbers of neighbors they look at.
_SAMPLES = 1000
_LADDER = (8, 16, 32, 64, 128, 256, 512)

# A neighborhood of eight is thick when the points stand off their surface by more
# than this share of its radius: the poles of a cloud that thick turn at random.
_THICK = 0.1
# Wider neighborhoods are wide enough to see the noise when they are this flat.
_FLAT = 0.22

# Under noise representatives stand a third of the reach of the fits apart.
_APART = 0.33

# Points of a clean cloud closer than a quarter of its spacing see each other under any
# angle: one of them is enough.
_TWIN = 0.25

# Points listen to so many representatives.
HEARD_BY = 6

# Sheets are told apart when they are farther from each other than 0.85 of the distance
# to the sixth representative. Where more than one of fifty points sees two that are
# nearer, there are up to so many times more representatives.
_TOLD_APART, _FEW, _TIMES = 0.85, 0.02, 6.0

# What sees them: representatives that face the same way, or the opposite, to within
# eight degrees, and yet stand off by this share of their distance. A surface that bends
# as far has turned further. So many points look.
_ALIKE, _OFF, _LOOKING = 0.99, 0.15, 20_000


def choose(
    nearest: NearestNeighbors,
    normals: FloatArray,
    spacing: float,
    noise: float,
    most: int,
) -> tuple[IntArray, bool]:
    """Choose representatives of a cloud.

    Parameters
    ----------
    normals : (n, 3) float64, unit
    spacing, noise : float
        See `measure`.
    most : int
        About how many there may be, where no sheets are close to each other.

    Returns
    -------
    rows : (m,) int
    narrow : bool
        Whether sheets are too close to be told apart by them.
    """
    points = nearest.points
    reach = reach_of_fits(spacing, noise)
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
    count = min(HEARD_BY, len(place))
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
