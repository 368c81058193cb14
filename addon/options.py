# SPDX-License-Identifier: GPL-3.0-or-later
"""Every setting of an estimate as an option of the command line, by its own name."""

import argparse
from dataclasses import fields
from pathlib import Path
from typing import Any

from .. import core

# Settings that are no number and no choice: how they are said on a command line.
_PLACE, _FILE = "viewpoint", "reference"


def add_settings(parser: Any, *, faces: bool = True) -> None:
    """Add an option for each field of Settings; without it, its default holds."""
    group = parser.add_argument_group("settings of the estimate")
    for item in fields(core.Settings):
        option = "--" + item.name.replace("_", "-")
        about: dict[str, Any] = {"dest": item.name, "default": argparse.SUPPRESS}
        about["help"] = item.metadata["doc"].replace("%", "%%")
        choices = item.metadata["choices"]
        if choices == (True, False):
            about["action"] = argparse.BooleanOptionalAction
        elif choices is not None:
            about["choices"] = [
                choice for choice in choices if faces or choice != "mesh"
            ]
        elif item.name == _PLACE:
            about |= {"nargs": 3, "type": float, "metavar": ("X", "Y", "Z")}
        elif item.name == _FILE:
            about |= {"type": Path, "metavar": "FILE"}
            about["help"] += ", those of a file over the same points"
        else:
            about |= {"type": _number, "metavar": "N"}
        if choices is None and item.name not in (_PLACE, _FILE):
            low, high = item.metadata["limits"] or (None, None)
            if low is not None and high is not None:
                about["help"] += f" ({low:g} to {high:g})"
        group.add_argument(option, **about)


def _number(text: str) -> int | float:
    try:
        return int(text)
    except ValueError:
        pass
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a number, got {text}") from None


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
