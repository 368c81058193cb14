# SPDX-License-Identifier: GPL-3.0-or-later
"""Colors of a comparison, the truth of a surface, and what makes them visible."""

import json

import bpy
import numpy as np
import pytest
import scenes
from bl_ext.user_default.timescale_normals import core
from bl_ext.user_default.timescale_normals.addon import bridge, coloring, overlay

MEASURES = ["error_estimate", "error_baseline", "deviation", "log_ratio", "wins"]
TRUTHLESS = {"error_estimate": "deviation"}


def compare(**settings):
    return bpy.ops.timescale.compare_delaunay(**settings)


def with_truth(obj):
    scenes.put(obj, "true_normal", "FLOAT_VECTOR", scenes.points_of(obj))
    return obj


def errors(obj):
    """A comparison anew from what the attributes hold."""
    return core.compare_normals(
        scenes.get(obj, "ts_normal"),
        scenes.get(obj, "delaunay_normal"),
        truth=scenes.points_of(obj),
    )


@pytest.mark.parametrize("measure", MEASURES)
def test_recoloring_is_as_if_compared_so_at_first(measure):
    obj = with_truth(scenes.sphere())
    compare(truth="true_normal", color_by=measure)
    expected = scenes.get(obj, "ts_error_color")
    compare(truth="true_normal")
    assert bpy.ops.timescale.color_by(measure=measure) == {"FINISHED"}
    found = scenes.get(obj, "ts_error_color")
    # Errors are kept in single precision: where both sides are exact, the ratio of
    # their errors is that of rounding.
    assert np.isclose(found, expected, atol=0.02).all(axis=1).mean() > 0.98


def test_range_is_that_of_the_last_color():
    obj = with_truth(scenes.sphere())
    compare(truth="true_normal", color_limit=0.02)
    expected = errors(obj).colors("error_estimate", limit=0.02)
    np.testing.assert_allclose(scenes.get(obj, "ts_error_color"), expected, atol=1e-3)
    bpy.ops.timescale.color_by(measure="error_estimate", limit=0.5)
    darker = scenes.get(obj, "ts_error_color")[:, :3].sum()
    assert darker < expected[:, :3].sum()


def test_settings_of_the_scene_recolor_at_once():
    obj = with_truth(scenes.sphere())
    compare(truth="true_normal")
    bpy.context.scene.timescale_normals.color_by = "wins"
    colors = scenes.get(obj, "ts_error_color")
    assert len(np.unique(colors, axis=0)) == 2


def test_settings_of_the_scene_need_no_comparison():
    scenes.sphere(3)
    bpy.context.scene.timescale_normals.color_by = "wins"


def test_measure_that_needs_a_truth_falls_back_and_says_so(capfd):
    obj = scenes.sphere()
    compare()
    expected = scenes.get(obj, "ts_error_color")
    bpy.ops.timescale.color_by(measure="wins")
    found = scenes.get(obj, "ts_error_color")
    np.testing.assert_allclose(found, expected, atol=1e-4)
    assert "this needs true normals" in capfd.readouterr().out


def test_nothing_to_recolor():
    scenes.sphere(3)
    bpy.ops.timescale.estimate_normals()
    with pytest.raises(RuntimeError, match="Compare with Delaunay first"):
        bpy.ops.timescale.color_by(measure="wins")


# Truth from a surface


def fine_sphere():
    obj = scenes.sphere(6)
    obj.name = "Truth"
    bpy.ops.object.shade_smooth()
    return obj


def test_truth_is_the_nearest_surface_of_another_object():
    fine_sphere()
    obj = scenes.new_cloud(scenes.ball())
    assert compare(truth_object="Truth") == {"FINISHED"}
    found = json.loads(obj.data.timescale_normals.summary)["comparison"]
    direct = core.compare_normals(
        scenes.get(obj, "ts_normal"),
        scenes.get(obj, "delaunay_normal"),
        truth=scenes.ball(),
    ).summary()
    # The fine sphere's own normals are off by 0.02 degrees.
    assert abs(found["angle_baseline_rms"] - direct["angle_baseline_rms"]) < 0.03


