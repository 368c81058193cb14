# SPDX-License-Identifier: GPL-3.0-or-later
"""What a person does with mouse and keyboard, in the real program."""

import time

import pytest

LONG = """
import math
n = 300_000
import numpy as np
turn = np.arange(n) * (np.pi * (3 - np.sqrt(5)))
z = 1 - (2 * np.arange(n) + 1) / n
flat = np.sqrt(1 - z * z)
points = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
mesh = bpy.data.meshes.new("Long")
mesh.vertices.add(n)
mesh.attributes["position"].data.foreach_set("vector", points.astype("f").ravel())
obj = bpy.data.objects.new("Long", mesh)
bpy.context.collection.objects.link(obj)
obj.select_set(True)
bpy.context.view_layer.objects.active = obj
bpy.ops.ed.undo_push(message="Long")
"""
HAS = "{!r} in bpy.context.object.data.attributes"
NAMES = "result = sorted(bpy.context.object.data.attributes.keys())"
RUNNING = "[o.bl_idname for o in window.modal_operators]"
# The sidebar covers the right: what is looked at is left of it.
LOOK = """
area.spaces.active.region_3d.view_perspective = "PERSP"
with bpy.context.temp_override(window=window, area=area, region=region):
    bpy.ops.view3d.view_selected()
area.spaces.active.region_3d.view_distance *= 1.3
"""
LIGHT = """
shading = area.spaces.active.shading
result = [shading.light, shading.color_type]
"""
# Gray is 0, the colors of a legend are 0.3 and more.
COLORFUL = 0.2


def add(window, call):
    window.ask(f"{call}\nbpy.ops.ed.undo_push(message='Add')")
    window.ask(LOOK)


def has(name):
    return HAS.format(name)


def test_button_estimates(window, picture):
    add(window, "bpy.ops.mesh.primitive_monkey_add()")
    window.press("timescale.estimate_normals")
    window.wait_for(has("ts_normal"))
    picture()


def test_button_compares_and_the_colors_are_visible(window, picture):
    add(window, "bpy.ops.mesh.primitive_torus_add(major_segments=64)")
    window.press("timescale.compare_delaunay")
    window.wait_for(has("ts_error_color"))
    picture()
    assert window.ask("result = area.spaces.active.shading.color_type") == "VERTEX"
    window.press("timescale.clear_results")
    window.wait_for("not " + has("ts_error_color"))
    assert window.ask("result = area.spaces.active.shading.color_type") == "MATERIAL"
    picture("cleared")


def test_colors_of_points_are_visible_at_once(window, picture):
    """Without a shader to wait for, whichever shading there was."""
    add(window, "bpy.ops.timescale.add_samples(shape='torus', count=3000, noise=0.3)")
    # The outline of what is selected has a color of its own.
    window.ask("area.spaces.active.overlay.show_outline_selected = False")
    before = window.saturation()
    window.press("timescale.compare_delaunay")
    window.wait_for(has("ts_error_color"))
    picture()
    assert window.ask("result = area.spaces.active.shading.type") == "SOLID"
    assert before < COLORFUL < window.saturation()
    # The samples know their true normals.
    assert window.ask("result = " + has("delaunay_error"))
    window.press("timescale.hide_colors")
    window.wait_for("not bpy.context.object.modifiers")
    assert window.saturation() < COLORFUL


def test_both_methods_are_seen_side_by_side(window, picture):
    add(window, "bpy.ops.timescale.add_samples(shape='torus', count=3000, noise=0.3)")
    window.press("timescale.compare_delaunay")
    window.wait_for(has("ts_error_color"))
    window.press("timescale.side_by_side")
    window.wait_for("len(bpy.data.objects) > 1 and " + has("delaunay_error_color"))
    picture()
    names = window.ask("result = [o.name for o in bpy.context.scene.objects]")
    assert names == ["Torus Samples", "Torus Samples Delaunay"]
    window.press("timescale.side_by_side")
    window.wait_for("not " + has("delaunay_error_color"))
    assert window.ask("result = len(bpy.context.scene.objects)") == 1


