# SPDX-License-Identifier: GPL-3.0-or-later
"""Entry point of the extension: Blender imports it and calls these two."""


def register() -> None:
    """Add the operators, the panel and the settings to Blender."""
    # Imported here because the tests of `core` collect this folder without Blender.
    from . import addon

    addon.register()


def unregister() -> None:
    """Take everything that `register` added out of Blender again."""
    from . import addon

    addon.unregister()
