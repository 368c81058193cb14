# SPDX-License-Identifier: GPL-3.0-or-later
"""Colors of a comparison: written, and changed without computing again."""

import bpy
import numpy as np
from bpy.types import Context, Object, Operator

from .. import core
from . import bridge
from .choices import limit_property, measure_property
from .settings import Returned

# Of the baseline, what is shown beside a measure of the estimate.
BESIDE = {"error_estimate": "error_baseline", "angle_estimate": "angle_baseline"}
# Shown of an object alone, it gives way to the measure of the estimate.
_ALONE = {theirs: ours for ours, theirs in BESIDE.items()}
# No measures of the core's comparison, but properties of the estimate, 0 to 1.
SURENESS = {"confidence": "ts_confidence", "side_confidence": "ts_side_confidence"}


def possible(measure: str, comparison: core.Comparison) -> str:
    """Return the measure, or the difference where it needs true normals."""
    if measure in SURENESS or getattr(comparison, measure) is not None:
        return measure
    return "angle_deviation" if measure.startswith("angle_") else "deviation"


def write_colors(
    obj: Object, comparison: core.Comparison, measure: str, limit: float
) -> None:
    """Color the points by a measure up to a limit, 0 for one that fits."""
    beside = bridge.has_attribute(obj, bridge.COLOR_BESIDE)
    theirs = None
    if beside:
        measure = _ALONE.get(measure, measure)
        theirs = BESIDE.get(measure, measure)
        if theirs != measure and not limit:
            # One range for both.
            limit = max(comparison.limits(m)[1] for m in (measure, theirs))
    results = {bridge.COLOR: _colors(obj, comparison, measure, limit)}
    if theirs is not None:
        results[bridge.COLOR_BESIDE] = _colors(obj, comparison, theirs, limit)
    bridge.write_results(obj, results)
    record = bridge.record_of(obj)
    record.color_by, record.color_limit = measure, limit


def _colors(
    obj: Object, comparison: core.Comparison, measure: str, limit: float
) -> np.ndarray:
    found, name, high = on_scale(obj, comparison, measure, limit)
    return found.colors(name, limit=high)


def on_scale(
    obj: Object, comparison: core.Comparison, measure: str, limit: float
) -> tuple[core.Comparison, str, float | None]:
    """Return what the core needs to color or count a measure.

    Returns
    -------
    comparison, measure : Comparison, str
        Where the measure is none of the core's, its values as a deviation.
    limit : float or None
        The value of the last color; None for one that fits.
    """
    if measure not in SURENESS:
        return comparison, measure, limit or None
    sure = bridge.read_attribute(obj, SURENESS[measure], "FLOAT")
    return core.Comparison(sure, sure), "deviation", limit or 1.0


def begin_beside(obj: Object) -> bool:
    """Make the colors that a copy beside an object is to wear, where there are any.

    Returns
    -------
    bool
        Whether there are: without true normals neither method has an error.
    """
    found, record = read_comparison(obj), bridge.record_of(obj)
    if found.error_baseline is None:
        return False
    measure = record.color_by
    if measure not in {*BESIDE, *_ALONE}:
        measure = "error_estimate"
    nothing = np.zeros((len(found.deviation), 4), np.float32)
    bridge.write_results(obj, {bridge.COLOR_BESIDE: nothing})
    write_colors(obj, found, measure, record.color_limit)
    return True


def end_beside(obj: Object) -> None:
    """Remove the colors that a copy beside an object wore."""
    if bridge.has_attribute(obj, bridge.COLOR_BESIDE):
        bridge.write_results(obj, {bridge.COLOR_BESIDE: None})


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
    names = ("ts_error", "delaunay_error", "ts_angle", "delaunay_angle")
    errors = (bridge.read_attribute(obj, name, "FLOAT") for name in names)
    return core.Comparison(found.deviation, found.angle_deviation, *errors)


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
    measure = "deviation" if measure in SURENESS else measure
    return core.Comparison(values, values, *pair, *pair).colors(measure, limit=limit)


class TIMESCALE_OT_color_by(Operator):
    """Other colors from the errors that are there."""

    bl_idname = "timescale.color_by"
    bl_label = "Color Comparison"
    bl_description = "Show another measure of the last comparison, or another range"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    measure: measure_property()
    limit: limit_property()

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
