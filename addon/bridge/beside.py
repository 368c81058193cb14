# SPDX-License-Identifier: GPL-3.0-or-later
"""A copy of an object beside it, which shows the other method."""

import bpy
from bpy.types import Object
from mathutils import Vector

from .arrays import Array

# Marks objects that were put beside others.
_BESIDE = "timescale_beside"


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
