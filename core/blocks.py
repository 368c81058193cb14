# SPDX-License-Identifier: GPL-3.0-or-later
"""Nearest points of many points at once: neighborhoods shared by blocks.

Points that stand together in a balanced tree make a block of some sixteen. The points
near a block are found once for all of it, by the distances between boxes, from coarse
to fine; the nearest points of each of its points are then picked from these by
distance alone. How far the picked points can be trusted to be all that there are is
known for every block, and so is which points need a search of their own.
"""

from functools import cached_property

import numpy as np

from .halves import sizes_of_halves
from .inputs import BoolArray, FloatArray, IntArray

# Points of a block, at most; blocks are halves of halves, down to this.
LARGEST = 22

# Every level of boxes has a sixteenth of the boxes of the next finer one, and each
# box knows so many near ones: in a surface eight touch it, and more at creases. Only
# points that are searched for by themselves look at all of these.
_BRANCH, _NEAR, _NEAR_CREASES = 16, 16, 32

# Blocks of a run, which is searched in one go, for sixteen neighbors: its arrays stay
# in the cache. With more neighbors runs are shorter.
_RUN, _RUN_COUNT = _BRANCH**2, 16

# A point that is searched for by itself is one around which points are uneven: it
# looks through blocks of so many times the points it wants.
_SPARE = 4

# Numbers in an array of distances at a time.
_BATCH = 1 << 17

# Where more than half of the points need a search of their own, blocks gain nothing.
_USEFUL, _TRIAL = 0.5, 17


