# SPDX-License-Identifier: GPL-3.0-or-later
"""Pick Point: what the last runs say of a single point."""

from collections.abc import Mapping
from typing import Any

import bpy
from bpy.props import IntProperty
from bpy.types import Context, Event, Object, Operator

from ...core import InputError
from .. import bridge
from ..settings.choices import measure_label
from ..settings.scene import Returned
from .pointing import ray_under_mouse

Rows = list[tuple[str, str]]


def picked_of(obj: Object) -> int | None:
    """Return the point that was picked of an object, where it still has results."""
    if obj.type not in bridge.TYPES or not bridge.has_estimate(obj):
        return None
    picked: int = bridge.record_of(obj).picked
    return picked if 0 <= picked < bridge.count_points(obj) else None


def values_of(obj: Object | None) -> tuple[int, dict[str, Any]] | None:
    """Return the point that is looked at, and its results.

    In Edit Mode it is the active vertex, else the point that was picked.
    """
    if obj is None or not bridge.read_summary(obj):
        return None
    editing = obj.mode == "EDIT"
    row = bridge.active_vertex(obj) if editing else picked_of(obj)
    if row is None:
        return None
    values = bridge.values_at(obj, row)
    return (row, values) if "ts_normal" in values else None


def rows_of(values: Mapping[str, Any]) -> Rows:
    """Return label and value of each row about a point."""
    if not values["ts_valid"]:
        return [("Normal", "none")]
    rows = _errors(values)
    rows += [
        (label, f"{values[name]:.2f}")
        for label, name in (
            ("Confidence", "ts_confidence"),
            ("Sureness of Side", "ts_side_confidence"),
        )
        if name in values
    ]
    if "ts_scale" in values:
        rows.append(("Reach of Patch", _length(values["ts_scale"])))
    x, y, z = values["ts_normal"]
    # Adding zero takes the sign off a rounded one.
    rows.append(
        ("Normal", ", ".join(f"{round(value, 3) + 0:.3f}" for value in (x, y, z)))
    )
    return rows


def lines_of(number: int, values: Mapping[str, Any]) -> list[str]:
    """Return what is said of a point where there is little room."""
    first = rows_of(values)[:3]
    return [f"Point {number:,}", *(f"{label}: {text}" for label, text in first)]


def _errors(values: Mapping[str, Any]) -> Rows:
    """Return the rows about a comparison, where there was one."""
    pairs = [("angle_estimate", "ts_"), ("angle_baseline", "delaunay_")]
    if "delaunay_angle" not in values:
        pairs = [("angle_deviation", "ts_")]
    return [
        (measure_label(measure), _error(values, prefix))
        for measure, prefix in pairs
        if prefix + "angle" in values
    ]


def _error(values: Mapping[str, Any], prefix: str) -> str:
    """Return an angle, and the largest difference in a coordinate."""
    return f"{values[prefix + 'angle']:.3g}° ({values[prefix + 'error']:.3g})"


def _length(value: float) -> str:
    units = bpy.context.scene.unit_settings
    if units.system == "NONE":
        return f"{value:.3g}"
    text: str = bpy.utils.units.to_string(
        units.system, "LENGTH", value * units.scale_length, precision=4
    )
    return text


class TIMESCALE_OT_pick_point(Operator):
    """Errors, confidence and normal of the point that is clicked."""

    bl_idname = "timescale.pick_point"
    bl_label = "Pick Point"
    bl_description = (
        "Click a point of the active object to see its errors, confidence and normal"
    )
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    index: IntProperty(
        name="Point", description="Number of the point; -1 for none", default=-1, min=-1
    )

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Ask for an estimate outside Edit Mode."""
        obj = context.object
        if obj is None or not bridge.read_summary(obj):
            cls.poll_message_set("Estimate or compare normals first")
            return False
        if obj.mode != "OBJECT":
            cls.poll_message_set("In Edit Mode the active vertex is shown")
            return False
        return True

    def invoke(self, context: Context, _event: Event) -> Returned:
        """Wait for a click."""
        context.window.cursor_modal_set("EYEDROPPER")
        context.workspace.status_text_set("Click a point    Esc to leave it")
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Context, event: Event) -> Returned:
        """Take the point under the mouse; turning the view goes on meanwhile."""
        if event.type in {"ESC", "RIGHTMOUSE"}:
            self.cancel(context)
            return {"CANCELLED"}
        if event.type != "LEFTMOUSE" or event.value != "PRESS":
            return {"PASS_THROUGH"}
        ray = ray_under_mouse(context, event)
        if ray is None:
            return {"PASS_THROUGH"}
        self.cancel(context)
        try:
            self.index = bridge.read_geometry(context.object).first_along(*ray)
        except InputError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return self.execute(context)

    def cancel(self, context: Context) -> None:
        """Leave the window as it was; Blender calls this when a file is loaded."""
        context.window.cursor_modal_restore()
        context.workspace.status_text_set(None)

    def execute(self, context: Context) -> Returned:
        """Remember the point, and say what there is of it."""
        obj, index = context.object, self.index
        count = bridge.count_points(obj)
        if index >= count:
            self.report({"ERROR"}, f"expected a point below {count:,}, got {index:,}")
            return {"CANCELLED"}
        if index >= 0 and not bridge.has_estimate(obj):
            self.report({"ERROR"}, f"{obj.name}: {EDITED}")
            return {"CANCELLED"}
        bridge.record_of(obj).picked = index
        found = values_of(obj)
        if found is not None:
            self.report({"INFO"}, ", ".join(lines_of(*found)))
        return {"FINISHED"}


EDITED = "its points changed since the last run; run again"

register, unregister = bpy.utils.register_classes_factory((TIMESCALE_OT_pick_point,))
