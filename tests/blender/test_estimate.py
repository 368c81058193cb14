# SPDX-License-Identifier: GPL-3.0-or-later
"""`timescale.estimate_normals`, by what it leaves on real objects."""

import json
import math

import bpy
import numpy as np
import pytest
import scenes
from mathutils import Matrix

# A patch of second order follows these spheres to 0.02 (642 vertices) and 0.07 degrees
# (600 points); the mean of the faces around is off by 0.5.
TOLERANCE = 0.1
# Normals are stored in single precision.
ROUNDING = 1e-6


def run(**settings):
    return bpy.ops.timescale.estimate_normals(**settings)


def summary(obj):
    return json.loads(obj.data.timescale_normals.summary)["estimate"]


def radial_error(obj):
    return scenes.angles(scenes.get(obj, "ts_normal"), scenes.points_of(obj)).max()


def test_sphere_gets_radial_custom_normals():
    obj = scenes.sphere()
    assert run() == {"FINISHED"}
    expected = scenes.points_of(obj)[scenes.corner_vertices(obj)]
    assert scenes.angles(scenes.corner_normals(obj), expected).max() < TOLERANCE


def test_attributes_have_the_names_types_and_domains_of_the_contract():
    obj = scenes.sphere()
    run()
    attributes = obj.data.attributes
    found = {a.name: (a.data_type, a.domain) for a in attributes}
    assert found["ts_normal"] == ("FLOAT_VECTOR", "POINT")
    assert found["ts_valid"] == ("BOOLEAN", "POINT")
    assert found["custom_normal"] == ("FLOAT_VECTOR", "POINT")
    assert scenes.get(obj, "ts_valid").all()


def test_free_normals_are_exactly_the_estimated_ones():
    obj = scenes.sphere()
    run(storage="free")
    normals = scenes.get(obj, "ts_normal")
    np.testing.assert_array_equal(
        scenes.corner_normals(obj), normals[scenes.corner_vertices(obj)]
    )
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=ROUNDING)


def test_tangent_space_normals_are_within_their_sixteen_bits():
    obj = scenes.sphere()
    run(storage="tangent_space")
    expected = scenes.get(obj, "ts_normal")[scenes.corner_vertices(obj)]
    assert obj.data.attributes["custom_normal"].data_type == "INT16_2D"
    assert "sharp_edge" not in obj.data.attributes
    # The worst of the encoding.
    assert scenes.angles(scenes.corner_normals(obj), expected).max() < 0.81


def test_plane_is_exact():
    obj = scenes.plane()
    run()
    np.testing.assert_array_equal(
        scenes.get(obj, "ts_normal"), np.tile([0, 0, 1], (len(obj.data.vertices), 1))
    )


def test_point_cloud_gets_attributes():
    obj = scenes.new_cloud(scenes.ball())
    assert obj.type == "POINTCLOUD"
    assert run() == {"FINISHED"}
    assert radial_error(obj) < TOLERANCE
    assert scenes.get(obj, "ts_valid").all()


def test_mesh_without_faces_gets_attributes_and_no_custom_normals():
    obj = scenes.new_mesh(scenes.ball())
    run()
    assert radial_error(obj) < TOLERANCE
    assert "custom_normal" not in obj.data.attributes


@pytest.mark.parametrize("primitive", ["cube", "monkey", "torus", "cone"])
def test_primitives_face_as_their_faces_do(primitive):
    getattr(bpy.ops.mesh, f"primitive_{primitive}_add")()
    obj = bpy.context.object
    before = np.empty(3 * len(obj.data.vertices), np.float32)
    obj.data.vertex_normals.foreach_get("vector", before)
    assert run() == {"FINISHED"}
    assert scenes.get(obj, "ts_valid").all()
    dots = (scenes.get(obj, "ts_normal") * before.reshape(-1, 3)).sum(axis=1)
    assert (dots > 0).all()


