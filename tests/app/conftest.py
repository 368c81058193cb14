# SPDX-License-Identifier: GPL-3.0-or-later
"""One window for all tests of the real program; every test gets an empty scene."""

import os
from pathlib import Path

import pytest
import window as app

PICTURES = Path(__file__).resolve().parents[2] / "out" / "app"


@pytest.fixture(scope="session")
def program():
    """Blender in a window, with the zip that TIMESCALE_ZIP names."""
    package = Path(os.environ.get("TIMESCALE_ZIP", ""))
    if not package.is_file():
        pytest.fail("TIMESCALE_ZIP does not name a built zip; run `make test-app`")
    missing = app.missing()
    if missing:
        pytest.skip(f"no window without {', '.join(missing)}; see tests/app/chroot.sh")
    opened = app.Window(package)
    try:
        opened.ask("result = bpy.app.version_string")
        yield opened
    finally:
        opened.close()


@pytest.fixture
def window(program):
    """The window with nothing in the scene and the panel open."""
    program.ask(
        """
if bpy.context.mode != "OBJECT":
    bpy.ops.object.mode_set(mode="OBJECT")
shapes = [*bpy.data.meshes, *bpy.data.pointclouds, *bpy.data.collections]
bpy.data.batch_remove([*bpy.data.objects, *shapes])
bpy.context.scene.property_unset("timescale_normals")
area.spaces.active.shading.type = "SOLID"
area.spaces.active.shading.color_type = "MATERIAL"
area.spaces.active.shading.light = "STUDIO"
area.spaces.active.overlay.show_outline_selected = True
bpy.ops.ed.undo_push(message="Empty")
"""
    )
    program.open_sidebar()
    yield program
    assert "Traceback" not in program.said(), program.said()


@pytest.fixture
def picture(window, request):
    """Take a picture into out/app, named after the test."""

    def take(name=""):
        label = request.node.name.removeprefix("test_") + (name and f"_{name}")
        label = label.replace("[", "_").replace("]", "")
        return window.picture(PICTURES / f"{label}.png")

    return take
