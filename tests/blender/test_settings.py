# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings, panels and registration."""

import dataclasses

import bpy
import numpy as np
import pytest
import scenes
from bl_ext.user_default.timescale_normals import addon, core
from bl_ext.user_default.timescale_normals.addon import bridge, missing, panel
from bl_ext.user_default.timescale_normals.addon.display import summaries
from bl_ext.user_default.timescale_normals.addon.settings import scene
from bl_ext.user_default.timescale_normals.addon.settings.properties import to_core

FIELDS = {field.name: field for field in dataclasses.fields(core.Settings)}
OPERATORS = ["estimate_normals", "compare_delaunay", "clear_results"]


def properties(operator):
    return getattr(bpy.ops.timescale, operator).get_rna_type().properties


# Of operators that Blender's own helpers make, with texts of its own.
BORROWED = {"rna_type", "name", "filepath", "check_existing", "filter_glob"}
BORROWED |= {"remove_name", "remove_active"}


def all_properties():
    for operator in dir(bpy.ops.timescale):
        yield from properties(operator)
    yield from bpy.types.Scene.bl_rna.properties[
        "timescale_normals"
    ].fixed_type.properties


@pytest.mark.parametrize("operator", ["estimate_normals", "compare_delaunay"])
def test_defaults_and_choices_are_those_of_the_core(operator):
    found = properties(operator)
    for name in ("method", "graph", "weights", "orientation", "nested"):
        assert found[name].default == FIELDS[name].default
        choices = tuple(item.identifier for item in found[name].enum_items)
        assert choices == FIELDS[name].metadata["choices"]


def test_numbers_have_the_bounds_of_the_core_and_zero_for_none():
    found = properties("estimate_normals")
    assert found["neighbors"].default == found["radius"].default == 0
    assert found["neighbors"].hard_min == 0
    assert found["neighbors"].hard_max == FIELDS["neighbors"].metadata["limits"][1]


def button():
    """What a button of the panel would run."""
    made = bpy.context.window_manager.operator_properties_last(
        "timescale.compare_delaunay"
    )
    scene.fill(made, bpy.context)
    return made


def test_scene_starts_with_the_defaults_of_the_core():
    assert to_core(button()) == core.Settings()


def test_settings_of_the_scene_reach_the_core_through_a_button():
    options = bpy.context.scene.timescale_normals
    camera = scenes.link(bpy.data.objects.new("C", bpy.data.cameras.new("C")))
    camera.location = (1, 2, 3)
    bpy.context.view_layer.update()
    options.method, options.neighbors, options.radius = "time_scale", 12, 0.5
    options.orientation, options.viewpoint_object = "viewpoint", camera
    options.truth, options.storage = "normal", "tangent_space"
    found = button()
    assert (found.truth, found.storage) == ("normal", "tangent_space")
    assert to_core(found) == core.Settings(
        method="time_scale",
        neighbors=12,
        radius=0.5,
        orientation="viewpoint",
        viewpoint=(1, 2, 3),
    )
    options.viewpoint_object = None
    options.viewpoint = (4, 5, 6)
    assert to_core(button()).viewpoint == (4, 5, 6)


def test_true_normals_of_samples_are_known():
    bpy.ops.timescale.add_samples(shape="sphere", count=100)
    assert panel.known_truth(bpy.context.object) == "true_normal"
    assert panel.known_truth(scenes.sphere(2)) == ""
    assert panel.known_truth(None) == ""


def test_every_label_and_tooltip_follows_the_rules_of_blender():
    for prop in all_properties():
        if prop.identifier in BORROWED:
            continue
        tip = prop.description
        assert prop.name == prop.name.title(), prop.identifier
        assert tip, prop.identifier
        assert tip[0].isupper(), tip
        assert not tip.endswith("."), tip
        assert tip.lower() != prop.name.lower(), tip
        for item in getattr(prop, "enum_items", ()):
            assert item.description[0].isupper(), item.identifier
            assert not item.description.endswith("."), item.description


@pytest.mark.parametrize("operator", sorted(dir(bpy.ops.timescale)))
def test_operators_have_a_label_and_a_tooltip(operator):
    rna = getattr(bpy.ops.timescale, operator).get_rna_type()
    assert rna.name
    assert rna.description[0].isupper()
    assert not rna.description.endswith(".")
    assert rna.name.lower() not in rna.description.lower()


@pytest.mark.parametrize(
    "operator",
    [
        *OPERATORS,
        "add_samples",
        "color_by",
        "show_colors",
        "hide_colors",
        "side_by_side",
        "show_patch",
    ],
)
def test_operators_that_change_something_can_be_undone(operator):
    found = getattr(bpy.ops.timescale, operator)
    assert {"REGISTER", "UNDO"} <= found.bl_options


def test_rows_of_the_panel_say_what_was_chosen():
    scenes.new_cloud(scenes.ball(), truth=scenes.ball())
    bpy.ops.timescale.compare_delaunay(truth="truth")
    summary = bridge.read_summary(bpy.context.object)
    rows = dict(summaries.result_rows(summary["estimate"]))
    assert rows["Points"] == "600"
    assert rows["Neighbors"] == str(summary["estimate"]["neighbors"])
    assert rows["Graph"] == "Nearest"
    assert "Without Normal" not in rows
    table = summaries.comparison_rows(summary["comparison"])
    assert table[:2] == [
        ("", "Estimate", "Delaunay"),
        ("Nearer at", "100.0 %", "0.0 %"),
    ]
    assert {len(row) for row in table} == {3}
    rms = next(row for row in table if row[0] == "RMS")
    assert rms[1] == f"{summary['comparison']['angle_estimate_rms']:.3g}°"


