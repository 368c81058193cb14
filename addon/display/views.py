# SPDX-License-Identifier: GPL-3.0-or-later
"""How viewports shade while colors are shown, and how they did before.

What they did before is kept on their screens: undo does not touch screens, and would
take back what is kept anywhere else while the shading stays.
"""

import json
from collections.abc import Iterator
from typing import Any

import bpy

_BEFORE = "timescale_shading"
# What changes. Light and gloss would change the colors; edges and dents show the shape.
_LOOK = {
    # Solid shading shows colors at once, without a shader compiled.
    "color_type": "VERTEX",
    "light": "FLAT",
    "show_specular_highlight": False,
    "show_cavity": True,
}
_WITHOUT_COLORS = {"WIREFRAME", "MATERIAL"}


def show_colors() -> None:
    """Let every viewport show colors as they are, where it does not yet."""
    for screen in bpy.data.screens:
        if _BEFORE in screen.keys():
            continue
        before = {}
        for index, shading in _shadings(screen):
            before[index] = {name: getattr(shading, name) for name in ("type", *_LOOK)}
            for name, value in _LOOK.items():
                setattr(shading, name, value)
            if shading.type in _WITHOUT_COLORS:
                shading.type = "SOLID"
        screen[_BEFORE] = json.dumps(before)


def show_them() -> bool:
    """Whether viewports show colors because of us."""
    return any(_BEFORE in screen.keys() for screen in bpy.data.screens)


def hide_colors() -> None:
    """Set every viewport back to how it was."""
    for screen in bpy.data.screens:
        if _BEFORE not in screen.keys():
            continue
        before = json.loads(screen[_BEFORE])
        for index, shading in _shadings(screen):
            for name, value in before.get(index, {}).items():
                setattr(shading, name, value)
        del screen[_BEFORE]


def _shadings(screen: bpy.types.Screen) -> Iterator[tuple[str, Any]]:
    """Yield a name and the shading of every 3D viewport of a screen."""
    for index, area in enumerate(screen.areas):
        for space in area.spaces:
            if isinstance(space, bpy.types.SpaceView3D):
                yield str(index), space.shading
