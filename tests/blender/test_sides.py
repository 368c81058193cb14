# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals that are there turn to the right side, and are otherwise left alone."""

import json

import bmesh
import bpy
import numpy as np
import pytest
import scenes
from bl_ext.user_default.timescale_normals.addon.display import summaries

# The worst of sixteen bits in tangent space, in degrees.
SIXTEEN_BITS = 0.81
# Rounding of single precision.
ROUNDING = 1e-6


def reorient(mode="flip", **options):
    return bpy.ops.timescale.reorient_normals(mode=mode, **options)


def estimate(**settings):
    return bpy.ops.timescale.estimate_normals(**settings)


def scrambled(normals, seed=0):
    signs = np.random.default_rng(seed).choice([-1, 1], len(normals))
    return (normals * signs[:, None]).astype(np.float32)


def two_balls():
    """A cloud of two spheres with mixed normals of its own, and the outward ones."""
    ball = scenes.ball(600)
    points, normals = (
        np.concatenate([ball, ball * 0.5 + [3, 0, 0]]),
        np.tile(ball, (2, 1)),
    )
    return scenes.new_cloud(points, normal=scrambled(normals)), normals


def test_vectors_that_a_file_brought_are_kept_but_for_their_side():
    obj, outward = two_balls()
    assert reorient("auto") == {"FINISHED"}
    found = scenes.get(obj, "normal")
    np.testing.assert_array_equal(found, outward.astype(np.float32))
    assert "ts_normal" not in obj.data.attributes


def test_estimated_normals_flip_and_flip_back():
    obj = scenes.new_cloud(scenes.ball())
    estimate()
    before = scenes.get(obj, "ts_normal")
    reorient()
    np.testing.assert_array_equal(scenes.get(obj, "ts_normal"), -before)
    reorient("auto")
    np.testing.assert_array_equal(scenes.get(obj, "ts_normal"), before)


@pytest.mark.parametrize("storage", ["free", "tangent_space"])
def test_selected_vertices_of_a_mesh_flip(storage):
    obj = scenes.sphere()
    obj.data.attributes.remove(obj.data.attributes[".select_vert"])
    upper = scenes.points_of(obj)[:, 2] > 0.1
    scenes.put(obj, ".select_vert", "BOOLEAN", upper)
    estimate(storage=storage)
    vectors, before = scenes.get(obj, "ts_normal"), scenes.corner_normals(obj)
    assert reorient(part="selected") == {"FINISHED"}
    sign = np.where(upper, -1, 1)[:, None]
    np.testing.assert_array_equal(scenes.get(obj, "ts_normal"), vectors * sign)
    corner_sign = sign[scenes.corner_vertices(obj)]
    after = scenes.corner_normals(obj)
    worst = 2 * SIXTEEN_BITS if storage == "tangent_space" else 1e-3
    assert scenes.angles(after, before * corner_sign).max() < worst


def test_in_edit_mode_the_selection_turns():
    obj = scenes.sphere(3)
    estimate()
    before = scenes.get(obj, "ts_normal")
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="DESELECT")
    with pytest.raises(RuntimeError, match="none of its points is selected"):
        reorient()
    bpy.ops.mesh.select_all(action="SELECT")
    reorient()
    assert obj.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    np.testing.assert_array_equal(scenes.get(obj, "ts_normal"), -before)


def test_custom_normals_without_an_estimate_turn_and_come_back():
    obj = scenes.sphere(3)
    scenes.set_tangent_normals(obj)
    before, shown = scenes.snapshot(obj), scenes.corner_normals(obj)
    reorient()
    assert scenes.angles(scenes.corner_normals(obj), -shown).max() < 2 * SIXTEEN_BITS
    bpy.ops.timescale.clear_results()
    assert scenes.snapshot(obj) == before


def test_a_mesh_without_custom_normals_gets_them():
    obj = scenes.sphere(3)
    shown = scenes.corner_normals(obj)
    reorient()
    assert scenes.angles(scenes.corner_normals(obj), -shown).max() < 1e-3
    # By its faces they are outward again.
    reorient("auto")
    assert scenes.angles(scenes.corner_normals(obj), shown).max() < 1e-3


def test_only_the_piece_near_the_cursor_turns():
    obj, _ = two_balls()
    before = scenes.get(obj, "normal")
    bpy.context.scene.cursor.location = (3, 0, 0.6)
    reorient(part="piece")
    sign = np.repeat([1, -1], 600)[:, None]
    np.testing.assert_array_equal(scenes.get(obj, "normal"), before * sign)


