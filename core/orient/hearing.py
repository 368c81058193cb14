# SPDX-License-Identifier: GPL-3.0-or-later
"""Which representatives of a cloud its points listen to, and what they make of it."""

from dataclasses import dataclass

import numpy as np

from ..inputs import FloatArray, IntArray
from ..neighbors.graph import NearestNeighbors
from ..progress import Progress, silent
from .representatives import HEARD_BY

# Points that listen in one go.
_CHUNK = 100_000


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
        shape = len(points), min(HEARD_BY, len(place))
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
