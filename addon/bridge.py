# SPDX-License-Identifier: GPL-3.0-or-later
"""The one door to Blender's memory: objects to arrays, arrays to attributes.

Behind it are `arrays`, the hinge, `custom_normals` and `polygons`, which nobody else
uses; `geometry` is what it hands out, `making` what it makes anew.

Results are attributes under the names in RESULTS and, on meshes with faces, custom
normals. What was there under these names before is kept on the data itself, renamed,
and comes back with `clear_results`: renaming is exact for every type, and backups that
are attributes follow edits, copies, files and undo as the data does.
"""

import json
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar, cast

import bmesh
import bpy
import numpy as np
from bpy.types import Context, Mesh, Object, PointCloud
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from ..core.faces import fan_means, unit
from ..core.inputs import as_normals
from . import arrays, custom_normals, polygons
from .arrays import (
    BACKUP,
    CUSTOM_NORMAL,
    KINDS,
    Array,
    Data,
    Kind,
    ObjectError,
)
from .geometry import Corners as Corners
from .geometry import Geometry as Geometry
from .geometry import Surface as Surface
from .geometry import times

TYPES = {"MESH": "mesh", "POINTCLOUD": "point cloud"}


# What the operators leave, one value a point.
RESULTS = {
    "ts_normal": "FLOAT_VECTOR",
    "ts_valid": "BOOLEAN",
    "ts_side_confidence": "FLOAT",
    "ts_confidence": "FLOAT",
    "ts_scale": "FLOAT",
    "delaunay_normal": "FLOAT_VECTOR",
    "ts_error": "FLOAT",
    "delaunay_error": "FLOAT",
    "ts_angle": "FLOAT",
    "delaunay_angle": "FLOAT",
    "ts_error_color": "FLOAT_COLOR",
    "delaunay_error_color": "FLOAT_COLOR",
}
COLOR = "ts_error_color"
# Colors of the baseline, while both are shown side by side.
COLOR_BESIDE = "delaunay_error_color"
# The modifier that shows the colors, which is ours and shapes nothing.
DRESS = "Time-Scale Colors"

# The number of each point marks data as ours, and shows whether points came or went
# since. The leading dot hides an attribute from menus and exporters.
_MARK = ".timescale_points"
# Marks objects that were put beside others.
_BESIDE = "timescale_beside"

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

Item = TypeVar("Item")


# Objects


def find_object(uid: int) -> Object:
    """Return the object with a session_uid, which undo and renaming leave alone.

    Raises
    ------
    ObjectError
        When there is none any more.
    """
    for obj in bpy.data.objects:
        if obj.session_uid == uid:
            return obj
    raise ObjectError("it was removed before its results could be written")


def fingerprint(obj: Object) -> tuple[int, ...]:
    """Return numbers that differ when an object has another shape or other marks."""
    data = _data(obj)
    count = data.attributes.domain_size("POINT")
    if not count:
        return (0,)
    points = zlib.crc32(read_points(obj).tobytes())
    if is_cloud(obj):
        return count, points
    marks = custom_normals.read_marks(data)
    return count, points, zlib.crc32(arrays.corner_vertices(data).tobytes()), marks


def active_vertex(obj: Object) -> int | None:
    """Return the active vertex of a mesh in Edit Mode; None where there is none."""
    if obj.type != "MESH" or obj.mode != "EDIT":
        return None
    active = bmesh.from_edit_mesh(_data(obj)).select_history.active
    return active.index if isinstance(active, bmesh.types.BMVert) else None


def in_edit_mode(context: Context) -> bool:
    """Whether the active object is in Edit Mode."""
    active = context.view_layer.objects.active
    return active is not None and active.mode == "EDIT"


def has_targets(context: Context) -> bool:
    """Whether a mesh or point cloud is selected."""
    return any(obj.type in TYPES for obj in chosen(context))


def targets(context: Context) -> list[Object]:
    """Return the selected meshes and point clouds, the active one first.

    Of objects that share their data only the first is returned.
    """
    # A script may have set a scale or location just before.
    context.view_layer.update()
    active = context.view_layer.objects.active
    found: dict[Data, Object] = {}
    for obj in sorted(chosen(context), key=lambda obj: obj != active):
        if obj.type in TYPES:
            found.setdefault(_data(obj), obj)
    return list(found.values())


