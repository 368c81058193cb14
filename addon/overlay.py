# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of selected objects as lines in the viewport, and the legend of the colors.

What is drawn comes from arrays that are read once and kept under the number of the
object: no reference to Blender's data outlives a redraw. When a shape changes, what is
kept of it goes, and comes back only where the results still belong to the shape.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import blf
import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent
from bpy.types import Context, Object, SpaceView3D
from bpy_extras.view3d_utils import location_3d_to_region_2d
from gpu_extras.batch import batch_for_shader
from mathutils import Color, Vector

from ..core.faces import unit
from . import bridge, coloring, dress
from .choices import measure_label
from .settings import settings_of

# Lines of one method; more would hide the surface and slow the viewport down.
MOST = 50_000

# Told apart with any color vision, on dark and light themes.
ESTIMATE = (0.13, 0.72, 0.78, 1.0)
DELAUNAY = (0.95, 0.53, 0.16, 1.0)
INVALID = (0.94, 0.16, 0.25, 1.0)
_WHITE = (0.92, 0.92, 0.92, 1.0)

# Of the legend, in pixels at a resolution scale of 1.
_WIDTH, _BARS, _RAMP, _MARGIN = 300, 46, 10, 12

# Measures that are the largest difference in a coordinate.
_COORDINATES = {"error_estimate", "error_baseline", "deviation"}


@dataclass(frozen=True)
class Lines:
    """What is drawn of one object, in the world.

    Attributes
    ----------
    estimate, baseline : (2 m, 3) float32
        Both ends of each line; baseline is empty where it is not shown.
    invalid : (i, 3) float32
        Points without a normal.
    """

    estimate: np.ndarray
    baseline: np.ndarray
    invalid: np.ndarray


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


def spacing(points: np.ndarray, count: int) -> float:
    """Return about how far `count` of the points (n, 3) on a surface are apart."""
    return float(np.linalg.norm(np.ptp(points, axis=0)) / np.sqrt(count))


def lines_of(obj: Object, *, share: float, length: float, baseline: bool) -> Lines:
    """Return the lines of an object.

    Parameters
    ----------
    share : float
        Of the points that get a line, 0 to 1; never more than MOST.
    length : float
        Of a line, in distances between lines.
    baseline : bool
        Whether the normals of the triangulation are shown too.
    """
    matrix = np.array(obj.matrix_world)
    points = bridge.read_points(obj) @ matrix[:3, :3].T + matrix[:3, 3]
    count = max(1, min(MOST, round(share * len(points))))
    # The same points every time: lines must not jump when a setting changes.
    rows = np.random.default_rng(0).permutation(len(points))[:count]
    size = length * spacing(points, count)
    starts, ends, side = points[rows], {}, None
    for name in ("ts_normal", "delaunay_normal"):
        if name == "ts_normal" or (baseline and bridge.has_attribute(obj, name)):
            normals = bridge.read_attribute(obj, name, "FLOAT_VECTOR")[rows]
            # Normals go to the world by the inverse transpose.
            normals = unit(normals @ np.linalg.inv(matrix[:3, :3]))
            # A triangulation of points alone knows no outside.
            side = normals if side is None else side
            normals[(normals * side).sum(axis=1) < 0] *= -1
            there = (normals != 0).any(axis=1)
            pairs = np.stack([starts, starts + size * normals], axis=1)[there]
            ends[name] = pairs.reshape(-1, 3).astype(np.float32)
    valid = bridge.read_attribute(obj, "ts_valid", "BOOLEAN")
    nothing = np.zeros((0, 3), np.float32)
    return Lines(
        ends["ts_normal"],
        ends.get("delaunay_normal", nothing),
        points[~valid][:MOST].astype(np.float32),
    )


def legend_of(obj: Object) -> Legend:
    """Return the legend of an object's colors."""
    found, record = coloring.read_comparison(obj), bridge.record_of(obj)
    measure = record.color_by
    found, name, limit = coloring.on_scale(obj, found, measure, record.color_limit)
    low, high = (0.0, 1.0) if measure == "wins" else found.limits(name, limit=limit)
    beyond = measure != "wins" and bool(
        (np.abs(getattr(found, name)) > 1.001 * high).any()
    )
    bins = 2 if measure == "wins" else 40
    counts, edges = coloring.histogram(found, name, bins=bins, limit=limit)
    colors = coloring.colors_of(measure, (edges[1:] + edges[:-1]) / 2, high)
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
    title = measure_label(measure)
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