SIDE = """
bpy.ops.mesh.primitive_cylinder_add(vertices=48, depth=1)
bpy.ops.object.mode_set(mode="EDIT")
bpy.ops.mesh.select_all(action="SELECT")
bpy.ops.mesh.subdivide(number_cuts=3)
bpy.ops.object.mode_set(mode="OBJECT")
bpy.ops.object.shade_smooth()
mesh = bpy.context.object.data
ends = [abs(face.normal.z) > 0.5 for face in mesh.polygons]
"""
MARKS = {
    "sharp": "bpy.ops.object.shade_smooth_by_angle()",
    "seams": """
import bmesh
work = bmesh.new()
work.from_mesh(mesh)
for edge in work.edges:
    flat = [abs(face.normal.z) > 0.5 for face in edge.link_faces]
    edge.seam = any(flat) and not all(flat)
work.to_mesh(mesh)
""",
    "materials": """
for name in "ab":
    mesh.materials.append(bpy.data.materials.new(name))
mesh.polygons.foreach_set("material_index", [int(end) for end in ends])
mesh.update()
""",
}
# The least height of the normals at corners of the flat ends.
UP = """
mesh = bpy.context.object.data
result = min(
    abs(mesh.corner_normals[i].vector.z)
    for face in mesh.polygons if abs(face.normal.z) > 0.5
    for i in face.loop_indices
)
"""


@pytest.mark.parametrize("marks", MARKS)
def test_marked_edges_split_the_normals(window, picture, marks):
    add(window, SIDE + MARKS[marks])
    settings = "bpy.context.scene.timescale_normals"
    window.ask(f"{settings}.split = set()")
    window.press("timescale.estimate_normals")
    window.wait_for(has("ts_normal"))
    assert window.ask(UP) < 0.9
    picture("not")
    window.ask(f"{settings}.split = {{{marks!r}}}")
    window.press("timescale.estimate_normals")
    window.wait_for(
        "bpy.context.object.data.attributes['custom_normal'].domain == 'CORNER'"
    )
    assert window.ask(UP) > 0.999
    picture()


MILLION = """
import numpy as np
n = 1_000_000
turn = np.arange(n) * (np.pi * (3 - np.sqrt(5)))
z = 1 - (2 * np.arange(n) + 1) / n
flat = np.sqrt(1 - z * z)
points = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
mesh = bpy.data.meshes.new("Million")
mesh.vertices.add(n)
mesh.attributes["position"].data.foreach_set("vector", points.astype("f").ravel())
obj = bpy.data.objects.new("Million", mesh)
bpy.context.collection.objects.link(obj)
obj.select_set(True)
bpy.context.view_layer.objects.active = obj
bpy.ops.object.convert(target="POINTCLOUD")
bpy.ops.timescale.estimate_normals(method="time_scale", orientation="outward")
"""


def test_normals_of_a_million_points_are_a_drawn_share(window, picture):
    window.ask(MILLION, 300)
    window.ask(LOOK, 300)
    window.ask("bpy.context.scene.timescale_normals.show_normals = True", 300)
    picture()
    drawn = """
import sys
overlay = sys.modules["bl_ext.user_default.timescale_normals.addon.display.overlay"]
kept = [found[2] for key, found in overlay._kept._found.items() if key[0] == "lines"]
lines = overlay.lines_of(bpy.context.object, share=1.0, length=1.0, baseline=False)
result = [len(kept), len(lines.estimate) // 2]
"""
    assert window.ask(drawn, 300) == [1, 50_000]
    window.ask("bpy.data.objects.remove(bpy.context.object)", 300)


def test_escape_ends_a_long_run_and_leaves_the_object_alone(window, picture):
    window.ask(LONG)
    before = window.ask(NAMES)
    window.press("timescale.estimate_normals")
    window.wait_for(RUNNING)
    window.ask("pass")
    picture("running")
    # The window answers while it computes: the view can be turned.
    view = window.ask("result = list(area.spaces.active.region_3d.view_rotation)")
    window.move(*window.center())
    window.key("KP_1")
    window.wait_for(f"{view} != list(area.spaces.active.region_3d.view_rotation)")
    if not window.ask(f"result = bool({RUNNING})"):
        pytest.skip("the machine was too fast for Esc")
    window.key("Escape")
    window.wait_for(f"not {RUNNING}", 10)
    assert window.ask(NAMES) == before
    picture("stopped")
    # Another run is possible at once.
    window.press("timescale.estimate_normals")
    window.wait_for(has("ts_normal"), 120)


def test_button_beside_the_bar_stops_too(window):
    window.ask(LONG)
    before = window.ask(NAMES)
    window.press("timescale.estimate_normals")
    window.wait_for(RUNNING)
    window.ask("bpy.ops.timescale.stop()")
    window.wait_for(f"not {RUNNING}", 10)
    assert window.ask(NAMES) == before


def test_object_that_goes_meanwhile_is_no_harm(window):
    window.ask(LONG)
    window.press("timescale.estimate_normals")
    window.wait_for(RUNNING)
    window.ask("bpy.data.objects.remove(bpy.data.objects['Long'])")
    window.wait_for(f"not {RUNNING}", 120)


