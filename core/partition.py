# SPDX-License-Identifier: GPL-3.0-or-later
"""Space cut into boxes that hold as many points each."""

from dataclasses import dataclass

import numpy as np

from .inputs import FloatArray, IntArray


@dataclass(frozen=True)
class Partition:
    """Space cut into boxes by planes across the axes, one box a tile.

    Attributes
    ----------
    axis, cut : (2^d - 1,)
        Of the planes, halves of halves: the children of i are 2 i + 1 and 2 i + 2.
    low, high : (2^d, 3) float64
        Corners of the boxes, infinite at the border.
    """

    axis: IntArray
    cut: FloatArray
    low: FloatArray
    high: FloatArray

    @classmethod
    def of(cls, sample: FloatArray, depth: int) -> "Partition":
        """Cut space so that 2^depth boxes hold as many points of a sample each.

        By the rule of `halves.halved`: where the sample is the whole cloud, the boxes
        hold what its halves of halves do.
        """
        axis = np.zeros(2**depth - 1, dtype=np.int64)
        cut = np.zeros(2**depth - 1)
        parts = [(sample, np.full(3, -np.inf), np.full(3, np.inf))]
        width = len(sample)
        for level in range(depth):
            below = []
            for node, (points, low, high) in enumerate(parts, 2**level - 1):
                axis[node], cut[node] = along, at = _plane(points, width // 2)
                left = points[:, along] < at
                split_low, split_high = low.copy(), high.copy()
                split_high[along] = split_low[along] = at
                below.append((points[left], low, split_high))
                below.append((points[~left], split_low, high))
            parts = below
            width -= width // 2
        return cls(
            axis,
            cut,
            np.array([part[1] for part in parts]),
            np.array([part[2] for part in parts]),
        )

    def __len__(self) -> int:
        return len(self.low)

    def box_of(self, points: FloatArray) -> IntArray:
        """Return the box of each point, (n,) int."""
        node = np.zeros(len(points), dtype=np.int64)
        rows = np.arange(len(points))
        while len(self.axis) and node[0] < len(self.axis):
            right = points[rows, self.axis[node]] >= self.cut[node]
            node = 2 * node + 1 + right
        return node - len(self.axis)

    def width(self, count: int, size: int) -> int:
        """Return the size of the largest box of a level of halves, for `halves.halved`.

        Parameters
        ----------
        count, size : int
            The points of the cloud, and of one box.

        Returns
        -------
        int
            The size itself where the boxes are no halves of halves of the cloud.
        """
        for _ in range(len(self).bit_length() - 1):
            count -= count // 2
        return count if count - 1 <= size <= count else size


def _plane(points, first):
    """Return the axis and the cut that leaves the first so many points on one side."""
    if not len(points):
        return 0, 0.0
    along = int(np.ptp(points, axis=0).argmax())
    at = min(first, len(points) - 1)
    return along, float(np.partition(points[:, along], at)[at])


def depth_in_box(points: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return how far inside a box points (n, 3) are, (n,); inf in an endless one."""
    return np.minimum(points - low, high - points).min(axis=1)
