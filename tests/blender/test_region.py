# SPDX-License-Identifier: GPL-3.0-or-later
"""New normals for a part of a mesh, in part, or from the shape after modifiers."""

import bpy
import numpy as np
import pytest
import scenes

ROUNDING = 1e-6
# The worst of sixteen bits in tangent space, in degrees.
SIXTEEN_BITS = 0.81


def run(**settings):
    return bpy.ops.timescale.estimate_normals(**settings)


def turned(obj):
    """Normals of the user's own, a quarter turn away from the estimated ones."""
    rng = np.random.default_rng(0)
    away = np.cross(scenes.points_of(obj), rng.normal(size=3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    scenes.put(obj, "custom_normal", "FLOAT_VECTOR", away)
    obj.data.update()
    return away


def upper(obj):
    return scenes.points_of(obj)[:, 2] > 0


def select_upper(obj):
    scenes.put(obj, ".select_vert", "BOOLEAN", upper(obj))


@pytest.mark.parametrize("storage", ["free", "tangent_space"])
def test_only_selected_vertices_change(storage):
    obj = scenes.sphere()
    obj.data.attributes.remove(obj.data.attributes[".select_vert"])
    select_upper(obj)
    scenes.set_tangent_normals(obj)
    before = scenes.corner_normals(obj)
    assert run(region="selected", storage=storage) == {"FINISHED"}
    corners = scenes.corner_vertices(obj)
    chosen = upper(obj)[corners]
    after = scenes.corner_normals(obj)
    np.testing.assert_array_equal(after[~chosen], before[~chosen])
    expected = scenes.get(obj, "ts_normal")[corners]
    worst = SIXTEEN_BITS if storage == "tangent_space" else 1e-3
    assert scenes.angles(after[chosen], expected[chosen]).max() < worst


def test_selection_of_edit_mode_counts():
    obj = scenes.sphere(3)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="DESELECT")
    with pytest.raises(RuntimeError, match="none of its vertices is selected"):
        run(region="selected")
    bpy.ops.mesh.select_all(action="SELECT")
    assert run(region="selected") == {"FINISHED"}
    assert obj.mode == "EDIT"


def test_vertex_group_blends_by_its_weights():
    obj = scenes.sphere()
    away = turned(obj)
    group = obj.vertex_groups.new(name="Blend")
    share = (scenes.points_of(obj)[:, 2] + 1) / 2
    for index, weight in enumerate(share):
        group.add([index], float(weight), "REPLACE")
    run(region="group", vertex_group="Blend")
    share = share[:, None]
    mixed = share * scenes.get(obj, "ts_normal") + (1 - share) * away
    mixed = mixed[scenes.corner_vertices(obj)]
    # Weights are kept in single precision.
    assert scenes.angles(scenes.corner_normals(obj), mixed).max() < 1e-3


def test_strength_blends_with_what_was_there_before_any_run():
    obj = scenes.sphere()
    away = turned(obj)[scenes.corner_vertices(obj)]
    for strength in (0.25, 0.75, 0.0, 0.5):
        run(strength=strength)
        new = scenes.get(obj, "ts_normal")[scenes.corner_vertices(obj)]
        mixed = strength * new + (1 - strength) * away
        assert scenes.angles(scenes.corner_normals(obj), mixed).max() < 1e-3
    before = {"custom_normal"}
    bpy.ops.timescale.clear_results()
    assert before <= set(obj.data.attributes.keys())
    np.testing.assert_allclose(scenes.corner_normals(obj), away, atol=ROUNDING)


def test_attribute_has_the_whole_estimate_whatever_the_region():
    obj = scenes.sphere()
    run()
    whole = scenes.get(obj, "ts_normal")
    run(strength=0.3)
    np.testing.assert_array_equal(scenes.get(obj, "ts_normal"), whole)


def test_vertex_group_that_is_not_there():
    obj = scenes.sphere(3)
    before = scenes.snapshot(obj)
    with pytest.raises(RuntimeError, match='no vertex group "Nobody"'):
        run(region="group", vertex_group="Nobody")
    assert scenes.snapshot(obj) == before


# Points without faces


TILTED = np.array([[1, 0.2, 0], [0, 1, 0], [0, 0, 1]])


@pytest.mark.parametrize("name", ["normal", "ts_normal"])
def test_strength_blends_with_the_normals_that_points_had(name):
    """Twice, because the first run leaves a ts_normal of its own."""
    points = scenes.ball()
    before = points @ TILTED
    obj = scenes.new_cloud(points, **{name: 3 * before})
    bpy.ops.timescale.estimate_normals()
    new = scenes.get(obj, "ts_normal")
    before /= np.linalg.norm(before, axis=1, keepdims=True)
    for strength in (0.25, 0.75, 0.0):
        run(strength=strength)
        mixed = strength * new + (1 - strength) * before
        assert scenes.angles(scenes.get(obj, "ts_normal"), mixed).max() < 1e-3
    bpy.ops.timescale.clear_results()
    assert scenes.angles(scenes.get(obj, name), before).max() < 1e-3


def test_only_selected_vertices_without_faces_change():
    points = scenes.ball()
    obj = scenes.new_mesh(points)
    scenes.put(obj, "normal", "FLOAT_VECTOR", points @ TILTED)
    above = points[:, 2] > 0
    if ".select_vert" in obj.data.attributes:
        obj.data.attributes.remove(obj.data.attributes[".select_vert"])
    scenes.put(obj, ".select_vert", "BOOLEAN", above)
    run(region="selected")
    found = scenes.get(obj, "ts_normal")
    # Patches of 600 points of a sphere are within a few degrees.
    assert scenes.angles(found[above], points[above]).max() < 3
    kept = (points @ TILTED)[~above]
    assert scenes.angles(found[~above], kept).max() < 1e-3


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"strength": 0.5}, 'neither "ts_normal" nor "normal"'),
        ({"region": "selected"}, 'neither "ts_normal" nor "normal"'),
    ],
)
def test_points_with_nothing_to_blend_with(settings, sentence):
    obj = scenes.new_cloud(scenes.ball())
    before = scenes.snapshot(obj)
    with pytest.raises(RuntimeError, match=sentence):
        run(**settings)
    assert scenes.snapshot(obj) == before