def test_truth_stands_in_the_world():
    truth = fine_sphere()
    truth.scale = (2, -3, 1)
    truth.rotation_euler = (0.3, 0.2, 0.1)
    truth.location = (512_000, 5_403_000, 0)
    obj = scenes.new_cloud(scenes.ball())
    obj.scale, obj.rotation_euler = truth.scale, truth.rotation_euler
    obj.location = truth.location
    compare(truth_object="Truth")
    error = json.loads(obj.data.timescale_normals.summary)["comparison"]
    assert error["angle_baseline_max"] < 5


@pytest.mark.parametrize(
    ("name", "sentence"),
    [("Nobody", 'no object "Nobody"'), ("Light", "no faces to take true normals")],
)
def test_surface_that_has_no_normals(name, sentence):
    scenes.link(bpy.data.objects.new("Light", bpy.data.lights.new("L", "POINT")))
    obj = scenes.sphere(3)
    before = scenes.snapshot(obj)
    with pytest.raises(RuntimeError, match=sentence):
        compare(truth_object=name)
    assert scenes.snapshot(obj) == before


# Making them visible


def makers():
    return {
        "mesh": lambda: scenes.sphere(3),
        "points of a mesh": lambda: scenes.new_mesh(scenes.ball()),
        "cloud": lambda: scenes.new_cloud(scenes.ball()),
    }


@pytest.mark.parametrize("kind", makers())
def test_colors_are_shown_and_hidden_without_a_trace(kind):
    obj = makers()[kind]()
    before = scenes.snapshot(obj)
    compare()
    bpy.ops.timescale.show_colors()
    shown = obj.evaluated_get(
        bpy.context.evaluated_depsgraph_get()
    ).evaluated_geometry()
    data = shown.mesh if kind == "mesh" else shown.pointcloud
    assert [m.name for m in data.materials if m] == ["Time-Scale Colors"]
    assert "ts_error_color" in data.attributes
    if kind == "points of a mesh":
        assert len(data.points) == 600
    bpy.ops.timescale.hide_colors()
    assert not obj.modifiers
    bpy.ops.timescale.show_colors()
    bpy.ops.timescale.clear_results()
    assert not obj.modifiers
    assert not bpy.data.materials
    assert not bpy.data.node_groups
    assert scenes.snapshot(obj) == before


def test_comparison_shows_its_colors_when_asked():
    obj = scenes.sphere(3)
    compare()
    assert not obj.modifiers
    compare(show_colors=True)
    assert [m.type for m in obj.modifiers] == ["NODES"]
    # The modifier is no reason to think that the mesh deforms, nor in the way.
    bpy.ops.timescale.estimate_normals(use_modifiers=True)
    assert obj.data.attributes["custom_normal"].data_type == "FLOAT_VECTOR"


def test_viewports_show_attributes_and_come_back():
    obj = scenes.sphere(3)
    spaces = [
        space
        for screen in bpy.data.screens
        for area in screen.areas
        for space in area.spaces
        if space.type == "VIEW_3D"
    ]
    if not spaces:
        pytest.skip("there is no viewport without a window")
    before = [(s.shading.type, s.shading.color_type) for s in spaces]
    compare(show_colors=True)
    assert {s.shading.color_type for s in spaces} == {"VERTEX"}
    scenes.select(obj)
    bpy.ops.timescale.clear_results()
    assert [(s.shading.type, s.shading.color_type) for s in spaces] == before


# What the overlay draws; drawing itself needs a window