def test_flat_shaded_faces_show_the_normals_too():
    obj = scenes.sphere(3)
    bpy.ops.object.shade_flat()
    for storage in ("free", "tangent_space"):
        run(storage=storage)
        expected = scenes.points_of(obj)[scenes.corner_vertices(obj)]
        assert scenes.angles(scenes.corner_normals(obj), expected).max() < 1


# Storage


def test_normals_that_must_follow_deformation_are_in_tangent_space():
    obj = scenes.sphere()
    obj.shape_key_add(name="Basis")
    run()
    assert obj.data.attributes["custom_normal"].data_type == "INT16_2D"


@pytest.mark.parametrize("deformer", ["ARMATURE", "SIMPLE_DEFORM", "LATTICE"])
def test_modifiers_that_deform_ask_for_tangent_space(deformer):
    obj = scenes.sphere()
    obj.modifiers.new("Deform", deformer)
    run()
    assert obj.data.attributes["custom_normal"].data_type == "INT16_2D"


def test_modifier_of_another_object_with_the_mesh_counts():
    obj = scenes.sphere()
    other = scenes.link(bpy.data.objects.new("Other", obj.data))
    other.modifiers.new("Deform", "ARMATURE")
    scenes.select(obj)
    run()
    assert obj.data.attributes["custom_normal"].data_type == "INT16_2D"


def test_modifiers_that_only_add_points_leave_normals_free():
    obj = scenes.sphere()
    obj.modifiers.new("Array", "ARRAY")
    run()
    assert obj.data.attributes["custom_normal"].data_type == "FLOAT_VECTOR"


def test_tangent_space_normals_follow_an_armature():
    obj = scenes.sphere(3)
    run(storage="tangent_space")
    armature = scenes.link(bpy.data.objects.new("A", bpy.data.armatures.new("A")))
    bpy.ops.object.mode_set(mode="EDIT")
    bone = armature.data.edit_bones.new("Bone")
    bone.tail = (0, 0, 1)
    bpy.ops.object.mode_set(mode="OBJECT")
    obj.vertex_groups.new(name="Bone").add(range(len(obj.data.vertices)), 1, "ADD")
    obj.modifiers.new("Armature", "ARMATURE").object = armature
    armature.pose.bones["Bone"].rotation_mode = "XYZ"
    armature.pose.bones["Bone"].rotation_euler.x = 1.0
    moved = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    expected = scenes.points_of(moved)[scenes.corner_vertices(moved)]
    assert scenes.angles(scenes.corner_normals(moved), expected).max() < 1


# Rows that are not valid


def bad_corner_mesh(**settings):
    """A sphere, one loose vertex far away, and three on a line with a face."""
    ball = scenes.sphere()
    points, faces = (
        scenes.points_of(ball),
        [tuple(p.vertices) for p in ball.data.polygons],
    )
    n = len(points)
    extra = [(9, 9, 9), (5, 0, 0), (6, 0, 0), (7, 0, 0)]
    return scenes.new_mesh(
        np.concatenate([points, extra]), [*faces, (n + 1, n + 2, n + 3)], **settings
    ), n


def test_loose_vertices_and_faces_without_area_are_not_valid(capfd):
    obj, n = bad_corner_mesh()
    assert run() == {"FINISHED"}
    valid, normals = scenes.get(obj, "ts_valid"), scenes.get(obj, "ts_normal")
    assert valid[:n].all()
    assert not valid[n:].any()
    assert (normals[n:] == 0).all()
    points = scenes.points_of(obj)
    assert scenes.angles(normals[:n], points[:n]).max() < TOLERANCE
    assert "4 of 646 points had too few neighbors" in capfd.readouterr().out


