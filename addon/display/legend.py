# SPDX-License-Identifier: GPL-3.0-or-later
"""What is drawn in the pixels of a viewport: the legend, and labels.

A legend is the scale of the colors, with how many points are along it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import blf
import gpu
import numpy as np
from bpy.types import Context, Object
from bpy_extras.view3d_utils import location_3d_to_region_2d
from gpu_extras.batch import batch_for_shader
from mathutils import Color, Vector

from .. import bridge
from ..settings.choices import measure_label
from . import coloring

_WHITE = (0.92, 0.92, 0.92, 1.0)
_BACK = (0.0, 0.0, 0.0, 0.7)
# Of the legend, in pixels at a resolution scale of 1.
_WIDTH, _BARS, _RAMP, _MARGIN = 300, 46, 10, 12
# Narrower, its words would be over one another.
_LEAST = 150
# The one that the interface has.
_FONT = 0
# Where there is room to say between what.
_TITLES = {
    "angle_deviation": "Angle Between Estimate and Delaunay",
    "deviation": "Difference to Delaunay",
}
# Measures that are the largest difference in a coordinate.
_COORDINATES = {"error_estimate", "error_baseline", "deviation"}


@dataclass(frozen=True)
class Legend:
    """The scale of a measure, and how many points there are along it.

    Attributes
    ----------
    heights, beside : (b,) float64
        Of the bars, and of the other method where both are side by side; 0 to 1.
    colors : (b, 4) float32
        As they are on the screen.
    """

    title: str
    count: str
    low: str
    middle: str
    high: str
    heights: np.ndarray
    beside: np.ndarray | None
    colors: np.ndarray


def legend_of(obj: Object) -> Legend:
    """Return the legend of an object's colors."""
    found, look = coloring.read_comparison(obj), coloring.look_of(obj)
    measure = look.measure
    found, name, limit = coloring.on_scale(obj, found, look)
    low, high = (0.0, 1.0) if measure == "wins" else found.limits(name, limit=limit)
    beyond = measure != "wins" and bool(
        (np.abs(getattr(found, name)) > 1.001 * high).any()
    )
    bins = 2 if measure == "wins" else 40
    counts, edges = coloring.histogram(found, name, bins=bins, limit=limit)
    middles = (edges[1:] + edges[:-1]) / 2
    colors = coloring.colors_of(replace(look, limit=high), middles)
    theirs = None
    if _is_beside(obj, measure):
        theirs, _ = coloring.histogram(
            found, coloring.BESIDE[measure], bins=bins, limit=high
        )
        counts, _ = coloring.histogram(found, measure, bins=bins, limit=high)
    most = max(1, counts.max(), 0 if theirs is None else theirs.max())
    shown = [Color(c[:3]).from_scene_linear_to_srgb()[:] for c in colors]
    return Legend(
        _title(obj, measure),
        f"{counts.sum():,} points",
        *_ticks(measure, low, high, counts, beyond=beyond),
        counts / most,
        None if theirs is None else theirs / most,
        np.concatenate([shown, np.ones((len(shown), 1))], axis=1),
    )


def _title(obj: Object, measure: str) -> str:
    """Return what the scale is of; two measures while both are side by side."""
    title = _TITLES.get(measure) or measure_label(measure)
    if _is_beside(obj, measure):
        title = f"{title}, Lines: Delaunay"
    # The infinity norm has no unit.
    return f"{title} (Coordinate)" if measure in _COORDINATES else title


def _ticks(
    measure: str, low: float, high: float, counts: np.ndarray, *, beyond: bool
) -> tuple[str, str, str]:
    """Return what stands under the ends and the middle of the scale.

    Parameters
    ----------
    beyond : bool
        Whether some points are past the end of the scale, and have its color.
    """
    if measure == "wins":
        lost, won = (f"{count / max(1, counts.sum()):.0%}" for count in counts)
        return f"Delaunay {lost}", "", f"Estimate {won}"
    if measure == "log_ratio":
        factor = f"{10**high:,.3g}x"
        return f"Delaunay {factor}", "equal", f"Estimate {factor}"
    if measure in coloring.SURENESS:
        return "a guess", f"{high / 2:.2g}", "certain" if high == 1 else f"{high:.2g}"
    unit = "°" if measure.startswith("angle_") else ""
    last = f"{high:.3g}{unit}"
    middle = (low + high) / 2
    return f"{low:.3g}{unit}", f"{middle:.3g}{unit}", f"≥ {last}" if beyond else last


def _is_beside(obj: Object, measure: str) -> bool:
    """Whether the measure of the other method is shown beside that of an object."""
    there = bridge.has_attribute(obj, bridge.COLOR_BESIDE)
    return measure in coloring.BESIDE and there


def draw(legend: Legend, context: Context) -> None:
    """Draw a legend in the pixels of the region, where there is room for one."""
    scale = context.preferences.system.ui_scale
    left, right = _room(context)
    pad = _MARGIN * scale
    width = min(_WIDTH * scale, right - left - 4 * pad)
    if width < _LEAST * scale:
        return
    # On the right: the panel of the last operation comes up on the left.
    x, y = right - width - 2 * pad, (_MARGIN + 26) * scale
    height = (_BARS + _RAMP + 58) * scale
    _fill([(x - pad, y - 26 * scale)], [(width + 2 * pad, height)], [_BACK])
    _draw_bars(legend, x, y, width, scale)
    _draw_words(legend, x, y, width, scale)


