# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples, patches to look at, presets and reports."""

import csv
import io
import json
from pathlib import Path

import bpy
import numpy as np
import pytest
import scenes
from bl_ext.user_default.timescale_normals import core
from bl_ext.user_default.timescale_normals.addon.display import patch_view
from bl_ext.user_default.timescale_normals.addon.operators import report
from bl_ext.user_default.timescale_normals.addon.settings import presets

# Samples


@pytest.mark.parametrize("shape", core.shapes.ALL)
@pytest.mark.parametrize("as_mesh", [False, True])
def test_samples_lie_on_their_surface_with_true_normals(shape, as_mesh):
    bpy.context.scene.cursor.location = (1, 2, 3)
    made = bpy.ops.timescale.add_samples(shape=shape, count=300, as_mesh=as_mesh)
    assert made == {"FINISHED"}
    obj = bpy.context.object
    assert obj.type == ("MESH" if as_mesh else "POINTCLOUD")
    assert tuple(obj.location) == (1, 2, 3)
    points, normals, _ = core.shapes.ALL[shape].sample(300, 0)
    np.testing.assert_allclose(scenes.points_of(obj), points, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(scenes.get(obj, "true_normal"), normals, atol=1e-6)
    assert len(bpy.data.meshes) == int(as_mesh)
    if not as_mesh:
        assert (scenes.get(obj, "radius") > 0).all()


def test_samples_can_be_compared_at_once():
    bpy.ops.timescale.add_samples(shape="torus", count=1500)
    obj = bpy.context.object
    bpy.ops.timescale.compare_delaunay(truth="true_normal")
    found = json.loads(obj.data.timescale_normals.summary)["comparison"]
    assert found["wins_percent"] > 80


def test_noise_is_a_share_of_the_diagonal_and_leaves_the_truth():
    bpy.ops.timescale.add_samples(shape="sphere", count=2000, noise=1)
    obj = bpy.context.object
    off = np.linalg.norm(scenes.points_of(obj), axis=1) - 1
    # Of a cube with sides of 2.
    assert abs(off.std() / (0.01 * np.sqrt(12)) - 1) < 0.1
    lengths = np.linalg.norm(scenes.get(obj, "true_normal"), axis=1)
    np.testing.assert_allclose(lengths, 1, atol=1e-6)


def test_other_seeds_give_other_points():
    found = []
    for seed in (1, 1, 2):
        bpy.ops.timescale.add_samples(shape="sphere", count=100, seed=seed)
        found.append(scenes.points_of(bpy.context.object))
    np.testing.assert_array_equal(found[0], found[1])
    assert not np.array_equal(found[0], found[2])


def test_samples_are_not_added_in_edit_mode():
    scenes.sphere(3)
    bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(RuntimeError, match="Leave Edit Mode first"):
        bpy.ops.timescale.add_samples()


# Patches


def parts():
    home = next(c for c in bpy.data.collections if c.name.startswith("Patch of"))
    return {obj.name: obj for obj in home.objects}


def test_patch_of_a_cloud_is_at_the_point_nearest_to_the_cursor():
    obj = scenes.new_cloud(scenes.ball())
    obj.location = (0, 0, 5)
    bpy.context.scene.cursor.location = (0, 0, 7)
    before = scenes.snapshot(obj)
    assert bpy.ops.timescale.show_patch() == {"FINISHED"}
    assert scenes.snapshot(obj) == before
    made = parts()
    assert set(made) == set(patch_view.COLORS)
    nearest = scenes.points_of(obj)[scenes.points_of(obj)[:, 2].argmax()]
    place = nearest + np.array(obj.location)
    for part in made.values():
        np.testing.assert_allclose(part.location, place, atol=1e-5)
    # The patch goes through the neighborhood of its point, on the unit sphere.
    sheet = made["Patch"]
    on = scenes.points_of(sheet) + nearest
    near = np.linalg.norm(scenes.points_of(sheet), axis=1) < 0.2
    assert np.abs(np.linalg.norm(on[near], axis=1) - 1).max() < 0.01


def test_grid_of_a_patch_is_its_two_time_scales():
    scenes.new_cloud(scenes.ball())
    bpy.ops.timescale.show_patch()
    curve = parts()["Time-Scale Grid"].data
    counts = sorted({len(spline.points) for spline in curve.splines})
    assert sum(len(s.points) for s in curve.splines) == 2 * counts[0] * counts[-1]
    lines = [*parts()["Tangents"].data.splines, *parts()["Normal"].data.splines]
    first, second, normal = (np.array(s.points[1].co[:3]) for s in lines)
    assert abs(first @ normal) < 1e-4 * (normal @ normal)
    assert abs(second @ normal) < 1e-4 * (normal @ normal)


def test_patch_of_a_mesh_is_at_the_active_vertex():
    obj = scenes.sphere()
    bpy.ops.object.mode_set(mode="EDIT")
    import bmesh

    mesh = bmesh.from_edit_mesh(obj.data)
    mesh.verts.ensure_lookup_table()
    mesh.select_history.add(mesh.verts[17])
    bpy.ops.timescale.show_patch()
    assert obj.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    place = parts()["Patch"].location
    np.testing.assert_allclose(place, scenes.points_of(obj)[17], atol=1e-6)


def test_patch_is_at_the_picked_point():
    obj = scenes.new_cloud(scenes.ball())
    bpy.ops.timescale.estimate_normals()
    bpy.ops.timescale.pick_point(index=17)
    bpy.ops.timescale.show_patch()
    place = parts()["Patch"].location
    np.testing.assert_allclose(place, scenes.points_of(obj)[17], atol=1e-6)


def test_patch_follows_the_settings_of_the_estimate():
    obj = scenes.new_cloud(scenes.ball())
    bpy.ops.timescale.estimate_normals(neighbors=20)
    bpy.ops.timescale.show_patch()
    assert neighbors_shown() == 20
    found = json.loads(obj.data.timescale_normals.summary)["estimate"]
    used = patch_view.settings_used(bpy.context, obj)
    assert (used.neighbors, used.patch) == (20, found["patch"])


def neighbors_shown():
    # Each is an octahedron.
    return len(parts()["Neighbors"].data.vertices) // 6


def test_patch_of_noisy_points_is_as_wide_as_the_estimate_s():
    rng = np.random.default_rng(0)
    points = scenes.ball(2500)
    obj = scenes.new_cloud(points + rng.normal(scale=0.02, size=points.shape))
    bpy.ops.timescale.show_patch()
    shown = neighbors_shown()
    assert shown > 50
    bpy.ops.timescale.estimate_normals()
    found = json.loads(obj.data.timescale_normals.summary)["estimate"]
    assert found["neighbors"] == shown


def test_patch_ends_at_sharp_edges():
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.subdivide(number_cuts=9)
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.object.shade_smooth_by_angle()
    # One row below the rim of the upper face.
    bpy.context.scene.cursor.location = (0, 0.8, 1)
    bpy.ops.timescale.show_patch()
    heights = scenes.points_of(parts()["Patch"])[:, 2]
    assert np.abs(heights).max() < 1e-6


def test_point_without_a_patch():
    obj = scenes.new_mesh(scenes.ball(8))
    with pytest.raises(RuntimeError, match=f"^Error: {obj.name}: "):
        bpy.ops.timescale.show_patch()
    assert not bpy.data.collections


# Presets


def test_preset_brings_the_settings_back():
    settings = bpy.context.scene.timescale_normals
    settings.method, settings.neighbors = "time_scale", 33
    bpy.ops.timescale.add_preset(name="Mine")
    settings.method, settings.neighbors = "auto", 0
    [folder] = bpy.utils.preset_paths("timescale_normals")
    [path] = Path(folder).glob("*.py")
    bpy.ops.script.execute_preset(
        filepath=str(path), menu_idname="TIMESCALE_PT_presets"
    )
    assert (settings.method, settings.neighbors) == ("time_scale", 33)
    bpy.ops.timescale.add_preset(name="Mine", remove_name=True)


def test_presets_name_settings_that_are_there():
    settings = bpy.context.scene.timescale_normals
    for name in presets.TIMESCALE_OT_add_preset.preset_values:
        assert hasattr(settings, name.removeprefix("settings."))


# Reports


def compared():
    objects = [scenes.sphere(3), scenes.new_cloud(scenes.ball())]
    scenes.select(*objects)
    bpy.ops.timescale.compare_delaunay()
    return objects


def test_report_has_a_row_for_each_object(tmp_path):
    objects = compared()
    path = tmp_path / "report.csv"
    assert bpy.ops.timescale.export_report(filepath=str(path)) == {"FINISHED"}
    rows = list(csv.DictReader(io.StringIO(path.read_text("utf-8"))))
    assert {row["object"] for row in rows} == {obj.name for obj in objects}
    assert all(float(row["angle_deviation_rms"]) > 0 for row in rows)


def test_report_for_scripts_keeps_numbers(tmp_path):
    compared()
    path = tmp_path / "report.json"
    bpy.ops.timescale.export_report(filepath=str(path), kind="JSON")
    rows = json.loads(path.read_text("utf-8"))
    assert all(isinstance(row["points"], int) for row in rows)
    assert rows == report.rows_of(bpy.context)
    assert list(tmp_path.iterdir()) == [path]


def test_report_to_a_folder_that_is_not_there(tmp_path):
    compared()
    with pytest.raises(RuntimeError, match="No such file"):
        bpy.ops.timescale.export_report(filepath=str(tmp_path / "no" / "r.csv"))


def test_nothing_to_report():
    scenes.sphere(3)
    with pytest.raises(RuntimeError, match="Estimate or compare normals first"):
        bpy.ops.timescale.copy_report()
