# SPDX-License-Identifier: GPL-3.0-or-later
"""Custom normals of meshes: where edges part them, and how they are written."""

import zlib
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ...core.mesh.faces import split_fans, unit
from . import arrays
from .arrays import BACKUP, CUSTOM_NORMAL, KINDS, Array, Kind

# Marks the edges that were made sharp for normals in tangent space.
_SHARPENED = ".timescale_sharp"
# What is made for a moment.
_WORK = "Time-Scale Work"
# Where Blender keeps what edges and faces are marked with.
_MARKS = ("sharp_edge", "sharp_face", "uv_seam", "material_index")


@dataclass(frozen=True)
class Fans:
    """A mesh parted along edges; see `faces.split_fans`.

    Attributes
    ----------
    corner : (c,) int
        The fan of each corner of a face.
    vertex : (f,) int
        The vertex of each fan; the first fans are those of the vertices in order.
    faces : (m, 3) int
        Triangles of fans.
    edges : (e,) bool
        Which edges of the mesh part it.
    """

    corner: Array
    vertex: Array
    faces: Array
    edges: Array


# Reading


def read_fans(mesh: Any, split: Collection[str]) -> Fans | None:
    """Return how a mesh falls apart at its marks; None where it does not.

    Parameters
    ----------
    split : some of "sharp", "seams", "materials"
    """
    edges = marked_edges(mesh, split)
    if not edges.any():
        return None
    ends = arrays.get(mesh.edges, Kind("vertices", np.int32, 2))[edges]
    triangles, vertices = arrays.triangles(mesh), arrays.corner_vertices(mesh)
    faces, vertex = split_fans(len(mesh.vertices), vertices[triangles], ends)
    corner = np.empty(len(vertices), dtype=faces.dtype)
    corner[triangles] = faces
    return Fans(corner, vertex, faces, edges)


def marked_edges(mesh: Any, split: Collection[str]) -> Array:
    """Return which edges of a mesh part it at its marks, (e,) bool."""
    marked: Array = np.zeros(len(mesh.edges), dtype=np.bool_)
    if "sharp" in split:
        marked |= _sharp_edges(mesh) & ~_sharpened(mesh)
        flat = _flags(mesh, "sharp_face", "FACE")
        # All flat is what meshes start with, and no choice of anyone's.
        if flat.any() and not flat.all():
            marked[_edge_of_corner(mesh)[flat[_face_of_corner(mesh)]]] = True
    if "seams" in split:
        marked |= _flags(mesh, "uv_seam")
    if "materials" in split and len(mesh.materials) > 1:
        material = arrays.get(mesh.polygons, Kind("material_index", np.int32, 1))
        marked |= _borders(mesh, material)
    return marked


def read_marks(mesh: Any) -> int:
    """Return a number that differs when edges or faces are marked otherwise."""
    total = 0
    for name in _MARKS:
        if name in mesh.attributes:
            attribute = mesh.attributes[name]
            values = arrays.get(attribute.data, KINDS[attribute.data_type])
            total = zlib.crc32(values.tobytes(), total)
    return total


def _borders(mesh: Any, values: Array) -> Array:
    """Return which edges have faces of different values, (e,) bool."""
    edge, here = _edge_of_corner(mesh), values[_face_of_corner(mesh)]
    one = np.zeros(len(mesh.edges), dtype=values.dtype)
    one[edge] = here
    border: Array = np.zeros(len(mesh.edges), dtype=np.bool_)
    border[edge[one[edge] != here]] = True
    return border


def _edge_of_corner(mesh: Any) -> Array:
    return arrays.read(mesh, ".corner_edge", "INT", domain="CORNER")


def _face_of_corner(mesh: Any) -> Array:
    sizes = arrays.get(mesh.polygons, Kind("loop_total", np.int32, 1))
    return np.repeat(np.arange(len(sizes)), sizes)


def _sharp_edges(mesh: Any) -> Array:
    return _flags(mesh, "sharp_edge")


def _sharpened(mesh: Any) -> Array:
    return _flags(mesh, _SHARPENED)


def _flags(mesh: Any, name: str, domain: str = "EDGE") -> Array:
    # Blender leaves the attribute out where nothing is marked.
    if name not in mesh.attributes:
        count = mesh.attributes.domain_size(domain)
        return np.zeros(count, dtype=np.bool_)
    return arrays.read(mesh, name, "BOOLEAN", domain=domain)


