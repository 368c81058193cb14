# SPDX-License-Identifier: GPL-3.0-or-later
"""Libraries that are used where they are, and how to get those that are not."""

import sys
from importlib import import_module
from types import ModuleType

from .shape import FileError

# Module -> what pip calls it.
_PACKAGES = {
    "laspy": "laspy[lazrs]",
    "lazrs": "lazrs",
    "dask": "distributed",
    "distributed": "distributed",
}


def needed(name: str, purpose: str) -> ModuleType:
    """Import a library, or raise FileError that says how to install it."""
    try:
        return import_module(name)
    except ImportError:
        raise FileError(
            f"{purpose} need {name}, which is not installed: run "
            f'"{sys.executable}" -m pip install "{_PACKAGES[name]}"'
        ) from None
