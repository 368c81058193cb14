# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings in Blender's terms; defaults, limits and choices are those of the core."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeAlias

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)
from bpy.types import Context

from ..core import InputError, Settings

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import OperatorReturnItems

# What operators say that they did.
Returned: TypeAlias = "set[OperatorReturnItems]"

_FIELDS = {field.name: field for field in fields(Settings)}

# What the choices of the core mean to someone who looks at a menu.
_METHODS = {
    "auto": "Chooses the size of the patches from the data",
    "time_scale": "Fits every patch to the same few neighbors",
    "paper": "Follows the published method to the letter, for comparison",
}
_QUALITIES = {"auto": "Auto", "time_scale": "Fast", "paper": "Exact Paper"}
_GRAPHS = {
    "auto": "Edges of the mesh where there are faces, the nearest points elsewhere",
    "nearest": "The points that are closest in space",
    "delaunay": "Points joined by edges of the Delaunay triangulation",
    "mesh": "Vertices joined by edges of the mesh",
}
_PATCHES = {
    "auto": "Cubic where there are neighbors enough for it",
    "biquadratic": "The eight terms of the paper",
    "cubic": "All terms up to the third power",
}
_WEIGHTS = {
    "second_order": "Exact for quadratic surfaces on uneven spacing",
    "paper": "As published",
}
ORIENTATIONS = {
    "auto": "By the faces where there are any, else chosen from the points",
    "poles": "By what is inside and outside of the whole, cavities too",
    "propagate": "From point to point along the surface, outside out",
    "viewpoint": "Toward an object or a place",
    "outward": "Away from the center of each piece",
    "faces": "To the front side of the faces",
    "reference": "To the side of another object's surface, or of normals that are "
    "there as an attribute",
    "none": "As they come",
}
_NESTED = {
    "cavity": "The wall of a cavity, whose normals face into it",
    "outward": "A body of its own, whose normals face away from it",
}
_REGIONS = {
    "all": "Every vertex gets the new normal",
    "selected": "Vertices selected in Edit Mode; the others keep their normals",
    "group": "By the weights of a vertex group, which blend smoothly",
}
_SPLITS = {
    "sharp": (
        "Sharp Edges",
        "Edges marked sharp, and those of flat faces among smooth ones",
    ),
    "seams": ("UV Seams", "Edges along which the surface is cut to lie flat"),
    "materials": ("Material Borders", "Edges between faces of different materials"),
}
_MEASURES = {
    "error_estimate": (
        "Error of Estimate",
        "Largest difference to the true normal in a coordinate",
    ),
    "error_baseline": (
        "Error of Delaunay",
        "Largest difference to the true normal in a coordinate",
    ),
    "deviation": ("Difference", "Largest difference of the two in a coordinate"),
    "angle_estimate": ("Angle of Estimate", "To the true normal, in degrees"),
    "angle_baseline": ("Angle of Delaunay", "To the true normal, in degrees"),
    "angle_deviation": ("Angle Between", "From one normal to the other, in degrees"),
    "log_ratio": (
        "Times Nearer",
        "Powers of ten between the two errors, neutral where they are equal",
    ),
    "wins": ("Winners", "Where the estimate is nearer to the true normal"),
    "confidence": (
        "Confidence",
        "How far the estimate is to be trusted, from 0 to 1: half where ten degrees of "
        "error are to be expected",
    ),
    "side_confidence": (
        "Sureness of Sides",
        "How sure it is which side of the estimate faces out, from 0 to 1",
    ),
}
_STORAGES = {
    "auto": "Tangent Space where a mesh deforms, else Free",
    "free": "Exact vectors, which do not follow deformation",
    "tangent_space": "Within 0.8 degrees, and follows armatures and shape keys",
}


def _items(
    tips: Mapping[str, str],
    choices: Iterable[str],
    labels: Mapping[str, str] | None = None,
) -> list[tuple[str, str, str]]:
    labels = labels or {}
    return [
        (name, labels.get(name) or name.replace("_", " ").title(), tips.get(name, ""))
        for name in choices
    ]


def _choice(
    name: str,
    tips: Mapping[str, str],
    tip: str,
    *,
    label: str = "",
    labels: Mapping[str, str] | None = None,
) -> object:
    """Return an enum of a setting's choices."""
    return EnumProperty(
        name=label or name.title(),
        description=tip,
        items=_items(tips, _FIELDS[name].metadata["choices"], labels),
        default=getattr(Settings, name),
    )


