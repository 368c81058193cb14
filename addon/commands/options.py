# SPDX-License-Identifier: GPL-3.0-or-later
"""Every setting of an estimate as an option of the command line, by its own name."""

import argparse
from collections.abc import Callable
from dataclasses import fields
from math import radians
from pathlib import Path
from typing import Any

from ... import core

# What a setting is called that is no choice, where its own words are about arrays.
_PLACE, _FILE, _ANGLE = "viewpoint", "reference", "sharp_angle"
_METAVARS = {
    "neighbors": "K",
    "radius": "LENGTH",
    _PLACE: ("X", "Y", "Z"),
    _FILE: "FILE",
    _ANGLE: "DEG",
    "threads": "N",
}
_HELP = {
    "neighbors": "neighbors of each point, {low:g} to {high:g}; chosen from the data "
    "if not given",
    "radius": "largest distance of a neighbor, in units of the coordinates",
    "orientation": "how the sides of the normals are found: auto (by the faces of a "
    "mesh, else poles), poles (what is inside and what outside), propagate (from point "
    "to point), outward (the same, then away from the middle), viewpoint, faces, "
    "reference, or none (sides as they come)",
    _PLACE: "the place that normals face, for --orientation viewpoint",
    _FILE: "a file whose sides are taken over, for --orientation reference: normals, "
    "or a mesh around the points",
    _ANGLE: "edges of a mesh whose faces turn by more degrees part its normals, 0 to "
    "180; by default none does (in Settings the same in radians)",
    "threads": "threads at work; by default one for each core",
}


def number(text: str) -> float:
    """Return a number, whole ones as int, for argparse."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    raise argparse.ArgumentTypeError(f"expected a number, got {text}")


def degrees(text: str) -> float:
    """Return an angle from 0 to 180, for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 180:
        raise argparse.ArgumentTypeError(f"expected degrees from 0 to 180, got {text}")
    return value


def _angle(text: str) -> float:
    return radians(degrees(text))


_TYPES: dict[str, Callable[[str], Any]] = {_PLACE: float, _FILE: Path, _ANGLE: _angle}


def add_settings(parser: Any) -> None:
    """Add an option for each field of Settings; without it, its default holds."""
    group = parser.add_argument_group("settings of the estimate")
    for item in fields(core.Settings):
        name, choices = item.name, item.metadata["choices"]
        about: dict[str, Any] = {"dest": name, "default": argparse.SUPPRESS}
        about["help"] = _help(item)
        if choices == (True, False):
            about["action"] = argparse.BooleanOptionalAction
        elif choices is not None:
            about |= {"choices": choices, "metavar": "WHICH"}
        else:
            about |= {"type": _TYPES.get(name, number), "metavar": _METAVARS[name]}
            about |= {"nargs": 3} if name == _PLACE else {}
        group.add_argument("--" + name.replace("_", "-"), **about)


def _help(item: Any) -> str:
    """Return what an option does, what may be chosen, and the default."""
    doc, choices = item.metadata["doc"], item.metadata["choices"]
    low, high = item.metadata["limits"] or (None, None)
    text = _HELP.get(item.name, doc[0].lower() + doc[1:]).format(low=low, high=high)
    if choices is not None and choices != (True, False):
        missing = [choice for choice in choices if choice not in text]
        text += f"; one of {', '.join(choices)}" if missing else ""
        text += f" ({item.default})"
    return text.replace("%", "%%")


def given_settings(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the settings that were given, as plain values, checked.

    Raises
    ------
    core.InputError
        When a value is outside its limits.
    """
    names = {item.name for item in fields(core.Settings)}
    given = {name: value for name, value in vars(arguments).items() if name in names}
    if isinstance(given.get(_FILE), Path):
        given[_FILE] = str(given[_FILE])
    to_settings({name: value for name, value in given.items() if name != _FILE})
    return given


def to_settings(given: dict[str, Any], reference: Any = None) -> core.Settings:
    """Return Settings of plain values, with normals in place of their file."""
    values = dict(given)
    if _FILE in values:
        values[_FILE] = reference
    return core.Settings(**values)
