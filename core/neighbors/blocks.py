# SPDX-License-Identifier: GPL-3.0-or-later
"""Nearest points of many points at once: neighborhoods shared by blocks.

Points that stand together in a balanced tree make a block of some sixteen. The points
near a block are found once for all of it, by the distances between boxes, from coarse
to fine; the nearest points of each of its points are then picked from these by
distance alone. How far the picked points can be trusted to be all that there are is
known for every block, and so is which points need a search of their own.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..inputs import BoolArray, FloatArray, IntArray
from ..threads import in_threads
from .halves import halved, sizes_of_halves

# Points of a block, at most; blocks are halves of halves, down to this.
LARGEST = 22

# Every level of boxes has a sixteenth of the boxes of the next finer one, and each
# box knows so many near ones: in a surface eight touch it, and more at creases. Only
# points that are searched for by themselves look at all of these.
_BRANCH, _NEAR, _NEAR_CREASES = 16, 16, 32

# Blocks of a run, which is searched in one go, for sixteen neighbors; with more
# neighbors runs are shorter. Threads wait for each other between array operations, so
# these are to be few and long, and short enough for the cache. Smaller clouds have
# shorter runs: so many at least, for threads to share.
_LEAST_RUN, _RUN, _RUN_COUNT, _SHARES = 256, 1024, 16, 8

# A point that is searched for by itself is one around which points are uneven: it
# looks through blocks of so many times the points it wants.
_SPARE = 4

# Searching for all points of a block is worth it when one of so many is asked for.
_ASKED = 5

# Numbers in an array of distances at a time.
_BATCH = 1 << 18

# Where more than half of the points need a search of their own, blocks gain nothing.
_USEFUL, _TRIAL = 0.5, 17


@dataclass(frozen=True)
class Found:
    """The nearest points of m points, these included, nearest first.

    Attributes
    ----------
    place : (m, count) int
        Where they stand in the order.
    distance : (m, count) float64
    offsets : (3, count, m) float64
        Their coordinates less those of the point.
    certain : (m,) bool
        Elsewhere a nearer point may be missing.
    """

    place: IntArray
    distance: FloatArray
    offsets: FloatArray
    certain: BoolArray

    @classmethod
    def nothing(cls, points: int, count: int) -> "Found":
        """Return room for what a search will find, for now with nothing certain."""
        return cls(
            np.zeros((points, count), dtype=np.int64),
            np.zeros((points, count)),
            np.zeros((3, count, points)),
            np.zeros(points, dtype=bool),
        )

    def only(self, rows: IntArray) -> "Found":
        """Return the same for some of the points."""
        return Found(
            np.take(self.place, rows, axis=0),
            np.take(self.distance, rows, axis=0),
            np.take(self.offsets, rows, axis=2),
            self.certain[rows],
        )

    def put(self, rows: IntArray | slice, found: "Found") -> None:
        """Write what was found for some of the m points."""
        self.place[rows], self.distance[rows] = found.place, found.distance
        self.offsets[:, :, rows], self.certain[rows] = found.offsets, found.certain


class Blocks:
    """Blocks of points in the order of a balanced tree.

    Parameters
    ----------
    points : (n, 3) float64
    center : (3,), optional
        Taken off the coordinates.
    threads : int, optional

    Attributes
    ----------
    order : (n,) int32
        Which points stand where in the tree. A point is meant by its place there.
    sizes, starts : (b,) and (b + 1,) int
        Of the blocks.
    least, most : int
        Points of a block; they differ by one, if at all.
    """

    def __init__(
        self,
        points: FloatArray,
        *,
        center: FloatArray | None = None,
        threads: int | None = None,
    ) -> None:
        self._points, self._center = points, center
        # Coordinates are not kept in order: who searches gathers those around.
        self.order = halved(points, LARGEST, center=center, threads=threads)
        self.sizes = sizes_of_halves(len(points), LARGEST)[-1]
        self.starts = np.concatenate([[0], np.cumsum(self.sizes)])
        self.least, self.most = int(self.sizes.min()), int(self.sizes.max())
        self._boxes = self._boxes_of_blocks(threads)

    def _boxes_of_blocks(self, threads):
        """Return the low and high corners of all blocks, 2 x (3, b)."""
        low, high = boxes = np.empty((2, 3, len(self.sizes)))

        def work(first):
            last = min(first + _RUN, len(self.sizes))
            start, end = self.starts[[first, last]]
            coordinates = self.at(np.arange(start, end))
            low[:, first:last], high[:, first:last] = _joined(
                (coordinates, coordinates), self.starts[first:last] - start
            )

        for _ in in_threads(work, range(0, len(self.sizes), _RUN), threads):
            pass
        return boxes

    @cached_property
    def _near(self):
        """The parents of blocks near each parent, see `_near_boxes`: few, and more."""
        levels = [self._boxes]
        while levels[-1][0].shape[1] > 1:
            every = np.arange(0, levels[-1][0].shape[1], _BRANCH)
            levels.append(_joined(levels[-1], every))
        # The one box of the last level is near itself, and nothing is beyond.
        wide = near = np.zeros((1, 1), dtype=np.int32), np.array([np.inf])
        for boxes in reversed(levels[1:-1]):
            near = _near_all(boxes, wide, _NEAR)
            wide = _near_all(boxes, wide, _NEAR_CREASES)
        return near, wide

    def at(self, places: IntArray) -> FloatArray:
        """Return the coordinates of points, (3, ...) float64."""
        points = np.moveaxis(np.take(self._points, self.order[places], axis=0), -1, 0)
        if self._center is None:
            return np.ascontiguousarray(points)
        center = self._center.reshape(3, *(1 for _ in places.shape))
        return np.subtract(points, center, order="C")

    def runs(self, count: int) -> IntArray:
        """Return where runs for `count` neighbors begin, and n at the end."""
        return np.append(self.starts[: -1 : self._run_of(count)], self.starts[-1])

    def _run_of(self, count):
        """Return how many blocks are searched in one go: all of so many parents."""
        run = min(max(len(self.sizes) // _SHARES, _LEAST_RUN), _RUN)
        return max(1, run * _RUN_COUNT // (_BRANCH * max(count, _RUN_COUNT))) * _BRANCH

    def between(self, start: int, end: int) -> IntArray | None:
        """Return the blocks of a run; None where others than whole runs are meant."""
        first, last = np.searchsorted(self.starts, [start, end])
        whole = self.starts[first] == start and self.starts[last] == end
        return np.arange(first, last) if whole and first % _BRANCH == 0 else None

    @cached_property
    def useful(self) -> bool:
        """Whether most points of a run in the middle find their neighbors in blocks.

        Points that fill space, and ties between coordinates, which do not part by
        halves, leave too many to do. A single run finds out by itself.
        """
        if len(self.sizes) <= _LEAST_RUN:
            return True
        middle = len(self.sizes) // 2 // _BRANCH * _BRANCH
        blocks = np.arange(middle, min(middle + _LEAST_RUN, len(self.sizes)))
        return bool(self.search(blocks, _TRIAL).certain.mean() > _USEFUL)

    def search(self, blocks: IntArray, count: int) -> Found:
        """Return the nearest points of all points of blocks (b,), increasing."""
        size = len(self.order) / len(self.sizes)
        # A disk around the block that holds the neighbors of all its points; a margin
        # for uneven ones.
        wanted = int(1.4 * (np.sqrt(count) + 1.25 * np.sqrt(size)) ** 2)
        near, trusted = self._near[0]
        together = len(self.sizes) // len(trusted)
        parents = blocks // together
        if np.array_equal(blocks, _children(parents[::together], together).ravel()):
            # All blocks of their parents look at the same ones.
            parents = parents[::together]
        known = np.union1d(near[parents], parents)
        numbers = _children(known, together).ravel()
        centers = sum(corner[:, blocks] for corner in self._boxes) / 2
        near, trusted = _near_boxes(
            (centers, centers),
            [corner[:, numbers] for corner in self._boxes],
            np.searchsorted(known, near[parents]),
            trusted[parents],
            _touched(wanted, size),
        )
        # Many of the blocks near a parent are near none of its own.
        own = np.searchsorted(numbers, blocks)
        used = np.zeros(len(numbers), dtype=bool)
        used[near] = used[own] = True
        region = _Region(self, numbers[used])
        near, own = ((np.cumsum(used) - 1)[a] for a in (near, own))
        slot, _, trusted = region.nearest(centers, near, trusted, wanted)
        if slot.shape[1] < count:
            return Found.nothing(self.sizes[blocks].sum(), count)
        return region.picked(own, centers, slot, trusted, count)

    def search_some(self, places: IntArray, count: int) -> Found:
        """Return the nearest points of any points, in blocks where many are asked."""
        own = np.searchsorted(self.starts, places, side="right") - 1
        blocks, which = np.unique(own, return_inverse=True)
        if _ASKED * len(places) < self.sizes[blocks].sum():
            return self.search_each(places, count)
        found = Found.nothing(len(places), count)
        step = self._run_of(count)
        by_block = np.argsort(which, kind="stable")
        cuts = np.searchsorted(which[by_block], np.arange(step, len(blocks), step))
        for at, rows in enumerate(np.split(by_block, cuts)):
            part = blocks[at * step : (at + 1) * step]
            before = np.cumsum(self.sizes[part]) - self.sizes[part]
            at_run = before[which[rows] - at * step] + places[rows]
            at_run -= self.starts[own[rows]]
            found.put(_as_slice(rows), self.search(part, count).only(at_run))
        return found

    def search_each(self, places: IntArray, count: int) -> Found:
        """Return the nearest points of any points, each searched for by itself."""
        found = Found.nothing(len(places), count)
        near, trusted = self._near[1]
        together = len(self.sizes) // len(trusted)
        parents = (np.searchsorted(self.starts, places, side="right") - 1) // together
        touched = _touched(_SPARE * count, len(self.order) / len(self.sizes))
        step = max(1, _BATCH // max(_BRANCH * _NEAR_CREASES, touched * LARGEST))
        for at in range(0, len(places), step):
            part = slice(at, at + step)
            centers, above = self.at(places[part]), parents[part]
            around, trust = _near_boxes(
                (centers, centers), self._boxes, near[above], trusted[above], touched
            )
            numbers, around = _numbered(around)
            region = _Region(self, numbers)
            slot, distance, trust = region.nearest(centers, around, trust, count)
            if slot.shape[1] == count:
                offsets = region.offsets(slot, centers)
                certain = distance[:, -1] <= trust
                place = np.take(region.place, slot)
                found.put(part, Found(place, distance, offsets, certain))
        return found


def _as_slice(rows):
    """Return rows that follow each other as a slice, which is written to faster."""
    if len(rows) and (np.diff(rows) == 1).all():
        return slice(rows[0], rows[-1] + 1)
    return rows


class _Region:
    """Some blocks with their points, in arrays that stay in the cache.

    Attributes
    ----------
    points : (3, b, w) float64
    place : (b, w) int
        Of the points in the order.
    missing : (b,) bool
        Whether a block has a point less than others: its first stands in the end too.
    """

    def __init__(self, blocks, numbers):
        self.least, width = blocks.least, blocks.most
        self.missing = blocks.sizes[numbers] < width
        self.place = blocks.starts[numbers][:, None] + np.arange(width)
        self.place[self.missing, -1] -= width - 1
        self.points = blocks.at(self.place)

    def nearest(self, centers, near, trusted, wanted):
        """Find the points nearest to centers.

        Parameters
        ----------
        centers : (3, c)
        near : (c, q) int, trusted : (c,)
            Blocks near the centers, and the distance to which these are all.
        wanted : int

        Returns
        -------
        slot : (c, s) int, nearest first
            Where the points stand among those of the region. s is `wanted`, or less
            where there are no more points to choose from.
        distance : (c, s)
        trusted : (c,)
            The distance to which these are all that there are.
        """
        width = self.points.shape[2]
        square = np.zeros((*near.shape, width))
        for along, center in zip(self.points, centers, strict=True):
            away = np.take(along, near, axis=0)
            away -= center[:, None, None]
            away *= away
            square += away
        square[..., -1][self.missing[near]] = np.inf
        # One more is there, and tells how far away the next is at least.
        wanted = min(wanted, near.shape[1] * self.least - 1)
        least, square = _least(square.reshape(len(near), -1), wanted + 1)
        slots = near[..., None] * width + np.arange(width)
        least += np.arange(len(near))[:, None] * (near.shape[1] * width)
        distance = np.sqrt(square)
        slot = np.take(slots, least[:, :-1])
        return slot, distance[:, :-1], np.minimum(trusted, distance[:, -1])

    def picked(self, own, centers, slot, trusted, count):
        """Pick the nearest of the candidates of each point of a run.

        Parameters
        ----------
        own : (b,) int
            The blocks of the run.
        centers : (3, b), slot : (b, s) int, trusted : (b,)
            What `nearest` was asked and has found.
        """
        # |a - b|^2 = |a|^2 - 2 a b + |b|^2 in one product of matrices.
        here = np.take(self.points, own, axis=1) - centers[:, :, None]
        away = self.at(slot) - centers[:, :, None]
        left = np.ones((len(slot), 5, here.shape[2]))
        right = np.ones((len(slot), 5, slot.shape[1]))
        np.multiply(here.swapaxes(0, 1), -2, out=left[:, :3])
        np.einsum("ibw,ibw->bw", here, here, out=left[:, 3])
        right[:, :3] = away.swapaxes(0, 1)
        np.einsum("ibs,ibs->bs", away, away, out=right[:, 4])
        reach = trusted[:, None] - np.sqrt(left[:, 3])
        found = np.empty((*here.shape[1:], count), dtype=np.int64)
        distance = np.empty(found.shape)
        step = max(1, _BATCH // (here.shape[2] * slot.shape[1]))
        for at in range(0, len(slot), step):
            part = slice(at, at + step)
            square = left[part].swapaxes(1, 2) @ right[part]
            # Of a point with itself rounding may leave less than nothing.
            least, square = _least(np.abs(square, out=square), count)
            least += (np.arange(len(least)) * slot.shape[1])[:, None, None]
            np.take(slot[part], least, out=found[part], mode="clip")
            np.sqrt(square, out=distance[part])
        once = np.ones(here.shape[1:], dtype=bool)
        once[self.missing[own], -1] = False
        once = np.flatnonzero(once)
        slot, distance = (
            np.take(a.reshape(-1, count), once, axis=0) for a in (found, distance)
        )
        own = np.take(self.points, own, axis=1).reshape(3, -1)[:, once]
        return Found(
            np.take(self.place, slot),
            distance,
            self.offsets(slot, own),
            distance[:, -1] <= reach.ravel()[once],
        )

    def at(self, slot):
        """Return the coordinates of points, (3, ...)."""
        return np.stack([np.take(along, slot) for along in self.points])

    def offsets(self, slot, centers):
        """Return the coordinates of points (m, s) less centers (3, m), (3, s, m)."""
        # In this order neighbor by neighbor, as patches want them.
        offsets = self.at(np.ascontiguousarray(slot.T))
        offsets -= centers[:, None]
        return offsets


def _joined(boxes, starts):
    """Return the boxes that hold the boxes from each start to the next."""
    low, high = boxes
    return (
        np.minimum.reduceat(low, starts, axis=1),
        np.maximum.reduceat(high, starts, axis=1),
    )


def _numbered(numbers):
    """Return the different numbers, increasing, and which of them each is."""
    known, which = np.unique(numbers, return_inverse=True)
    return known, which.reshape(numbers.shape)


def _children(parents, together):
    """Return the boxes below boxes, of which each has so many, (..., together)."""
    return parents[..., None] * together + np.arange(together)


def _touched(wanted, size):
    """Return how many blocks a disk of so many points touches, with a margin."""
    return int(1.3 * (np.sqrt(wanted / size) + 1) ** 2)


def _near_all(boxes, near, count):
    """Find the nearest of all boxes of a level, run by run; see `_near_boxes`."""
    near, trusted = near
    together = boxes[0].shape[1] // len(near)
    runs = []
    for at in range(0, len(near), _BRANCH):
        of_run = slice(at, at + _BRANCH)
        run = [corner[:, at * together : (at + _BRANCH) * together] for corner in boxes]
        runs.append(_near_boxes(run, boxes, near[of_run], trusted[of_run], count))
    return tuple(np.concatenate(parts) for parts in zip(*runs, strict=True))


def _near_boxes(boxes, others, near, trusted, count):
    """Find the nearest boxes of a level from those near their parents.

    Parameters
    ----------
    boxes, others : two (3, b), two (3, c)
        Low and high corners: of the boxes asked for, and of all of their level.
    near : (p, q) int, trusted : (p,)
        The boxes near the parents, and the distance to which these are all; b / p
        boxes have the same parent, one after the other.

    Returns
    -------
    near : (b, count) int32, trusted : (b,)
    """
    parents, together = len(near), boxes[0].shape[1] // len(near)
    # All numbers of boxes are powers of two: only the root may have fewer children.
    branch = min(_BRANCH, others[0].shape[1])
    children = _children(near, branch).reshape(parents, -1)
    square = np.zeros((parents, together, children.shape[1]))
    gap, above = np.empty((2, *square.shape))
    nothing = np.zeros(children.shape[1])
    grouped = (corner.reshape(3, parents, together, 1) for corner in boxes)
    below = (corner.reshape(3, -1, branch) for corner in others)
    for low, high, others_low, others_high in zip(*grouped, *below, strict=True):
        other = np.take(others_low, near, axis=0).reshape(parents, 1, -1)
        np.subtract(other, high, out=gap)
        other = np.take(others_high, near, axis=0).reshape(parents, 1, -1)
        np.subtract(low, other, out=above)
        np.maximum(gap, above, out=gap)
        np.maximum(gap, nothing, out=gap)
        gap *= gap
        square += gap
    width = children.shape[1]
    trusted = np.repeat(trusted, together)
    if width <= count:
        return np.repeat(children.astype(np.int32), together, axis=0), trusted
    place, square = _least(square.reshape(-1, width), count + 1)
    first = np.repeat(np.arange(parents) * width, together)[:, None]
    near = np.take(children.astype(np.int32), place[:, :-1] + first)
    return near, np.minimum(trusted, np.sqrt(square[:, -1]))


def _least(square, count):
    """Return places and values of the `count` least of each row, increasing.

    The places stand in the last bits of the values while these are sorted: one sort
    of plain numbers is several times faster than one that carries places along.
    """
    bits = np.int64((1 << int(square.shape[-1] - 1).bit_length()) - 1)
    key = square.view(np.int64)
    key &= ~bits
    key |= np.arange(square.shape[-1])
    if count < square.shape[-1]:
        key.partition(count - 1, axis=-1)
    key = np.sort(key[..., :count], axis=-1)
    return key & bits, (key & ~bits).view(np.float64)
