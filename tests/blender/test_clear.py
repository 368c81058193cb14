# SPDX-License-Identifier: GPL-3.0-or-later
"""`timescale.clear_results` brings back what was there before, bit for bit."""

import bpy
import numpy as np
import pytest
import scenes


def run_all(**settings):
    bpy.ops.timescale.estimate_normals(**settings)
    bpy.ops.timescale.compare_delaunay()
    # Again, with results there: the first backup has to survive.
    bpy.ops.timescale.estimate_normals(**settings)
    bpy.ops.timescale.compare_delaunay()


def clear():
    return bpy.ops.timescale.clear_results()


OWN_NORMALS = {
    "none": lambda _: None,
    "tangent space": scenes.set_tangent_normals,
    "free on points": scenes.set_free_normals,
    "free on corners": lambda obj: scenes.set_free_normals(obj, "CORNER"),
    "free on faces": lambda obj: scenes.set_free_normals(obj, "FACE"),
}


@pytest.mark.parametrize("storage", ["free", "tangent_space"])
@pytest.mark.parametrize("own", OWN_NORMALS)
def test_custom_normals_come_back(own, storage):
    obj = scenes.sphere(3)
    OWN_NORMALS[own](obj)
    before = scenes.snapshot(obj)
    run_all(storage=storage)
    assert scenes.snapshot(obj)["shading"] != before["shading"]
    assert clear() == {"FINISHED"}
    assert scenes.snapshot(obj) == before


@pytest.mark.parametrize("storage", ["free", "tangent_space"])
def test_custom_normals_with_sharp_edges_and_flat_faces_come_back(storage):
    bpy.ops.mesh.primitive_monkey_add()
    obj = bpy.context.object
    rng = np.random.default_rng(0)
    scenes.put(
        obj,
        "sharp_edge",
        "BOOLEAN",
        rng.random(len(obj.data.edges)) < 0.1,
        domain="EDGE",
    )
    flat = rng.random(len(obj.data.polygons)) < 0.3
    obj.data.polygons.foreach_set("use_smooth", ~flat)
    scenes.set_tangent_normals(obj)
    before = scenes.snapshot(obj)
    run_all(storage=storage)
    clear()
    assert scenes.snapshot(obj) == before


def test_attributes_of_the_user_s_with_our_names_come_back():
    obj = scenes.sphere(3)
    rng = np.random.default_rng(0)
    n, c = len(obj.data.vertices), len(obj.data.loops)
    scenes.put(obj, "ts_normal", "FLOAT_VECTOR", rng.random((n, 3)))
    scenes.put(obj, "ts_valid", "FLOAT", rng.random(n))
    scenes.put(obj, "ts_error", "INT", rng.integers(0, 99, c), domain="CORNER")
    scenes.put(obj, "delaunay_normal", "FLOAT2", rng.random((c, 2)), domain="CORNER")
    scenes.put(obj, "delaunay_error", "BOOLEAN", rng.random(n) < 0.5)
    scenes.put(obj, "ts_error_color", "FLOAT_COLOR", rng.random((n, 4)))
    obj.data.attributes.active_color_name = "ts_error_color"
    before = scenes.snapshot(obj)
    run_all()
    assert scenes.get(obj, "ts_valid").dtype == np.bool_
    clear()
    assert scenes.snapshot(obj) == before


def test_attributes_of_a_point_cloud_come_back():
    ball = scenes.ball()
    obj = scenes.new_cloud(ball, ts_normal=ball, ts_error=ball, normal=ball)
    before = scenes.snapshot(obj)
    run_all()
    assert obj.data.attributes["ts_error"].data_type == "FLOAT"
    clear()
    assert scenes.snapshot(obj) == before


@pytest.mark.parametrize("colors", [(), ("mine",), ("mine", "ts_error_color")])
def test_active_color_comes_back(colors):
    obj = scenes.sphere(3)
    for name in colors:
        scenes.put(obj, name, "FLOAT_COLOR", np.ones((len(obj.data.vertices), 4)))
    before = scenes.snapshot(obj)
    assert before["active color"] == (colors[0] if colors else "")
    bpy.ops.timescale.compare_delaunay()
    assert obj.data.attributes.active_color_name == "ts_error_color"
    clear()
    assert scenes.snapshot(obj) == before


def test_color_that_the_user_chose_since_stays():
    obj = scenes.sphere(3)
    bpy.ops.timescale.compare_delaunay()
    obj.data.attributes.new("later", "FLOAT_COLOR", "POINT")
    obj.data.attributes.active_color_name = "later"
    clear()
    assert obj.data.attributes.active_color_name == "later"