def _limits(name: str) -> dict[str, float]:
    """Return the bounds of a number whose 0 stands for the core's None."""
    _, high = _FIELDS[name].metadata["limits"]
    return {"min": 0} if high is None else {"min": 0, "max": high}


class SideOptions:
    """What decides the sides, beside the orientation."""

    nested: _choice(
        "nested", _NESTED, "What a piece inside another one is", label="Inner Pieces"
    )
    viewpoint: FloatVectorProperty(
        name="Viewpoint",
        description="Place in the scene that normals face, when no object is chosen",
        size=3,
        subtype="TRANSLATION",
    )
    viewpoint_attribute: StringProperty(
        name="Viewpoints",
        description=(
            "Vector attribute with the place of the sensor that saw each point, in "
            "the axes of the object"
        ),
    )
    reference: StringProperty(
        name="Reference",
        description=(
            "Vector attribute of the points whose side the normals take, when no "
            "object is chosen"
        ),
        default="normal",
    )


class EstimateOptions(SideOptions):
    """What the settings of a scene and the properties of an operator share."""

    method: _choice(
        "method",
        _METHODS,
        "How the surface around a point is fitted",
        label="Quality",
        labels=_QUALITIES,
    )
    neighbors: IntProperty(
        name="Neighbors",
        description=(
            f"How many points a patch is fitted to, "
            f"{_FIELDS['neighbors'].metadata['limits'][0]} at least; "
            f"0 chooses from the data"
        ),
        default=_FIELDS["neighbors"].default or 0,
        **_limits("neighbors"),
    )
    radius: FloatProperty(
        name="Radius",
        description="Points farther away are left out of a patch; 0 sets no bound",
        default=_FIELDS["radius"].default or 0.0,
        subtype="DISTANCE",
        **_limits("radius"),
    )
    graph: _choice("graph", _GRAPHS, "Which points count as neighbors")
    patch: _choice("patch", _PATCHES, "Which surfaces are fitted")
    weights: _choice("weights", _WEIGHTS, "How the two one-sided slopes are mixed")
    orientation: _choice("orientation", ORIENTATIONS, "Which side the normals face")
    storage: EnumProperty(
        name="Storage",
        description="How the normals of a mesh are kept",
        items=_items(_STORAGES, _STORAGES),
        default="auto",
    )
    region: EnumProperty(
        name="Vertices",
        description="Which vertices of a mesh get new custom normals",
        items=_items(
            _REGIONS, _REGIONS, {"all": "All", "selected": "Selected", "group": "Group"}
        ),
        default="all",
    )
    split: EnumProperty(
        name="Split At",
        description=(
            "Edges of a mesh where the surface is taken to end, so that normals "
            "differ on both sides"
        ),
        items=[(name, *words) for name, words in _SPLITS.items()],
        options={"ENUM_FLAG"},
        default={"sharp"},
    )
    vertex_group: StringProperty(
        name="Vertex Group",
        description="Weights that blend from the normals that are there to new ones",
    )
    strength: FloatProperty(
        name="Strength",
        description=(
            "Share of the new normals; the rest are those from before any run: "
            "the normals of a mesh, ts_normal or else normal of a point cloud"
        ),
        default=1.0,
        min=0.0,
        max=1.0,
        subtype="FACTOR",
    )
    use_modifiers: BoolProperty(
        name="After Modifiers",
        description=(
            "Estimate from the shape that modifiers and shape keys make, "
            "where they keep the number of points"
        ),
    )


def measure_property(
    *,
    default: str = "error_estimate",
    update: Callable[[Any, Context], None] | None = None,
) -> object:
    """Return an enum of what colors can show."""
    return EnumProperty(
        name="Colors",
        description="What the colors of a comparison show",
        items=[(name, *words) for name, words in _MEASURES.items()],
        default=default,
        update=update,
    )


def measure_label(measure: str) -> str:
    """Return what a measure is called in menus."""
    return _MEASURES[measure][0]


def _color_again(self: Any, _context: Context) -> None:
    """Let colors follow the settings of a scene at once."""
    ours: Any = bpy.ops
    if isinstance(self, TimeScaleSettings) and ours.timescale.color_by.poll():
        ours.timescale.color_by(measure=self.color_by, limit=self.color_limit)