def has_free(mesh: Any) -> bool:
    """Whether the mesh has custom normals that are plain vectors."""
    attribute = mesh.attributes.get(CUSTOM_NORMAL)
    return attribute is not None and attribute.data_type == "FLOAT_VECTOR"


# Mixing


def mixed(before: Array, normals: Array, share: Array) -> Array:
    """Mix normals into those from before.

    Parameters
    ----------
    before, normals : (n, 3) float
    share : (n,) float
        Of the new ones, 0 to 1.
    """
    share = share[:, None]
    result = unit(share * normals + (1 - share) * before)
    return np.where(share > 0, np.where(share < 1, result, normals), before)


# Writing, when what was there is set aside


def write_vertices(
    mesh: Any, normals: Array, kept: Array, storage: str, before: Array | None
) -> None:
    """Write normals (n, 3) of vertices, but for corners kept, (c,) bool.

    Parameters
    ----------
    before : (c, 3) float or None
        The normals of the corners; None where none is kept.
    """
    if storage == "tangent_space":
        _write_vertices_in_tangent_space(mesh, normals, kept)
    elif before is None:
        arrays.write(mesh, CUSTOM_NORMAL, "FLOAT_VECTOR", normals)
    else:
        # The corners of a kept vertex may differ, as on a cube.
        corners = normals[arrays.corner_vertices(mesh)]
        shown = np.where(kept[:, None], before, corners)
        arrays.write(mesh, CUSTOM_NORMAL, "FLOAT_VECTOR", shown, domain="CORNER")


def _write_vertices_in_tangent_space(mesh: Any, normals: Array, kept: Array) -> None:
    """Write normals of vertices; zeros stand for what Blender computes itself."""
    bits, _ = in_tangent_space(mesh, normals, "POINT")
    arrays.write(mesh, CUSTOM_NORMAL, "INT16_2D", bits, domain="CORNER")
    if kept.any():
        _keep_bits(mesh, kept)


def write_corners(
    mesh: Any, normals: Array, kept: Array, storage: str, edges: Array | None
) -> None:
    """Write normals (c, 3) of corners.

    Parameters
    ----------
    kept : (c,) bool
        Corners whose normals are those from before.
    edges : (e,) bool or None
        Where the mesh is parted.
    """
    if storage == "free":
        arrays.write(mesh, CUSTOM_NORMAL, "FLOAT_VECTOR", normals, domain="CORNER")
        return
    there, sharp = "sharp_edge" in mesh.attributes, _sharp_edges(mesh)
    if edges is not None:
        # Corners that no sharp edge separates share a tangent space and a normal.
        _write_flags(mesh, "sharp_edge", sharp | edges)
    # Blender sharpens more where corners differ.
    bits, after = in_tangent_space(mesh, normals, "CORNER")
    arrays.write(mesh, CUSTOM_NORMAL, "INT16_2D", bits, domain="CORNER")
    made = after & ~sharp
    if made.any():
        _write_flags(mesh, "sharp_edge", after)
        _write_flags(mesh, _SHARPENED, made)
        mesh.timescale_normals.had_sharp_edges = there
    touched = np.zeros(len(mesh.vertices), dtype=np.bool_)
    touched[arrays.get(mesh.edges, Kind("vertices", np.int32, 2))[made]] = True
    _keep_bits(mesh, kept & ~touched[arrays.corner_vertices(mesh)])


def soften(mesh: Any) -> None:
    """Take back the edges that were made sharp."""
    if _SHARPENED not in mesh.attributes:
        return
    sharp = _sharp_edges(mesh) & ~_sharpened(mesh)
    arrays.remove(mesh, _SHARPENED)
    if sharp.any() or mesh.timescale_normals.had_sharp_edges:
        _write_flags(mesh, "sharp_edge", sharp)
    else:
        arrays.remove(mesh, "sharp_edge")


def _write_flags(mesh: Any, name: str, flags: Array) -> None:
    if name in mesh.attributes:
        arrays.put(mesh.attributes[name].data, KINDS["BOOLEAN"], flags)
    else:
        arrays.write(mesh, name, "BOOLEAN", flags, domain="EDGE")


