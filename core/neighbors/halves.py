# SPDX-License-Identifier: GPL-3.0-or-later
"""Points in the order of a balanced tree: halves of halves, each compact in space."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..inputs import FloatArray, IntArray
from ..threads import in_threads

# Boxes of so many points are halved to the end in one go: their arrays stay in the
# cache, and threads have something to share.
_TOGETHER = 1 << 15

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
) -> tuple[FloatArray, IntArray]:
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
    coordinates : (3, n) float64
        The points in that order, each axis on its own.
    order : (n,) int32
        Which points they are.

    Notes
    -----
    Each box is cut across its longest side. The place of a point stands in the last
    bits of its coordinate while these are parted, as plain numbers.
    """
    coordinates = np.empty(points.shape[::-1])
    np.subtract(points.T, 0 if center is None else center[:, None], out=coordinates)
    order = np.arange(len(points), dtype=np.int32)
    levels = sizes_of_halves(len(points), most, width)
    width = width or len(points)
    start = 0
    for level, sizes in enumerate(levels[:-1]):
        together = sizes.max() <= _TOGETHER
        ends = np.cumsum(sizes)
        work = []
        for box, (start, end) in enumerate(zip(ends - sizes, ends, strict=True)):
            # Down to the last level, or only the next one.
            below = [
                sizes[box << down : (box + 1) << down]
                for down, sizes in enumerate(levels[level:-1] if together else [sizes])
            ]
            work.append((coordinates[:, start:end], order[start:end], below, width))
        for _ in in_threads(_halve, work, threads):
            pass
        if together:
            break
        width -= width // 2
    return coordinates, order


def _halve(part):
    """Halve the boxes of a part, in place, level by level."""
    coordinates, order, levels, width = part
    local = coordinates
    if len(levels) > 1:
        # One place more, so that every box may be read as if it had the largest size.
        local = np.zeros((3, len(order) + 1))
        local[:, :-1] = coordinates
    for sizes in levels:
        place = _parted(local, sizes, width // 2)
        for row in (*local[:, : len(order)], order):
            row[:] = np.take(row, place)
        width -= width // 2
    if len(levels) > 1:
        coordinates[:] = local[:, :-1]


def _parted(coordinates, sizes, first):
    """Return the places of the points, box by box, the first so many of each first."""
    width, starts = sizes.max(), np.cumsum(sizes) - sizes
    there = coordinates[:, : starts[-1] + sizes[-1]]
    low = np.minimum.reduceat(there, starts, axis=1)
    high = np.maximum.reduceat(there, starts, axis=1)
    axis = (high - low).argmax(axis=0)
    along = sliding_window_view(coordinates, width, axis=1)[axis, starts]
    # From zero up floats are ordered as their bits are.
    along -= low[axis, np.arange(len(axis))][:, None]
    key = along.view(np.int64)
    bits = np.int64((1 << int(width - 1).bit_length()) - 1)
    key &= ~bits
    key |= np.arange(width)
    key[sizes < width, -1] = _MISSING
    key.partition(first, axis=-1)
    missing = key == _MISSING if sizes.min() < width else None
    key &= bits
    key += starts[:, None]
    return key.ravel() if missing is None else key[~missing]