def shapes_of_scene(context: Context) -> list[Object]:
    """Return all meshes and point clouds of the view layer, by name.

    Of objects that share their data only the first is returned.
    """
    context.view_layer.update()
    found: dict[Data, Object] = {}
    for obj in sorted(context.view_layer.objects, key=lambda obj: obj.name):
        if obj.type in TYPES:
            found.setdefault(_data(obj), obj)
    return list(found.values())


def chosen(context: Context) -> list[Object]:
    """Return the selected objects, and the active one when it is being edited."""
    active = context.view_layer.objects.active
    found = list(context.selected_objects)
    if active and active.mode == "EDIT" and active not in found:
        found.append(active)
    return found


@contextmanager
def object_mode(context: Context) -> Iterator[None]:
    """Leave Edit Mode and the like for the time of the block.

    In these modes attributes have no data, or are kept elsewhere.
    """
    active = context.view_layer.objects.active
    mode = active.mode if active else "OBJECT"
    if mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    try:
        yield
    finally:
        if mode != "OBJECT":
            bpy.ops.object.mode_set(mode=mode)


def with_progress(
    context: Context, items: Iterable[Item]
) -> Iterator[tuple[Item, Callable[[float], None]]]:
    """Yield each item with a callable that shows its share of the whole, 0 to 1."""
    items = list(items)
    manager = context.window_manager
    manager.progress_begin(0, len(items))
    try:
        for index, item in enumerate(items):
            yield item, partial(_show, manager, index)
    finally:
        manager.progress_end()


def _show(manager: Any, done: int, share: float) -> None:
    manager.progress_update(done + share)


def check_writable(obj: Object) -> None:
    """Raise ObjectError when results could not be written to the object's data."""
    data, kind = _data(obj), TYPES[obj.type]
    if not data.is_editable or data.override_library:
        raise ObjectError(
            f"its {kind} belongs to another file; "
            f"use Object > Relations > Make Local > Selected Objects and Data first"
        )
    if obj.mode == "EDIT" or getattr(data, "is_editmode", False):
        raise ObjectError(f"its {kind} is in Edit Mode; leave Edit Mode first")
    taken = obj.vertex_groups.keys() if obj.type == "MESH" else ()
    for name in (*RESULTS, CUSTOM_NORMAL):
        # Blender would call the attribute "name.001".
        if name in taken:
            raise ObjectError(f'its vertex group "{name}" is in the way; rename it')


def is_cloud(obj: Object) -> bool:
    """Whether an object is points alone: a point cloud, or a mesh without faces."""
    data = _data(obj)
    return isinstance(data, PointCloud) or not data.polygons


# Reading


def read_points(obj: Object) -> Array:
    """Return the points in the object's own space, (n, 3) float32."""
    return read_attribute(obj, "position", "FLOAT_VECTOR")


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
    count = _data(obj).attributes.domain_size("POINT")
    if not count:
        # Without points 5.x has no attribute "position" either.
        raise ObjectError(f"its {TYPES[obj.type]} has no points")
    with _shape_of(obj, evaluated) as data:
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
    kept = arrays.corner_vertices(_data(obj))
    with _shape_of(obj, evaluated) as shown:
        same = np.array_equal(arrays.corner_vertices(shown), kept)
        fans = custom_normals.read_fans(shown if same else _data(obj), split)
    if fans is not None and np.linalg.det(np.array(obj.matrix_world)[:3, :3]) < 0:
        fans = replace(fans, faces=fans.faces[:, ::-1])
    return fans


def read_faces(obj: Object, split: Collection[str]) -> polygons.Faces:
    """Return how an object's triangles belong to its faces, parted at marked edges.

    The triangles are those of `read_geometry`, in their order.
    """
    mirrored = np.linalg.det(np.array(obj.matrix_world)[:3, :3]) < 0
    return polygons.read(_data(obj), split, mirrored=bool(mirrored))


