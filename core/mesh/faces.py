# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of triangles and their weighted means at the vertices.

References
----------
[1] N. Max, "Weights for Computing Vertex Normals from Facet Normals", Journal of
    Graphics Tools 4 (1999).
"""

from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np

from ..inputs import FloatArray, IntArray, as_choice

FACE_WEIGHTS = ("area", "angle", "max")


def face_vectors(points: FloatArray, faces: IntArray) -> FloatArray:
    """Return the cross products of the triangles: direction normal, length 2 x area.

    Returns
    -------
    (m, 3) float64
    """
    a, b, c = (points[faces[:, i]] for i in range(3))
    b -= a
    c -= a
    return cross(b, c)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return cross products (m, 3), in half the time that numpy takes."""
    result = np.empty(a.shape)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        np.multiply(a[:, j], b[:, k], out=result[:, i])
        result[:, i] -= a[:, k] * b[:, j]
    return result


def squares(vectors: FloatArray) -> FloatArray:
    """Return the squared lengths of vectors (m, d), (m,)."""
    return np.einsum("ij,ij->i", vectors, vectors)


@dataclass(frozen=True)
class Triangles:
    """Triangles of a mesh, and what was measured of them.

    Attributes
    ----------
    points, faces : (n, 3) float64, (m, 3) int
    """

    points: FloatArray
    faces: IntArray

    @cached_property
    def vectors(self) -> FloatArray:
        """(m, 3) float64, see `face_vectors`."""
        return face_vectors(self.points, self.faces)

    @cached_property
    def doubled_areas(self) -> FloatArray:
        """(m,) float64."""
        return np.sqrt(squares(self.vectors))

    @property
    def normals(self) -> FloatArray:
        """(m, 3) float64, unit; zero for triangles without area."""
        return unit(self.vectors)

    @cached_property
    def sides(self) -> FloatArray:
        """(m, 3) float64, the squared lengths of the sides opposite the corners."""
        result = np.empty(self.faces.shape)
        for corner in range(3):
            ends = [self.faces[:, (corner + i) % 3] for i in (1, 2)]
            result[:, corner] = squares(self.points[ends[0]] - self.points[ends[1]])
        return result

    @cached_property
    def mean_edge(self) -> float:
        """The mean length of the sides."""
        return float(np.sqrt(self.sides).mean())

    @property
    def longest_edges(self) -> FloatArray:
        """(n,) float32, the length of the longest edge at each vertex, or zero."""
        longest = np.zeros(len(self.points), dtype=np.float32)
        for corner in range(3):
            length = np.sqrt(self.sides[:, corner]).astype(np.float32)
            for end in (1, 2):
                np.maximum.at(longest, self.faces[:, (corner + end) % 3], length)
        return longest

    @property
    def quality(self) -> FloatArray:
        """(m,) float64, 1 where all sides are equal and near 0 for slivers.

        The area over the sum of the squared sides, in units of the largest possible.
        """
        total = self.sides.sum(axis=1)
        share = np.divide(
            self.doubled_areas, total, out=np.zeros_like(total), where=total > 0
        )
        return 2 * np.sqrt(3) * share

    def weights(self, kind: str) -> FloatArray | None:
        """Return what each triangle's vector counts at its corners; see below.

        Returns
        -------
        (m, 3) float64, zero for triangles without area; None for ones.
        """
        as_choice(kind, FACE_WEIGHTS, name="face weights")
        double = self.doubled_areas
        if kind == "area":
            return None
        result = np.zeros(self.faces.shape)
        whole = double > 0
        for corner in range(3):
            beside, after = (self.sides[:, (corner + i) % 3] for i in (1, 2))
            if kind == "angle":
                dot = (beside + after - self.sides[:, corner]) / 2
                value, scale = np.arctan2(double, dot), double
            else:
                value, scale = np.ones(len(double)), beside * after
            np.divide(value, scale, out=result[:, corner], where=(scale > 0) & whole)
        return result

    def vertex_normals(self, kind: str) -> FloatArray:
        """Return the weighted mean of face normals at each vertex.

        Parameters
        ----------
        kind : "area" | "angle" | "max"
            The triangle's area (N_D of the paper), its angle at the vertex, or the
            sine over the product of the two edges of [1], exact on spheres.

        Returns
        -------
        (n, 3) float64, unit; zero at vertices without a face of any area.
        """
        weights = self.weights(kind)
        return unit(corner_sums(self.vectors, self.faces, len(self.points), weights))

    def fan_width(self, axes: FloatArray) -> FloatArray:
        """Return how far the faces at each vertex turn from an axis.

        Parameters
        ----------
        axes : (n, 3) float64, unit

        Returns
        -------
        (n,) float64, the root mean square sine of the angles between the axis and the
        normals of the faces; zero at vertices without a face.
        """
        count = len(self.points)
        total, faces = np.zeros(count), np.zeros(count)
        x, y, z = self.normals.T
        for corner in range(3):
            at = self.faces[:, corner]
            a, b, c = (axis[at] for axis in axes.T)
            # Component by component: arrays of vectors would be three times as large.
            sine = (y * c - z * b) ** 2
            sine += (z * a - x * c) ** 2
            sine += (x * b - y * a) ** 2
            total += np.bincount(at, sine, minlength=count)
            faces += np.bincount(at, minlength=count)
        return np.sqrt(total / np.maximum(faces, 1))


