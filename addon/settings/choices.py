# SPDX-License-Identifier: GPL-3.0-or-later
"""What the choices of the core are called in menus, and what they mean to a user."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from typing import Any

from bpy.props import EnumProperty, FloatProperty
from bpy.types import Context

from ...core import Settings
from ...core.colormaps import COLORMAPS

FIELDS = {field.name: field for field in fields(Settings)}
# What the choices of the core mean to someone who looks at a menu.
METHODS = {
    "auto": "Chooses the size of the patches from the data",
    "time_scale": "Fits every patch to the same few neighbors",
    "paper": "Follows the published method to the letter, for comparison",
}
QUALITIES = {"auto": "Auto", "time_scale": "Fast", "paper": "Exact Paper"}
GRAPHS = {
    "auto": "Edges of the mesh where there are faces, the nearest points elsewhere",
    "nearest": "The points that are closest in space",
    "delaunay": "Points joined by edges of the Delaunay triangulation",
    "mesh": "Vertices joined by edges of the mesh",
}
PATCHES = {
    "auto": "Cubic where there are neighbors enough for it",
    "biquadratic": "The eight terms of the paper",
    "cubic": "All terms up to the third power",
}
WEIGHTS = {
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
NESTED = {
    "cavity": "The wall of a cavity, whose normals face into it",
    "outward": "A body of its own, whose normals face away from it",
}
REGIONS = {
    "all": "Every vertex gets the new normal",
    "selected": "Vertices selected in Edit Mode; the others keep their normals",
    "group": "By the weights of a vertex group, which blend smoothly",
}
SPLITS = {
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
# Measures with a middle or two sides, whose colors are their own.
TWO_SIDED = {"log_ratio", "wins"}
_COLORMAPS = {
    "heat": "Dark violet over red to cream",
    "viridis": "Violet over blue and green to yellow",
    "cividis": "Blue over gray to yellow, which color-blind people see alike",
    "rainbow": "Blue over green and yellow to red, which tells most values apart",
    "gray": "Black to white, for print",
}
STORAGES = {
    "auto": "Tangent Space where a mesh deforms, else Free",
    "free": "Exact vectors, which do not follow deformation",
    "tangent_space": "Within 0.8 degrees, and follows armatures and shape keys",
}


def items(
    tips: Mapping[str, str],
    choices: Iterable[str],
    labels: Mapping[str, str] | None = None,
) -> list[tuple[str, str, str]]:
    """Return choices as an enum wants them: name, label, tip."""
    labels = labels or {}
    return [
        (name, labels.get(name) or name.replace("_", " ").title(), tips.get(name, ""))
        for name in choices
    ]


def choice(
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
        items=items(tips, FIELDS[name].metadata["choices"], labels),
        default=getattr(Settings, name),
    )


def limits(name: str) -> dict[str, float]:
    """Return the bounds of a number whose 0 stands for the core's None."""
    _, high = FIELDS[name].metadata["limits"]
    return {"min": 0} if high is None else {"min": 0, "max": high}


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


def limit_property(*, update: Callable[[Any, Context], None] | None = None) -> object:
    """Return a number for the end of the scale of colors."""
    return FloatProperty(
        name="Range",
        description="The value of the last color; 0 takes 95 % of the points in",
        default=0.0,
        min=0.0,
        precision=4,
        step=1,
        update=update,
    )


def map_property(*, update: Callable[[Any, Context], None] | None = None) -> object:
    """Return an enum of the maps from values to colors."""
    return EnumProperty(
        name="Color Map",
        description="Which colors stand for small and large values",
        items=items(_COLORMAPS, COLORMAPS),
        default=COLORMAPS[0],
        update=update,
    )


def measure_label(measure: str) -> str:
    """Return what a measure is called in menus."""
    return _MEASURES[measure][0]
