# SPDX-License-Identifier: GPL-3.0-or-later
"""Colors of a comparison: written, and changed without computing again."""

import bpy
import numpy as np
from bpy.props import FloatProperty
from bpy.types import Context, Object, Operator

from .. import core
from . import bridge
from .settings import Returned, measure_property


def possible(measure: str, comparison: core.Comparison) -> str:
    """Return the measure, or the difference where it needs true normals."""
    return "deviation" if getattr(comparison, measure) is None else measure


def write_colors(
    obj: Object, comparison: core.Comparison, measure: str, limit: float
) -> None:
    """Color the points by a measure up to a limit, 0 for one that fits."""
    colors = comparison.colors(measure, limit=limit or None)
    bridge.write_results(obj, {bridge.COLOR: colors})
    record = bridge.record_of(obj)
    record.color_by, record.color_limit = measure, limit


def read_comparison(obj: Object) -> core.Comparison:
    """Return what the last comparison left in the attributes of an object.

    Raises
    ------
    AttributeMismatchError
        When there was none.
    """
    ours, theirs = (
        bridge.read_normals(obj, name) for name in ("ts_normal", "delaunay_normal")
    )
    found = core.compare_normals(ours, theirs)
    if not bridge.has_attribute(obj, "delaunay_error"):
        return found
    return core.Comparison(
        found.deviation,
        found.angle_deviation,
        bridge.read_attribute(obj, "ts_error", "FLOAT"),
        bridge.read_attribute(obj, "delaunay_error", "FLOAT"),
    )


def histogram(
    comparison: core.Comparison, measure: str, *, bins: int, limit: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return counts (bins,) and edges (bins + 1,) along the scale of a measure."""
    if measure != "wins":
        return comparison.histogram(measure, bins=bins, limit=limit)
    won = comparison.wins[comparison.compared].astype(np.float64)
    return np.histogram(won, bins=bins, range=(0, 1))


def colors_of(measure: str, values: np.ndarray, limit: float) -> np.ndarray:
    """Return the colors of values (n,) on the scale of a measure, (n, 4) linear."""
    if measure == "log_ratio":
        pair = np.ones_like(values), 10**values
    elif measure == "wins":
        pair = 1 - values, values
    else:
        pair = values, values
    return core.Comparison(values, values, *pair).colors(measure, limit=limit)


class TIMESCALE_OT_color_by(Operator):
    """Other colors from the errors that are there."""

    bl_idname = "timescale.color_by"
    bl_label = "Color Comparison"
    bl_description = "Show another measure of the last comparison, or another range"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    measure: measure_property()
    limit: FloatProperty(
        name="Range",
        description="The value of the last color; 0 takes 95 % of the points in",
        min=0.0,
    )

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Ask for a comparison."""
        if any(bridge.has_comparison(obj) for obj in bridge.chosen(context)):
            return True
        cls.poll_message_set("Compare with Delaunay first")
        return False

    def execute(self, context: Context) -> Returned:
        """Color every selected object that was compared."""
        with bridge.object_mode(context):
            for obj in filter(bridge.has_comparison, bridge.targets(context)):
                found = read_comparison(obj)
                measure = possible(self.measure, found)
                write_colors(obj, found, measure, self.limit)
                if measure != self.measure:
                    self.report(
                        {"WARNING"},
                        f"{obj.name}: this needs true normals; "
                        f"colors show the difference",
                    )
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((TIMESCALE_OT_color_by,))
