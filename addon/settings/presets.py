# SPDX-License-Identifier: GPL-3.0-or-later
"""Presets of the settings, in the menu of the panel's header."""

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel
from bpy.types import Operator, Panel

from .properties import EstimateOptions
from .scene import PROPERTY

_FOLDER = "timescale_normals"
# What names a place or an attribute of one file is no preset for another.
_LEFT_OUT = {"viewpoint", "reference", "vertex_group"}


class TIMESCALE_PT_presets(PresetPanel, Panel):
    """The menu."""

    bl_label = "Time-Scale Presets"
    preset_subdir = _FOLDER
    preset_operator = "script.execute_preset"
    preset_add_operator = "timescale.add_preset"


class TIMESCALE_OT_add_preset(AddPresetBase, Operator):
    """Keep the settings of the scene under a name."""

    bl_idname = "timescale.add_preset"
    bl_label = "Add Time-Scale Preset"
    bl_description = "Keep the settings under a name, or remove the chosen preset"
    preset_menu = "TIMESCALE_PT_presets"
    preset_subdir = _FOLDER
    # Blender wants plain lists.
    preset_defines = [f"settings = bpy.context.scene.{PROPERTY}"]  # noqa: RUF012
    preset_values = [  # noqa: RUF012
        f"settings.{name}"
        for name in EstimateOptions.__annotations__
        if name not in _LEFT_OUT
    ]


register, unregister = bpy.utils.register_classes_factory(
    (TIMESCALE_PT_presets, TIMESCALE_OT_add_preset)
)
