# SPDX-License-Identifier: GPL-3.0-or-later
"""New objects, meshes and curves of arrays: the bridge where nothing is there yet."""

from collections.abc import Iterable, Mapping
from typing import Any

import bpy
import numpy as np
from bpy.types import Context, Mesh, Object

from . import arrays
from .arrays import KINDS, Array
from .results import COLOR


def add_points(
    context: Context,
    name: str,
    points: Array,
    attributes: Mapping[str, Array],
    *,
    cloud: bool,
) -> Object:
    """Add points with vector attributes at the 3D cursor, selected and active.

    Parameters
    ----------
    points : (n, 3) float
    attributes : name to (n, 3) float
    cloud : bool
        A point cloud, whose points have a size; else vertices of a mesh.
    """
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(points))
    position: Any = mesh.attributes["position"]
    arrays.put(position.data, KINDS["FLOAT_VECTOR"], points)
    for attribute, values in attributes.items():
        arrays.write(mesh, attribute, "FLOAT_VECTOR", values)
    obj: Any = bpy.data.objects.new(name, mesh)
    context.collection.objects.link(obj)
    for other in context.selected_objects:
        other.select_set(False)
    obj.select_set(True)
    context.view_layer.objects.active = obj
    if cloud:
        # The one way that all versions have.
        bpy.ops.object.convert(target="POINTCLOUD")
        obj = context.view_layer.objects.active
        obj.data.name = name
        if not mesh.users:
            bpy.data.meshes.remove(mesh)
        arrays.remove(obj.data, "radius")
        size = np.full(len(points), point_radius(points))
        arrays.write(obj.data, "radius", "FLOAT", size)
    obj.location = context.scene.cursor.location
    return obj


def point_radius(points: Array) -> float:
    """Return a size at which points on a surface nearly touch."""
    return 0.3 * float(np.linalg.norm(np.ptp(points, axis=0)) / np.sqrt(len(points)))


def new_sheet(points: Array) -> Mesh:
    """Return a smooth mesh over a grid of points (n1, n2, 3)."""
    n1, n2 = points.shape[:2]
    number = np.arange(n1 * n2).reshape(n1, n2)
    corners = (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    faces = np.stack(corners, axis=-1).reshape(-1, 4)
    mesh = bpy.data.meshes.new("Sheet")
    mesh.from_pydata(points.reshape(-1, 3).tolist(), [], faces.tolist())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(faces), np.bool_))
    return mesh


def new_disc(name: str) -> Mesh:
    """Return a mesh of one hexagon in z = 0, at a radius of 1, with our colors."""
    turn = np.arange(6) * np.pi / 3
    points = np.stack([np.cos(turn), np.sin(turn), np.zeros(6)], axis=1)
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points.tolist(), [], [list(range(6))])
    mesh.attributes.new(COLOR, "FLOAT_COLOR", "POINT")
    mesh.attributes.active_color_name = COLOR
    return mesh


def new_dots(points: Array, radius: float) -> Mesh:
    """Return a mesh with an octahedron at each of the points (n, 3)."""
    ends = np.concatenate([np.eye(3), -np.eye(3)]) * radius
    faces = np.array(
        [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2)]
        + [(1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)]
    )
    places = (points[:, None] + ends).reshape(-1, 3)
    first = len(ends) * np.arange(len(points))[:, None, None]
    mesh = bpy.data.meshes.new("Dots")
    mesh.from_pydata(places.tolist(), [], (first + faces).reshape(-1, 3).tolist())
    return mesh


def new_lines(lines: Iterable[Array], radius: float) -> Any:
    """Return a curve of round lines, each along points (n, 3)."""
    curve: Any = bpy.data.curves.new("Lines", "CURVE")
    curve.dimensions = "3D"
    curve.bevel_depth = radius
    curve.bevel_resolution = 2
    curve.use_fill_caps = True
    for points in lines:
        spline = curve.splines.new("POLY")
        spline.points.add(len(points) - 1)
        rows = np.concatenate([points, np.ones((len(points), 1))], axis=1)
        spline.points.foreach_set("co", rows.astype(np.float32).ravel())
    return curve
