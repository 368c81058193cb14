# SPDX-License-Identifier: GPL-3.0-or-later
"""What is drawn over the viewports, and kept until the shape it shows changes.

What is drawn comes from arrays that are read once and kept under the number of the
object: no reference to Blender's data outlives a redraw. When a shape changes, what is
kept of it goes, and comes back only where the results still belong to the shape.
"""

from collections.abc import Iterator
from typing import Any

import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent
from bpy.types import Context, Object, SpaceView3D
from gpu_extras.batch import batch_for_shader

from .. import bridge
from ..settings.scene import settings_of
from . import dress, legend, picking
from .lines import lines_of

# Told apart with any color vision, on dark and light themes.
ESTIMATE = (0.13, 0.72, 0.78, 1.0)
DELAUNAY = (0.95, 0.53, 0.16, 1.0)
INVALID = (0.94, 0.16, 0.25, 1.0)


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


def _draw_labels() -> None:
    """Draw what is written of the active object, in the pixels of the region."""
    context = bpy.context
    obj = context.object
    if obj is None or not _overlays(context) or obj not in _shown(context):
        return
    # Looking closer at what has no results would leave a record there.
    if not bridge.read_summary(obj):
        return
    signature = (*bridge.color_signature(obj), *_place(obj))
    point = _kept.get("point", obj, signature, _point)
    if point is not None:
        place, lines = point
        legend.draw_point(place, lines, context)
    if settings_of(context).show_legend and dress.is_dressed(obj):
        _draw_legend(context, obj)


def _place(obj: Object) -> tuple[float, ...]:
    """Return what differs when an object, or the point picked of it, is elsewhere."""
    return bridge.record_of(obj).picked, *np.array(obj.matrix_world).ravel()


def _point(obj: Object) -> tuple[list[float], list[str]] | None:
    """Return place and lines of the point that was picked."""
    found = picking.values_of(obj)
    if found is None:
        return None
    return bridge.place_of_point(obj, found[0]), picking.lines_of(*found)


def _draw_legend(context: Context, obj: Object) -> None:
    shown = _kept.get("legend", obj, (bridge.color_signature(obj),), _legend)
    if shown is not None:
        legend.draw(shown, context)
        legend.draw_names(obj, context)


def _legend(obj: Object) -> legend.Legend | None:
    if not bridge.has_comparison(obj) or not bridge.has_estimate(obj):
        return None
    return legend.legend_of(obj)


def _overlays(context: Context) -> bool:
    """Whether the viewport that is drawn shows overlays at all."""
    space = context.space_data
    return isinstance(space, SpaceView3D) and space.overlay.show_overlays


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
    for draw, space in ((_draw_lines, "POST_VIEW"), (_draw_labels, "POST_PIXEL")):
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
