# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the pictures of guide.md: every step in the real program, seen as it is.

    guide.py --zip FILE

Needs what tests/app needs: Blender and X tools on PATH or in TIMESCALE_CHROOT.
"""

import argparse
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PICTURES = ROOT / "docs" / "pictures"
sys.path.insert(0, str(ROOT / "tests" / "app"))

import window as app  # noqa: E402 - found by the line above

LOOK = """
area.spaces.active.region_3d.view_perspective = "PERSP"
with bpy.context.temp_override(window=window, area=area, region=region):
    bpy.ops.view3d.view_selected()
# The sidebar covers the right.
area.spaces.active.region_3d.view_distance *= 1.25
"""
EMPTY = """
bpy.data.batch_remove(
    [*bpy.data.objects, *bpy.data.meshes, *bpy.data.collections[1:]]
)
bpy.context.scene.property_unset("timescale_normals")
"""
# The highest point is in nobody's shadow.
PICK = """
places = bpy.context.object.data.attributes["position"].data
top = max(range(len(places)), key=lambda index: places[index].vector.z)
bpy.ops.timescale.pick_point(index=top)
bpy.context.scene.timescale_normals.color_map = "viridis"
"""

# Name of the picture, what is done for it, and a button that is pressed then.
STEPS = (
    (
        "estimate",
        EMPTY + "bpy.ops.mesh.primitive_monkey_add(); bpy.ops.object.shade_smooth()",
        "timescale.estimate_normals",
    ),
    (
        "split",
        EMPTY + "bpy.ops.mesh.primitive_cylinder_add(vertices=64, depth=0.7)\n"
        "bpy.ops.object.mode_set(mode='EDIT')\n"
        "bpy.ops.mesh.select_all(action='SELECT')\n"
        "bpy.ops.mesh.subdivide(number_cuts=4)\n"
        "bpy.ops.object.mode_set(mode='OBJECT')\n"
        "bpy.ops.object.shade_smooth_by_angle()",
        "timescale.estimate_normals",
    ),
    (
        "samples",
        EMPTY + "bpy.ops.timescale.add_samples(shape='torus', count=3000, seed=1)\n"
        "bpy.context.scene.timescale_normals.show_normals = True",
        "timescale.estimate_normals",
    ),
    (
        "points",
        EMPTY + "bpy.ops.timescale.add_samples("
        "shape='bumpy', count=4000, noise=0.2)\n"
        "bpy.ops.ed.undo_push(message='Add')",
        "timescale.compare_delaunay",
    ),
    ("pick", PICK, None),
    (
        "compare",
        EMPTY + "bpy.ops.mesh.primitive_torus_add(major_segments=96)\n"
        "bpy.ops.object.duplicate(); fine = bpy.context.object\n"
        "fine.name = 'Fine'\n"
        "fine.modifiers.new('Fine', 'SUBSURF').levels = 2\n"
        "fine.modifiers['Fine'].subdivision_type = 'CATMULL_CLARK'\n"
        "bpy.ops.object.shade_smooth(); fine.hide_set(True)\n"
        "torus = bpy.data.objects['Torus']; torus.select_set(True)\n"
        "bpy.context.view_layer.objects.active = torus\n"
        "bpy.context.scene.timescale_normals.truth_object = fine",
        "timescale.compare_delaunay",
    ),
    ("ratio", "bpy.context.scene.timescale_normals.color_by = 'log_ratio'", None),
    (
        "beside",
        "bpy.context.scene.timescale_normals.color_by = 'angle_estimate'",
        "timescale.side_by_side",
    ),
    (
        "patch",
        EMPTY + "bpy.ops.timescale.add_samples(shape='bumpy', count=1500)\n"
        "bpy.context.scene.cursor.location = (0.8, -0.6, 0.4)\n"
        "bpy.ops.timescale.show_patch()\n"
        "bpy.context.object.hide_set(True)\n"
        "bpy.data.objects['Neighbors'].select_set(True)",
        None,
    ),
)


def take(window: app.Window, name: str) -> None:
    """Take a picture and make it small enough for a page."""
    options = "-crop 1150x830+0+0 +repage -resize 900x -dither None -colors 256"
    path = window.picture(PICTURES / f"{name}.png", options)
    print(f"  {path.relative_to(ROOT)}")


def main() -> None:
    """Open the window and go through the steps."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--zip", type=Path, required=True)
    package = parser.parse_args().zip
    missing = app.missing()
    if missing:
        sys.exit(f"guide.py: needs {', '.join(missing)}; see tests/app/chroot.sh")
    window = app.Window(package)
    try:
        window.open_sidebar()
        for name, code, button in STEPS:
            window.ask(code)
            window.ask(LOOK)
            if button:
                window.press(button)
                window.wait_for("'ts_normal' in bpy.context.object.data.attributes")
                time.sleep(2)
            take(window, name)
    finally:
        window.close()


if __name__ == "__main__":
    main()