class Blocks:
    """Blocks of points in the order of a balanced tree.

    Parameters
    ----------
    points : (3, n) float64
        In that order, see `halves.halved`. A point is meant by its place in it.
    """

    def __init__(self, points: FloatArray) -> None:
        self.points = points
        self.sizes = sizes_of_halves(points.shape[1], LARGEST)[-1]
        self.starts = np.concatenate([[0], np.cumsum(self.sizes)])
        low = np.minimum.reduceat(points, self.starts[:-1], axis=1)
        high = np.maximum.reduceat(points, self.starts[:-1], axis=1)
        self.centers = (low + high) / 2
        self._boxes = low, high
        levels = [self._boxes]
        while low.shape[1] > 1:
            every = np.arange(0, low.shape[1], _BRANCH)
            low = np.minimum.reduceat(low, every, axis=1)
            high = np.maximum.reduceat(high, every, axis=1)
            levels.append((low, high))
        # The one box of the last level is near itself, and nothing is beyond.
        wide = near = np.zeros((1, 1), dtype=np.int64), np.array([np.inf])
        for boxes in reversed(levels[1:-1]):
            near = _near_all(boxes, wide, _NEAR)
            wide = _near_all(boxes, wide, _NEAR_CREASES)
        # Of the parents of blocks.
        self._near, self._wide = near, wide

    def runs(self, count: int) -> IntArray:
        """Return where runs for `count` neighbors begin, and n at the end."""
        parents = max(1, _RUN * _RUN_COUNT // (_BRANCH * max(count, _RUN_COUNT)))
        return np.append(self.starts[: -1 : parents * _BRANCH], self.points.shape[1])

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
        if len(self.sizes) <= _RUN:
            return True
        middle = len(self.sizes) // 2 // _BRANCH * _BRANCH
        blocks = np.arange(middle, min(middle + _RUN, len(self.sizes)))
        _, _, certain = self.search(blocks, _TRIAL)
        return bool(certain.mean() > _USEFUL)

    def search(
        self, blocks: IntArray, count: int
    ) -> tuple[IntArray, FloatArray, BoolArray]:
        """Return the nearest points of every point of a run, itself included.

        Returns
        -------
        place : (m, count) int, nearest first
        distance : (m, count) float64
        certain : (m,) bool
            Elsewhere a nearer point may be missing.
        """
        size = self.sizes.mean()
        # A disk around the block that holds the neighbors of all its points; a margin
        # for uneven ones.
        wanted = int(1.2 * (np.sqrt(count) + 1.25 * np.sqrt(size)) ** 2)
        parents = slice(blocks[0] // _BRANCH, blocks[-1] // _BRANCH + 1)
        place, _, trusted = self._around(
            self.centers[:, blocks],
            [of_parents[parents] for of_parents in self._near],
            wanted,
            _touched(wanted, size),
        )
        if place.shape[1] < count:
            return _nobody(self.sizes[blocks].sum(), count)
        return self._picked(blocks, place, trusted, count)

    def search_each(
        self, places: IntArray, count: int
    ) -> tuple[IntArray, FloatArray, BoolArray]:
        """Return the nearest points of any points, each searched for by itself.

        Returns what `search` does, in the order of the (m,) places asked for.
        """
        parents = (np.searchsorted(self.starts, places, side="right") - 1) // _BRANCH
        found = _nobody(len(places), count)
        touched = _touched(_SPARE * count, self.sizes.mean())
        step = max(1, _BATCH // max(_BRANCH * _NEAR_CREASES, touched * LARGEST))
        for at in range(0, len(places), step):
            part = slice(at, at + step)
            place, distance, trusted = self._around(
                self.points[:, places[part]],
                [of_parents[parents[part]] for of_parents in self._wide],
                count,
                touched,
            )
            if place.shape[1] == count:
                certain = distance[:, -1] <= trusted
                for all_of, some in zip(found, (place, distance, certain), strict=True):
                    all_of[part] = some
        return found

    def _around(self, centers, near, wanted, touched):
        """Find the points nearest to centers.

        Parameters
        ----------
        centers : (3, b)
        near : (p, q) int and (p,)
            Parents near the centers and how far they are all, see `_near_boxes`.
        wanted, touched : int
            How many points of how many blocks.

        Returns
        -------
        place : (b, w) int, distance : (b, w), nearest first
            w is `wanted`, or less where there are no more points to choose from.
        trusted : (b,)
            The distance to which these are all that there are.
        """
        near, trusted = _near_boxes(
            (centers, centers), self._boxes, near[0], near[1], touched
        )
        place, missing = self._members(near)
        square = np.zeros(place.shape)
        for along, center in zip(self.points, centers, strict=True):
            away = np.take(along, place)
            away -= center[:, None]
            away *= away
            square += away
        square[missing] = np.inf
        # One more is there, and tells how far away the next is at least.
        wanted = min(wanted, near.shape[1] * self.sizes.min() - 1)
        least, square = _least(square, wanted + 1)
        place = np.take_along_axis(place, least[:, :-1], axis=1)
        distance = np.sqrt(square)
        return place, distance[:, :-1], np.minimum(trusted, distance[:, -1])

    def _members(self, blocks):
        """Return the points of (b, c) blocks in (b, c * largest) places."""
        column = np.arange(self.sizes.max())
        shape = (len(blocks), -1)
        missing = column >= self.sizes[blocks][..., None]
        place = self.starts[blocks][..., None] + np.where(missing, 0, column)
        return place.reshape(shape), missing.reshape(shape)

    def _picked(self, blocks, place, trusted, count):
        """Pick the nearest of the candidates of each point."""
        start = self.starts[blocks[0]]
        total = self.starts[blocks[-1] + 1] - start
        own, missing = self._members(blocks[:, None])
        centers = self.centers[:, blocks, None]
        # |a - b|^2 = |a|^2 - 2 a b + |b|^2 in one product of matrices.
        left = np.empty((*own.shape, 5))
        right = np.empty((len(blocks), 5, place.shape[1]))
        here = np.take(self.points, own, axis=1) - centers
        away = np.take(self.points, place, axis=1) - centers
        left[..., :3] = np.moveaxis(-2 * here, 0, -1)
        left[..., 3] = (here * here).sum(axis=0)
        left[..., 4] = 1
        right[:, :3] = away.swapaxes(0, 1)
        right[:, 3] = 1
        right[:, 4] = (away * away).sum(axis=0)
        found = np.empty((total, count), dtype=np.int64)
        distance = np.empty((total, count))
        certain = np.empty(total, dtype=bool)
        step = max(1, _BATCH // (own.shape[1] * place.shape[1]))
        for at in range(0, len(blocks), step):
            part = slice(at, at + step)
            square = left[part] @ right[part]
            least, square = _least(np.maximum(square, 0, out=square), count)
            least += np.arange(len(least))[:, None, None] * place.shape[1]
            reach = trusted[part, None] - np.sqrt(left[part, :, 3])
            there = ~missing[part]
            done = slice(own[at, 0] - start, own[part][-1].max() + 1 - start)
            np.sqrt(square[there], out=distance[done])
            np.take(place[part], least[there], out=found[done])
            certain[done] = distance[done, -1] <= reach[there]
        return found, distance, certain


def _nobody(points, count):
    """Return the result of a search that has found nothing for certain."""
    shape = (points, count)
    return np.zeros(shape, int), np.zeros(shape), np.zeros(points, dtype=bool)


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
    near : (b, count) int, trusted : (b,)
    """
    parents, together = len(near), boxes[0].shape[1] // len(near)
    children = (near[..., None] * _BRANCH + np.arange(_BRANCH)).reshape(parents, -1)
    # All numbers of boxes are powers of two: only the root may have fewer children.
    children = children[:, : others[0].shape[1]]
    square = np.zeros((parents, together, children.shape[1]))
    gap, above = np.empty((2, *square.shape))
    grouped = (corner.reshape(3, parents, together, 1) for corner in boxes)
    for low, high, others_low, others_high in zip(*grouped, *others, strict=True):
        np.subtract(np.take(others_low, children)[:, None], high, out=gap)
        np.subtract(low, np.take(others_high, children)[:, None], out=above)
        np.maximum(gap, above, out=gap)
        np.maximum(gap, 0, out=gap)
        gap *= gap
        square += gap
    width = children.shape[1]
    trusted = np.repeat(trusted, together)
    if width <= count:
        return np.repeat(children, together, axis=0), trusted
    place, square = _least(square.reshape(-1, width), count + 1)
    first = np.repeat(np.arange(parents) * width, together)[:, None]
    near = np.take(children, place[:, :-1] + first)
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
