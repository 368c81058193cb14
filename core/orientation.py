# SPDX-License-Identifier: GPL-3.0-or-later
"""Consistent signs for normals that are known up to their side.

References
----------
[1] H. Hoppe et al., "Surface Reconstruction from Unorganized Points", SIGGRAPH 1992:
    signs spread along a minimum spanning tree of 1 - |n_i . n_j|.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .faces import vertex_normals
from .graph import NearestNeighbors, NeighborGraph
from .inputs import (
    FloatArray,
    InputError,
    IntArray,
    as_choice,
    as_faces,
    as_normals,
    as_points,
)

MODES = (
    "auto",
    "propagate",
    "viewpoint",
    "outward",
    "faces",
    "reference",
    "none",
)

# Neighbors in the graph along which signs spread.
_NEIGHBORS = 10


@dataclass(frozen=True)
class Orientation:
    """Signs of normals, and how they were found.

    Attributes
    ----------
    signs : (n,) int8, +1 or -1
    mode : str
        What "auto" became.
    pieces : int
        Connected pieces that were oriented each on its own.
    """

    signs: IntArray
    mode: str
    pieces: int


def orient_normals(
    points: ArrayLike,
    normals: ArrayLike,
    *,
    mode: str = "auto",
    faces: ArrayLike | None = None,
    viewpoint: ArrayLike | None = None,
    reference: ArrayLike | None = None,
    graph: NeighborGraph | None = None,
) -> FloatArray:
    """Turn normals to consistent sides.

    Parameters
    ----------
    points, normals : (n, 3) array_like of float
        Rows of `normals` that are zero stay zero and are left out.
    mode : "auto" | "propagate" | "viewpoint" | "outward" | "faces" | "reference" |
            "none"
        "auto": "faces" where there are faces, else "propagate".
        "propagate": along a minimum spanning tree of the neighbor graph [1], each
        piece turned so that its outermost points look out.
        "viewpoint": toward a point. "outward": away from the center of each piece.
        "faces": to the side on which the faces wind counterclockwise.
        "reference": to the side of given normals. "none": as they are.
    faces : (m, 3) array_like of int, optional
    viewpoint : (3,) or (n, 3) array_like of float, optional
        One point for all, or one for each (a sensor's path).
    reference : (n, 3) array_like of float, optional
    graph : NeighborGraph, optional
        Where signs may spread; by default the ten nearest neighbors.

    Returns
    -------
    (n, 3) float64

    Raises
    ------
    InputError
        When an array has the wrong shape or what the mode needs is missing.
    """
    points = as_points(points)
    normals = as_normals(normals, len(points))
    orientation = find_orientation(
        points,
        normals,
        mode=mode,
        faces=as_faces(faces, len(points)),
        viewpoint=viewpoint,
        reference=reference,
        graph=graph,
    )
    return normals * orientation.signs[:, None]


def find_orientation(
    points: FloatArray,
    normals: FloatArray,
    *,
    mode: str,
    faces: IntArray | None = None,
    viewpoint: ArrayLike | None = None,
    reference: ArrayLike | None = None,
    graph: NeighborGraph | None = None,
) -> Orientation:
    """Return the Orientation of checked arrays; see `orient_normals`."""
    as_choice(mode, MODES, name="orientation")
    if mode == "auto":
        mode = "propagate" if faces is None else "faces"
    if mode == "none":
        return Orientation(np.ones(len(points), dtype=np.int8), mode, 0)
    if mode == "viewpoint":
        return Orientation(_toward(points, normals, viewpoint), mode, 0)
    if mode == "reference":
        if reference is None:
            raise InputError('expected reference normals for orientation "reference"')
        reference = as_normals(reference, len(points), name="reference normals")
        return Orientation(_agreeing(normals, reference), mode, 0)
    if mode == "faces":
        if faces is None:
            raise InputError('expected faces for orientation "faces", got none')
        return _by_faces(points, normals, faces)
    if graph is None:
        graph = NeighborGraph.nearest(points, _NEIGHBORS)
    labels = _pieces(graph, normals)
    if mode == "propagate":
        signs = _propagated(graph, normals)
        signs = signs * _looking_out(points, normals * signs[:, None], labels)[labels]
    else:
        signs = _agreeing(normals, points - _centers(points, labels)[labels])
    pieces = len(np.unique(labels[(normals != 0).any(axis=1)]))
    return Orientation(signs.astype(np.int8), mode, pieces)


def _agreeing(normals, directions):
    """Return the signs that turn normals to the side of the directions, (n,) int8."""
    return np.where((normals * directions).sum(axis=1) < 0, -1, 1).astype(np.int8)


def _toward(points, normals, viewpoint):
    if viewpoint is None:
        raise InputError('expected a viewpoint for orientation "viewpoint", got none')
    viewpoint = np.asarray(viewpoint, dtype=np.float64)
    if viewpoint.shape not in ((3,), points.shape) or not np.isfinite(viewpoint).all():
        raise InputError(
            f"expected a finite viewpoint of shape (3,) or {points.shape}, "
            f"got {viewpoint.shape}"
        )
    return _agreeing(normals, viewpoint - points)


def _by_faces(points, normals, faces):
    """Agree with the faces; loose vertices agree with the nearest that has one."""
    guide = vertex_normals(points, faces, weights="angle")
    has_face = (guide != 0).any(axis=1)
    if has_face.any() and not has_face.all():
        guided = np.flatnonzero(has_face)
        _, at = NearestNeighbors(points[guided]).tree.query(points[~has_face])
        guide[~has_face] = guide[guided[at]]
    return Orientation(_agreeing(normals, guide), "faces", 0)


def _pieces(graph, normals):
    """Return the connected piece of each point, (n,) int, apart from invalid ones."""
    from scipy.sparse.csgraph import connected_components

    return connected_components(_between_valid(graph, normals), directed=False)[1]


def _between_valid(graph, normals):
    """Return the (n, n) matrix of [1]'s edge weights between valid points."""
    from scipy import sparse

    edges = graph.edges
    valid = (normals != 0).any(axis=1)
    edges = edges[valid[edges].all(axis=1)]
    a, b = edges.T
    tilt = 1 - np.abs((normals[a] * normals[b]).sum(axis=1))
    # A stored zero would be no edge at all to scipy.
    weight = np.maximum(tilt, 0) + 1e-12
    return sparse.coo_matrix((weight, (a, b)), shape=(len(normals),) * 2).tocsr()


def _propagated(graph, normals):
    """Spread signs along a minimum spanning tree [1], (n,) int8.

    Every point first knows its sign relative to its parent; jumping from parent to
    grandparent and on, it knows it relative to the root after log2(depth) rounds.
    """
    from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

    tree = minimum_spanning_tree(_between_valid(graph, normals))
    count, labels = connected_components(tree, directed=False)
    # One tree for all pieces: a root beside the points, joined to one of each.
    _, firsts = np.unique(labels, return_index=True)
    parent = _parents(tree, firsts, count)
    here = np.arange(len(normals))
    dot = (normals * normals[parent]).sum(axis=1)
    sign = np.where((dot < 0) & (parent != here), -1, 1).astype(np.int8)
    while (parent[parent] != parent).any():
        sign = sign * sign[parent]
        parent = parent[parent]
    return sign


def _parents(tree, firsts, pieces):
    """Return each point's parent in a forest; the roots `firsts` are their own."""
    from scipy import sparse
    from scipy.sparse.csgraph import breadth_first_order

    n = tree.shape[0]
    joined = sparse.bmat(
        [
            [tree, None],
            [
                sparse.coo_matrix(
                    (np.ones(pieces), (np.zeros(pieces, dtype=int), firsts)),
                    shape=(1, n),
                ),
                sparse.coo_matrix((1, 1)),
            ],
        ]
    ).tocsr()
    _, parent = breadth_first_order(joined, n, directed=False, return_predecessors=True)
    parent = parent[:n].astype(np.int64)
    parent[firsts] = firsts
    return parent


def _centers(points, labels):
    """Return the mean point of each piece, (pieces, 3)."""
    size = np.bincount(labels)
    sums = [np.bincount(labels, points[:, axis]) for axis in range(3)]
    return np.stack(sums, axis=1) / size[:, None]


def _looking_out(points, normals, labels):
    """Return the sign for each piece that makes its outermost points look out.

    In each of many directions the farthest point of a closed surface has the
    direction itself as its normal: the pieces take the sign that most of these
    points, weighted by how clearly they say so, ask for.
    """
    order = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[order], np.arange(labels.max() + 1))
    votes = np.zeros(len(starts))
    for direction in _directions():
        height = points[order] @ direction
        top = np.maximum.reduceat(height, starts)
        at_top = height == top[labels[order]]
        facing = normals[order] @ direction
        votes += np.add.reduceat(np.where(at_top, facing, 0), starts)
    return np.where(votes < 0, -1, 1)


def _directions():
    """Return 26 directions: to the faces, edges and corners of a cube, (26, 3)."""
    steps = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1)
    steps = steps.reshape(-1, 3)[np.arange(27) != 13]
    return steps / np.linalg.norm(steps, axis=1, keepdims=True)