def test_noise_is_left_out_where_faces_gave_the_normals():
    summary = {"points": 9, "valid": 9, "noise_percent": 0.25}
    assert dict(summaries.result_rows(summary))["Noise"] == "0.25 %"
    assert "Noise" not in dict(summaries.result_rows({**summary, "from_faces": 5}))
    patches = {"points": 9, "valid": 9, "neighbors": 16, "patch": "cubic"}
    assert (
        dict(summaries.result_rows({**patches, "from_faces": 8}))["Neighbors"] == "16"
    )
    all_faces = dict(summaries.result_rows({**patches, "from_faces": 9}))
    assert not {"Neighbors", "Patch"} & set(all_faces)


def test_rows_of_a_split_mesh_have_points_and_normals():
    bpy.ops.mesh.primitive_cube_add()
    obj = bpy.context.object
    bpy.ops.object.shade_smooth()
    obj.data.edges.foreach_set("use_edge_sharp", np.ones(12, bool))
    bpy.ops.timescale.estimate_normals()
    rows = dict(summaries.result_rows(bridge.read_summary(obj)["estimate"]))
    assert (rows["Points"], rows["Normals"]) == ("8", "24")
    assert "Side Uncertain" not in rows


def test_uncertain_sides_are_shown_with_their_warnings():
    summary = {"points": 9, "valid": 9, "uncertain": 0.0712, "warnings": ["a " * 40]}
    assert dict(summaries.result_rows(summary))["Side Uncertain"] == "7.1 %"
    lines = summaries.warning_lines(summary, 300)
    assert [line["icon"] for line in lines[:2]] == ["ERROR", "BLANK1"]
    assert lines[0]["text"].startswith("A a")
    assert not summaries.warning_lines({"points": 9, "valid": 9}, 300)


def test_warnings_of_an_estimate_are_reported(capfd):
    # Two planes of points that cross: nobody can tell their sides.
    rng = np.random.default_rng(0)
    flat = rng.random((300, 3)) * [1, 1, 0]
    obj = scenes.new_cloud(np.concatenate([flat, flat[:, [0, 2, 1]] + [0, 0.5, -0.5]]))
    bpy.ops.timescale.estimate_normals()
    found = bridge.read_summary(obj)["estimate"]
    out = capfd.readouterr().out
    assert all(warning in out for warning in found["warnings"])
    sure = scenes.get(obj, "ts_side_confidence")
    assert ((sure >= 0) & (sure <= 1)).all()
    assert abs((sure < 0.3).mean() - found["uncertain"]) < 0.01


def test_rows_of_a_comparison_without_truth():
    scenes.sphere(3)
    bpy.ops.timescale.compare_delaunay()
    summary = bridge.read_summary(bpy.context.object)
    table = summaries.comparison_rows(summary["comparison"])
    assert table[:2] == [("", "Difference"), ("Angle", "")]
    assert {len(row) for row in table} == {2}
    expected = f"{summary['comparison']['deviation_max']:.3g}"
    assert table[-1] == ("Maximum", expected)


def test_panel_of_results_shows_only_where_there_are_some():
    poll = bpy.types.VIEW3D_PT_timescale_result.poll
    assert not poll(bpy.context)
    scenes.link(bpy.data.objects.new("L", bpy.data.lights.new("L", "POINT")))
    assert not poll(bpy.context)
    scenes.sphere(3)
    assert not poll(bpy.context)
    bpy.ops.timescale.estimate_normals()
    assert poll(bpy.context)
    bpy.ops.timescale.clear_results()
    assert not poll(bpy.context)


def ours():
    """Everything of ours that Blender knows."""
    found = {name for name in dir(bpy.types) if "timescale" in name.lower()}
    found |= {f"ops.{name}" for name in dir(bpy.ops.timescale)}
    for owner in (bpy.types.Scene, bpy.types.Mesh, bpy.types.PointCloud):
        if hasattr(owner, "timescale_normals"):
            found.add(owner.__name__)
    menu = bpy.types.VIEW3D_MT_object
    entries = {
        f"{draw.__module__}.{draw.__name__}" for draw in menu._dyn_ui_initialize()
    }
    found |= {name for name in entries if "timescale" in name}
    return found


def test_nothing_is_left_after_unregistering_and_twice_is_as_once():
    before = ours()
    # Operators, panels and menus, two groups, three owners, one entry.
    assert len(before) >= 25
    for _ in range(2):
        addon.unregister()
        assert not ours()
        addon.register()
        assert ours() == before
    scenes.sphere(3)
    assert bpy.ops.timescale.estimate_normals() == {"FINISHED"}


def test_without_scipy_a_panel_says_what_to_do(monkeypatch, caplog):
    addon.unregister()
    monkeypatch.setattr(addon, "find_spec", lambda _: None)
    addon.register()
    try:
        assert hasattr(bpy.types, "VIEW3D_PT_timescale_missing")
        assert not hasattr(bpy.types, "VIEW3D_PT_timescale")
        assert missing.SENTENCE in caplog.text
    finally:
        addon.unregister()
        monkeypatch.undo()
        addon.register()
    assert not hasattr(bpy.types, "VIEW3D_PT_timescale_missing")


def test_results_stay_in_the_file_while_the_extension_is_off():
    obj = scenes.sphere(3)
    before = scenes.snapshot(obj)
    bpy.ops.timescale.estimate_normals()
    kept = scenes.get(obj, "ts_normal")
    addon.unregister()
    addon.register()
    np.testing.assert_array_equal(scenes.get(obj, "ts_normal"), kept)
    bpy.ops.timescale.clear_results()
    assert scenes.snapshot(obj) == before