@pytest.mark.parametrize(
    ("storage", "own"),
    [
        ("free", "none"),
        ("free", "tangent_space"),
        ("free", "POINT"),
        ("free", "CORNER"),
        ("tangent_space", "none"),
        ("tangent_space", "tangent_space"),
    ],
)
def test_vertices_that_are_not_valid_keep_the_normal_they_had(storage, own):
    obj, _ = bad_corner_mesh()
    if own == "tangent_space":
        scenes.set_tangent_normals(obj)
    elif own != "none":
        scenes.set_free_normals(obj, own)
    before = scenes.corner_normals(obj)
    for _ in range(2):
        # The second run must not take the first one's for Blender's.
        run(storage=storage)
        kept = ~scenes.get(obj, "ts_valid")[scenes.corner_vertices(obj)]
        assert kept.sum() == 3
        after = scenes.corner_normals(obj)
        np.testing.assert_array_equal(after[kept], before[kept])


def test_free_normals_cannot_be_kept_in_tangent_space():
    """Vertices that are not valid get the automatic normal then."""
    obj, _ = bad_corner_mesh()
    automatic = scenes.corner_normals(obj)
    scenes.set_free_normals(obj)
    run(storage="tangent_space")
    kept = ~scenes.get(obj, "ts_valid")[scenes.corner_vertices(obj)]
    np.testing.assert_array_equal(scenes.corner_normals(obj)[kept], automatic[kept])


def test_radius_that_reaches_nobody_leaves_all_as_it_was(capfd):
    obj = scenes.new_cloud(scenes.ball())
    assert run(radius=1e-4) == {"FINISHED"}
    assert not scenes.get(obj, "ts_valid").any()
    assert "600 of 600 points had too few neighbors" in capfd.readouterr().out


# World space


def test_stretched_object_is_estimated_as_it_stands():
    """The result is that of the same shape with its scale applied."""
    obj = scenes.new_cloud(scenes.ball())
    obj.matrix_world = (
        Matrix.Translation((3, -2, 1))
        @ Matrix.Rotation(0.7, 4, (1, 2, 3))
        @ Matrix.Diagonal((1, 0.5, 3, 1))
    )
    run()
    matrix = np.array(obj.matrix_world)[:3, :3]
    to_world = scenes.get(obj, "ts_normal") @ np.linalg.inv(matrix)
    applied = scenes.new_cloud(scenes.points_of(obj) @ matrix.T)
    run()
    # Points are rounded to single precision when the scale is applied.
    assert scenes.angles(to_world, scenes.get(applied, "ts_normal")).max() < 1e-2


def test_stretched_sphere_has_the_normals_of_an_ellipsoid():
    obj = scenes.sphere(5)
    obj.scale = (1, 1, 2)
    run()
    # In object space it is a sphere still: normals go by the inverse transpose. The
    # normals of the ellipsoid themselves are up to 19 degrees away.
    assert radial_error(obj) < 0.5


@pytest.mark.parametrize("scale", [(-1, 1, 1), (-1, -1, -1), (2, -3, 1)])
@pytest.mark.parametrize("cloud", [False, True])
def test_mirrored_object_faces_out(scale, cloud):
    obj = scenes.new_cloud(scenes.ball()) if cloud else scenes.sphere()
    obj.scale = scale
    run()
    normals = scenes.get(obj, "ts_normal")
    assert ((normals * scenes.points_of(obj)).sum(axis=1) > 0.9).all()


def test_coordinates_far_from_the_origin_of_the_world_do_not_matter():
    obj = scenes.new_cloud(scenes.ball())
    run()
    near = scenes.get(obj, "ts_normal")
    obj.location = (512_000, 5_403_000, 250)
    run()
    assert scenes.angles(near, scenes.get(obj, "ts_normal")).max() < 1e-3


# Orientation


def open_cap():
    points = scenes.ball(900)
    return points[points[:, 2] > 0.5]


