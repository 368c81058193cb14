# SPDX-License-Identifier: GPL-3.0-or-later
"""The tab "Time-Scale" of the sidebar, and the entry in the Object menu."""

from collections.abc import Sequence
from typing import Any

import bpy
from bpy.types import Context, Menu, Panel

from . import bridge
from .display import dress, picking, summaries
from .operators import run
from .operators.estimate import CLASSES as OPERATORS
from .operators.samples import TRUTH
from .settings import presets
from .settings.choices import measure_label
from .settings.layouts import (
    Layout,
    draw_colors,
    draw_compare,
    draw_details,
    draw_estimate,
)
from .settings.scene import fill, settings_of

ESTIMATE, COMPARE, CLEAR = (operator.bl_idname for operator in OPERATORS)
REORIENT = "timescale.reorient_normals"
REPAIR = "timescale.repair_normals"


class _InSidebar(Panel):
    bl_category = "Time-Scale"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"


class VIEW3D_PT_timescale(_InSidebar):
    """Settings and the buttons that use them."""

    bl_label = "Time-Scale Normals"

    def draw(self, context: Context) -> None:
        """Show the choices of most users and the three buttons."""
        _draw_run(self.layout)
        if not bridge.has_targets(context):
            _draw_start(self.layout)
        settings = settings_of(context)
        column = self.layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        draw_estimate(column, settings, context.object)
        _button(column, ESTIMATE, context, icon="NORMALS_VERTEX")
        column.separator(type="LINE")
        draw_compare(column, settings, context.object)
        chosen = settings.truth_object or settings.truth
        if not chosen and known_truth(context.object):
            column.label(text="True normals of samples", icon="INFO")
        _button(column, COMPARE, context, icon="MOD_TRIANGULATE")
        column.separator(type="LINE")
        column.operator("timescale.show_patch", icon="SURFACE_NSURFACE")
        row = column.row(align=True)
        for mode, text in (("flip", "Flip"), ("auto", "Reorient")):
            _button(row, REORIENT, context, text=text).mode = mode
        row = column.row(align=True)
        _button(row, REPAIR, context, icon="MODIFIER").preview = False
        _button(row, REPAIR, context, text="Preview").preview = True
        column.operator(CLEAR, icon="LOOP_BACK")


class VIEW3D_PT_timescale_details(_InSidebar):
    """The rest of the settings."""

    bl_label = "Settings"
    bl_parent_id = "VIEW3D_PT_timescale"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender wants a plain set

    def draw_header_preset(self, _context: Context) -> None:
        """Offer the presets."""
        presets.TIMESCALE_PT_presets.draw_panel_header(self.layout)

    def draw(self, context: Context) -> None:
        """Show what is chosen well without anyone looking."""
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        draw_details(self.layout, settings_of(context), context.object)


class VIEW3D_PT_timescale_colors(_InSidebar):
    """What the colors of a comparison show, changed at once."""

    bl_label = "Colors"
    bl_parent_id = "VIEW3D_PT_timescale"

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Stay away from objects without a comparison."""
        return context.object is not None and bridge.has_comparison(context.object)

    def draw(self, context: Context) -> None:
        """Show what to color by, and whether viewports show it."""
        column = self.layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        draw_colors(column, settings_of(context))
        shown = bridge.record_of(context.object).color_by
        if shown != settings_of(context).color_by:
            # Without true normals there is no error to show; a script may have
            # asked for another measure.
            known = bridge.has_attribute(context.object, "delaunay_error")
            why = "Shown" if known else "No true normals"
            column.label(text=f"{why}: {measure_label(shown)}", icon="INFO")
        column.prop(settings_of(context), "show_legend")
        column.operator(
            "timescale.side_by_side",
            icon="MOD_MIRROR",
            depress=bridge.has_attribute(context.object, bridge.COLOR_BESIDE),
        )
        if dress.is_dressed(context.object):
            column.operator("timescale.hide_colors", icon="HIDE_ON")
        else:
            column.operator("timescale.show_colors", icon="HIDE_OFF")


class VIEW3D_PT_timescale_normals(_InSidebar):
    """Lines in the viewport."""

    bl_label = ""
    bl_parent_id = "VIEW3D_PT_timescale"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender wants a plain set

    def draw_header(self, context: Context) -> None:
        """Switch the lines on and off."""
        self.layout.prop(settings_of(context), "show_normals")

    def draw(self, context: Context) -> None:
        """Show how the lines look."""
        settings = settings_of(context)
        column = self.layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        column.active = settings.show_normals
        for name in ("normal_length", "normal_share", "show_baseline"):
            column.prop(settings, name)


class VIEW3D_PT_timescale_result(_InSidebar):
    """What the last run said about the active object."""

    bl_label = "Last Result"
    bl_parent_id = "VIEW3D_PT_timescale"

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Stay away from objects without a result."""
        return bool(bridge.read_summary(context.object))

    def draw(self, context: Context) -> None:
        """Show comparison and estimate as two tables."""
        summary = bridge.read_summary(context.object)
        if "comparison" in summary:
            _table(self.layout, summaries.comparison_rows(summary["comparison"]))
            self.layout.separator(type="LINE")
        if "estimate" in summary:
            _table(self.layout, summaries.result_rows(summary["estimate"]))
            width = context.region.width
            for line in summaries.warning_lines(summary["estimate"], width):
                self.layout.label(**line)
        row = self.layout.row(align=True)
        row.operator("timescale.copy_report", text="Copy", icon="COPYDOWN")
        row.operator("timescale.export_report", text="Export", icon="EXPORT")


