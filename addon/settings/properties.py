# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties that operators and the settings of a scene share, and what they ask for.

Defaults, limits and choices are those of the core.
"""

from dataclasses import replace
from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    StringProperty,
)

from ...core import InputError, Settings
from . import choices
from .choices import (
    choice,
    items,
    limit_property,
    limits,
    map_property,
    measure_property,
)


class SideOptions:
    """What decides the sides, beside the orientation."""

    nested: choice(
        "nested",
        choices.NESTED,
        "What a piece inside another one is",
        label="Inner Pieces",
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


class GuideObjects:
    """Objects that the sides are found by, under the names that operators take."""

    viewpoint_object: StringProperty(
        name="Viewpoint", description="Camera or other object that normals face"
    )
    reference_object: StringProperty(
        name="Like Object",
        description="Mesh whose nearest surface says which side is out",
    )


class EstimateOptions(SideOptions):
    """What the settings of a scene and the properties of an operator share."""

    method: choice(
        "method",
        choices.METHODS,
        "How the surface around a point is fitted",
        label="Quality",
        labels=choices.QUALITIES,
    )
    neighbors: IntProperty(
        name="Neighbors",
        description=(
            f"How many points a patch is fitted to, "
            f"{choices.FIELDS['neighbors'].metadata['limits'][0]} at least; "
            f"0 chooses from the data"
        ),
        default=choices.FIELDS["neighbors"].default or 0,
        **limits("neighbors"),
    )
    radius: FloatProperty(
        name="Radius",
        description="Points farther away are left out of a patch; 0 sets no bound",
        default=choices.FIELDS["radius"].default or 0.0,
        subtype="DISTANCE",
        **limits("radius"),
    )
    graph: choice("graph", choices.GRAPHS, "Which points count as neighbors")
    patch: choice("patch", choices.PATCHES, "Which surfaces are fitted")
    weights: choice(
        "weights", choices.WEIGHTS, "How the two one-sided slopes are mixed"
    )
    orientation: choice(
        "orientation", choices.ORIENTATIONS, "Which side the normals face"
    )
    storage: EnumProperty(
        name="Storage",
        description="How the normals of a mesh are kept",
        items=items(choices.STORAGES, choices.STORAGES),
        default="auto",
    )
    region: EnumProperty(
        name="Vertices",
        description="Which vertices of a mesh get new custom normals",
        items=items(
            choices.REGIONS,
            choices.REGIONS,
            {"all": "All", "selected": "Selected", "group": "Group"},
        ),
        default="all",
    )
    split: EnumProperty(
        name="Split At",
        description=(
            "Edges of a mesh where the surface is taken to end, so that normals "
            "differ on both sides"
        ),
        items=[(name, *words) for name, words in choices.SPLITS.items()],
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


class CompareOptions:
    """What a comparison needs beside an estimate."""

    truth: StringProperty(
        name="True Normals",
        description=(
            "Vector attribute of the points that both sides are measured against; "
            "without one they are measured against each other"
        ),
    )
    color_by: measure_property()
    color_limit: limit_property()
    color_map: map_property()
    show_colors: BoolProperty(
        name="Show Colors",
        description="Let viewports and renders show the comparison at once",
    )


def to_core(options: Any) -> Settings:
    """Return the core's settings from an operator, all but what each object brings.

    Raises
    ------
    InputError
        When a value is out of its limits or the viewpoint's object is not there.
    """
    viewpoint = place_of(options) if options.orientation == "viewpoint" else None
    return replace(
        patches_of(options),
        orientation=options.orientation,
        nested=options.nested,
        viewpoint=viewpoint,
    )


def patches_of(options: Any) -> Settings:
    """Return the core's settings of an operator or a scene, all but those of sides."""
    return Settings(
        method=options.method,
        neighbors=options.neighbors or None,
        radius=options.radius or None,
        graph=options.graph,
        patch=options.patch,
        weights=options.weights,
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
