# SPDX-License-Identifier: GPL-3.0-or-later
"""`timescale.compare_delaunay`, by the attributes that it leaves."""

import json

import bpy
import numpy as np
import pytest
import scenes

# Errors come from normals in double precision and are kept in single precision.
ROUNDING = 1e-6


def run(**settings):
    return bpy.ops.timescale.compare_delaunay(**settings)


def summary(obj):
    return json.loads(obj.data.timescale_normals.summary)["comparison"]


def infinity_norm(a, b):
    return np.minimum(np.abs(a - b).max(axis=1), np.abs(a + b).max(axis=1))


def sphere_with_truth(subdivisions=4):
    obj = scenes.sphere(subdivisions)
    scenes.put(obj, "true_normal", "FLOAT_VECTOR", scenes.points_of(obj))
    return obj


def area_weighted(obj):
    """N_D of a triangle mesh, from its definition."""
    points, corners = scenes.points_of(obj), scenes.corner_vertices(obj).reshape(-1, 3)
    a, b, c = (points[corners[:, i]].astype(float) for i in range(3))
    total = np.zeros(points.shape)
    for i in range(3):
        np.add.at(total, corners[:, i], np.cross(b - a, c - a))
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def test_errors_are_the_distances_to_the_true_normals():
    obj = sphere_with_truth()
    assert run(truth="true_normal") == {"FINISHED"}
    truth = scenes.points_of(obj)
    for error, normal in (
        ("ts_error", "ts_normal"),
        ("delaunay_error", "delaunay_normal"),
    ):
        expected = infinity_norm(scenes.get(obj, normal), truth)
        np.testing.assert_allclose(scenes.get(obj, error), expected, atol=ROUNDING)


def test_baseline_of_a_mesh_is_that_of_its_own_faces():
    obj = sphere_with_truth(3)
    run()
    np.testing.assert_allclose(
        scenes.get(obj, "delaunay_normal"), area_weighted(obj), atol=ROUNDING
    )


def test_estimate_is_nearer_to_the_truth_on_a_sphere():
    obj = sphere_with_truth()
    run(truth="true_normal")
    found = summary(obj)
    assert found["compared"] == found["points"] == 642
    # By symmetry both sides are exact at the twelve vertices with five faces.
    assert found["wins"] >= 642 - 13
    assert found["error_estimate_max"] < found["error_baseline_rms"]


def test_without_truth_the_error_is_the_difference_of_the_two():
    obj = scenes.sphere()
    run()
    expected = infinity_norm(
        scenes.get(obj, "ts_normal"), scenes.get(obj, "delaunay_normal")
    )
    np.testing.assert_allclose(scenes.get(obj, "ts_error"), expected, atol=ROUNDING)
    assert "delaunay_error" not in obj.data.attributes
    assert "wins" not in summary(obj)


def test_truth_of_an_earlier_run_is_not_mistaken_for_this_one_s():
    obj = sphere_with_truth()
    run(truth="true_normal")
    run()
    assert "delaunay_error" not in obj.data.attributes


def test_truth_need_not_be_of_length_one():
    obj = scenes.sphere()
    scenes.put(obj, "long", "FLOAT_VECTOR", 7 * scenes.points_of(obj))
    run(truth="long")
    expected = infinity_norm(scenes.get(obj, "ts_normal"), scenes.points_of(obj))
    np.testing.assert_allclose(scenes.get(obj, "ts_error"), expected, atol=ROUNDING)


def test_colors_are_active_and_darker_where_the_error_is_smaller():
    obj = sphere_with_truth()
    run(truth="true_normal")
    attribute = obj.data.attributes["ts_error_color"]
    assert (attribute.data_type, attribute.domain) == ("FLOAT_COLOR", "POINT")
    assert obj.data.attributes.active_color_name == "ts_error_color"
    colors, error = scenes.get(obj, "ts_error_color"), scenes.get(obj, "ts_error")
    light = colors[:, :3].sum(axis=1)
    assert light[error.argmin()] < light[error.argmax()]
    assert (colors[:, 3] == 1).all()


def test_point_cloud_has_a_baseline_of_its_points_alone():
    obj = scenes.new_cloud(scenes.ball(), truth=scenes.ball())
    assert run(truth="truth") == {"FINISHED"}
    found = summary(obj)
    assert found["wins_percent"] > 95
    # Spacing of 600 points on the unit sphere is 0.15: a mean of faces is off by less.
    assert 0 < found["error_baseline_max"] < 0.1
    assert "ts_error_color" in obj.data.attributes