def _room(context: Context) -> tuple[float, float]:
    """Return where the region is free of tools on its left and of the sidebar."""
    wide = {region.type: region.width for region in context.area.regions}
    # Hidden ones are one pixel wide.
    return wide.get("TOOLS", 0), context.region.width - max(1, wide.get("UI", 0))


def _draw_bars(legend: Legend, x: float, y: float, width: float, scale: float) -> None:
    """Draw the colors, the histogram over them, and marks for the other method's."""
    bars, ramp = _BARS * scale, _RAMP * scale
    step = width / len(legend.heights)
    lefts = [(x + step * i, y) for i in range(len(legend.heights))]
    _fill(lefts, [(step, ramp)] * len(lefts), legend.colors)
    above = [(left, y + ramp + 3 * scale) for left, _ in lefts]
    sizes = [(max(1.0, step - scale), height * bars) for height in legend.heights]
    _fill(above, sizes, legend.colors)
    if legend.beside is not None:
        marks = [
            (left, y + ramp + (2 + height * _BARS) * scale)
            for (left, _), height in zip(lefts, legend.beside, strict=True)
        ]
        _fill(marks, [(step, 2 * scale)] * len(marks), [_WHITE] * len(marks))


def _draw_words(legend: Legend, x: float, y: float, width: float, scale: float) -> None:
    """Write the title over the bars and the values under them."""
    blf.size(_FONT, 11 * scale)
    title, below = y + (_RAMP + _BARS + 12) * scale, y - 16 * scale
    _write(legend.title, x, title, 0)
    long = blf.dimensions(_FONT, f"{legend.title}  {legend.count}")[0] > width
    if not long:
        _write(legend.count, x + width, title, 1)
    _write(legend.low, x, below, 0)
    _write(legend.middle, x + width / 2, below, 0.5)
    _write(legend.high, x + width, below, 1)


def draw_point(place: Sequence[float], lines: Sequence[str], context: Context) -> None:
    """Mark a place of the world, and write lines beside it."""
    at = location_3d_to_region_2d(context.region, context.region_data, Vector(place))
    if at is None:
        return
    scale = context.preferences.system.ui_scale
    size, pad, off = 11 * scale, 6 * scale, 14 * scale
    blf.size(_FONT, size)
    width = max(blf.dimensions(_FONT, line)[0] for line in lines)
    step = 1.4 * size
    x, y = at.x + off, at.y + off
    if x + width + pad > _room(context)[1]:
        x = at.x - off - width
    height = step * len(lines) + pad
    _fill([(x - pad, y - pad)], [(width + 2 * pad, height)], [_BACK])
    for half, color in ((4.5 * scale, (0, 0, 0, 1)), (3 * scale, _WHITE)):
        _fill([(at.x - half, at.y - half)], [(2 * half, 2 * half)], [color])
    for row, line in enumerate(reversed(lines)):
        _write(line, x, y + row * step, 0)


def draw_names(obj: Object, context: Context) -> None:
    """Write which method is which above objects that are side by side."""
    if not bridge.has_attribute(obj, bridge.COLOR_BESIDE):
        return
    scale = context.preferences.system.ui_scale
    blf.size(_FONT, 14 * scale)
    for shown, name in ((obj, "Estimate"), (bridge.object_beside(obj), "Delaunay")):
        if shown is None:
            continue
        found = [
            location_3d_to_region_2d(context.region, context.region_data, Vector(c))
            for c in bridge.bounds(shown)
        ]
        if None not in found:
            x, y = np.mean([p.x for p in found]), max(p.y for p in found)
            _write(name, x, y + 6 * scale, 0.5)


def _write(text: str, x: float, y: float, anchor: float) -> None:
    blf.color(_FONT, *_WHITE)
    blf.position(_FONT, x - anchor * blf.dimensions(_FONT, text)[0], y, 0)
    blf.draw(_FONT, text)


def _fill(places: Any, sizes: Any, colors: Any) -> None:
    """Fill rectangles, each with its color."""
    corners: list[tuple[float, float]] = []
    tints: list[tuple[float, ...]] = []
    triangles: list[tuple[int, int, int]] = []
    for (x, y), (w, h), color in zip(places, sizes, colors, strict=True):
        first = len(corners)
        corners += [(x, y), (x + w, y), (x + w, y + h), (x, y + h)]
        tints += [tuple(map(float, color))] * 4
        triangles += [
            (first, first + 1, first + 2),
            (first, first + 2, first + 3),
        ]
    shader = gpu.shader.from_builtin("FLAT_COLOR")
    batch = batch_for_shader(
        shader, "TRIS", {"pos": corners, "color": tints}, indices=triangles
    )
    gpu.state.blend_set("ALPHA")
    batch.draw(shader)
    gpu.state.blend_set("NONE")
