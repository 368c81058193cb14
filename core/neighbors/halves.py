# SPDX-License-Identifier: GPL-3.0-or-later
"""Points in the order of a balanced tree: halves of halves, each compact in space."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..inputs import FloatArray, IntArray, extent_of
from ..threads import in_threads

# Boxes of so many points are halved to the end in one go: threads wait for each other
# between array operations, so these are to be few and long.
_TOGETHER = 1 << 17

# Points of a large box whose coordinates are gathered at a time.
_PART = 1 << 16

# Beyond all coordinates, as bits.
_MISSING = np.iinfo(np.int64).max


def sizes_of_halves(count: int, most: int, width: int | None = None) -> list[IntArray]:
    """Return the sizes of all boxes, level by level, from one of all points down.

    The last level has boxes of at most `most` points. On every level sizes differ by
    one at most, and all first halves are alike.

    Parameters
    ----------
    count, most : int
    width : int, optional
        Where all the points are one box of a level: the size of its largest.
    """
    width = width or count
    sizes = [np.array([count])]
    while width > most:
        first = np.full(len(sizes[-1]), width // 2)
        sizes.append(np.stack([first, sizes[-1] - first], axis=1).ravel())
        width -= width // 2
    return sizes


def halved(
    points: FloatArray,
    most: int,
    *,
    center: FloatArray | None = None,
    threads: int | None = None,
    width: int | None = None,
) -> IntArray:
    """Sort points so that halves of halves, and so on, are boxes of their own.

    Parameters
    ----------
    points : (n, 3) float64
    most : int
        Points of the least boxes, at most.
    center : (3,), optional
        Taken off the coordinates.
    threads, width : int, optional
        See `sizes_of_halves`.

    Returns
    -------
    (n,) int32
        Which point stands where.

    Notes
    -----
    Each box is cut across its longest side. The place of a point stands in the last
    bits of its coordinate while these are parted, as plain numbers. Coordinates are
    gathered anew for every level of large boxes: those of all are never in memory.
    """
    order = np.arange(len(points), dtype=np.int32)
    center = np.zeros(3) if center is None else center
    levels = sizes_of_halves(len(points), most, width)
    width = width or len(points)

    def halve(box):
        own, below = box
        if len(below) > 1:
            place = _halved_to_the_end(points, center, own, below, width)
        else:
            place = _halved_once(points, center, own, width // 2)
        own[:] = np.take(own, place)

    for level, sizes in enumerate(levels[:-1]):
        together = sizes.max() <= _TOGETHER
        # Down to the last level, or only the next one.
        below = list(enumerate(levels[level : -1 if together else level + 1]))
        boxes = [
            (own, [part[box << down : (box + 1) << down] for down, part in below])
            for box, own in enumerate(np.split(order, np.cumsum(sizes)[:-1]))
        ]
        for _ in in_threads(halve, boxes, threads):
            pass
        if together:
            break
        width -= width // 2
    return order


def _halved_once(points, center, own, first):
    """Return the places of the points of one box, the first so many first."""
    parts = [own[at : at + _PART] for at in range(0, len(own), _PART)]
    extents = [extent_of(np.take(points, part, axis=0)) for part in parts]
    low = np.min([part.low for part in extents], axis=0) - center
    high = np.max([part.high for part in extents], axis=0) - center
    axis = (high - low).argmax()
    along = np.concatenate([points[part, axis] for part in parts])
    along -= center[axis]
    along -= low[axis]
    return _parted(along[None], np.array([len(own)]), first)


def _halved_to_the_end(points, center, own, levels, width):
    """Return the places of the points of one box, halved level by level."""
    # One place more, so that every box may be read as if it had the largest size.
    local = np.zeros((3, len(own) + 1))
    there = local[:, :-1]
    np.subtract(np.take(points, own, axis=0).T, center[:, None], out=there)
    places = np.arange(len(own))
    for sizes in levels:
        starts = np.cumsum(sizes) - sizes
        low = np.minimum.reduceat(there, starts, axis=1)
        high = np.maximum.reduceat(there, starts, axis=1)
        axis = (high - low).argmax(axis=0)
        along = sliding_window_view(local, sizes.max(), axis=1)[axis, starts]
        along -= low[axis, np.arange(len(axis))][:, None]
        place = _parted(along, sizes, width // 2)
        for row in (*there, places):
            row[:] = np.take(row, place)
        width -= width // 2
    return places


def _parted(along, sizes, first):
    """Return the places of points, box by box, the first so many of each first.

    Parameters
    ----------
    along : (b, w) float64, used up
        Coordinates in each box, from zero up; one too many where a box has less.
    sizes : (b,) int
    """
    # From zero up floats are ordered as their bits are.
    key = along.view(np.int64)
    bits = np.int64((1 << int(key.shape[1] - 1).bit_length()) - 1)
    key &= ~bits
    key |= np.arange(key.shape[1])
    key[sizes < key.shape[1], -1] = _MISSING
    key.partition(first, axis=-1)
    missing = key == _MISSING if sizes.min() < key.shape[1] else None
    key &= bits
    key += (np.cumsum(sizes) - sizes)[:, None]
    return key.ravel() if missing is None else key[~missing]