class Kept:
    """Arrays and batches under the number of their object, until its shape changes."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, int], tuple[Any, int, Any]] = {}

    def get(self, kind: str, obj: Object, signature: tuple, make: Any) -> Any:
        """Return what was made for a signature, or make it."""
        key, owner = (kind, obj.session_uid), obj.data.session_uid
        if key not in self._found or self._found[key][0] != signature:
            self._found[key] = (signature, owner, make(obj))
        return self._found[key][2]

    def forget(self, uid: int) -> None:
        """Drop what belongs to an object, or to objects with this data."""
        for key, (_, owner, _) in list(self._found.items()):
            if uid in {key[1], owner}:
                del self._found[key]

    def clear(self) -> None:
        """Drop everything."""
        self._found.clear()


_kept = Kept()


@persistent  # type: ignore[untyped-decorator]  # untyped in the stubs
def _forget_changed(_scene: object, depsgraph: Any) -> None:
    for update in depsgraph.updates:
        if update.is_updated_geometry:
            _kept.forget(update.id.original.session_uid)


@persistent  # type: ignore[untyped-decorator]  # untyped in the stubs
def _forget_all(*_arguments: object) -> None:
    _kept.clear()


def _shown(context: Context) -> Iterator[Object]:
    """Yield the objects that can be looked at as they are."""
    for obj in context.selected_objects:
        if obj.type in bridge.TYPES and obj.mode == "OBJECT" and obj.visible_get():
            yield obj


def _draw_lines() -> None:
    """Draw normals, in the space of the world."""
    context = bpy.context
    settings = settings_of(context)
    if not settings.show_normals or not _overlays(context):
        return
    look = (settings.normal_share, settings.normal_length, settings.show_baseline)
    gpu.state.depth_test_set("LESS_EQUAL")
    for obj in _shown(context):
        place = tuple(np.array(obj.matrix_world).ravel())
        batches = _kept.get("lines", obj, (*look, place), _batches)
        for shader, batch, color in batches:
            shader.bind()
            shader.uniform_float("color", color)
            gpu.state.point_size_set(7)
            batch.draw(shader)
    gpu.state.point_size_set(1)
    gpu.state.depth_test_set("NONE")


def _batches(obj: Object) -> list[tuple[Any, Any, tuple[float, ...]]]:
    if not bridge.has_estimate(obj):
        return []
    settings = settings_of(bpy.context)
    lines = lines_of(
        obj,
        share=settings.normal_share / 100,
        length=settings.normal_length,
        baseline=settings.show_baseline,
    )
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    parts: list[tuple[Any, Any, tuple[float, ...]]] = [
        ("LINES", lines.baseline, DELAUNAY),
        ("LINES", lines.estimate, ESTIMATE),
        ("POINTS", lines.invalid, INVALID),
    ]
    return [
        (shader, batch_for_shader(shader, kind, {"pos": values}), color)
        for kind, values, color in parts
        if len(values)
    ]


def _draw_legend() -> None:
    """Draw the legend of the active object, in the pixels of the region."""
    context = bpy.context
    obj = context.object
    if obj is None or not settings_of(context).show_legend or not _overlays(context):
        return
    if obj not in _shown(context) or not dress.is_dressed(obj):
        return
    legend = _kept.get("legend", obj, (bridge.color_signature(obj),), _legend)
    if legend is not None:
        _draw(legend, context)
        _draw_names(obj, context)


def _legend(obj: Object) -> Legend | None:
    if not bridge.has_comparison(obj) or not bridge.has_estimate(obj):
        return None
    return legend_of(obj)


def _overlays(context: Context) -> bool:
    """Whether the viewport that is drawn shows overlays at all."""
    space = context.space_data
    return isinstance(space, SpaceView3D) and space.overlay.show_overlays


def _draw(legend: Legend, context: Context) -> None:
    scale = context.preferences.system.ui_scale
    width, bars, ramp = _WIDTH * scale, _BARS * scale, _RAMP * scale
    pad = _MARGIN * scale
    # On the right: the panel of the last operation comes up on the left.
    sidebar = next((r.width for r in context.area.regions if r.type == "UI"), 0)
    x = context.region.width - max(1, sidebar) - width - 2 * pad
    y = (_MARGIN + 26) * scale
    gpu.state.blend_set("ALPHA")
    back = (0.0, 0.0, 0.0, 0.55)
    _fill(
        [(x - pad, y - 26 * scale)],
        [(width + 2 * pad, bars + ramp + 58 * scale)],
        [back],
    )
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
    gpu.state.blend_set("NONE")
    font, size = 0, 11 * scale
    blf.size(font, size)
    blf.color(font, *_WHITE)
    title = y + ramp + bars + 12 * scale
    _write(font, legend.title, x, title, 0)
    _write(font, legend.count, x + width, title, 1)
    below = y - 16 * scale
    _write(font, legend.low, x, below, 0)
    _write(font, legend.middle, x + width / 2, below, 0.5)
    _write(font, legend.high, x + width, below, 1)


def _draw_names(obj: Object, context: Context) -> None:
    """Write which method is which above objects that are side by side."""
    if not bridge.has_attribute(obj, bridge.COLOR_BESIDE):
        return
    scale = context.preferences.system.ui_scale
    font = 0
    blf.size(font, 14 * scale)
    for shown, name in ((obj, "Estimate"), (bridge.object_beside(obj), "Delaunay")):
        if shown is None:
            continue
        found = [
            location_3d_to_region_2d(context.region, context.region_data, Vector(c))
            for c in bridge.bounds(shown)
        ]
        if None not in found:
            x, y = np.mean([p.x for p in found]), max(p.y for p in found)
            _write(font, name, x, y + 6 * scale, 0.5)


def _write(font: int, text: str, x: float, y: float, anchor: float) -> None:
    blf.position(font, x - anchor * blf.dimensions(font, text)[0], y, 0)
    blf.draw(font, text)


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
    batch.draw(shader)


_HANDLERS = (
    ("depsgraph_update_post", _forget_changed),
    ("undo_post", _forget_all),
    ("redo_post", _forget_all),
    ("load_post", _forget_all),
)
_drawn: list[Any] = []


def register() -> None:
    """Draw in every 3D viewport; nothing where there is no window."""
    if bpy.app.background:
        return
    for draw, space in ((_draw_lines, "POST_VIEW"), (_draw_legend, "POST_PIXEL")):
        _drawn.append(SpaceView3D.draw_handler_add(draw, (), "WINDOW", space))
    for name, handler in _HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    """Stop drawing and forget everything."""
    while _drawn:
        SpaceView3D.draw_handler_remove(_drawn.pop(), "WINDOW")
    for name, handler in _HANDLERS:
        handlers = getattr(bpy.app.handlers, name)
        if handler in handlers:
            handlers.remove(handler)
    _kept.clear()
