# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel that says what to do where SciPy is missing."""

import logging

import bpy

SENTENCE = (
    "SciPy is missing: install Time-Scale Normals again, from the package "
    "made for this operating system and this version of Blender"
)


class VIEW3D_PT_timescale_missing(bpy.types.Panel):
    """Stands where the tools would be."""

    bl_label = "Time-Scale Normals"
    bl_category = "Time-Scale"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"

    def draw(self, _context: bpy.types.Context) -> None:
        """Show the sentence, one part a line: labels do not wrap."""
        column = self.layout.column(align=True)
        column.alert = True
        problem, cure = SENTENCE.split(": ")
        column.label(text=problem, icon="ERROR")
        for part in cure.split(", "):
            column.label(text=part[0].upper() + part[1:])


def register() -> None:
    """Add the panel, and say it where there is no window too."""
    bpy.utils.register_class(VIEW3D_PT_timescale_missing)
    logging.getLogger(__name__).error(SENTENCE)


def unregister() -> None:
    """Remove the panel."""
    bpy.utils.unregister_class(VIEW3D_PT_timescale_missing)