class CompareOptions:
    """What a comparison needs beside an estimate."""

    truth: StringProperty(
        name="True Normals",
        description=(
            "Vector attribute of the points that both sides are measured against; "
            "without one they are measured against each other"
        ),
    )
    color_by: measure_property(update=_color_again)
    color_limit: FloatProperty(
        name="Range",
        description="The value of the last color; 0 takes 95 % of the points in",
        default=0.0,
        min=0.0,
        precision=4,
        step=1,
        update=_color_again,
    )
    show_colors: BoolProperty(
        name="Show Colors",
        description="Let viewports and renders show the comparison at once",
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
    views_before: StringProperty(
        name="Shading Before", description="JSON of how viewports were before colors"
    )


class TimeScaleRecord(bpy.types.PropertyGroup):
    """What the last run leaves on a mesh or point cloud beside its attributes."""

    had_sharp_edges: BoolProperty(
        description="Whether edges had marks of sharpness before"
    )
    summary: StringProperty(description="JSON of what the panel shows")
    color_by: StringProperty(description="What the colors show")
    color_limit: FloatProperty(description="Value of the last color; 0 chose one")
    active_color: StringProperty(description="Active color attribute before")
    default_color: StringProperty(description="Color attribute for rendering before")


# Settings that are objects.
OBJECTS = {"viewpoint_object", "reference_object", "truth_object"}
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

Options = TimeScaleSettings | bpy.types.Operator
Owner = bpy.types.Object | None
# None is what stubs of Blender say; a panel that is drawn has a layout.
Layout = bpy.types.UILayout | None


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


def draw_estimate(layout: Layout, options: Options, obj: Owner) -> None:
    """Show what most users choose: how to fit, which side is out, and where."""
    # Without a label the three choices fit into a narrow sidebar.
    row = layout.row()
    row.use_property_split = False
    row.prop(options, "method", expand=True)
    layout.prop(options, "orientation")
    draw_guides(layout, options, options.orientation, obj)
    if obj is not None and obj.type == "MESH":
        # Three switches side by side are too narrow for their words.
        layout.column().prop(options, "split")
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


def draw_details(layout: Layout, options: Options) -> None:
    """Show what is chosen well without anyone looking."""
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
    layout.prop(options, "color_by")
    layout.prop(options, "color_limit", text="Range (0 Auto)")


def _draw_attribute(layout: Layout, options: Options, name: str, obj: Owner) -> None:
    if obj is not None and obj.type in {"MESH", "POINTCLOUD"}:
        layout.prop_search(options, name, obj.data, "attributes")
    else:
        layout.prop(options, name)


def to_core(options: Any) -> Settings:
    """Return the core's settings from an operator, all but what each object brings.

    Raises
    ------
    InputError
        When a value is out of its limits or the viewpoint's object is not there.
    """
    return Settings(
        method=options.method,
        neighbors=options.neighbors or None,
        radius=options.radius or None,
        graph=options.graph,
        patch=options.patch,
        weights=options.weights,
        orientation=options.orientation,
        nested=options.nested,
        viewpoint=place_of(options) if options.orientation == "viewpoint" else None,
    )


def truth_of(options: Any) -> bpy.types.Object | None:
    """Return the object that an operator takes the true normals from.

    Raises
    ------
    InputError
        When it is not there.
    """
    return _object(options.truth_object, "with true normals")


def reference_of(options: Any) -> bpy.types.Object | None:
    """Return the object whose side the normals take.

    Raises
    ------
    InputError
        When it is not there.
    """
    return _object(options.reference_object, "whose side to take")


def _object(name: str, purpose: str) -> bpy.types.Object | None:
    if name and name not in bpy.data.objects:
        raise InputError(f'there is no object "{name}" {purpose}')
    return bpy.data.objects[name] if name else None


def place_of(options: Any) -> tuple[float, ...]:
    """Return the place that normals are to face.

    Raises
    ------
    InputError
        When the object that stands for it is not there.
    """
    if not options.viewpoint_object:
        return tuple(options.viewpoint)
    viewed: Any = _object(options.viewpoint_object, "to face")
    return viewed.matrix_world.translation.to_tuple()


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
