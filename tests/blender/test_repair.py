# SPDX-License-Identifier: GPL-3.0-or-later
"""Repair Normals on meshes of Blender."""

import bpy
import numpy as np
import pytest
import scenes

STORAGES = pytest.mark.parametrize("storage", ["free", "tangent_space"])


def run(**settings):
    return bpy.ops.timescale.repair_normals(**settings)


def noisy_sphere(share=0.3, subdivisions=5):
    """A sphere whose vertices moved by a share of the mean edge, and true normals."""
    obj = scenes.sphere(subdivisions)
    bpy.ops.object.shade_smooth()
    points = scenes.points_of(obj)
    edge = np.sqrt(4 * np.pi / len(obj.data.polygons) * 4 / np.sqrt(3))
    rng = np.random.default_rng(1)
    moved = points + rng.normal(0, share * edge, points.shape)
    obj.data.vertices.foreach_set("co", moved.astype(np.float32).ravel())
    obj.data.update()
    return obj, points[scenes.corner_vertices(obj)]


def rms(obj, expected):
    return np.sqrt((scenes.angles(scenes.corner_normals(obj), expected) ** 2).mean())


def turn_faces(obj, which):
    import bmesh

    edited = bmesh.new()
    edited.from_mesh(obj.data)
    edited.faces.ensure_lookup_table()
    bmesh.ops.reverse_faces(edited, faces=[edited.faces[i] for i in which])
    edited.to_mesh(obj.data)
    edited.free()
    obj.data.update()


@STORAGES
def test_noise_is_averaged_and_the_shape_stays(storage, capsys):
    obj, truth = noisy_sphere()
    before = scenes.snapshot(obj)
    points = scenes.points_of(obj)
    wrong = rms(obj, truth)
    assert run(storage=storage) == {"FINISHED"}
    assert rms(obj, truth) < wrong / 5
    np.testing.assert_array_equal(scenes.points_of(obj), points)
    bpy.ops.timescale.clear_results()
    assert scenes.snapshot(obj) == before
    # Of edges that noise has made longer.
    assert "noise of 0.26 edges found" in capsys.readouterr().out


def test_a_preview_only_colors():
    obj, truth = noisy_sphere()
    wrong = rms(obj, truth)
    before = scenes.snapshot(obj)
    assert run(preview=True) == {"FINISHED"}
    assert rms(obj, truth) == wrong
    assert "ts_error_color" in obj.data.attributes
    assert "ts_normal" not in obj.data.attributes
    assert "Time-Scale Colors" in obj.modifiers
    bpy.ops.timescale.clear_results()
    assert scenes.snapshot(obj) == before
    assert "Time-Scale Colors" not in obj.modifiers


def test_repair_after_a_preview_leaves_no_colors():
    obj, truth = noisy_sphere()
    run(preview=True)
    run()
    assert rms(obj, truth) < 5
    assert "ts_error_color" not in obj.data.attributes
    assert "Time-Scale Colors" not in obj.modifiers


@STORAGES
@pytest.mark.parametrize("turn", [True, False])
def test_flipped_faces(storage, turn, capsys):
    obj = scenes.sphere(4)
    bpy.ops.object.shade_smooth()
    which = [3, 50, 51, 52, 700]
    turn_faces(obj, which)
    assert run(storage=storage, turn_faces=turn) == {"FINISHED"}
    said = capsys.readouterr().out
    normals = np.array([p.normal[:] for p in obj.data.polygons])
    middles = np.array([p.center[:] for p in obj.data.polygons])
    inward = (normals * middles).sum(axis=1) < 0
    if turn:
        assert "5 faces flipped" in said
        assert not inward.any()
    else:
        assert "5 faces wind against the others" in said
        np.testing.assert_array_equal(np.flatnonzero(inward), which)
    expected = scenes.points_of(obj)[scenes.corner_vertices(obj)]
    # What flipped faces show in tangent space cannot be chosen freely.
    if turn or storage == "free":
        assert rms(obj, expected) < 1


def test_quads_keep_their_corners_when_flipped():
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32)
    bpy.ops.object.shade_smooth()
    obj = bpy.context.object
    turn_faces(obj, [100, 101, 500])
    run(storage="free")
    expected = scenes.points_of(obj)[scenes.corner_vertices(obj)]
    assert scenes.angles(scenes.corner_normals(obj), expected).max() < 1


def cube():
    bpy.ops.mesh.primitive_cube_add()
    obj = bpy.context.object
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.subdivide(number_cuts=7)
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.object.shade_smooth()
    return obj


def face_normals(obj):
    normals = np.array([p.normal[:] for p in obj.data.polygons])
    return np.repeat(normals, [p.loop_total for p in obj.data.polygons], axis=0)


@STORAGES
@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 2, 1)])
def test_sharp_angle_parts_a_cube(storage, scale):
    obj = cube()
    obj.scale = scale
    run(storage=storage, sharp_angle=np.radians(30))
    assert scenes.angles(scenes.corner_normals(obj), face_normals(obj)).max() < 0.81


def test_marked_edges_part_as_in_an_estimate():
    obj = cube()
    flat = np.array([e.use_edge_sharp for e in obj.data.edges])
    assert not flat.any()
    points = np.abs(scenes.points_of(obj))
    ends = np.array([e.vertices[:] for e in obj.data.edges])
    on = (points[ends] > 0.999).all(axis=1).sum(axis=1) >= 2
    obj.data.edges.foreach_set("use_edge_sharp", on)
    run(storage="free")
    assert scenes.angles(scenes.corner_normals(obj), face_normals(obj)).max() < 1e-3
    run(storage="free", split=set())
    assert scenes.angles(scenes.corner_normals(obj), face_normals(obj)).max() > 30


def test_only_the_selection_changes():
    obj, truth = noisy_sphere()
    shown = scenes.corner_normals(obj)
    chosen = scenes.points_of(obj)[:, 2] > 0
    obj.data.vertices.foreach_set("select", chosen)
    run(region="selected", storage="free")
    at = chosen[scenes.corner_vertices(obj)]
    new = scenes.corner_normals(obj)
    np.testing.assert_allclose(new[~at], shown[~at], atol=1e-6)
    assert np.sqrt((scenes.angles(new[at], truth[at]) ** 2).mean()) < 5


def test_only_faces_of_the_selection_are_flipped():
    obj = scenes.sphere(4)
    middles = np.array([p.center[:] for p in obj.data.polygons])
    which = [int(middles[:, 2].argmax()), int(middles[:, 2].argmin())]
    turn_faces(obj, which)
    obj.data.vertices.foreach_set("select", scenes.points_of(obj)[:, 2] > 0)
    run(region="selected")
    normals = np.array([p.normal[:] for p in obj.data.polygons])
    inward = np.flatnonzero((normals * middles).sum(axis=1) < 0)
    assert inward.tolist() == which[1:]


def test_points_alone_are_refused():
    scenes.new_cloud(scenes.ball(100))
    with pytest.raises(RuntimeError, match="no faces to repair"):
        run()


def test_the_panel_says_how_noisy_a_mesh_is():
    from bl_ext.user_default.timescale_normals.addon import bridge
    from bl_ext.user_default.timescale_normals.addon.display import summaries

    obj, _ = noisy_sphere()
    run()
    rows = dict(summaries.result_rows(bridge.read_summary(obj)["estimate"]))
    assert rows["Averaged"] == rows["From Faces"] == "2,562"
    assert rows["Noise"].endswith(" %")
