# SPDX-License-Identifier: GPL-3.0-or-later
"""Colors of a comparison, the truth of a surface, and what makes them visible."""

import json

import bpy
import numpy as np
import pytest
import scenes
from bl_ext.user_default.timescale_normals import core
from bl_ext.user_default.timescale_normals.addon import bridge
from bl_ext.user_default.timescale_normals.addon.display import coloring, overlay
from bl_ext.user_default.timescale_normals.addon.display.legend import legend_of
from bl_ext.user_default.timescale_normals.addon.display.lines import MOST, lines_of
from bl_ext.user_default.timescale_normals.core.colormaps import COLORMAPS, map_colors
from mathutils import Color

MEASURES = list(core.comparison.MEASURES)


def compare(**settings):
    return bpy.ops.timescale.compare_delaunay(**settings)


def with_truth(obj):
    """Make an ellipsoid of a sphere: no mean of faces is exact on it."""
    points = scenes.points_of(obj)
    flat = (points * [1, 1, 0.6]).astype(np.float32)
    obj.data.attributes["position"].data.foreach_set("vector", flat.ravel())
    obj.data.update_tag()
    if obj.type == "MESH":
        obj.data.update()
    normals = points / [1, 1, 0.6]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    scenes.put(obj, "true_normal", "FLOAT_VECTOR", normals)
    return obj