def read_corner_normals(obj: Object) -> Array:
    """Return the normals that a mesh is shaded with, (c, 3) float64."""
    return arrays.corner_normals(_data(obj)).astype(np.float64)


def read_surface(obj: Object) -> Surface:
    """Return the faces of a mesh, after its modifiers, as a source of true normals.

    Raises
    ------
    ObjectError
        When there are no faces.
    """
    if obj.type != "MESH":
        raise ObjectError(f'"{obj.name}" has no faces to take true normals from')
    with _shape_of(obj, True) as mesh:
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


def read_weight(obj: Object, region: str, vertex_group: str) -> Array:
    """Return the share of each vertex in a region of a mesh, (n,) float64, 0 to 1.

    Parameters
    ----------
    region : "all" | "selected" | "group"

    Raises
    ------
    ObjectError
        When nothing is selected or there is no such vertex group.
    """
    mesh = _data(obj)
    count = mesh.attributes.domain_size("POINT")
    if region == "all":
        return np.ones(count)
    if isinstance(mesh, PointCloud):
        raise ObjectError("a point cloud has no groups or selection; choose all points")
    if region == "selected":
        # Blender leaves the attribute out where nothing is selected.
        if ".select_vert" not in mesh.attributes:
            raise ObjectError("none of its vertices is selected")
        return arrays.read(mesh, ".select_vert", "BOOLEAN").astype(np.float64)
    if vertex_group not in obj.vertex_groups:
        raise ObjectError(f'it has no vertex group "{vertex_group}"')
    number = obj.vertex_groups[vertex_group].index
    weight = np.zeros(count)
    # Blender gives these weights one vertex at a time.
    for index, vertex in enumerate(mesh.vertices):
        for element in vertex.groups:
            if element.group == number:
                weight[index] = element.weight
    return weight


def read_selected(obj: Object) -> Array:
    """Return which points are selected in Edit Mode, (n,) bool.

    Raises
    ------
    ObjectError
        When none is.
    """
    data = _data(obj)
    name = ".selection" if isinstance(data, PointCloud) else ".select_vert"
    # Blender leaves the attribute out where nothing is selected, or all points are.
    chosen = np.full(data.attributes.domain_size("POINT"), name == ".selection")
    if name in data.attributes:
        chosen = arrays.read(data, name, data.attributes[name].data_type) > 0
    if not chosen.any():
        raise ObjectError("none of its points is selected")
    return chosen


def read_facing(obj: Object, name: str) -> Array:
    """Return the normals that the points of an object show, (n, 3) float64.

    The estimated ones; where there are none, those of an attribute, and of a mesh with
    faces the means of what its corners are shaded with.

    Raises
    ------
    AttributeMismatchError
        When points without faces have no such attribute.
    """
    if has_estimate(obj) or is_cloud(obj):
        return read_normals(obj, _kept_in(obj, name))
    mesh = _data(obj)
    shown = arrays.corner_normals(mesh).astype(np.float64)
    return fan_means(shown, arrays.corner_vertices(mesh), len(mesh.vertices))


def _kept_in(obj: Object, name: str) -> str:
    return "ts_normal" if has_estimate(obj) else name


def read_attribute(obj: Object, name: str, kind: str) -> Array:
    """Return an attribute of the points, (n,) or (n, width).

    Raises
    ------
    AttributeMismatchError
        When there is none of this name, type and domain.
    """
    return arrays.read(_data(obj), name, kind)


def read_normals(obj: Object, name: str) -> Array:
    """Return a vector attribute of the points at length one, (n, 3) float64.

    Raises
    ------
    InputError
        When there is no such attribute, or values in it are not finite.
    """
    vectors = read_attribute(obj, name, "FLOAT_VECTOR")
    return unit(as_normals(vectors, len(vectors), name=f'values in "{name}"'))


def read_normals_before(obj: Object) -> Array:
    """Return the normals that points had before any run, (n, 3) float64.

    Raises
    ------
    ObjectError
        When they had none.
    """
    data = _data(obj)
    ours = BACKUP if _is_ours(data) else ""
    for name in (f"{ours}ts_normal", "normal"):
        if name in data.attributes:
            return read_normals(obj, name)
    raise ObjectError(
        'it has no normals to blend with, neither "ts_normal" nor "normal"; '
        "choose all points and a strength of 1"
    )


