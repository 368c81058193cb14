# SPDX-License-Identifier: GPL-3.0-or-later
"""Colors of a comparison: written, and changed without computing again."""

from dataclasses import dataclass, replace

import bpy
import numpy as np
from bpy.types import Context, Object, Operator

from ... import core
from ...core.colormaps import COLORMAPS
from .. import bridge
from ..settings.choices import limit_property, map_property, measure_property
from ..settings.scene import Returned

# Of the baseline, what is shown beside a measure of the estimate.
BESIDE = {"error_estimate": "error_baseline", "angle_estimate": "angle_baseline"}
# Shown of an object alone, it gives way to the measure of the estimate.
_ALONE = {theirs: ours for ours, theirs in BESIDE.items()}
# No measures of the core's comparison, but properties of the estimate, 0 to 1.
SURENESS = {"confidence": "ts_confidence", "side_confidence": "ts_side_confidence"}


@dataclass(frozen=True)
class Look:
    """What the colors of an object show.

    Attributes
    ----------
    measure : str
    limit : float
        The value of the last color; 0 for one that fits.
    colormap : str
    """

    measure: str
    limit: float
    colormap: str


def look_of(obj: Object) -> Look:
    """Return what the colors of an object show now."""
    record = bridge.record_of(obj)
    # Files from before there was a choice have the first map.
    colormap = record.color_map or COLORMAPS[0]
    return Look(record.color_by, record.color_limit, colormap)


def possible(measure: str, comparison: core.Comparison) -> str:
    """Return the measure, or the difference where it needs true normals."""
    if measure in SURENESS or getattr(comparison, measure) is not None:
        return measure
    return "angle_deviation" if measure.startswith("angle_") else "deviation"


def write_colors(obj: Object, comparison: core.Comparison, look: Look) -> None:
    """Color the points of an object that was compared."""
    results = {}
    if bridge.has_attribute(obj, bridge.COLOR_BESIDE):
        look = replace(look, measure=_ALONE.get(look.measure, look.measure))
        theirs = BESIDE.get(look.measure, look.measure)
        if theirs != look.measure and not look.limit:
            # One range for both.
            ends = (comparison.limits(name)[1] for name in (look.measure, theirs))
            look = replace(look, limit=max(ends))
        beside = replace(look, measure=theirs)
        results[bridge.COLOR_BESIDE] = _colors(obj, comparison, beside)
    results[bridge.COLOR] = _colors(obj, comparison, look)
    bridge.write_results(obj, results)
    record = bridge.record_of(obj)
    record.color_by, record.color_limit = look.measure, look.limit
    record.color_map = look.colormap


def _colors(obj: Object, comparison: core.Comparison, look: Look) -> np.ndarray:
    found, name, high = on_scale(obj, comparison, look)
    return found.colors(name, limit=high, colormap=look.colormap)


def on_scale(
    obj: Object, comparison: core.Comparison, look: Look
) -> tuple[core.Comparison, str, float | None]:
    """Return what the core needs to color or count a measure.

    Returns
    -------
    comparison, measure : Comparison, str
        Where the measure is none of the core's, its values as a deviation.
    limit : float or None
        The value of the last color; None for one that fits.
    """
    if look.measure not in SURENESS:
        return comparison, look.measure, look.limit or None
    sure = bridge.read_attribute(obj, SURENESS[look.measure], "FLOAT")
    return core.Comparison(sure, sure), "deviation", look.limit or 1.0


def begin_beside(obj: Object) -> bool:
    """Make the colors that a copy beside an object is to wear, where there are any.

    Returns
    -------
    bool
        Whether there are: without true normals neither method has an error.
    """
    found, look = read_comparison(obj), look_of(obj)
    if found.error_baseline is None:
        return False
    if look.measure not in {*BESIDE, *_ALONE}:
        look = replace(look, measure="error_estimate")
    nothing = np.zeros((len(found.deviation), 4), np.float32)
    bridge.write_results(obj, {bridge.COLOR_BESIDE: nothing})
    write_colors(obj, found, look)
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


def colors_of(look: Look, values: np.ndarray) -> np.ndarray:
    """Return the colors of values (n,) up to a limit that is given, (n, 4) linear."""
    measure = look.measure
    if measure == "log_ratio":
        pair = np.ones_like(values), 10**values
    elif measure == "wins":
        pair = 1 - values, values
    else:
        pair = values, values
    measure = "deviation" if measure in SURENESS else measure
    return core.Comparison(values, values, *pair, *pair).colors(
        measure, limit=look.limit, colormap=look.colormap
    )


class OnComparison(Operator):
    """An operator on selected objects that were compared."""

    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Ask for a comparison."""
        if any(bridge.has_comparison(obj) for obj in bridge.chosen(context)):
            return True
        cls.poll_message_set("Compare with Delaunay first")
        return False


class TIMESCALE_OT_color_by(OnComparison):
    """Other colors from the errors that are there."""

    bl_idname = "timescale.color_by"
    bl_label = "Color Comparison"
    bl_description = (
        "Show another measure of the last comparison, another range or other colors"
    )

    measure: measure_property()
    limit: limit_property()
    color_map: map_property()

    def execute(self, context: Context) -> Returned:
        """Color every selected object that was compared."""
        with bridge.object_mode(context):
            for obj in filter(bridge.has_comparison, bridge.targets(context)):
                found = read_comparison(obj)
                measure = possible(self.measure, found)
                look = Look(measure, self.limit, self.color_map)
                write_colors(obj, found, look)
                if measure != self.measure:
                    self.report(
                        {"WARNING"},
                        f"{obj.name}: this needs true normals; "
                        f"colors show the difference",
                    )
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((TIMESCALE_OT_color_by,))