def vertex_normals(
    points: FloatArray, faces: IntArray, *, weights: str = "area"
) -> FloatArray:
    """Return the weighted mean of face normals at each vertex.

    Parameters
    ----------
    points : (n, 3) float64
    faces : (m, 3) int
    weights : "area" | "angle" | "max"
        See `Triangles.vertex_normals`.

    Returns
    -------
    (n, 3) float64, unit; zero at vertices without a face of any area.
    """
    return Triangles(points, faces).vertex_normals(weights)


def corner_sums(
    vectors: FloatArray,
    faces: IntArray,
    count: int,
    weights: FloatArray | None = None,
) -> FloatArray:
    """Return the sums of the vectors of triangles at their corners.

    Parameters
    ----------
    vectors : (m, 3) float
    count : int
        The number n of vertices.
    weights : (m, 3) float, optional
        Factors of each triangle's vector at its corners.

    Returns
    -------
    (n, 3) float64
    """
    total = np.zeros((3, count))
    for corner in range(3):
        at = faces[:, corner]
        for axis in range(3):
            share = vectors[:, axis]
            if weights is not None:
                share = share * weights[:, corner]
            total[axis] += np.bincount(at, share, minlength=count)
    return np.ascontiguousarray(total.T)


def angles_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the angles between vectors (m, 3) in degrees, (m,), 0 to 180."""
    return np.degrees(
        np.arctan2(np.sqrt(squares(cross(a, b))), np.einsum("ij,ij->i", a, b))
    )


def split_fans(
    count: int, faces: IntArray, edges: IntArray
) -> tuple[IntArray, IntArray]:
    """Part the vertices of a mesh along edges.

    A fan is a connected set of corners around a vertex that no given edge separates.
    As vertices of their own, fans keep neighborhoods and means of faces on one side.

    Parameters
    ----------
    count : int
        The number n of vertices.
    faces : (m, 3) int
    edges : (e, 2) int
        Pairs of vertices, in any order.

    Returns
    -------
    fans : (m, 3) int
        The fan of each corner, a triangulation of the parted mesh.
    vertex : (f,) int
        The vertex of each fan, f >= n. The first n fans are those of the vertices in
        their order: what is not parted, or has no face, keeps its number.

    Notes
    -----
    Corners at one vertex are joined where their triangles share an edge that is not
    given. A vertex of no given edge is one fan, even where its faces meet in it alone.
    """
    from scipy import sparse

    corners = faces.ravel()
    touched = np.zeros(count, dtype=bool)
    touched[edges] = True
    parted = np.flatnonzero(touched[corners])
    place = np.full(len(corners), -1)
    place[parted] = np.arange(len(parted))
    first, second = _shared_sides(count, faces, edges, touched)
    first, second = place[first], place[second]
    joined = first >= 0
    pairs = (first[joined], second[joined])
    graph = sparse.coo_array(
        (np.ones(len(pairs[0]), dtype=bool), pairs), shape=(len(parted),) * 2
    )
    fan_count, label = sparse.csgraph.connected_components(graph, directed=False)
    origin = np.empty(fan_count, dtype=np.int64)
    origin[label] = corners[parted]
    _, oldest = np.unique(origin, return_index=True)
    younger = np.ones(fan_count, dtype=bool)
    younger[oldest] = False
    number = origin.copy()
    number[younger] = count + np.arange(younger.sum())
    fans = corners.astype(np.int64)
    fans[parted] = number[label]
    return fans.reshape(faces.shape), np.append(np.arange(count), origin[younger])


def _shared_sides(count, faces, edges, touched):
    """Return pairs of corners at the ends of sides that triangles share.

    Both corners of a pair are at one vertex; sides among the edges are left out, and
    triangles away from touched vertices.
    """
    near = np.flatnonzero(touched[faces].any(axis=1))
    corner = 3 * near[:, None] + np.arange(3)
    ends = np.stack([corner, np.roll(corner, -1, axis=1)], axis=-1).reshape(-1, 2)
    sides = faces.ravel()[ends]
    turned = sides[:, 0] > sides[:, 1]
    ends[turned] = ends[turned, ::-1]
    key = sides.min(axis=1) * np.int64(count) + sides.max(axis=1)
    given = edges.min(axis=1) * np.int64(count) + edges.max(axis=1)
    free = np.flatnonzero(~np.isin(key, given))
    free = free[np.argsort(key[free], kind="stable")]
    same = key[free[1:]] == key[free[:-1]]
    return ends[free[:-1][same]].ravel(), ends[free[1:][same]].ravel()


def fan_means(normals: FloatArray, vertex: IntArray, count: int) -> FloatArray:
    """Return the means of the normals of fans at their vertices.

    Parameters
    ----------
    normals : (f, 3) float64
    vertex : (f,) int
        The vertex of each fan, below `count`.

    Returns
    -------
    (count, 3) float64, unit; zero where there are none or they cancel out.
    """
    total = [np.bincount(vertex, axis, minlength=count) for axis in normals.T]
    return unit(np.stack(total, axis=1))


def unit(vectors: FloatArray) -> FloatArray:
    """Return vectors at length one, and zero vectors as they are, (..., 3)."""
    # Scaled first: the square of a very small or very large component would be
    # rounded to zero or to infinity.
    top = reduce(np.maximum, np.moveaxis(np.abs(vectors), -1, 0))[..., None]
    scaled = np.divide(vectors, top, out=np.zeros_like(vectors), where=top > 0)
    length = np.sqrt(np.einsum("...i,...i->...", scaled, scaled))[..., None]
    return np.divide(scaled, length, out=scaled, where=length > 0)