def is_split(obj: Object) -> bool:
    """Whether an object's estimate differs on both sides of edges."""
    found = read_summary(obj).get("estimate", {})
    return found.get("normals", 0) > found.get("valid", 0)


def read_places(obj: Object, name: str) -> Array:
    """Return a vector attribute of the points as places of the world, (n, 3) float64.

    Raises
    ------
    InputError
        When there is no such attribute, or values in it are not finite.
    """
    places = read_attribute(obj, name, "FLOAT_VECTOR")
    places = as_normals(places, len(places), name=f'values in "{name}"')
    matrix = np.array(obj.matrix_world)
    return times(places, matrix[:3, :3].T) + matrix[:3, 3]


def read_shaded(obj: Object) -> Array | None:
    """Return the mean of the normals that Blender shades each vertex with, (n, 3).

    Zero at vertices without a face; None for points alone.
    """
    if is_cloud(obj):
        return None
    mesh = _data(obj)
    vertex = arrays.corner_vertices(mesh)
    return fan_means(arrays.corner_normals(mesh), vertex, len(mesh.vertices))


def has_estimate(obj: Object) -> bool:
    """Whether the object holds an estimate of the points it has now."""
    data = _data(obj)
    # The summary is lost where Blender converts a mesh to a point cloud.
    there = "ts_normal" in data.attributes and "estimate" in read_summary(obj)
    return there and _is_ours(data) and not _is_edited(data)


def has_attribute(obj: Object, name: str) -> bool:
    """Whether there is an attribute of this name."""
    return name in _data(obj).attributes


def has_comparison(obj: Object) -> bool:
    """Whether the object holds a comparison; cheap enough for a panel."""
    return obj.type in TYPES and "comparison" in read_summary(obj)


def record_of(obj: Object) -> Any:
    """Return what a run leaves on the object's data beside attributes."""
    return _data(obj).timescale_normals


def color_signature(obj: Object) -> tuple[str, float, str]:
    """Return what differs when an object's colors mean something else."""
    record = record_of(obj)
    return record.color_by, record.color_limit, record.summary


def read_summary(obj: Object | None) -> dict[str, dict[str, Any]]:
    """Return what the last run said about an object; empty where there was none."""
    if obj is None or obj.type not in TYPES:
        return {}
    if not _data(obj).is_property_set("timescale_normals"):
        # Looking at the record would make one.
        return {}
    summary = _data(obj).timescale_normals.summary
    return json.loads(summary) if summary else {}


# Writing


def write_estimate(
    obj: Object,
    normals: Array,
    valid: Array,
    *,
    storage: str,
    weight: Array | None = None,
    before: Array | None = None,
    corners: Corners | None = None,
) -> None:
    """Write normals (n, 3) and valid (n,) of an object in place of earlier results.

    Vertices that are not valid keep the normals they had before any run; in tangent
    space the automatic ones, where they had free ones, which have no such form.

    Parameters
    ----------
    storage : "auto" | "free" | "tangent_space"
        How custom normals of meshes are kept.
    weight : (n,) float, optional
        Share of the new normals, 0 to 1; the rest are those that were there before
        any run. Of meshes this holds for custom normals alone.
    before : (n, 3) float, optional
        What the rest is where there are no faces.
    corners : Corners, optional
        Custom normals where edges part the mesh.
    """
    # Earlier results are not what an invalid vertex should keep.
    clear_results(obj)
    data = _data(obj)
    if is_cloud(obj):
        _claim(data)
        if weight is not None and before is not None:
            normals = custom_normals.mixed(before, normals, weight * valid)
    else:
        if storage == "auto":
            mixed = weight is not None and custom_normals.has_free(data)
            storage = "tangent_space" if _deforms(obj) and not mixed else "free"
        if weight is None and corners is None:
            _write_of_vertices(data, normals, valid, storage)
        else:
            _write_of_corners(data, normals, valid, storage, weight, corners)
    write_results(obj, {"ts_normal": normals, "ts_valid": valid})