def test_the_piece_of_the_active_vertex_turns():
    near, far = scenes.sphere(3), scenes.sphere(3)
    far.location.x = 3
    scenes.select(near, far)
    bpy.ops.object.join()
    estimate()
    before = scenes.get(near, "ts_normal")
    bpy.ops.object.mode_set(mode="EDIT")
    mesh = bmesh.from_edit_mesh(near.data)
    mesh.verts.ensure_lookup_table()
    mesh.select_history.clear()
    mesh.verts[len(mesh.verts) - 1].select = True
    mesh.select_history.add(mesh.verts[len(mesh.verts) - 1])
    reorient(part="piece")
    bpy.ops.object.mode_set(mode="OBJECT")
    sign = np.repeat([1, -1], len(before) // 2)[:, None]
    np.testing.assert_array_equal(scenes.get(near, "ts_normal"), before * sign)


def test_toward_the_place_of_the_sensor_of_each_point():
    ball = scenes.ball(600)
    # A sensor that flies around: always above the point it sees, in object space.
    obj = scenes.new_cloud(ball, normal=scrambled(ball), sensor=ball * 4)
    obj.location, obj.scale = (5, 6, 7), (2, 1, 1)
    reorient("viewpoint", viewpoint_attribute="sensor")
    np.testing.assert_array_equal(scenes.get(obj, "normal"), ball)
    estimate(orientation="viewpoint", viewpoint_attribute="sensor")
    assert ((scenes.get(obj, "ts_normal") * ball).sum(axis=1) > 0).all()


def test_toward_an_object_and_like_an_object():
    ball = scenes.ball(600)
    inner = scenes.sphere(3, radius=0.9)
    eye = scenes.link(bpy.data.objects.new("Eye", None))
    obj = scenes.new_cloud(ball, normal=scrambled(ball))
    reorient("viewpoint", viewpoint_object=eye.name)
    np.testing.assert_array_equal(scenes.get(obj, "normal"), -ball)
    reorient("reference", reference_object=inner.name)
    np.testing.assert_array_equal(scenes.get(obj, "normal"), ball)
    estimate(orientation="reference", reference_object=inner.name)
    assert ((scenes.get(obj, "ts_normal") * ball).sum(axis=1) > 0).all()
    with pytest.raises(RuntimeError, match='no object "Nobody"'):
        reorient("reference", reference_object="Nobody")


def test_a_mirrored_object_turns_like_any_other():
    ball = scenes.ball(600)
    obj = scenes.new_cloud(ball, normal=scrambled(ball))
    obj.scale.x = -1
    reorient("auto")
    np.testing.assert_array_equal(scenes.get(obj, "normal"), ball)


def test_the_report_follows():
    obj = scenes.new_cloud(scenes.ball())
    estimate(orientation="none")
    assert scenes.get(obj, "ts_side_confidence").min() == 1
    reorient("auto")
    record = obj.data.timescale_normals.summary
    assert '"orientation": "poles"' in record and '"pieces": 1' in record
    # The poles of so few points leave some doubt.
    assert 0 < scenes.get(obj, "ts_side_confidence").min() < 1


def test_the_panel_says_where_faces_disagree():
    obj = scenes.sphere(3)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="DESELECT")
    mesh = bmesh.from_edit_mesh(obj.data)
    mesh.faces.ensure_lookup_table()
    mesh.faces[5].select = True
    bpy.ops.mesh.flip_normals()
    bpy.ops.object.mode_set(mode="OBJECT")
    estimate()
    summary = json.loads(obj.data.timescale_normals.summary)["estimate"]
    # The three sides of the one that was turned over.
    assert ("Faces Disagree", "3") in summaries.result_rows(summary)
    assert "wind against" in summary["warnings"][0]


def test_what_is_missing_is_said():
    obj = scenes.new_cloud(scenes.ball())
    with pytest.raises(RuntimeError, match='"normal" on POINT, found none'):
        reorient()
    other = scenes.new_cloud(scenes.ball(), normal=scenes.ball())
    scenes.select(other, obj)
    # One bad object does not stop the other.
    assert reorient() == {"FINISHED"}
    np.testing.assert_array_equal(scenes.get(other, "normal"), -scenes.ball())


def test_it_is_one_step_of_undo():
    operator = bpy.types.TIMESCALE_OT_reorient_normals
    assert operator.bl_options == {"REGISTER", "UNDO"}
