# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces of meshes: their triangles, the edges between them, and turning them over."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import bmesh
import numpy as np

from . import arrays, custom_normals
from .arrays import Array, Kind


@dataclass(frozen=True)
class Faces:
    """How the triangles of a mesh belong to its faces, corners and edges.

    Attributes
    ----------
    triangles : (m, 3) int
        The corner of a face that each corner of a triangle is.
    face : (m,) int
        The face of each triangle.
    vertices : (c,) int
        The vertex of each corner.
    ends : (e, 2) int
        The vertices of the edges, the smaller index first.
    marked : (e,) bool
        Which edges part the mesh.
    """

    triangles: Array
    face: Array
    vertices: Array
    ends: Array
    marked: Array

    @property
    def parting(self) -> Array:
        """The vertices (k, 2) of the edges that part the mesh."""
        return self.ends[self.marked]

    def edges_among(self, pairs: Array) -> Array:
        """Return which edges (e,) bool are among pairs (k, 2) of vertices."""
        size = len(self.vertices) + 1 + int(self.ends.max(initial=0))
        pairs = np.sort(pairs, axis=1).astype(np.int64)
        keys = self.ends.astype(np.int64) @ [size, 1]
        return np.isin(keys, pairs @ [size, 1])

    def at_corners(self, values: Array) -> Array:
        """Return values of the corners of triangles, (m, 3, 3), at those of faces."""
        result = np.zeros((len(self.vertices), 3))
        result[self.triangles.ravel()] = values.reshape(-1, 3)
        return result

    def faces_of(self, triangles: Array) -> Array:
        """Return which faces (f,) bool have most of their triangles among some."""
        total = np.bincount(self.face)
        some = np.bincount(self.face, triangles, minlength=len(total))
        return 2 * some > total


def read(mesh: Any, split: Collection[str], *, mirrored: bool) -> Faces:
    """Return the Faces of a mesh, parted at its marks.

    Parameters
    ----------
    split : some of "sharp", "seams", "materials"
    mirrored : bool
        Whether triangles wind the other way around in the world.
    """
    triangles = arrays.triangles(mesh)
    if len(triangles) == len(mesh.polygons):
        face = np.arange(len(triangles))
    else:
        face = arrays.get(mesh.loop_triangles, Kind("polygon_index", np.int32, 1))
    ends = arrays.get(mesh.edges, Kind("vertices", np.int32, 2))
    return Faces(
        triangles[:, ::-1] if mirrored else triangles,
        face,
        arrays.corner_vertices(mesh),
        np.sort(ends, axis=1),
        custom_normals.marked_edges(mesh, split),
    )


def turn_over(mesh: Any, which: Array) -> Array:
    """Turn some faces, (f,) bool, over.

    Returns
    -------
    (c,) int
        For each corner, which it was before.
    """
    before = _order(mesh)
    edited = bmesh.new()
    try:
        edited.from_mesh(mesh)
        edited.faces.ensure_lookup_table()
        faces: Any = edited.faces
        chosen = [faces[index] for index in np.flatnonzero(which).tolist()]
        bmesh.ops.reverse_faces(edited, faces=chosen)
        edited.to_mesh(mesh)
    finally:
        edited.free()
    was = np.empty(len(before), dtype=np.int64)
    was[_order(mesh)] = before
    return was


def _order(mesh: Any) -> Array:
    """Return the corners face by face, in each by their vertices, (c,) int."""
    sizes = arrays.get(mesh.polygons, Kind("loop_total", np.int32, 1))
    face = np.repeat(np.arange(len(sizes)), sizes)
    return np.lexsort((arrays.corner_vertices(mesh), face))