def turn_faces(obj: Object, which: Array, corners: Corners) -> Corners:
    """Turn some faces of a mesh, (f,) bool, over; return its corners as they are then.

    Not a part of what `clear_results` brings back.
    """
    was = polygons.turn_over(_data(obj), which)
    return replace(corners, normals=corners.normals[was], valid=corners.valid[was])


def write_preview(obj: Object, colors: Array) -> None:
    """Color the points of a mesh, (n, 4), in place of earlier results."""
    clear_results(obj)
    _claim(_data(obj))
    write_results(obj, {COLOR: colors})


def turn_normals(obj: Object, turned: Array, name: str) -> None:
    """Turn over the normals of some points, (n,) bool, where `read_facing` found them.

    Custom normals of a mesh that had no result are set aside before, as in a run.
    """
    data = _data(obj)
    if has_estimate(obj) or is_cloud(obj):
        name = _kept_in(obj, name)
        vectors = arrays.read(data, name, "FLOAT_VECTOR")
        vectors[turned] *= -1
        arrays.put(data.attributes[name].data, KINDS["FLOAT_VECTOR"], vectors)
    if not is_cloud(obj):
        shown = arrays.corner_normals(data)
        if not _is_ours(data):
            _claim(data)
        custom_normals.turn(data, shown, turned)
    _changed(data)


def write_results(obj: Object, results: Mapping[str, Array | None]) -> None:
    """Write arrays under names in RESULTS; None removes what is there."""
    data = _data(obj)
    for name, values in results.items():
        arrays.remove(data, name)
        if values is not None:
            arrays.write(data, name, RESULTS[name], values)
    if COLOR in results and isinstance(data, Mesh):
        data.attributes.active_color_name = COLOR
    _changed(data)


def write_summary(obj: Object, summary: Mapping[str, dict[str, Any]]) -> None:
    """Keep plain values for the panel, in addition to those there."""
    record = _data(obj).timescale_normals
    record.summary = json.dumps(read_summary(obj) | dict(summary))


def clear_results(obj: Object) -> bool | None:
    """Remove all results and bring back what was there before the first run.

    Returns
    -------
    bool or None
        Whether points came or went in between, so that what was there came back
        for those that remain; None when there was nothing to clear.
    """
    data = _data(obj)
    if not _is_ours(data):
        return None
    edited = _is_edited(data)
    colors = {}
    if isinstance(data, Mesh):
        colors = _colors_before(data)
        custom_normals.soften(data)
    arrays.remove(data, _MARK)
    for name in (*RESULTS, CUSTOM_NORMAL):
        arrays.remove(data, name)
        if BACKUP + name in data.attributes:
            data.attributes[BACKUP + name].name = name
    for use, before in colors.items():
        setattr(data.attributes, use, before if before in data.attributes else "")
    data.property_unset("timescale_normals")
    _changed(data)
    return edited


# Beside each other


def object_beside(obj: Object) -> Object | None:
    """Return the copy of an object that shows its baseline; None where none is."""
    for other in bpy.data.objects:
        if other.type == obj.type and other.data == obj.data and is_beside(other):
            return other
    return None


def is_beside(obj: Object) -> bool:
    """Whether an object is such a copy."""
    return _BESIDE in obj.keys()


def add_beside(obj: Object, step: Array) -> Object:
    """Return a copy of an object that shares its data, moved by a step, (3,) float."""
    made: Object = obj.copy()
    made.name = f"{obj.name} Delaunay"
    made[_BESIDE] = True
    # It is there to be looked at: what is done to it would be done to both.
    made.hide_select = True
    for collection in obj.users_collection:
        collection.objects.link(made)
    made.select_set(False)
    matrix = obj.matrix_world.copy()
    matrix.translation += Vector(step.tolist())
    made.matrix_world = matrix
    return made


def remove_beside(obj: Object) -> None:
    """Remove the copy of an object that shows its baseline, where there is one."""
    other = object_beside(obj)
    if other is not None:
        bpy.data.objects.remove(other)