def test_edges_made_sharp_since_stay_sharp():
    obj = scenes.sphere(3)
    run_all(storage="tangent_space")
    scenes.put(
        obj, "sharp_edge", "BOOLEAN", np.ones(len(obj.data.edges)), domain="EDGE"
    )
    clear()
    assert scenes.get(obj, "sharp_edge").all()


def test_nothing_to_clear_is_no_error(capfd):
    obj = scenes.sphere(3)
    before = scenes.snapshot(obj)
    assert clear() == {"CANCELLED"}
    assert scenes.snapshot(obj) == before
    assert "nothing to clear" in capfd.readouterr().out


def test_attributes_that_only_look_like_ours_are_not_cleared():
    obj = scenes.sphere(3)
    scenes.put(obj, "ts_error", "FLOAT", np.ones(len(obj.data.vertices)))
    before = scenes.snapshot(obj)
    assert clear() == {"CANCELLED"}
    assert scenes.snapshot(obj) == before


def test_clears_all_selected_objects_at_once():
    objects = [scenes.sphere(3), scenes.new_cloud(scenes.ball())]
    befores = [scenes.snapshot(obj) for obj in objects]
    scenes.select(*objects)
    run_all()
    clear()
    assert [scenes.snapshot(obj) for obj in objects] == befores


@pytest.mark.parametrize("storage", ["free", "tangent_space"])
def test_clears_in_edit_mode(storage):
    obj = scenes.sphere(3)
    scenes.set_tangent_normals(obj)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.object.mode_set(mode="OBJECT")
    before = scenes.snapshot(obj)
    bpy.ops.object.mode_set(mode="EDIT")
    run_all(storage=storage)
    clear()
    assert obj.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    assert scenes.snapshot(obj) == before


def test_survives_saving_and_loading(tmp_path):
    obj = scenes.sphere(3)
    scenes.set_tangent_normals(obj)
    scenes.put(obj, "ts_normal", "FLOAT", np.arange(len(obj.data.vertices)))
    before = scenes.snapshot(obj)
    run_all()
    kept = scenes.get(obj, "ts_normal")
    path = str(tmp_path / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    obj = bpy.context.object
    np.testing.assert_array_equal(scenes.get(obj, "ts_normal"), kept)
    clear()
    after = scenes.snapshot(obj)
    # Files do not keep every internal flag of the selection.
    hidden = {name for name in before if name.startswith(".")}
    for name in before.keys() - hidden:
        assert after[name] == before[name], name


def test_copies_clear_each_on_its_own():
    obj = scenes.sphere(3)
    scenes.set_tangent_normals(obj)
    before = scenes.snapshot(obj)
    run_all()
    copy = obj.copy()
    copy.data = obj.data.copy()
    scenes.link(copy)
    clear()
    assert scenes.snapshot(copy) == before
    assert "ts_normal" in obj.data.attributes


def test_what_remains_comes_back_after_points_were_removed(capfd):
    obj = scenes.sphere(3)
    scenes.set_tangent_normals(obj)
    n = len(obj.data.vertices)
    numbers = np.arange(n)
    scenes.put(obj, "ts_error", "INT", numbers)
    run_all()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="DESELECT")
    bpy.ops.object.mode_set(mode="OBJECT")
    obj.data.vertices[5].select = True
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.delete(type="VERT")
    assert clear() == {"FINISHED"}
    bpy.ops.object.mode_set(mode="OBJECT")
    np.testing.assert_array_equal(scenes.get(obj, "ts_error"), np.delete(numbers, 5))
    assert obj.data.attributes["custom_normal"].data_type == "INT16_2D"
    assert "points were added or removed since" in capfd.readouterr().out


def test_mesh_that_became_a_point_cloud_is_cleared_too():
    obj = scenes.new_mesh(scenes.ball())
    scenes.put(obj, "ts_error", "FLOAT", np.arange(600))
    run_all()
    bpy.ops.object.convert(target="POINTCLOUD")
    obj = bpy.context.object
    clear()
    names = {name for name in obj.data.attributes.keys() if not name.startswith(".")}
    assert names == {"position", "ts_error"}
    np.testing.assert_array_equal(scenes.get(obj, "ts_error"), np.arange(600))


def test_undo_takes_a_run_back_in_one_step():
    obj = scenes.sphere(3)
    bpy.ops.ed.undo_push(message="Before")
    if not bpy.ops.ed.undo.poll():
        pytest.skip("there is no undo without a window")
    bpy.ops.timescale.compare_delaunay()
    bpy.ops.ed.undo()
    assert "ts_normal" not in bpy.data.objects[obj.name].data.attributes
