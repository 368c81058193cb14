# SPDX-License-Identifier: GPL-3.0-or-later
"""What the mouse points at in a 3D viewport."""

from typing import Any

from bpy.types import Context, Event
from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d

# Start and direction in the world.
Ray = tuple[Any, Any]


def ray_under_mouse(context: Context, event: Event) -> Ray | None:
    """Return the ray under the mouse; None where it is in no view, or over a panel."""
    found = _view_at(context, event.mouse_x, event.mouse_y)
    if found is None:
        return None
    region, view = found
    at = (event.mouse_x - region.x, event.mouse_y - region.y)
    return (
        region_2d_to_origin_3d(region, view, at),
        region_2d_to_vector_3d(region, view, at),
    )


def _view_at(context: Context, x: int, y: int) -> tuple[Any, Any] | None:
    """Return the region of a view, and how it looks at the scene."""
    for area in context.window.screen.areas:
        if area.type != "VIEW_3D":
            continue
        under = [region for region in area.regions if _has(region, x, y)]
        # Panels and headers lie over the view.
        if any(region.type in {"UI", "HEADER", "TOOL_HEADER"} for region in under):
            return None
        space: Any = area.spaces.active
        windows = [region for region in area.regions if region.type == "WINDOW"]
        views = space.region_quadviews or [space.region_3d]
        for region, view in zip(windows, views, strict=False):
            if region in under:
                return region, view
    return None


def _has(region: Any, x: int, y: int) -> bool:
    within = 0 <= x - region.x < region.width and 0 <= y - region.y < region.height
    return within and region.width > 1
