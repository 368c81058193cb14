# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of triangles and their weighted means at the vertices.

References
----------
[1] N. Max, "Weights for Computing Vertex Normals from Facet Normals", Journal of
    Graphics Tools 4 (1999).
"""

import numpy as np

from .inputs import FloatArray, IntArray, as_choice

FACE_WEIGHTS = ("area", "angle", "max")


def face_vectors(points: FloatArray, faces: IntArray) -> FloatArray:
    """Return the cross products of the triangles: direction normal, length 2 x area.

    Returns
    -------
    (m, 3) float64
    """
    a, b, c = (points[faces[:, i]] for i in range(3))
    return cross(b - a, c - a)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return cross products (m, 3), in half the time that numpy takes."""
    result = np.empty(a.shape)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        np.multiply(a[:, j], b[:, k], out=result[:, i])
        result[:, i] -= a[:, k] * b[:, j]
    return result


def corner_weights(points: FloatArray, faces: IntArray, weights: str) -> FloatArray:
    """Return what each triangle's cross product counts at each of its corners.

    Parameters
    ----------
    weights : "area" | "angle" | "max"
        The triangle's area (N_D of the paper), its angle at the vertex, or the
        sine over the product of the two edges of [1], exact on spheres.

    Returns
    -------
    (m, 3) float64, zero for triangles without area
    """
    as_choice(weights, FACE_WEIGHTS, name="face weights")
    double = np.linalg.norm(face_vectors(points, faces), axis=1)
    if weights == "area":
        return np.repeat((double > 0).astype(np.float64)[:, None], 3, axis=1)
    result = np.zeros((len(faces), 3))
    for corner in range(3):
        here, after, before = (points[faces[:, (corner + i) % 3]] for i in range(3))
        a, b = after - here, before - here
        if weights == "angle":
            value, scale = np.arctan2(double, (a * b).sum(1)), double
        else:
            value, scale = np.ones(len(faces)), (a * a).sum(1) * (b * b).sum(1)
        np.divide(value, scale, out=result[:, corner], where=(scale > 0) & (double > 0))
    return result


def vertex_normals(
    points: FloatArray, faces: IntArray, *, weights: str = "area"
) -> FloatArray:
    """Return the weighted mean of face normals at each vertex.

    Parameters
    ----------
    points : (n, 3) float64
    faces : (m, 3) int
    weights : see `corner_weights`

    Returns
    -------
    (n, 3) float64, unit; zero at vertices without a face of any area.
    """
    vectors = face_vectors(points, faces)
    scale = None
    if weights != "area":
        scale = corner_weights(points, faces, weights)
    return unit(corner_sums(vectors, faces, len(points), scale))


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
    total = np.zeros((count, 3))
    for corner in range(3):
        share = vectors if weights is None else vectors * weights[:, corner, None]
        for axis in range(3):
            total[:, axis] += np.bincount(
                faces[:, corner], share[:, axis], minlength=count
            )
    return total


def fan_width(points: FloatArray, faces: IntArray, axes: FloatArray) -> FloatArray:
    """Return how far the faces at each vertex turn from an axis.

    Parameters
    ----------
    axes : (n, 3) float64, unit

    Returns
    -------
    (n,) float64, the root mean square sine of the angles between the axis and the
    normals of the faces; zero at vertices without a face.
    """
    normals = unit(face_vectors(points, faces))
    total, count = np.zeros(len(points)), np.zeros(len(points))
    for corner in range(3):
        at = faces[:, corner]
        sine = (cross(normals, axes[at]) ** 2).sum(axis=1)
        total += np.bincount(at, sine, minlength=len(points))
        count += np.bincount(at, minlength=len(points))
    return np.sqrt(total / np.maximum(count, 1))


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


def mean_edge(points: FloatArray, faces: IntArray) -> float:
    """Return the mean length of the triangles' sides."""
    sides = points[faces] - points[np.roll(faces, 1, axis=1)]
    return float(np.linalg.norm(sides, axis=2).mean())


def unit(vectors: FloatArray) -> FloatArray:
    """Return vectors at length one, and zero vectors as they are, (..., 3)."""
    # Scaled first: the square of a very small or very large component would be
    # rounded to zero or to infinity.
    top = np.abs(vectors).max(axis=-1, keepdims=True)
    scaled = np.divide(vectors, top, out=np.zeros_like(vectors), where=top > 0)
    length = np.linalg.norm(scaled, axis=-1, keepdims=True)
    return np.divide(scaled, length, out=scaled, where=length > 0)