def test_normals_face_an_object():
    scenes.link(bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN")))
    bpy.context.object.location = (0, 0, -9)
    obj = scenes.new_cloud(open_cap())
    run(orientation="viewpoint", viewpoint_object="Sun")
    assert (scenes.get(obj, "ts_normal")[:, 2] < 0).all()


def test_normals_face_a_place_in_the_world():
    obj = scenes.new_cloud(open_cap())
    obj.location = (0, 0, 100)
    run(orientation="viewpoint", viewpoint=(0, 0, 90))
    assert (scenes.get(obj, "ts_normal")[:, 2] < 0).all()
    run(orientation="viewpoint", viewpoint=(0, 0, 110))
    assert (scenes.get(obj, "ts_normal")[:, 2] > 0).all()


def test_viewpoint_that_is_not_there_is_refused():
    obj = scenes.new_cloud(open_cap())
    before = scenes.snapshot(obj)
    with pytest.raises(RuntimeError, match='there is no object "Nobody" to face'):
        run(orientation="viewpoint", viewpoint_object="Nobody")
    assert scenes.snapshot(obj) == before


def test_normals_agree_with_a_reference_attribute():
    points = scenes.ball()
    sides = np.where(points[:, :1] > 0.2, 1, -1)
    obj = scenes.new_cloud(points, normal=points * sides)
    # Mirrored: the attribute has to be taken to the world and back.
    obj.scale = (1, -2, 1)
    run(orientation="reference")
    np.testing.assert_array_equal(
        np.sign((scenes.get(obj, "ts_normal") * points).sum(axis=1)), sides[:, 0]
    )


def test_normals_take_the_side_of_another_object():
    """Of a sphere turned inside out, which stands elsewhere in the world's axes."""
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4, radius=1.1)
    guide = bpy.context.object
    guide.data.flip_normals()
    guide.data.transform(Matrix.Translation((0, 0, -3)))
    guide.location = (0, 0, 3)
    obj = scenes.new_cloud(scenes.ball())
    run(orientation="reference", reference_object=guide.name)
    sides = (scenes.get(obj, "ts_normal") * scenes.points_of(obj)).sum(axis=1)
    assert (sides < 0).all()


def test_object_to_take_the_side_of_is_not_there():
    obj = scenes.new_cloud(scenes.ball())
    before = scenes.snapshot(obj)
    with pytest.raises(RuntimeError, match='there is no object "Nobody" whose side'):
        run(orientation="reference", reference_object="Nobody")
    assert scenes.snapshot(obj) == before


def test_reference_that_is_not_there_is_refused():
    obj = scenes.sphere()
    before = scenes.snapshot(obj)
    with pytest.raises(RuntimeError, match=r'"mine" on POINT, found none'):
        run(orientation="reference", reference="mine")
    assert scenes.snapshot(obj) == before


# Settings


def test_properties_of_the_operator_reach_the_core():
    obj = scenes.new_cloud(scenes.ball())
    chosen = {"method": "time_scale", "neighbors": 20, "graph": "nearest"}
    chosen |= {"weights": "paper", "orientation": "outward", "patch": "cubic"}
    run(**chosen)
    found = summary(obj)
    expected = chosen | {"points": 600}
    assert {key: found[key] for key in expected} == expected


def test_a_run_without_settings_has_the_defaults():
    obj = scenes.new_cloud(scenes.ball())
    run(neighbors=30, graph="delaunay")
    run()
    assert summary(obj)["graph"] == "nearest"


def test_paper_is_what_the_paper_says():
    obj = scenes.new_cloud(scenes.ball())
    run(method="paper")
    assert summary(obj)["method"] == "paper"
    assert summary(obj)["graph"] == "delaunay"


def test_neighbors_below_a_patch_are_refused():
    obj = scenes.sphere()
    before = scenes.snapshot(obj)
    with pytest.raises(RuntimeError, match="expected neighbors from 8"):
        run(neighbors=5)
    assert scenes.snapshot(obj) == before


# Several objects, modes


