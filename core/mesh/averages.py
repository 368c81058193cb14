# SPDX-License-Identifier: GPL-3.0-or-later
"""Means over the vertices around, taken once or many times over."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..inputs import BoolArray, FloatArray, IntArray
from .faces import Triangles, corner_sums

# Rounds after which a ladder has a rung.
RUNGS = (1, 2, 4, 8, 16, 32, 64)


class Averages:
    """Who is joined to whom by the edges of a mesh, and means over them.

    Attributes
    ----------
    joined : (n, n) sparse, ones where an edge is
    degree : (n,) int
        Neighbors of each vertex.
    inner : (n,) bool
        Vertices with faces all around.
    """

    def __init__(self, count: int, faces: IntArray) -> None:
        from scipy import sparse

        m = len(faces)
        corner = np.arange(0, 3 * m + 1, 3, dtype=np.int64)
        corners = sparse.csr_array(
            (np.ones(3 * m, dtype=np.float32), faces.ravel(), corner), shape=(m, count)
        )
        shared = (corners.T @ corners).tocsr()
        shared.sum_duplicates()
        row = np.repeat(np.arange(count), np.diff(shared.indptr))
        loop = shared.indices == row
        # Around an inner vertex every edge has two faces.
        alone = np.bincount(row[~loop], shared.data[~loop] != 2, minlength=count)
        self.degree: IntArray = np.bincount(row[~loop], minlength=count)
        self.inner: BoolArray = (alone == 0) & (self.degree > 0)
        kept = ~loop & (self.degree[row] > 0)
        self.joined: Any = sparse.csr_array(
            (
                np.ones(int(kept.sum()), dtype=np.float32),
                shared.indices[kept],
                np.concatenate([[0], np.cumsum(self.degree)]),
            ),
            shape=(count, count),
        )
        self._self_too = (1 / (self.degree + 1.0)).astype(np.float32)[:, None]
        self._others = (1 / np.maximum(self.degree, 1.0))[:, None]

    def means(self, values: FloatArray, rounds: int = 1) -> FloatArray:
        """Return means of a vertex and its neighbors, (n, c), so many times over."""
        for _ in range(rounds):
            values = (self.joined @ values + values) * self._self_too
        return values

    def around(self, values: FloatArray) -> FloatArray:
        """Return means of the neighbors alone, (n, c)."""
        return (self.joined @ values) * self._others

    @property
    def edges(self) -> tuple[IntArray, IntArray]:
        """Both ends of every edge, (e,) int each."""
        row = np.repeat(np.arange(len(self.degree)), self.degree)
        once = row < self.joined.indices
        return row[once], self.joined.indices[once]


def area_vectors(mesh: Triangles) -> FloatArray:
    """Return the sums of area vectors of faces at vertices, (n, 3) float32.

    In units of their largest component. The sum of area vectors over a part of a mesh
    depends on its rim alone, so that noise cancels inside, however the faces fold.
    """
    vectors = corner_sums(mesh.vectors, mesh.faces, len(mesh.points))
    top = np.abs(vectors).max(initial=0)
    return (vectors / top if top > 0 else vectors).astype(np.float32)


def ladder(
    averages: Averages, vectors: FloatArray
) -> Iterator[tuple[int, FloatArray, FloatArray | None]]:
    """Yield fields of normals that are smoother and smoother, rung by rung.

    Parameters
    ----------
    averages : Averages
    vectors : (n, 3 f) float32
        Those of `area_vectors`, of f fields side by side.

    Yields
    ------
    rounds : int, 0 and those of RUNGS
    plain : (n, 3 f) float32
        Normals of the means.
    sharpened : (n, 3 f) float32 or None
        Of twice the mean of half as many rounds less the mean: what a mean rounds
        off at one rung is in the difference to the next. None before two rounds.
    """
    before, done = vectors, 0
    yield 0, _units(vectors), None
    for rounds in RUNGS:
        after = averages.means(before, rounds - done)
        yield (
            rounds,
            _units(after),
            _units(2 * before - after) if rounds > 1 else None,
        )
        before, done = after, rounds


def _units(vectors):
    """Return the vectors of fields side by side at length one, or zero."""
    fields = vectors.reshape(len(vectors), -1, 3)
    length = np.sqrt(np.einsum("ijk,ijk->ij", fields, fields))[:, :, None]
    result = np.divide(fields, length, out=np.zeros_like(fields), where=length > 0)
    return result.reshape(vectors.shape)