def in_tangent_space(mesh: Any, normals: Array, domain: str) -> tuple[Array, Array]:
    """Return normals as Blender keeps them in tangent space, and the edges for it.

    A node does it, to the bit as the methods of meshes do, which read numbers from
    Python one by one and take several times as long.

    Parameters
    ----------
    normals : (n, 3) or (c, 3) float
    domain : "POINT" | "CORNER"

    Returns
    -------
    bits : (c, 2) int16
    sharp : (e,) bool
        The edges that have to be sharp.
    """
    keys = set(bpy.data.shape_keys.keys())
    copy = mesh.copy()
    obj = bpy.data.objects.new(_WORK, copy)
    scene = bpy.data.scenes.new(_WORK)
    tree = _tangent_space_nodes(domain)
    modifier: Any = obj.modifiers.new(_WORK, "NODES")
    modifier.node_group = tree
    try:
        if copy.shape_keys:
            # The bits are those of the shape without them.
            obj.shape_key_clear()
        arrays.write(copy, _WORK, "FLOAT_VECTOR", normals, domain=domain)
        scene.collection.objects.link(obj)
        layer = scene.view_layers[0]
        with bpy.context.temp_override(scene=scene, view_layer=layer):
            depsgraph = bpy.context.evaluated_depsgraph_get()
            made: Any = obj.evaluated_get(depsgraph).data
            bits = arrays.read(made, CUSTOM_NORMAL, "INT16_2D", domain="CORNER")
            return bits, _sharp_edges(made)
    finally:
        # 4.5 counts a user too many of a key that was copied.
        left = [key for key in bpy.data.shape_keys if key.name not in keys]
        bpy.data.batch_remove([scene, obj, copy, tree, *left])


def _tangent_space_nodes(domain: str) -> Any:
    """Return nodes that make custom normals of an attribute."""
    tree: Any = bpy.data.node_groups.new(_WORK, "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket(
            "Geometry", in_out=direction, socket_type="NodeSocketGeometry"
        )
    nodes, links = tree.nodes, tree.links
    first, last = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput")
    asked = nodes.new("GeometryNodeInputNamedAttribute")
    asked.data_type = "FLOAT_VECTOR"
    asked.inputs["Name"].default_value = _WORK
    custom = nodes.new("GeometryNodeSetMeshNormal")
    custom.mode, custom.domain = "TANGENT_SPACE", domain
    links.new(first.outputs[0], custom.inputs["Mesh"])
    links.new(asked.outputs["Attribute"], custom.inputs["Custom Normal"])
    links.new(custom.outputs[0], last.inputs[0])
    return tree


def _keep_bits(mesh: Any, kept: Array) -> None:
    """Bring back what some corners had in tangent space before.

    Tangent spaces depend on shape and sharp edges alone: these bits still fit.
    """
    backup = mesh.attributes.get(BACKUP + CUSTOM_NORMAL)
    if backup is not None and backup.data_type != "INT16_2D":
        return
    kind = KINDS["INT16_2D"]
    values = arrays.get(mesh.attributes[CUSTOM_NORMAL].data, kind)
    # Zeros stand for what Blender computes itself.
    values[kept] = 0 if backup is None else arrays.get(backup.data, kind)[kept]
    arrays.put(mesh.attributes[CUSTOM_NORMAL].data, kind, values)


# Turning over


def turn(mesh: Any, shown: Array, turned: Array) -> None:
    """Turn over the normals of some vertices, in the form that they are kept in.

    Parameters
    ----------
    shown : (c, 3) float
        The normals of the corners.
    turned : (n,) bool
    """
    there = mesh.attributes.get(CUSTOM_NORMAL)
    kept = there or mesh.attributes.get(BACKUP + CUSTOM_NORMAL)
    free = kept is None or kept.data_type == "FLOAT_VECTOR"
    if free and there is not None and there.domain == "POINT":
        vectors = arrays.get(there.data, KINDS["FLOAT_VECTOR"])
        arrays.put(there.data, KINDS["FLOAT_VECTOR"], _turned(vectors, turned))
        return
    shown = _turned(shown, turned[arrays.corner_vertices(mesh)])
    if free:
        arrays.remove(mesh, CUSTOM_NORMAL)
        arrays.write(mesh, CUSTOM_NORMAL, "FLOAT_VECTOR", shown, domain="CORNER")
        return
    earlier, had = _sharpened(mesh), mesh.timescale_normals.had_sharp_edges
    nothing = np.zeros(len(shown), dtype=np.bool_)
    write_corners(mesh, shown, nothing, "tangent_space", None)
    if earlier.any():
        _write_flags(mesh, _SHARPENED, earlier | _sharpened(mesh))
        mesh.timescale_normals.had_sharp_edges = had


def _turned(vectors: Array, which: Array) -> Array:
    return np.where(which[:, None], -vectors, vectors)
