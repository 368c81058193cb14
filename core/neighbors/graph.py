# SPDX-License-Identifier: GPL-3.0-or-later
"""Who is near whom: the graph G = (V, E) of Table 1 of the paper.

Two kinds of neighborhood answer to the same call, `neighbors(rows)`: nearest points,
found on demand in a kd-tree so that nothing grows with the number of points, and the
rows of an adjacency matrix (Delaunay edges, mesh edges), grown by rings.
"""

from functools import cached_property
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..inputs import FloatArray, InputError, IntArray, as_faces, as_points
from .blocks import Blocks, Found

# Rows of a graph that grow at a time.
_PART = 1 << 16

# scipy.spatial and scipy.sparse take longer to import than the rest of the core;
# functions that need them import them.


class NearestNeighbors:
    """The k nearest points, asked for chunk by chunk.

    Parameters
    ----------
    points : (n, 3) float64
    center : (3,), optional
        Taken off the points; as long as nobody asks for `points` that is no copy.
    threads : int, optional
        As many as there are cores, if not said.
    cloud : int, optional
        The points of a cloud that these are a part of: what hangs on how many there
        are is to be the same as in all of it.
    """

    def __init__(
        self,
        points: FloatArray,
        *,
        center: FloatArray | None = None,
        threads: int | None = None,
        cloud: int | None = None,
    ) -> None:
        self._given, self._center = points, center
        self.cloud = cloud or len(points)
        self._threads = threads
        self._starts: dict[int, int] = {}
        self._tree: Any = None
        self._one_tree = Lock()

    def __len__(self) -> int:
        return len(self._given)

    @cached_property
    def points(self) -> FloatArray:
        """(n, 3) float64, centered, in the order of the input."""
        return self._given if self._center is None else self._given - self._center

    @cached_property
    def _blocks(self):
        return Blocks(self._given, center=self._center, threads=self._threads)

    @property
    def order(self) -> IntArray:
        """(n,) int32, the points in the order of a balanced tree.

        Those near one another in space stand together: work in this order gathers
        from memory that is close.
        """
        return self._blocks.order

    @cached_property
    def rank(self) -> IntArray:
        """(n,) int32, where each point stands in the order."""
        rank = np.empty(len(self.order), dtype=np.int32)
        rank[self.order] = np.arange(len(self.order), dtype=np.int32)
        return rank

    @property
    def tree(self) -> Any:
        """The scipy.spatial.cKDTree of the points, made when it is asked for."""
        from scipy.spatial import cKDTree

        with self._one_tree:
            if self._tree is None:
                self._tree = cKDTree(self.points)
        return self._tree

    def runs(self, count: int) -> list[IntArray]:
        """Return all rows, run by run: so asked for, `count` neighbors come faster."""
        starts = self._blocks.runs(count)
        # Found out once, and not by every thread that asks first.
        _ = self._blocks.useful
        self._starts |= zip(
            self.order[starts[:-1]].tolist(), starts.tolist(), strict=False
        )
        return np.split(self.order, starts[1:-1])

    def neighbors(
        self, rows: IntArray, count: int, *, radius: float | None = None
    ) -> tuple[IntArray, FloatArray]:
        """Return the nearest points of the given ones, nearest first.

        Parameters
        ----------
        rows : (m,) int
        count : int
            Neighbors beside the point itself, at most n - 1.
        radius : float, optional
            Leave out neighbors farther away.

        Returns
        -------
        index : (m, count) int
            Where fewer are within the radius, the point's own index fills the row.
        distance : (m, count) float64
            Zero where the point itself stands in.
        """
        found = self._found(rows, count)
        index = np.take(self.order, found.place).astype(np.int64)
        if radius is None:
            return index, found.distance
        far = found.distance > radius
        return (
            np.where(far, np.asarray(rows)[:, None], index),
            np.where(far, 0.0, found.distance),
        )

    def offsets(
        self, rows: IntArray, count: int, *, radius: float | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return where the neighbors are, seen from the point.

        Parameters are those of `neighbors`.

        Returns
        -------
        offsets : (3, count, m) float64
        distance : (m, count) float64
            Both zero for neighbors beyond the radius.
        """
        found = self._found(rows, count)
        offsets, distance = found.offsets, found.distance
        if radius is not None:
            within = distance <= radius
            offsets, distance = offsets * within.T, distance * within
        return offsets, distance

    def around(self, rows: IntArray, count: int) -> tuple[IntArray, FloatArray]:
        """Return the nearest points of the given ones, and where they are from there.

        Returns
        -------
        index : (count, m) int
        offsets : (3, count, m) float64
        """
        found = self._found(rows, count)
        return np.take(self.order, found.place.T), found.offsets

    def toward(self, index: IntArray, rows: IntArray) -> FloatArray:
        """Return where points (k, m) are, seen from rows (m,): (3, k, m) float64."""
        away = np.take(self._given, index, axis=0) - self._given[rows]
        return np.ascontiguousarray(np.moveaxis(away, -1, 0))

    def others(self, count: int, points: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return distance and index of the nearest but the first, 2 x (m, count).

        Parameters
        ----------
        points : (m, 3) float64
            Some of the points: each is its own first.
        """
        found = self.tree.query(points, k=count + 1)
        distance, index = (np.asarray(a)[:, 1:] for a in found)
        return distance, index

    def _found(self, rows, count):
        """Return the Found of rows (m,), each without itself."""
        own, blocks = self._places_of(rows)
        if not self._blocks.useful:
            found = self._found_in_tree(own, count + 1)
        elif blocks is None:
            found = self._blocks.search_some(own, count + 1)
        else:
            found = self._blocks.search(blocks, count + 1)
        for search in (self._blocks.search_each, self._found_in_tree):
            left = np.flatnonzero(~found.certain)
            if len(left):
                found.put(left, search(own[left], count + 1))
        return self._without_self(own, found)

    def _places_of(self, rows):
        """Return the places of rows (m,), and the blocks of which they are a run."""
        start = self._starts.get(int(rows[0])) if len(rows) else None
        if start is not None:
            end = start + len(rows)
            if np.array_equal(self.order[start:end], rows):
                return np.arange(start, end), self._blocks.between(start, end)
        return self.rank[rows], None

    def _found_in_tree(self, own, count):
        here = self._blocks.at(own)
        distance, index = self.tree.query(here.T, k=np.arange(1, count + 1))
        place = self.rank[index].astype(np.int64)
        offsets = self._blocks.at(place.T) - here[:, None]
        return Found(place, distance, offsets, np.ones(len(own), dtype=bool))

    def _without_self(self, own, found):
        """Drop each point from its own row; a twin may stand before it."""
        place, distance, offsets = found.place, found.distance, found.offsets
        if (place[:, 0] == own).all():
            return Found(place[:, 1:], distance[:, 1:], offsets[:, 1:], found.certain)
        here = place == own[:, None]
        # More than `count` twins push the point out of its row: drop the last then.
        here[~here.any(axis=1), -1] = True
        shape = (len(own), place.shape[1] - 1)
        offsets = np.stack([along.T[~here].reshape(shape).T for along in offsets])
        place, distance = (a[~here].reshape(shape) for a in (place, distance))
        return Found(place, distance, offsets, found.certain)


class NeighborGraph:
    """An undirected graph over points, as the rows of an adjacency matrix.

    Parameters
    ----------
    matrix : (n, n) scipy sparse matrix
        Any nonzero (i, j) or (j, i) joins i and j; the diagonal is ignored.

    Examples
    --------
    >>> graph = NeighborGraph.mesh(4, [[0, 1, 2], [1, 3, 2]])
    >>> graph.row(0)
    array([1, 2], dtype=int32)
    """

    def __init__(self, matrix: Any) -> None:
        from scipy import sparse

        matrix = sparse.csr_matrix(matrix, dtype=bool)
        matrix = (matrix + matrix.T).tocoo()
        apart = matrix.row != matrix.col
        self._set(
            sparse.csr_matrix(
                (matrix.data[apart], (matrix.row[apart], matrix.col[apart])),
                shape=matrix.shape,
            )
        )

    def _set(self, matrix):
        matrix.sort_indices()
        self.matrix = matrix
        self.indptr, self.indices = matrix.indptr, matrix.indices

    @classmethod
    def from_edges(cls, count: int, edges: ArrayLike) -> "NeighborGraph":
        """Make the graph of `count` points with (e, 2) int edges."""
        from scipy import sparse

        edges = np.asarray(edges).reshape(-1, 2)
        data = np.ones(len(edges), dtype=bool)
        return cls(sparse.coo_matrix((data, edges.T), shape=(count, count)))

    @classmethod
    def nearest(
        cls, points: ArrayLike, count: int, *, radius: float | None = None
    ) -> "NeighborGraph":
        """Join every point with its `count` nearest, within `radius` if given."""
        points = as_points(points, least=2)
        count = min(count, len(points) - 1)
        rows = np.arange(len(points))
        index, _ = NearestNeighbors(points).neighbors(rows, count, radius=radius)
        edges = np.stack([np.repeat(rows, count), index.ravel()], axis=1)
        return cls.from_edges(len(points), edges)

    @classmethod
    def delaunay(cls, points: ArrayLike) -> "NeighborGraph":
        """Join the points along the edges of their Delaunay complex.

        Notes
        -----
        Tetrahedra in space, as in section 4 of the paper; triangles where all points
        lie in one plane, where there are no tetrahedra.
        """
        checked = as_points(points, least=3)
        simplices = delaunay_simplices(checked)
        corners = np.triu_indices(simplices.shape[1], 1)
        edges = np.concatenate(
            [simplices[:, pair] for pair in np.stack(corners, axis=1)]
        )
        return cls.from_edges(len(checked), edges)

    @classmethod
    def mesh(cls, count: int, faces: ArrayLike) -> "NeighborGraph":
        """Join `count` vertices along the edges of (m, 3) triangles."""
        triangles = as_faces(faces, count)
        if triangles is None:
            raise InputError("expected at least one face for a mesh graph, got none")
        edges = np.concatenate(
            [triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]
        )
        return cls.from_edges(count, edges)

    def __len__(self) -> int:
        return len(self.indptr) - 1

    @property
    def degrees(self) -> IntArray:
        """(n,) int, the number of neighbors of each point."""
        return np.diff(self.indptr)

    @property
    def edges(self) -> IntArray:
        """(e, 2) int, every edge once, the smaller index first."""
        matrix = self.matrix.tocoo()
        once = matrix.row < matrix.col
        return np.stack([matrix.row[once], matrix.col[once]], axis=1)

    def row(self, i: int) -> IntArray:
        """Return the neighbors of point i, (degree,) int, increasing."""
        return self.indices[self.indptr[i] : self.indptr[i + 1]]

    def neighbors(self, rows: IntArray) -> IntArray:
        """Return the neighbors of the given points in a rectangle.

        Parameters
        ----------
        rows : (m,) int

        Returns
        -------
        (m, w) int, w the largest degree among the rows; a point's own index fills
        its row up.
        """
        degrees = self.degrees[rows]
        column = np.arange(degrees.max(initial=0))
        present = column < degrees[:, None]
        at = np.minimum(self.indptr[rows][:, None] + column, len(self.indices) - 1)
        return np.where(present, self.indices[at], np.asarray(rows)[:, None])

    def extended(self, least: int, *, rings: int = 6) -> "NeighborGraph":
        """Return the graph with short rows grown ring by ring.

        A row with fewer than `least` neighbors takes the neighbors of its neighbors
        (the k-neighborhood of section 4), again and again up to `rings` times; rows
        long enough are left as they are. The result is no longer symmetric.

        Parameters
        ----------
        least : int

        Returns
        -------
        NeighborGraph
            A small piece of the graph may still have shorter rows.
        """
        grown = self.matrix
        for _ in range(rings):
            short = np.flatnonzero(np.diff(grown.indptr) < least)
            if not len(short):
                break
            # In parts, so that what comes and goes takes little memory.
            parts = np.array_split(short, -(-len(short) // _PART))
            wider = [_a_ring_wider(grown, self.matrix, rows) for rows in parts]
            if sum(part.nnz for part in wider) == np.diff(grown.indptr)[short].sum():
                break
            grown = _with_rows(grown, short, wider)
        graph = NeighborGraph.__new__(NeighborGraph)
        graph._set(grown)
        return graph


def _a_ring_wider(grown, step, ids):
    """Return rows `ids` of a bool matrix with what is a step from their entries."""
    from scipy import sparse

    rows = grown[ids]
    rows = (rows + rows @ step).tocoo()
    apart = ids[rows.row] != rows.col
    return sparse.csr_matrix(
        (rows.data[apart], (rows.row[apart], rows.col[apart])), shape=rows.shape
    )


def _with_rows(matrix, ids, parts):
    """Return the matrix with rows `ids` replaced by those of `parts`, stacked."""
    from scipy import sparse

    kept = np.ones(matrix.shape[0], dtype=bool)
    kept[ids] = False
    others = np.flatnonzero(kept)
    if not len(others):
        return sparse.vstack(parts, format="csr")
    stacked = sparse.vstack([matrix[others], *parts], format="csr")
    return stacked[np.argsort(np.concatenate([others, ids]))]


def delaunay_simplices(points: FloatArray) -> IntArray:
    """Return the Delaunay tetrahedra of points in space, or triangles in a plane.

    Parameters
    ----------
    points : (n, 2) or (n, 3) float64

    Returns
    -------
    (m, 4) or (m, 3) int; empty where the points span no plane.

    Notes
    -----
    Points that share a place are joined with nothing but the one of them that qhull
    keeps. Points in space are moved by a billionth of their size first: thousands on
    one sphere have no Delaunay complex of their own, and the fan that qhull makes
    of them joins one point with all.
    """
    from scipy.spatial import Delaunay, QhullError

    centered = points - points.mean(axis=0)
    _, spread, axes = np.linalg.svd(centered, full_matrices=False)
    # What is flat to within rounding of the coordinates has no tetrahedra but those
    # that rounding makes.
    rank = int((spread > 1e-12 * spread[0]).sum())
    if rank < 2 or len(points) < rank + 1:
        return np.empty((0, 3), dtype=np.int64)
    seen = centered @ axes[:rank].T
    if rank == 3:
        seen = seen + _jitter(seen)
    try:
        return Delaunay(seen).simplices.astype(np.int64)
    except QhullError:
        return np.empty((0, 3), dtype=np.int64)


def _jitter(points):
    """Return shifts of a billionth of the size that depend on nothing but the place.

    The same point moves alike wherever it stands in the array, so the graph does not
    depend on the order of the points.
    """
    size = np.abs(points).max()
    mixed = (
        points / size @ np.array([[1.0, 1.7, 2.9], [2.3, 3.1, 1.3], [3.7, 1.1, 1.9]])
    )
    return 1e-9 * size * np.sin(1e6 * mixed)