def test_shape_that_changes_meanwhile_is_not_written_to(window):
    window.ask(LONG)
    window.press("timescale.estimate_normals")
    window.wait_for(RUNNING)
    window.ask("bpy.context.object.data.vertices[0].co.x += 1")
    window.wait_for(f"not {RUNNING}", 120)
    assert "ts_normal" not in window.ask(NAMES)


def test_one_undo_takes_a_run_back_and_redo_brings_it_again(window):
    add(window, "bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=5)")
    window.press("timescale.compare_delaunay")
    window.wait_for(has("ts_error"))
    window.move(*window.center())
    window.key("ctrl+z")
    window.wait_for("not " + has("ts_normal"))
    assert window.ask("result = len(bpy.context.object.modifiers)") == 0
    # Viewports are outside of undo, and follow all the same.
    assert window.ask(LIGHT) == ["STUDIO", "MATERIAL"]
    window.key("ctrl+shift+z")
    window.wait_for(has("ts_error"))
    assert window.ask(LIGHT) == ["FLAT", "VERTEX"]


def test_viewport_is_as_before_when_the_colored_object_goes(window):
    add(window, "bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=3)")
    window.press("timescale.compare_delaunay")
    window.wait_for(has("ts_error"))
    assert window.ask(LIGHT) == ["FLAT", "VERTEX"]
    window.move(*window.center())
    window.key("Delete")
    window.wait_for("not bpy.data.objects or bpy.context.object is None")
    window.wait_for("area.spaces.active.shading.light == 'STUDIO'", 5)


def test_estimate_after_a_comparison_shows_the_object_as_it_is(window):
    """Its errors are gone, so colors would stand for nothing."""
    add(window, "bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=3)")
    window.press("timescale.compare_delaunay")
    window.wait_for(has("ts_error"))
    window.press("timescale.estimate_normals")
    window.wait_for("not " + has("ts_error"))
    assert window.ask("result = len(bpy.context.object.modifiers)") == 0
    assert window.ask(LIGHT) == ["STUDIO", "MATERIAL"]


TWO_SPHERES = """
for x in (-2, 2):
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4, location=(x, 0, 0))
    bpy.context.object.select_set(True)
bpy.ops.object.select_all(action="SELECT")
bpy.ops.object.join()
bpy.ops.object.transform_apply(location=True)
bpy.ops.timescale.estimate_normals()
"""
# A key of the user's own, with the mouse where the piece is.
KEY = """
keys = bpy.context.window_manager.keyconfigs.addon.keymaps.new(name="Object Mode")
item = keys.keymap_items.new("timescale.reorient_normals", "J", "PRESS")
item.properties.mode, item.properties.part = "flip", "piece"
"""
NO_KEY = """
keys = bpy.context.window_manager.keyconfigs.addon.keymaps["Object Mode"]
for item in keys.keymap_items:
    if item.idname == "timescale.reorient_normals":
        keys.keymap_items.remove(item)
"""
# Where a place of the world is in the window.
AT = """
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Vector
at = location_3d_to_region_2d(region, area.spaces.active.region_3d, Vector({}))
result = at.x + region.x, at.y + region.y
"""
# Which sphere has normals that face out, left and right.
OUTWARD = """
import numpy as np
data = bpy.context.object.data
points, normals = np.empty((2, len(data.vertices) * 3), np.float32)
data.attributes["position"].data.foreach_get("vector", points)
data.attributes["ts_normal"].data.foreach_get("vector", normals)
points, normals = points.reshape(-1, 3), normals.reshape(-1, 3)
left = points[:, 0] < 0
points[:, 0] += np.where(left, 2, -2)
out = (points * normals).sum(axis=1) > 0
result = [bool(out[side].all()) for side in (left, ~left)] + [
    bool((~out)[side].all()) for side in (left, ~left)
]
"""


def test_piece_under_the_mouse_is_turned_over_and_back(window, picture):
    add(window, TWO_SPHERES)
    assert window.ask(OUTWARD) == [True, True, False, False]
    window.ask(KEY)
    window.move(*window.ask(AT.format((-2, 0, 0))))
    window.key("j")
    window.wait(lambda: window.ask(OUTWARD) == [False, True, True, False], 10)
    picture()
    window.move(*window.center())
    window.key("ctrl+z")
    assert window.ask(OUTWARD) == [True, True, False, False]
    window.key("ctrl+shift+z")
    assert window.ask(OUTWARD) == [False, True, True, False]
    window.ask(NO_KEY)


