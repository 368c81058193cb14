# SPDX-License-Identifier: GPL-3.0-or-later
"""How settings are shown, in the sidebar and in the panel of the last operation."""

from typing import Any

import bpy

from . import choices
from .scene import Options

# Settings that are well chosen without anyone looking.
DETAILS = (
    "neighbors",
    "radius",
    "graph",
    "patch",
    "weights",
    "nested",
    "storage",
    "use_modifiers",
)
Owner = bpy.types.Object | None
# None is what stubs of Blender say; a panel that is drawn has a layout.
Layout = bpy.types.UILayout | None


def draw_estimate(layout: Layout, options: Options, obj: Owner) -> None:
    """Show what most users choose: how to fit, which side is out, and where."""
    # Without a label the three choices fit into a narrow sidebar.
    row = layout.row()
    row.use_property_split = False
    row.prop(options, "method", expand=True)
    layout.prop(options, "orientation")
    draw_guides(layout, options, options.orientation, obj)
    if obj is not None and obj.type == "MESH":
        layout.prop(options, "region")
        if options.region == "group":
            layout.prop_search(options, "vertex_group", obj, "vertex_groups", text=" ")
    layout.prop(options, "strength")


def draw_guides(layout: Layout, options: Any, orientation: str, obj: Owner) -> None:
    """Show what an orientation is to go by."""
    if orientation == "viewpoint":
        _draw_attribute(layout, options, "viewpoint_attribute", obj)
        if not options.viewpoint_attribute:
            layout.prop_search(options, "viewpoint_object", bpy.data, "objects")
            if not options.viewpoint_object:
                layout.prop(options, "viewpoint", text="Place")
    if orientation == "reference":
        layout.prop_search(options, "reference_object", bpy.data, "objects")
        if not options.reference_object:
            _draw_attribute(layout, options, "reference", obj)


def draw_details(layout: Layout, options: Options, obj: Owner) -> None:
    """Show what is chosen well without anyone looking."""
    if obj is not None and obj.type == "MESH":
        # Three switches side by side are too narrow for their words.
        layout.column().prop(options, "split")
    for name in DETAILS:
        if name != "nested" or options.orientation in {"auto", "poles"}:
            layout.prop(options, name)


def draw_compare(layout: Layout, options: Options, obj: Owner) -> None:
    """Show what to compare with and what to show of it."""
    layout.prop_search(options, "truth_object", bpy.data, "objects")
    if not options.truth_object:
        _draw_attribute(layout, options, "truth", obj)


def draw_colors(layout: Layout, options: Options) -> None:
    """Show what the colors mean."""
    layout.prop(options, "color_by", text="Measure")
    layout.prop(options, "color_limit", text="Range (0 Auto)")
    if options.color_by not in choices.TWO_SIDED:
        layout.prop(options, "color_map")


def _draw_attribute(layout: Layout, options: Options, name: str, obj: Owner) -> None:
    if obj is not None and obj.type in {"MESH", "POINTCLOUD"}:
        layout.prop_search(options, name, obj.data, "attributes")
    else:
        layout.prop(options, name)
