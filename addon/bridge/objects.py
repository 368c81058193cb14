# SPDX-License-Identifier: GPL-3.0-or-later
"""Which objects are worked on, in which mode, and the data of one."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

import bmesh
import bpy
import numpy as np
from bpy.types import Context, Mesh, Object, PointCloud

from .arrays import Array, Data, ObjectError

TYPES = {"MESH": "mesh", "POINTCLOUD": "point cloud"}
Item = TypeVar("Item")


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


def count_points(obj: Object) -> int:
    """Return how many points an object has, outside Edit Mode."""
    count: int = data_of(obj).attributes.domain_size("POINT")
    return count


def active_vertex(obj: Object) -> int | None:
    """Return the active vertex of a mesh in Edit Mode; None where there is none."""
    if obj.type != "MESH" or obj.mode != "EDIT":
        return None
    active = bmesh.from_edit_mesh(data_of(obj)).select_history.active
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
            found.setdefault(data_of(obj), obj)
    return list(found.values())


def shapes_of_scene(context: Context) -> list[Object]:
    """Return all meshes and point clouds of the view layer, by name.

    Of objects that share their data only the first is returned.
    """
    context.view_layer.update()
    found: dict[Data, Object] = {}
    for obj in sorted(context.view_layer.objects, key=lambda obj: obj.name):
        if obj.type in TYPES:
            found.setdefault(data_of(obj), obj)
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


def is_cloud(obj: Object) -> bool:
    """Whether an object is points alone: a point cloud, or a mesh without faces."""
    data = data_of(obj)
    return isinstance(data, PointCloud) or not data.polygons


def bounds(obj: Object) -> Array:
    """Return the corners of a box around an object in the world, (8, 3) float64."""
    matrix = np.array(obj.matrix_world)
    box = np.array([corner[:] for corner in obj.bound_box])
    return box @ matrix[:3, :3].T + matrix[:3, 3]


def data_of(obj: Object) -> Any:
    """Return the object's Mesh or PointCloud."""
    return obj.data


def changed(data: Data) -> None:
    """Let Blender forget what it computed from the data."""
    if isinstance(data, Mesh):
        data.update()
    else:
        data.update_tag()