def errors(obj):
    """A comparison anew from what the attributes hold."""
    return core.compare_normals(
        scenes.get(obj, "ts_normal"),
        scenes.get(obj, "delaunay_normal"),
        truth=scenes.get(obj, "true_normal"),
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


def test_angles_are_kept_in_degrees():
    obj = with_truth(scenes.sphere())
    compare(truth="true_normal")
    expected = errors(obj)
    # Normals are kept in single precision.
    for name, values in (
        ("ts_angle", expected.angle_estimate),
        ("delaunay_angle", expected.angle_baseline),
    ):
        np.testing.assert_allclose(scenes.get(obj, name), values, atol=1e-4)
    compare()
    between = scenes.get(obj, "ts_angle")
    np.testing.assert_allclose(between, expected.angle_deviation, atol=1e-4)
    assert "delaunay_angle" not in obj.data.attributes


@pytest.mark.parametrize("measure", ["angle_estimate", "angle_deviation"])
def test_legend_of_angles_is_in_degrees(measure):
    obj = with_truth(scenes.sphere())
    compare(truth="true_normal", color_by=measure, color_limit=2.0)
    legend = legend_of(obj)
    assert (legend.low, legend.middle, legend.high) == ("0°", "1°", "2°")
    assert legend.count == f"{len(obj.data.vertices):,} points"
    compare(truth="true_normal", color_by=measure, color_limit=0.001)
    assert legend_of(obj).high == "≥ 0.001°"


def test_angle_that_needs_a_truth_falls_back_to_the_angle_between():
    obj = scenes.sphere()
    compare(color_by="angle_estimate")
    assert obj.data.timescale_normals.color_by == "angle_deviation"


def test_sureness_of_sides_is_colored_from_a_guess_to_certain():
    obj = scenes.new_cloud(scenes.ball())
    compare(color_by="side_confidence")
    sure = scenes.get(obj, "ts_side_confidence")
    expected = core.Comparison(sure, sure).colors("deviation", limit=1.0)
    np.testing.assert_allclose(scenes.get(obj, "ts_error_color"), expected, atol=1e-4)
    legend = legend_of(obj)
    assert (legend.low, legend.high) == ("a guess", "certain")
    assert len(legend.heights) == 40


def test_confidence_is_colored_from_a_guess_to_certain():
    obj = scenes.new_cloud(scenes.ball())
    compare(color_by="confidence")
    sure, scale = (scenes.get(obj, name) for name in ("ts_confidence", "ts_scale"))
    assert ((sure > 0.5) & (sure <= 1)).all()
    assert (scale > 0).all()
    expected = core.Comparison(sure, sure).colors("deviation", limit=1.0)
    np.testing.assert_allclose(scenes.get(obj, "ts_error_color"), expected, atol=1e-4)


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
    data = shown.mesh
    assert [m.name for m in data.materials if m] == ["Time-Scale Colors"]
    # What Solid shading looks for.
    assert data.attributes.active_color_name == "ts_error_color"
    if kind != "mesh":
        assert len(data.polygons) == 600
    bpy.ops.timescale.hide_colors()
    assert not obj.modifiers
    bpy.ops.timescale.show_colors()
    bpy.ops.timescale.clear_results()
    assert not obj.modifiers
    assert not bpy.data.materials
    assert not bpy.data.node_groups
    assert set(bpy.data.objects) == {obj}
    assert "Time-Scale Disc" not in bpy.data.meshes
    assert scenes.snapshot(obj) == before


def test_points_are_discs_across_their_normals_that_close_the_surface():
    obj = scenes.new_cloud(scenes.ball(2000))
    obj.scale = (3, 1, 1)
    compare(show_colors=True)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    shown = obj.evaluated_get(depsgraph).evaluated_geometry()
    found = scenes.read(shown.mesh, "position").reshape(-1, 6, 3)
    points, normals = scenes.points_of(obj), scenes.get(obj, "ts_normal")
    np.testing.assert_allclose(found.mean(axis=1), points, atol=1e-5)
    spokes = found - points[:, None]
    radius = np.linalg.norm(spokes, axis=2)
    across = np.abs((spokes * normals[:, None]).sum(axis=2)) / radius
    assert across.max() < 1e-4
    # Discs this large leave no gap between points at the corners of hexagons.
    apart = np.sqrt(4 * np.pi / 2000)
    assert apart / np.sqrt(3) < radius.min()
    assert radius.max() < 1.5 * apart


@pytest.mark.parametrize("kind", makers())
def test_colors_are_in_a_render_without_a_window(kind, tmp_path):
    """In the colors of the attribute, darker toward the rim and none brighter."""
    obj = makers()[kind]()
    compare(color_by="side_confidence", color_limit=1e-3, show_colors=True)
    scene = bpy.context.scene
    lens = bpy.data.cameras.new("C")
    lens.type, lens.ortho_scale = "ORTHO", 1.0
    scene.camera = scenes.link(bpy.data.objects.new("C", lens))
    scene.camera.location = (0, 0, 5)
    scene.render.engine, scene.cycles.samples = "CYCLES", 4
    scene.render.resolution_x = scene.render.resolution_y = 24
    scene.view_settings.view_transform = "Standard"
    scene.render.image_settings.file_format = "PNG"
    scene.render.filepath = str(tmp_path / "seen.png")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    pixels = np.empty(24 * 24 * 4, np.float32)
    image.pixels.foreach_get(pixels)
    seen = np.median(pixels.reshape(-1, 4)[:, :3], axis=0)
    # All points are past the end of the scale; the image is in sRGB.
    [expected] = np.unique(scenes.get(obj, "ts_error_color")[:, :3], axis=0)
    expected = np.array(Color(expected).from_scene_linear_to_srgb())
    np.testing.assert_allclose(seen, expected, atol=0.12)


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


# Side by side


def beside():
    return bpy.ops.timescale.side_by_side()


def worn(obj):
    """The colors that are seen of an object, (n, 4)."""
    made = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    shown = made.evaluated_geometry()
    # A point of a cloud has a disc of six corners.
    step = 6 if bridge.is_cloud(obj) else 1
    return scenes.read(shown.mesh, "ts_error_color")[::step]


def other_of(obj):
    [other] = [o for o in bpy.data.objects if o.data == obj.data and o != obj]
    return other


@pytest.mark.parametrize("make", [scenes.sphere, lambda: scenes.new_cloud(FEW)])
def test_both_methods_are_side_by_side_in_one_range(make):
    obj = with_truth(make())
    obj.location, obj.scale = (1, 2, 3), (2, 1, 1)
    compare(truth="true_normal")
    assert beside() == {"FINISHED"}
    other = other_of(obj)
    bpy.context.view_layer.update()
    assert other.name == f"{obj.name} Delaunay"
    step = np.array(other.matrix_world.translation - obj.matrix_world.translation)
    # A gap of 15 % of its width, which is 4.
    np.testing.assert_allclose(step, [4.6, 0, 0], atol=0.05)
    found = coloring.read_comparison(obj)
    limit = max(found.limits(m)[1] for m in ("error_estimate", "error_baseline"))
    for shown, measure in ((obj, "error_estimate"), (other, "error_baseline")):
        expected = found.colors(measure, limit=limit)
        np.testing.assert_allclose(worn(shown), expected, atol=1e-3)
    assert legend_of(obj).title == "Error of Estimate, Lines: Delaunay (Coordinate)"
    assert bpy.context.object == obj
    assert bpy.context.selected_objects == [obj]


FEW = scenes.ball(400)


def test_recoloring_keeps_both_sides():
    obj = with_truth(scenes.sphere())
    compare(truth="true_normal", color_by="angle_baseline")
    beside()
    found = coloring.read_comparison(obj)
    high = max(found.limits(m)[1] for m in ("angle_estimate", "angle_baseline"))
    np.testing.assert_allclose(
        worn(other_of(obj)), found.colors("angle_baseline", limit=high), atol=1e-3
    )
    assert bpy.context.scene.timescale_normals.color_by == "angle_estimate"
    bpy.ops.timescale.color_by(measure="error_estimate", limit=0.01)
    for shown, measure in ((obj, "error_estimate"), (other_of(obj), "error_baseline")):
        expected = found.colors(measure, limit=0.01)
        np.testing.assert_allclose(worn(shown), expected, atol=1e-3)
    bpy.ops.timescale.color_by(measure="wins")
    np.testing.assert_array_equal(worn(other_of(obj)), worn(obj))


@pytest.mark.parametrize("way", ["side_by_side", "clear_results", "hide_colors"])
def test_what_is_beside_goes_without_a_trace(way):
    obj = with_truth(scenes.sphere())
    before = scenes.snapshot(obj)
    compare(truth="true_normal")
    compared = scenes.snapshot(obj)
    beside()
    assert getattr(bpy.ops.timescale, way)() == {"FINISHED"}
    assert list(bpy.data.objects) == [obj]
    assert "delaunay_error_color" not in obj.data.attributes
    if way == "clear_results":
        assert scenes.snapshot(obj) == before
    else:
        assert set(scenes.snapshot(obj)) == set(compared)
        bpy.ops.timescale.hide_colors()
    assert not bpy.data.node_groups
    assert not bpy.data.materials


def test_new_estimate_takes_what_is_beside_away():
    obj = with_truth(scenes.sphere())
    compare(truth="true_normal")
    beside()
    bpy.ops.timescale.estimate_normals()
    assert list(bpy.data.objects) == [obj]
    # Compared again, the estimate stays, and so does what is beside.
    compare(truth="true_normal")
    beside()
    compare(truth="true_normal", color_by="angle_estimate")
    found = coloring.read_comparison(obj)
    high = max(found.limits(m)[1] for m in ("angle_estimate", "angle_baseline"))
    expected = found.colors("angle_baseline", limit=high)
    np.testing.assert_allclose(worn(other_of(obj)), expected, atol=1e-3)


def test_modifiers_and_colors_of_an_earlier_look_stay():
    obj = with_truth(scenes.sphere())
    obj.modifiers.new("Bend", "SIMPLE_DEFORM")
    compare(truth="true_normal", show_colors=True)
    beside()
    assert [m.name for m in other_of(obj).modifiers] == ["Bend", "Time-Scale Colors"]
    beside()
    assert [m.name for m in obj.modifiers] == ["Bend", "Time-Scale Colors"]


def test_without_truth_there_are_no_errors_to_show(capfd):
    obj = scenes.sphere(3)
    compare()
    assert beside() == {"CANCELLED"}
    assert "errors need true normals" in capfd.readouterr().out
    assert list(bpy.data.objects) == [obj]


# What the overlay draws; drawing itself needs a window


@pytest.mark.parametrize("measure", MEASURES)
def test_legend_has_the_points_and_colors_of_its_measure(measure):
    obj = with_truth(scenes.sphere())
    compare(truth="true_normal", color_by=measure)
    legend = legend_of(obj)
    assert legend.heights.max() == 1
    assert len(legend.heights) == len(legend.colors) == (2 if measure == "wins" else 40)
    assert ((legend.colors >= 0) & (legend.colors <= 1)).all()
    assert legend.low
    assert legend.high
    assert legend.beside is None


def test_legend_of_both_methods_has_both_histograms():
    obj = with_truth(scenes.sphere())
    compare(truth="true_normal", color_by="angle_estimate")
    beside()
    legend = legend_of(obj)
    found = coloring.read_comparison(obj)
    limit = max(found.limits(m)[1] for m in ("angle_estimate", "angle_baseline"))
    counts = [
        found.histogram(measure, bins=40, limit=limit)[0]
        for measure in ("angle_estimate", "angle_baseline")
    ]
    np.testing.assert_allclose(
        [legend.heights, legend.beside], np.array(counts) / np.max(counts)
    )


@pytest.mark.parametrize("measure", MEASURES)
def test_colors_of_a_scale_are_those_of_the_points(measure):
    obj = with_truth(scenes.sphere())
    compare(truth="true_normal")
    found = coloring.read_comparison(obj)
    values = np.asarray(getattr(found, measure), np.float64)
    high = 1.0 if measure == "wins" else found.limits(measure)[1]
    np.testing.assert_allclose(
        coloring.colors_of(coloring.Look(measure, high, "viridis"), values),
        found.colors(measure, colormap="viridis"),
        atol=1e-4,
    )


@pytest.mark.parametrize("colormap", COLORMAPS)
def test_points_and_legend_have_the_chosen_map(colormap):
    obj = with_truth(scenes.sphere())
    compare(truth="true_normal", color_limit=0.01, color_map=colormap)
    expected = errors(obj).colors("error_estimate", limit=0.01, colormap=colormap)
    np.testing.assert_allclose(scenes.get(obj, "ts_error_color"), expected, atol=1e-4)
    ends = map_colors(colormap, np.array([0.0125, 0.9875]))
    ends = [Color(color).from_scene_linear_to_srgb()[:] for color in ends]
    np.testing.assert_allclose(legend_of(obj).colors[[0, -1], :3], ends, atol=1e-3)


def test_map_of_the_scene_colors_again_at_once():
    obj = with_truth(scenes.sphere())
    compare(truth="true_normal")
    before = scenes.get(obj, "ts_error_color").copy()
    bpy.context.scene.timescale_normals.color_map = "cividis"
    assert obj.data.timescale_normals.color_map == "cividis"
    assert not np.allclose(scenes.get(obj, "ts_error_color"), before)


def test_file_without_a_map_has_the_first_one():
    obj = with_truth(scenes.sphere())
    compare(truth="true_normal")
    obj.data.timescale_normals.color_map = ""
    assert coloring.look_of(obj).colormap == "heat"
    assert legend_of(obj).heights.max() == 1


def test_lines_stand_on_the_points_along_the_normals_in_the_world():
    obj = scenes.sphere()
    obj.scale, obj.location = (2, 1, -3), (5, 0, 0)
    compare()
    lines = lines_of(obj, share=1, length=2, baseline=True)
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
    lines = lines_of(obj, share=1, length=1, baseline=True)
    for ends in (lines.estimate, lines.baseline):
        outward = ((ends[1::2] - ends[::2]) * ends[::2]).sum(axis=1)
        assert (outward > 0).all()


def test_many_points_get_a_bounded_number_of_lines():
    obj = scenes.new_cloud(scenes.ball(80_000))
    bpy.ops.timescale.estimate_normals(method="time_scale", orientation="none")
    lines = lines_of(obj, share=1, length=1, baseline=False)
    assert len(lines.estimate) == 2 * MOST
    few = lines_of(obj, share=0.01, length=1, baseline=False)
    assert len(few.estimate) == 2 * 800
    assert len(few.baseline) == 0


def test_points_without_a_normal_are_marked_and_have_no_line():
    obj = scenes.new_cloud(scenes.ball())
    bpy.ops.timescale.estimate_normals(radius=1e-4)
    lines = lines_of(obj, share=1, length=1, baseline=False)
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