def test_objects_that_share_a_mesh_share_the_result_of_one_run(capfd):
    obj = scenes.sphere()
    other = scenes.link(bpy.data.objects.new("Other", obj.data))
    other.scale = (1, 1, 5)
    scenes.select(other, obj)
    assert run() == {"FINISHED"}
    assert capfd.readouterr().out.count("normals") == 1
    assert "ts_normal" in other.data.attributes
    assert other.data == obj.data


def test_all_selected_objects_are_done():
    objects = [scenes.sphere(3), scenes.new_cloud(scenes.ball()), scenes.plane()]
    scenes.select(*objects)
    run()
    assert all("ts_normal" in obj.data.attributes for obj in objects)


def test_a_bad_object_does_not_stop_the_others(capfd):
    good, bad = scenes.sphere(3), scenes.new_mesh([], name="Hole")
    before = scenes.snapshot(bad)
    scenes.select(bad, good)
    assert run() == {"FINISHED"}
    assert "ts_normal" in good.data.attributes
    assert scenes.snapshot(bad) == before
    assert "Warning: Hole: its mesh has no points" in capfd.readouterr().out


def test_lights_in_the_selection_are_passed_over():
    obj = scenes.sphere(3)
    light = scenes.link(bpy.data.objects.new("L", bpy.data.lights.new("L", "POINT")))
    scenes.select(light, obj)
    assert run() == {"FINISHED"}
    assert "ts_normal" in obj.data.attributes


@pytest.mark.parametrize("mode", ["EDIT", "SCULPT", "WEIGHT_PAINT", "VERTEX_PAINT"])
def test_runs_in_other_modes_and_comes_back(mode):
    obj = scenes.sphere()
    bpy.ops.object.mode_set(mode=mode)
    assert run() == {"FINISHED"}
    assert obj.mode == mode
    bpy.ops.object.mode_set(mode="OBJECT")
    assert radial_error(obj) < TOLERANCE
    np.testing.assert_array_equal(
        scenes.corner_normals(obj),
        scenes.get(obj, "ts_normal")[scenes.corner_vertices(obj)],
    )


def test_unsaved_edits_of_edit_mode_count():
    obj = scenes.sphere()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.transform.translate(value=(0, 0, 7))
    bpy.ops.mesh.subdivide()
    run()
    bpy.ops.object.mode_set(mode="OBJECT")
    assert len(scenes.get(obj, "ts_normal")) > 642


def test_several_objects_in_edit_mode():
    objects = [scenes.sphere(3), scenes.plane()]
    scenes.select(*objects)
    bpy.ops.object.mode_set(mode="EDIT")
    run()
    assert all(obj.mode == "EDIT" for obj in objects)
    bpy.ops.object.mode_set(mode="OBJECT")
    assert all("ts_normal" in obj.data.attributes for obj in objects)


def test_object_in_edit_mode_need_not_be_selected():
    obj = scenes.sphere(3)
    obj.select_set(False)
    bpy.ops.object.mode_set(mode="EDIT")
    assert run() == {"FINISHED"}
    bpy.ops.object.mode_set(mode="OBJECT")
    assert "ts_normal" in obj.data.attributes


def test_hidden_vertices_are_estimated_too():
    obj = scenes.sphere()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.hide()
    bpy.ops.object.mode_set(mode="OBJECT")
    run()
    assert scenes.get(obj, "ts_valid").all()
    assert radial_error(obj) < TOLERANCE


def test_second_run_replaces_the_first():
    obj = scenes.sphere()
    run(storage="tangent_space", orientation="none")
    run()
    names = [name for name in obj.data.attributes.keys() if "." in name[1:]]
    assert not names
    assert obj.data.attributes["custom_normal"].data_type == "FLOAT_VECTOR"


def test_rotation_alone_turns_the_normals_back():
    obj = scenes.sphere()
    obj.rotation_euler = (0.3, math.pi / 2, 1)
    run()
    assert radial_error(obj) < TOLERANCE