class VIEW3D_PT_timescale_point(_InSidebar):
    """What the last runs say of one point of the active object."""

    bl_label = "Point"
    bl_parent_id = "VIEW3D_PT_timescale"

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Stay away from objects without a result."""
        return bool(bridge.read_summary(context.object))

    def draw(self, context: Context) -> None:
        """Show the picked point; in Edit Mode the active vertex."""
        found = picking.values_of(context.object)
        if context.object.mode != "EDIT":
            row = self.layout.row(align=True)
            row.operator("timescale.pick_point", icon="EYEDROPPER")
            if found is not None:
                row.operator_context = "EXEC_DEFAULT"
                row.operator("timescale.pick_point", text="", icon="X").index = -1
        elif found is None:
            self.layout.label(text="No active vertex", icon="INFO")
        if found is not None:
            number, values = found
            rows = [("Number", f"{number:,}"), *picking.rows_of(values)]
            _table(self.layout, rows)


class VIEW3D_MT_object_timescale(Menu):
    """The operators with the settings of the scene."""

    bl_label = "Time-Scale Normals"

    def draw(self, context: Context | None) -> None:
        """List the operators."""
        for name in (ESTIMATE, COMPARE):
            _button(self.layout, name, context)
        _button(self.layout, REORIENT, context)
        _button(self.layout, REPAIR, context)
        self.layout.operator("timescale.show_patch")
        self.layout.operator(CLEAR)


def _table(layout: Layout, rows: Sequence[tuple[str, ...]]) -> None:
    columns = layout.grid_flow(
        row_major=True, columns=len(rows[0]), even_columns=True, align=True
    )
    for row in rows:
        for cell in row:
            columns.label(text=cell)


def _draw_run(layout: Layout) -> None:
    """Show how far the run beside the window is, and how to end it."""
    share = run.share_done()
    if share is not None:
        row = layout.row(align=True)
        row.progress(factor=share, text=f"{share:.0%}")
        row.operator("timescale.stop", text="", icon="X")


def _draw_start(layout: Layout) -> None:
    """Say what is missing, and offer something to try."""
    layout.label(text="Select a mesh or point cloud", icon="INFO")
    layout.operator("timescale.add_samples", text="Add Samples", icon="ADD")


def _button(
    layout: Layout,
    name: str,
    context: Any,
    *,
    icon: Any = "NONE",
    text: str | None = None,
) -> Any:
    """Draw a button with the settings of the scene; return its properties."""
    button: Any = layout.operator(name, icon=icon, text=text)
    fill(button, context)
    if name == COMPARE and not button.truth_object and not button.truth:
        button.truth = known_truth(context.object)
    return button


def known_truth(obj: Any) -> str:
    """Return the attribute of true normals that an object was made with, or ""."""
    there = obj is not None and obj.type in bridge.TYPES
    return TRUTH if there and bridge.has_attribute(obj, TRUTH) else ""


# The stubs of append and remove leave out the menu that draws.
def _draw_menu(menu: Menu, _context: Context) -> None:
    menu.layout.separator()
    menu.layout.menu(VIEW3D_MT_object_timescale.__name__)


CLASSES = (
    VIEW3D_PT_timescale,
    VIEW3D_PT_timescale_details,
    VIEW3D_PT_timescale_colors,
    VIEW3D_PT_timescale_point,
    VIEW3D_PT_timescale_result,
    VIEW3D_PT_timescale_normals,
    VIEW3D_MT_object_timescale,
)
_register_classes, _unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Add the panels and the menu."""
    _register_classes()
    # Menus are unknown to the stubs as classes that can be added to.
    bpy.types.VIEW3D_MT_object.append(_draw_menu)  # type: ignore[arg-type]


def unregister() -> None:
    """Remove them."""
    bpy.types.VIEW3D_MT_object.remove(_draw_menu)  # type: ignore[arg-type]
    _unregister_classes()