@pytest.mark.parametrize("measure", MEASURES)
def test_legend_has_the_points_and_colors_of_its_measure(measure):
    obj = with_truth(scenes.sphere())
    compare(truth="true_normal", color_by=measure)
    legend = overlay.legend_of(obj)
    assert legend.heights.max() == 1
    assert len(legend.heights) == len(legend.colors) == (2 if measure == "wins" else 40)
    assert ((legend.colors >= 0) & (legend.colors <= 1)).all()
    assert legend.low
    assert legend.high


@pytest.mark.parametrize("measure", MEASURES)
def test_colors_of_a_scale_are_those_of_the_points(measure):
    obj = with_truth(scenes.sphere())
    compare(truth="true_normal")
    found = coloring.read_comparison(obj)
    values = np.asarray(getattr(found, measure), np.float64)
    high = 1.0 if measure == "wins" else found.limits(measure)[1]
    np.testing.assert_allclose(
        coloring.colors_of(measure, values, high), found.colors(measure), atol=1e-4
    )


def test_lines_stand_on_the_points_along_the_normals_in_the_world():
    obj = scenes.sphere()
    obj.scale, obj.location = (2, 1, -3), (5, 0, 0)
    compare()
    lines = overlay.lines_of(obj, share=1, length=2, baseline=True)
    assert lines.estimate.shape == lines.baseline.shape == (2 * 642, 3)
    start, end = lines.estimate[::2], lines.estimate[1::2]
    local = (start - np.array(obj.location)) / np.array(obj.scale)
    np.testing.assert_allclose(np.linalg.norm(local, axis=1), 1, atol=1e-5)
    # Of an ellipsoid: points by the squares of its half axes.
    expected = local / np.array(obj.scale)
    assert scenes.angles(end - start, expected).max() < 2
    lengths = np.linalg.norm(end - start, axis=1)
    np.testing.assert_allclose(lengths, lengths[0], rtol=1e-4)


def test_lines_of_both_methods_are_on_one_side():
    obj = scenes.new_cloud(scenes.ball())
    compare()
    lines = overlay.lines_of(obj, share=1, length=1, baseline=True)
    for ends in (lines.estimate, lines.baseline):
        outward = ((ends[1::2] - ends[::2]) * ends[::2]).sum(axis=1)
        assert (outward > 0).all()


def test_many_points_get_a_bounded_number_of_lines():
    obj = scenes.new_cloud(scenes.ball(80_000))
    bpy.ops.timescale.estimate_normals(method="time_scale", orientation="none")
    lines = overlay.lines_of(obj, share=1, length=1, baseline=False)
    assert len(lines.estimate) == 2 * overlay.MOST
    few = overlay.lines_of(obj, share=0.01, length=1, baseline=False)
    assert len(few.estimate) == 2 * 800
    assert len(few.baseline) == 0


def test_points_without_a_normal_are_marked_and_have_no_line():
    obj = scenes.new_cloud(scenes.ball())
    bpy.ops.timescale.estimate_normals(radius=1e-4)
    lines = overlay.lines_of(obj, share=1, length=1, baseline=False)
    assert (len(lines.estimate), len(lines.invalid)) == (0, 600)


def test_what_is_kept_goes_with_the_shape():
    obj = scenes.sphere(3)
    kept, made = overlay.Kept(), []

    def make(_obj):
        made.append(1)
        return len(made)

    assert kept.get("lines", obj, (1,), make) == 1
    assert kept.get("lines", obj, (1,), make) == 1
    assert kept.get("lines", obj, (2,), make) == 2
    kept.forget(obj.data.session_uid)
    assert kept.get("lines", obj, (2,), make) == 3


def test_nothing_draws_in_background():
    assert not overlay._drawn


def test_comparison_read_back_is_the_one_that_was_made():
    obj = with_truth(scenes.sphere())
    compare(truth="true_normal")
    assert bridge.has_comparison(obj)
    expected, found = errors(obj), coloring.read_comparison(obj)
    for name in ("deviation", "error_estimate", "error_baseline"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), atol=1e-6
        )