def test_point_clouds_have_no_selection():
    obj = scenes.new_cloud(scenes.ball(), normal=scenes.ball())
    before = scenes.snapshot(obj)
    with pytest.raises(RuntimeError, match="no groups or selection"):
        run(region="selected")
    assert scenes.snapshot(obj) == before


# After modifiers


def bent(obj):
    modifier = obj.modifiers.new("Bend", "SIMPLE_DEFORM")
    modifier.deform_method, modifier.factor, modifier.deform_axis = "TAPER", 0.5, "Z"
    return obj


def evaluated(obj):
    return obj.evaluated_get(bpy.context.evaluated_depsgraph_get())


def test_shape_after_modifiers_is_estimated():
    obj = bent(scenes.sphere(5))
    run(use_modifiers=True)
    shown = evaluated(obj)
    applied = scenes.new_mesh(
        scenes.points_of(shown), [tuple(p.vertices) for p in obj.data.polygons]
    )
    normals = scenes.corner_normals(shown)
    run()
    expected = scenes.get(applied, "ts_normal")[scenes.corner_vertices(applied)]
    assert scenes.angles(normals, expected).max() < 1e-2


def test_shape_keys_count_too():
    obj = scenes.sphere()
    obj.shape_key_add(name="Basis")
    key = obj.shape_key_add(name="Tall")
    tall = scenes.points_of(obj) * [1, 1, 3]
    key.data.foreach_set("co", np.ascontiguousarray(tall, np.float32).ravel())
    key.value = 1
    run(use_modifiers=True)
    expected = scenes.points_of(obj) / [1, 1, 3]
    assert scenes.angles(scenes.get(obj, "ts_normal"), expected).max() < 1


def test_modifiers_that_make_points_are_refused_with_numbers():
    obj = scenes.sphere(3)
    obj.modifiers.new("Subdivision", "SUBSURF")
    before = scenes.snapshot(obj)
    with pytest.raises(RuntimeError, match=r"its modifiers make [\d,]+ points of 162"):
        run(use_modifiers=True)
    assert scenes.snapshot(obj) == before


def test_tangent_space_would_be_turned_twice():
    obj = bent(scenes.sphere(3))
    with pytest.raises(RuntimeError, match="choose Free"):
        run(use_modifiers=True, storage="tangent_space")
    assert "ts_normal" not in obj.data.attributes
