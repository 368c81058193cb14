# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands around the core: files, the command line and all that knows Blender.

Importing this package alone does not need Blender.
"""

from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

# In the order of registration; each has register() and unregister().
MODULES = (
    "settings.scene",
    "operators.run",
    "operators.estimate",
    "operators.sides",
    "operators.repair",
    "display.coloring",
    "display.dress",
    "display.overlay",
    "display.picking",
    "display.patch_view",
    "operators.report",
    "operators.samples",
    "settings.presets",
    "panel",
    "cli",
)
# What stands in for them where a library that the core needs is not installed.
FALLBACK = ("missing",)


def register() -> None:
    """Add the settings, operators and panels to Blender."""
    for module in _modules():
        module.register()


def unregister() -> None:
    """Take them out again, last in, first out."""
    for module in reversed(_modules()):
        module.unregister()


def _modules() -> list[ModuleType]:
    names = MODULES if find_spec("scipy") else FALLBACK
    return [import_module(f".{name}", __package__) for name in names]
