# SPDX-License-Identifier: GPL-3.0-or-later
"""Nearest points of many points at once: neighborhoods shared by blocks.

Points that stand together in a balanced kd-tree make a block of some sixteen. The
points near a block are found once for all of it, by the distances between boxes, from
coarse to fine; the nearest points of each of its points are then picked from these by
distance alone. How far the picked points can be trusted to be all that there are is
known for every block, and so is which points need a search of their own.
"""

from functools import cached_property

import numpy as np

from .inputs import BoolArray, FloatArray, IntArray

# Points of a block, at most; blocks are halves of halves, down to this.
LARGEST = 22

# Every level of boxes has a sixteenth of the boxes of the next finer one, and each
# box knows so many near ones: in a surface eight touch it.
_BRANCH, _NEAR = 16, 16

# Blocks of a run, which is searched in one go, for sixteen neighbors: its arrays stay
# in the cache. With more neighbors runs are shorter.
_RUN, _RUN_COUNT = _BRANCH**2, 16

# Numbers in an array of distances at a time.
_BATCH = 1 << 17

# Where more than half of the points need a search of their own, blocks gain nothing.
_USEFUL, _TRIAL = 0.5, 17


class Blocks:
    """Blocks of points in the order of a balanced tree.

    Parameters
    ----------
    points : (n, 3) float64
        In that order: halved and halved again, each half is a box of its own.
    """

    def __init__(self, points: FloatArray) -> None:
        self.points = points
        sizes = np.array([len(points)])
        while sizes.max() > LARGEST:
            sizes = np.stack([sizes // 2, sizes - sizes // 2], axis=1).ravel()
        self.starts = np.concatenate([[0], np.cumsum(sizes)])
        self.sizes = sizes
        low = np.minimum.reduceat(points, self.starts[:-1])
        high = np.maximum.reduceat(points, self.starts[:-1])
        self.centers = (low + high) / 2
        self._boxes = low, high
        levels = [self._boxes]
        while len(low) > 1:
            every = np.arange(0, len(low), _BRANCH)
            low = np.minimum.reduceat(low, every)
            high = np.maximum.reduceat(high, every)
            levels.append((low, high))
        # The one box of the last level is near itself, and nothing is beyond.
        near, trusted = np.zeros((1, 1), dtype=np.int64), np.array([np.inf])
        for boxes in reversed(levels[1:-1]):
            near, trusted = _near_boxes(boxes, boxes, near, trusted)
        self._near = near, trusted

    def runs(self, count: int) -> IntArray:
        """Return where runs for `count` neighbors begin, and n at the end."""
        parents = max(1, _RUN * _RUN_COUNT // (_BRANCH * max(count, _RUN_COUNT)))
        return np.append(self.starts[: -1 : parents * _BRANCH], len(self.points))

    def between(self, start: int, end: int) -> IntArray | None:
        """Return the blocks of a run; None where others than whole runs are meant."""
        first, last = np.searchsorted(self.starts, [start, end])
        whole = self.starts[first] == start and self.starts[last] == end
        return np.arange(first, last) if whole and first % _BRANCH == 0 else None

    @cached_property
    def useful(self) -> bool:
        """Whether most points of a run in the middle find their neighbors in blocks.

        Points that fill space, and ties between coordinates, which do not part by
        halves, leave too many to do.
        """
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
        index : (m, count) int, nearest first
        distance : (m, count) float64
        certain : (m,) bool
            Elsewhere a nearer point may be missing.
        """
        size = self.sizes.mean()
        # A disk around the block that holds the neighbors of all its points; a margin
        # for uneven ones; and the blocks that it touches.
        wanted = int(1.15 * (np.sqrt(count) + 1.25 * np.sqrt(size)) ** 2)
        touched = int(1.3 * (np.sqrt(wanted / size) + 1) ** 2)
        index, trusted = self._candidates(blocks, wanted, touched)
        if index.shape[1] < count:
            # Fewer points than that are near: nothing is certain.
            nobody = np.zeros((self.sizes[blocks].sum(), count), dtype=np.int64)
            return nobody, np.zeros(nobody.shape), np.zeros(len(nobody), dtype=bool)
        return self._picked(blocks, index, trusted, count)

    def _candidates(self, blocks, wanted, touched):
        """Return points near blocks (b, w), and the distance to which they are all."""
        near, trusted = self._near
        parents = slice(blocks[0] // _BRANCH, blocks[-1] // _BRANCH + 1)
        centers = self.centers[blocks]
        near, trusted = _near_boxes(
            (centers, centers), self._boxes, near[parents], trusted[parents], touched
        )
        index, missing = self._members(near)
        away = np.take(self.points, index, axis=0)
        away -= centers[:, None]
        square = np.einsum("bki,bki->bk", away, away)
        square[missing] = np.inf
        # One more is there, and tells how far away the next is at least.
        wanted = min(wanted, near.shape[1] * self.sizes.min() - 1)
        place, square = _least(square, wanted + 1)
        index = np.take_along_axis(index, place[:, :-1], axis=1)
        return index, np.minimum(trusted, np.sqrt(square[:, -1]))

    def _members(self, blocks):
        """Return the points of (b, c) blocks in (b, c * largest) places."""
        column = np.arange(self.sizes.max())
        shape = (len(blocks), -1)
        missing = column >= self.sizes[blocks][..., None]
        index = self.starts[blocks][..., None] + np.where(missing, 0, column)
        return index.reshape(shape), missing.reshape(shape)

    def _picked(self, blocks, index, trusted, count):
        """Pick the nearest of the candidates of each point."""
        start = self.starts[blocks[0]]
        total = self.starts[blocks[-1] + 1] - start
        own, missing = self._members(blocks[:, None])
        centers = self.centers[blocks][:, None]
        away = np.take(self.points, index, axis=0) - centers
        here = np.take(self.points, own, axis=0) - centers
        # |a - b|^2 = |a|^2 - 2 a b + |b|^2 in one product of matrices.
        left = np.empty((*own.shape, 5))
        left[..., :3] = -2 * here
        left[..., 3] = np.einsum("bgi,bgi->bg", here, here)
        left[..., 4] = 1
        right = np.empty((len(blocks), 5, index.shape[1]))
        right[:, :3] = away.swapaxes(1, 2)
        right[:, 3] = 1
        right[:, 4] = np.einsum("bki,bki->bk", away, away)
        found = np.empty((total, count), dtype=np.int64)
        distance = np.empty((total, count))
        certain = np.empty(total, dtype=bool)
        step = max(1, _BATCH // (own.shape[1] * index.shape[1]))
        for at in range(0, len(blocks), step):
            part = slice(at, at + step)
            square = left[part] @ right[part]
            place, square = _least(np.maximum(square, 0, out=square), count)
            place += np.arange(len(place))[:, None, None] * index.shape[1]
            reach = trusted[part, None] - np.sqrt(left[part, :, 3])
            there = ~missing[part]
            done = slice(own[at, 0] - start, own[part][-1].max() + 1 - start)
            np.sqrt(square[there], out=distance[done])
            np.take(index[part], place[there], out=found[done])
            certain[done] = distance[done, -1] <= reach[there]
        return found, distance, certain


def _near_boxes(boxes, others, near, trusted, count=_NEAR):
    """Find the nearest boxes of a level from those near their parents.

    Parameters
    ----------
    boxes, others : two (b, 3), two (c, 3)
        Low and high corners: of the boxes asked for, and of all of their level.
    near : (p, q) int, trusted : (p,)
        The boxes near the parents, and the distance to which these are all.

    Returns
    -------
    near : (b, count) int, trusted : (b,)
    """
    children = (near[..., None] * _BRANCH + np.arange(_BRANCH)).reshape(len(near), -1)
    # All numbers of boxes are powers of two: only the root may have fewer children.
    children = children[:, : len(others[0])]
    parent = np.arange(len(boxes[0])) // _BRANCH
    (low, high), (others_low, others_high) = boxes, others
    square = np.zeros((len(low), children.shape[1]))
    for axis in range(3):
        below = others_low[children, axis][parent] - high[:, axis, None]
        above = low[:, axis, None] - others_high[children, axis][parent]
        gap = np.maximum(np.maximum(below, above), 0)
        square += gap * gap
    trusted = trusted[parent]
    if square.shape[1] <= count:
        return children[parent], trusted
    place, square = _least(square, count + 1)
    near = np.take_along_axis(children[parent], place[:, :-1], axis=1)
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