PICKED = "result = bpy.context.object.data.timescale_normals.picked"


def test_clicked_point_says_its_values(window, picture):
    add(
        window,
        "bpy.ops.timescale.add_samples(shape='torus', count=500, noise=0.1)\n"
        "bpy.ops.timescale.compare_delaunay(truth='true_normal', show_colors=True)",
    )
    window.press("timescale.pick_point")
    window.wait_for(RUNNING)
    window.move(*window.center())
    window.key("Escape")
    window.wait_for(f"not {RUNNING}", 5)
    assert window.ask(PICKED) == -1
    # From above, the highest point is in nobody's shadow.
    window.ask("area.spaces.active.region_3d.view_rotation = (1, 0, 0, 0)")
    window.ask(LOOK)
    top = window.ask(
        """
data = bpy.context.object.data.attributes["position"].data
index = max(range(len(data)), key=lambda i: data[i].vector.z)
result = index, *data[index].vector
"""
    )
    window.press("timescale.pick_point")
    window.wait_for(RUNNING)
    window.click(*window.ask(AT.format(tuple(top[1:]))))
    window.wait_for("bpy.context.object.data.timescale_normals.picked >= 0")
    assert window.ask(PICKED) == top[0]
    picture()
    window.move(*window.center())
    window.key("ctrl+z")
    assert window.ask(PICKED) == -1


def test_operator_is_found_by_its_name(window):
    add(window, "bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4)")
    window.move(*window.center())
    # What F3 is bound to, which not every display passes on.
    window.ask(
        """
with bpy.context.temp_override(window=window, area=area, region=region):
    bpy.ops.wm.search_menu("INVOKE_DEFAULT")
"""
    )
    time.sleep(2)
    window.type("estimate normals")
    time.sleep(2)
    window.key("Return")
    window.wait_for(has("ts_normal"))


def test_normals_are_drawn_and_follow_the_shape(window, picture):
    add(window, "bpy.ops.timescale.add_samples(shape='torus', count=2000)")
    window.ask(
        """
bpy.ops.timescale.compare_delaunay(truth="true_normal")
settings = bpy.context.scene.timescale_normals
settings.show_normals = settings.show_baseline = True
"""
    )
    window.ask(LOOK)
    picture()
    kept = """
import sys
overlay = sys.modules["bl_ext.user_default.timescale_normals.addon.display.overlay"]
result = len([key for key in overlay._kept._found if key[0] == "lines"])
"""
    assert window.ask(kept) == 1
    window.ask("bpy.ops.timescale.clear_results(); area.tag_redraw()")
    picture("cleared")
    window.ask("bpy.data.objects.remove(bpy.context.object); area.tag_redraw()")
    time.sleep(1)


def test_patch_is_shown(window, picture):
    add(
        window,
        "bpy.ops.timescale.add_samples(shape='bumpy', count=1500)\n"
        "bpy.context.scene.cursor.location = (0.8, -0.6, 0.4)",
    )
    window.press("timescale.show_patch")
    window.wait_for("'Patch' in bpy.data.objects")
    window.ask(
        """
bpy.ops.object.select_all(action="DESELECT")
bpy.data.objects["Neighbors"].select_set(True)
area.spaces.active.region_3d.view_perspective = "PERSP"
"""
    )
    window.ask(LOOK)
    picture()


def test_the_whole_panel_can_be_read(window, picture):
    add(window, "bpy.ops.timescale.add_samples(shape='sphere', count=2000, noise=0.2)")
    window.ask(
        """
bpy.ops.timescale.compare_delaunay(truth="true_normal")
for number in range(3):
    bpy.ops.ed.undo_push(message="Sample")
"""
    )
    picture()


def test_extension_goes_while_it_draws_and_computes(window):
    window.ask(LONG)
    window.press("timescale.estimate_normals")
    window.wait_for(RUNNING)
    module = "bl_ext.user_default.timescale_normals"
    window.ask(f"bpy.ops.preferences.addon_disable(module={module!r})")
    time.sleep(2)
    window.ask(f"bpy.ops.preferences.addon_enable(module={module!r})")
    window.open_sidebar()
    window.press("timescale.estimate_normals")
    window.wait_for(has("ts_normal"), 120)


def test_program_ends_in_the_middle_of_a_run(window):
    """The last one: nothing is left to ask."""
    window.ask(LONG)
    window.press("timescale.estimate_normals")
    window.wait_for(RUNNING)
    window.quit()
    assert window.blender.returncode == 0
