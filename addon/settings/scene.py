# SPDX-License-Identifier: GPL-3.0-or-later
"""The settings of a scene, and what a run leaves on meshes and point clouds."""

from typing import TYPE_CHECKING, Any, TypeAlias

import bpy
from bpy.props import (
    BoolProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)
from bpy.types import Context

from .choices import limit_property, map_property, measure_property
from .properties import CompareOptions, EstimateOptions

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import OperatorReturnItems

# What operators say that they did.
Returned: TypeAlias = "set[OperatorReturnItems]"


def _color_again(self: Any, _context: Context) -> None:
    """Let colors follow the settings of a scene at once."""
    ours: Any = bpy.ops
    if ours.timescale.color_by.poll():
        ours.timescale.color_by(
            measure=self.color_by, limit=self.color_limit, color_map=self.color_map
        )


def _redraw(_self: object, context: Context) -> None:
    """Draw the viewports again."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def _is_mesh(_self: object, obj: bpy.types.Object) -> bool:
    return obj.type == "MESH"


class TimeScaleSettings(EstimateOptions, CompareOptions, bpy.types.PropertyGroup):
    """Settings of a scene."""

    viewpoint_object: PointerProperty(
        name="Viewpoint",
        description="Camera or other object that normals face",
        type=bpy.types.Object,
    )
    truth_object: PointerProperty(
        name="True Surface",
        description="Mesh whose nearest surface has the true normals",
        type=bpy.types.Object,
        poll=_is_mesh,
    )
    reference_object: PointerProperty(
        name="Like Object",
        description="Mesh whose nearest surface says which side is out",
        type=bpy.types.Object,
        poll=_is_mesh,
    )
    # Who looks at colors knows degrees; scripts get what ts_error holds.
    color_by: measure_property(default="angle_estimate", update=_color_again)
    color_limit: limit_property(update=_color_again)
    color_map: map_property(update=_color_again)
    # A script has no use for it unless it says so.
    show_colors: BoolProperty(
        name="Show Colors",
        description="Let viewports and renders show the comparison at once",
        default=True,
    )
    show_normals: BoolProperty(
        name="Show Normals",
        description="Draw estimated normals of selected objects as lines",
        update=_redraw,
    )
    show_baseline: BoolProperty(
        name="Delaunay Too",
        description="Draw the normals of the triangulation in another color",
        update=_redraw,
    )
    normal_length: FloatProperty(
        name="Length",
        description="How long the lines are, in distances from one to the next",
        default=2.0,
        min=0.01,
        soft_max=10.0,
        update=_redraw,
    )
    normal_share: FloatProperty(
        name="Share",
        description="How many of the points get a line, up to fifty thousand",
        default=100.0,
        min=0.01,
        max=100.0,
        subtype="PERCENTAGE",
        update=_redraw,
    )
    show_legend: BoolProperty(
        name="Legend",
        description="Draw the scale of the colors and how many points it holds where",
        default=True,
        update=_redraw,
    )


class TimeScaleRecord(bpy.types.PropertyGroup):
    """What the last run leaves on a mesh or point cloud beside its attributes."""

    had_sharp_edges: BoolProperty(
        description="Whether edges had marks of sharpness before"
    )
    summary: StringProperty(description="JSON of what the panel shows")
    color_by: StringProperty(description="What the colors show")
    color_limit: FloatProperty(description="Value of the last color; 0 chose one")
    color_map: StringProperty(description="Which colors the values have")
    picked: IntProperty(
        description="The point that is looked at; -1 for none", default=-1
    )
    active_color: StringProperty(description="Active color attribute before")
    default_color: StringProperty(description="Color attribute for rendering before")


# Settings that are objects.
OBJECTS = {"viewpoint_object", "reference_object", "truth_object"}


# What has settings as properties.
Options = TimeScaleSettings | bpy.types.Operator


def settings_of(context: Context | None) -> TimeScaleSettings:
    """Return the settings of the scene that is looked at."""
    found: TimeScaleSettings = getattr(context.scene, PROPERTY)
    return found


def fill(operator: Any, context: Context | None) -> None:
    """Give an operator's button the settings of the scene."""
    settings = settings_of(context)
    shared = set(operator.bl_rna.properties.keys()) & set(
        settings.bl_rna.properties.keys()
    )
    for name in shared - {"rna_type"}:
        value = getattr(settings, name)
        if name in OBJECTS:
            # Operators keep objects by name.
            value = value.name if value else ""
        setattr(operator, name, value)


CLASSES = (TimeScaleSettings, TimeScaleRecord)
_register_classes, _unregister_classes = bpy.utils.register_classes_factory(CLASSES)

# The name of the property on these types.
PROPERTY = "timescale_normals"
OWNERS = {
    bpy.types.Scene: TimeScaleSettings,
    bpy.types.Mesh: TimeScaleRecord,
    bpy.types.PointCloud: TimeScaleRecord,
}


def register() -> None:
    """Add the settings to scenes and the records to meshes and point clouds."""
    _register_classes()
    for owner, group in OWNERS.items():
        setattr(owner, PROPERTY, PointerProperty(type=group))


def unregister() -> None:
    """Remove them; what files hold of them stays there."""
    for owner in OWNERS:
        delattr(owner, PROPERTY)
    _unregister_classes()
