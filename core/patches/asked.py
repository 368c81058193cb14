# SPDX-License-Identifier: GPL-3.0-or-later
"""Some points of a cloud with their neighbors: what the whole cloud is judged by."""

from collections.abc import Callable

import numpy as np

from ..inputs import FloatArray
from ..neighbors.graph import NearestNeighbors

# Points that are asked: enough for a mean square within a few per cent. Of a small
# cloud a quarter is.
_SAMPLES, EVERY = 1024, 4

# Neighbors are looked up for steps to come as well, up to four times as many; nobody
# asks for more than the most.
_AHEAD, MOST = 4, 922


class Asked:
    """The points that are asked, and their neighbors, looked up as steps need them.

    Parameters
    ----------
    count : int
        The points of the whole cloud.
    look_up : callable (k) -> (3, k, m) float64
        Returns neighbors less their point, nearest first: k of them, or more.
    """

    def __init__(self, count: int, look_up: Callable[[int], FloatArray]) -> None:
        self.count = count
        self._look_up = look_up
        self._offsets: FloatArray = np.empty((3, 0, 0))

    @classmethod
    def of(cls, nearest: NearestNeighbors) -> "Asked":
        """Ask points from all over a cloud."""
        n = len(nearest)
        rows = nearest.order[:: max(EVERY, n // _SAMPLES)]

        def look_up(k):
            return nearest.offsets(rows, k)[0]

        return cls(n, look_up)

    def around(self, k: int) -> tuple[FloatArray, FloatArray]:
        """Return the k nearest neighbors of each point, in units of their reach.

        Returns
        -------
        offsets : (3, k, m) float64
        reach : (m,) float64
            The distance of the farthest.
        """
        k = min(k, self.count - 1)
        if k > self._offsets.shape[1]:
            ahead = min(_AHEAD * k, MOST, self.count // EVERY)
            self._offsets = self._look_up(max(k, ahead))
        offsets = self._offsets[:, :k]
        reach = np.sqrt((offsets[:, -1] ** 2).sum(axis=0))
        return offsets / np.where(reach > 0, reach, 1), reach

    def forget(self) -> None:
        """Let go of the neighbors; who asks again has them looked up again."""
        self._offsets = np.empty((3, 0, 0))