def bounds(obj: Object) -> Array:
    """Return the corners of a box around an object in the world, (8, 3) float64."""
    matrix = np.array(obj.matrix_world)
    box = np.array([corner[:] for corner in obj.bound_box])
    return box @ matrix[:3, :3].T + matrix[:3, 3]


# Helpers of the above, which work on the data of objects


@contextmanager
def _shape_of(obj: Object, evaluated: bool) -> Iterator[Any]:
    """Yield the data of an object, as it is kept or after its modifiers but ours."""
    if not evaluated:
        yield _data(obj)
        return
    dress: Any = obj.modifiers.get(DRESS)
    shown = dress is not None and dress.show_viewport
    if shown:
        dress.show_viewport = False
    try:
        yield _data(obj.evaluated_get(bpy.context.evaluated_depsgraph_get()))
    finally:
        if shown:
            dress.show_viewport = True


def _data(obj: Object) -> Any:
    """Return the object's Mesh or PointCloud."""
    return obj.data


def _changed(data: Data) -> None:
    """Let Blender forget what it computed from the data."""
    if isinstance(data, Mesh):
        data.update()
    else:
        data.update_tag()


def _is_ours(data: Data) -> bool:
    return _MARK in data.attributes


def _is_edited(data: Data) -> bool:
    """Whether points came, went or changed places since our run."""
    numbers = arrays.read(data, _MARK, "INT")
    return not np.array_equal(numbers, np.arange(len(numbers)))


def _claim(data: Data) -> None:
    """Set aside what has our names, and mark the data as ours."""
    if isinstance(data, Mesh):
        record = cast(Any, data).timescale_normals
        record.active_color = data.attributes.active_color_name or ""
        record.default_color = data.attributes.default_color_name or ""
    for name in (*RESULTS, CUSTOM_NORMAL):
        if name in data.attributes:
            data.attributes[name].name = BACKUP + name
    arrays.write(data, _MARK, "INT", np.arange(data.attributes.domain_size("POINT")))


def _colors_before(mesh: Any) -> dict[str, str]:
    """Return the roles that our colors have on the mesh, and who had them before."""
    record = mesh.timescale_normals
    roles = {
        "active_color_name": record.active_color,
        "default_color_name": record.default_color,
    }
    # Blender gave the role to the backup where it was renamed in it.
    ours = (COLOR, BACKUP + COLOR)
    return {r: name for r, name in roles.items() if getattr(mesh.attributes, r) in ours}


def _deforms(obj: Object) -> bool:
    """Whether a user of the mesh moves its points after the normals are set."""
    mesh = _data(obj)
    users = [obj]
    if mesh.users > 1:
        users = [user for user in bpy.data.objects if user.data == mesh]
    return bool(mesh.shape_keys) or any(
        user.parent_type in {"ARMATURE", "LATTICE"}
        or any(modifier.type in _DEFORMERS for modifier in user.modifiers)
        for user in users
    )


def _write_of_vertices(mesh: Mesh, normals: Array, valid: Array, storage: str) -> None:
    """Make the normals those of the mesh; corners of the other vertices keep theirs."""
    kept = ~valid[arrays.corner_vertices(mesh)]
    before = arrays.corner_normals(mesh) if kept.any() else None
    _claim(mesh)
    custom_normals.write_vertices(mesh, normals, kept, storage, before)


def _write_of_corners(
    mesh: Mesh,
    normals: Array,
    valid: Array,
    storage: str,
    weight: Array | None,
    corners: Corners | None,
) -> None:
    """Mix normals into those that the corners have."""
    vertices = arrays.corner_vertices(mesh)
    new, share = normals[vertices], valid[vertices].astype(np.float64)
    if corners is not None:
        new, share = corners.normals, corners.valid.astype(np.float64)
    if weight is not None:
        share *= weight[vertices]
    shown = custom_normals.mixed(arrays.corner_normals(mesh), new, share)
    edges = None if corners is None else corners.edges
    _claim(mesh)
    custom_normals.write_corners(mesh, shown, share == 0, storage, edges)
