# SPDX-License-Identifier: GPL-3.0-or-later
"""The shape of an object: points and faces in the world, and where edges part it."""

import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import bpy
import numpy as np
from bpy.types import Object
from mathutils.bvhtree import BVHTree

from ...core.mesh.faces import unit
from . import arrays, custom_normals, polygons
from .arrays import Array, Kind, ObjectError
from .geometry import Geometry, Surface, times
from .objects import TYPES, data_of, is_cloud

# The modifier that shows the colors, which is ours and shapes nothing.
DRESS = "Time-Scale Colors"
# Modifiers that move points after the normals are set.
_DEFORMERS = frozenset(
    {
        "ARMATURE",
        "CAST",
        "CLOTH",
        "CORRECTIVE_SMOOTH",
        "CURVE",
        "DISPLACE",
        "HOOK",
        "LAPLACIANDEFORM",
        "LAPLACIANSMOOTH",
        "LATTICE",
        "MESH_CACHE",
        "MESH_DEFORM",
        "MESH_SEQUENCE_CACHE",
        "SHRINKWRAP",
        "SIMPLE_DEFORM",
        "SMOOTH",
        "SOFT_BODY",
        "SURFACE_DEFORM",
        "WARP",
        "WAVE",
    }
)


def fingerprint(obj: Object) -> tuple[int, ...]:
    """Return numbers that differ when an object has another shape or other marks."""
    data = data_of(obj)
    count = data.attributes.domain_size("POINT")
    if not count:
        return (0,)
    points = zlib.crc32(read_points(obj).tobytes())
    if is_cloud(obj):
        return count, points
    marks = custom_normals.read_marks(data)
    return count, points, zlib.crc32(arrays.corner_vertices(data).tobytes()), marks


def read_points(obj: Object) -> Array:
    """Return the points in the object's own space, (n, 3) float32."""
    return arrays.read(data_of(obj), "position", "FLOAT_VECTOR")


def place_of_point(obj: Object, row: int) -> list[float]:
    """Return where a point is in the world."""
    at = data_of(obj).attributes["position"].data[row].vector
    return list(obj.matrix_world @ at)


def read_geometry(obj: Object, *, evaluated: bool = False) -> Geometry:
    """Return the object's shape in the world.

    Parameters
    ----------
    evaluated : bool
        Take the shape after shape keys and modifiers, which must keep the points.

    Raises
    ------
    ObjectError
        When there are no points, the object is scaled flat or modifiers change the
        number of points.
    """
    count = data_of(obj).attributes.domain_size("POINT")
    if not count:
        # Without points 5.x has no attribute "position" either.
        raise ObjectError(f"its {TYPES[obj.type]} has no points")
    with shape_of(obj, evaluated) as data:
        found = data.attributes.domain_size("POINT")
        if found != count:
            raise ObjectError(
                f"its modifiers make {found:,} points of {count:,}; "
                f"apply them first or turn After Modifiers off"
            )
        points = arrays.read(data, "position", "FLOAT_VECTOR").astype(np.float64)
        faces = None
        if not is_cloud(obj):
            faces = arrays.corner_vertices(data)[arrays.triangles(data)]
    matrix = np.array(obj.matrix_world)
    axes = matrix[:3, :3]
    side = np.sign(np.linalg.det(axes))
    if side == 0 or not np.isfinite(matrix).all():
        raise ObjectError("its scale is zero along an axis; give it another one")
    # The core refuses coordinates that are not finite, and says how many.
    with np.errstate(invalid="ignore"):
        points = times(points, axes.T) + matrix[:3, 3]
    if faces is not None and side < 0:
        # Mirrored, the triangles wind the other way around.
        faces = faces[:, ::-1]
    return Geometry(points, faces, axes)


def read_fans(
    obj: Object, split: Collection[str], *, evaluated: bool = False
) -> custom_normals.Fans | None:
    """Return how an object's faces fall apart at marked edges; None where they do not.

    Parameters
    ----------
    split : some of "sharp", "seams", "materials"
    evaluated : bool
        Take the marks after modifiers, where these keep the corners.
    """
    if is_cloud(obj):
        return None
    kept = arrays.corner_vertices(data_of(obj))
    with shape_of(obj, evaluated) as shown:
        same = np.array_equal(arrays.corner_vertices(shown), kept)
        fans = custom_normals.read_fans(shown if same else data_of(obj), split)
    if fans is not None and np.linalg.det(np.array(obj.matrix_world)[:3, :3]) < 0:
        fans = replace(fans, faces=fans.faces[:, ::-1])
    return fans


def read_faces(obj: Object, split: Collection[str]) -> polygons.Faces:
    """Return how an object's triangles belong to its faces, parted at marked edges.

    The triangles are those of `read_geometry`, in their order.
    """
    mirrored = np.linalg.det(np.array(obj.matrix_world)[:3, :3]) < 0
    return polygons.read(data_of(obj), split, mirrored=bool(mirrored))


def read_surface(obj: Object) -> Surface:
    """Return the faces of a mesh, after its modifiers, as a source of true normals.

    Raises
    ------
    ObjectError
        When there are no faces.
    """
    if obj.type != "MESH":
        raise ObjectError(f'"{obj.name}" has no faces to take true normals from')
    with shape_of(obj, True) as mesh:
        if not mesh.polygons:
            raise ObjectError(f'"{obj.name}" has no faces to take true normals from')
        mesh.calc_loop_triangles()
        points = arrays.read(mesh, "position", "FLOAT_VECTOR").astype(np.float64)
        triangles = arrays.get(mesh.loop_triangles, Kind("vertices", np.int32, 3))
        loops = arrays.get(mesh.loop_triangles, Kind("loops", np.int32, 3))
        normals = arrays.corner_normals(mesh)[loops].astype(np.float64)
    matrix = np.array(obj.matrix_world)
    points = times(points, matrix[:3, :3].T)
    center = points.mean(axis=0)
    points -= center
    normals = unit((normals @ np.linalg.inv(matrix[:3, :3])).reshape(-1, 3))
    return Surface(
        BVHTree.FromPolygons(points.tolist(), triangles.tolist()),
        center + matrix[:3, 3],
        points[triangles],
        normals.reshape(-1, 3, 3),
    )


def deforms(obj: Object) -> bool:
    """Whether a user of the mesh moves its points after the normals are set."""
    mesh = data_of(obj)
    users = [obj]
    if mesh.users > 1:
        users = [user for user in bpy.data.objects if user.data == mesh]
    return bool(mesh.shape_keys) or any(
        user.parent_type in {"ARMATURE", "LATTICE"}
        or any(modifier.type in _DEFORMERS for modifier in user.modifiers)
        for user in users
    )


@contextmanager
def shape_of(obj: Object, evaluated: bool) -> Iterator[Any]:
    """Yield the data of an object, as it is kept or after its modifiers but ours."""
    if not evaluated:
        yield data_of(obj)
        return
    dress: Any = obj.modifiers.get(DRESS)
    shown = dress is not None and dress.show_viewport
    if shown:
        dress.show_viewport = False
    try:
        yield data_of(obj.evaluated_get(bpy.context.evaluated_depsgraph_get()))
    finally:
        if shown:
            dress.show_viewport = True