def test_mesh_without_faces_with_the_normals_a_ply_brings():
    obj = scenes.new_mesh(scenes.ball())
    scenes.put(obj, "normal", "FLOAT_VECTOR", scenes.ball())
    run(truth="normal")
    assert summary(obj)["compared"] == 600


def test_estimates_first_where_there_is_none():
    obj = scenes.sphere()
    run(storage="tangent_space", method="time_scale")
    assert obj.data.attributes["custom_normal"].data_type == "INT16_2D"
    assert scenes.get(obj, "ts_valid").all()


def test_takes_the_estimate_that_is_there():
    obj = scenes.sphere()
    bpy.ops.timescale.estimate_normals(method="paper", orientation="none")
    before = scenes.get(obj, "ts_normal")
    run()
    np.testing.assert_array_equal(scenes.get(obj, "ts_normal"), before)
    found = json.loads(obj.data.timescale_normals.summary)["estimate"]
    assert found["method"] == "paper"


def test_estimates_anew_when_points_came_or_went():
    obj = scenes.sphere(3)
    run()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide()
    bpy.ops.object.mode_set(mode="OBJECT")
    run()
    lengths = np.linalg.norm(scenes.get(obj, "ts_normal"), axis=1)
    np.testing.assert_allclose(lengths, 1, atol=ROUNDING)


def test_an_attribute_of_the_user_s_with_our_name_is_no_estimate():
    obj = scenes.sphere()
    mine = np.tile([1, 0, 0], (642, 1))
    scenes.put(obj, "ts_normal", "FLOAT_VECTOR", mine)
    run()
    assert not np.array_equal(scenes.get(obj, "ts_normal"), mine)
    bpy.ops.timescale.clear_results()
    np.testing.assert_array_equal(scenes.get(obj, "ts_normal"), mine)


def test_new_estimate_takes_the_old_comparison_with_it():
    obj = sphere_with_truth()
    run(truth="true_normal")
    bpy.ops.timescale.estimate_normals()
    names = {"delaunay_normal", "ts_error", "delaunay_error", "ts_error_color"}
    assert not names & set(obj.data.attributes.keys())
    assert "comparison" not in json.loads(obj.data.timescale_normals.summary)


def test_points_without_a_normal_are_not_compared():
    ball = scenes.sphere(3)
    faces = [tuple(p.vertices) for p in ball.data.polygons]
    points = scenes.points_of(ball)
    obj = scenes.new_mesh(np.concatenate([points, [(9, 9, 9)]]), faces)
    run()
    assert np.isnan(scenes.get(obj, "ts_error")[-1])
    assert np.isfinite(scenes.get(obj, "ts_error")[:-1]).all()
    assert (scenes.get(obj, "delaunay_normal")[-1] == 0).all()
    assert np.isfinite(scenes.get(obj, "ts_error_color")).all()


@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (1, 2, 3)])
def test_both_sides_of_a_stretched_or_mirrored_object_face_out(scale):
    obj = scenes.sphere()
    obj.scale = scale
    run()
    for name in ("ts_normal", "delaunay_normal"):
        dots = (scenes.get(obj, name) * scenes.points_of(obj)).sum(axis=1)
        assert (dots > 0.9).all(), name


@pytest.mark.parametrize(
    ("kind", "domain", "sentence"),
    [
        (None, None, 'FLOAT_VECTOR attribute "truth" on POINT, found none'),
        ("FLOAT", "POINT", "found FLOAT on POINT"),
        ("FLOAT_VECTOR", "CORNER", "found FLOAT_VECTOR on CORNER"),
        ("FLOAT_VECTOR", "FACE", "found FLOAT_VECTOR on FACE"),
    ],
)
def test_truth_of_the_wrong_kind_is_refused(kind, domain, sentence):
    obj = scenes.sphere(3)
    if kind:
        obj.data.attributes.new("truth", kind, domain)
    before = scenes.snapshot(obj)
    with pytest.raises(RuntimeError, match=sentence):
        run(truth="truth")
    assert scenes.snapshot(obj) == before


def test_truth_that_is_not_finite_is_refused():
    truth = scenes.ball()
    truth[3] = np.nan
    obj = scenes.new_cloud(scenes.ball(), truth=truth)
    before = scenes.snapshot(obj)
    with pytest.raises(RuntimeError, match=r'finite values in "truth".* 1 of 600'):
        run(truth="truth")
    assert scenes.snapshot(obj) == before
