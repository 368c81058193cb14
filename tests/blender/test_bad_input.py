# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that cannot be done are refused with a sentence and stay as they were."""

import bpy
import numpy as np
import pytest
import scenes

OPERATORS = ["estimate_normals", "compare_delaunay"]


def line(n=20):
    return np.outer(np.linspace(0, 1, n), [1, 2, 3])


def spoiled(value):
    points = scenes.ball(50)
    points[7, 1] = value
    return points


def flat_object():
    obj = scenes.sphere(3)
    obj.scale.z = 0
    return obj


def group_in_the_way():
    obj = scenes.sphere(3)
    obj.vertex_groups.new(name="ts_normal")
    return obj


# What makes the object, and a part of the sentence.
REFUSED = {
    "empty mesh": (lambda: scenes.new_mesh([]), "its mesh has no points"),
    "too few": (lambda: scenes.new_mesh(scenes.ball(8)), "at least 9 points.* got 8"),
    "few in a cloud": (lambda: scenes.new_cloud(scenes.ball(5)), "at least 9 .* got 5"),
    "nan": (lambda: scenes.new_mesh(spoiled(np.nan)), "finite points.* 1 of 50"),
    "infinite": (lambda: scenes.new_cloud(spoiled(np.inf)), "finite points.* 1 of 50"),
    "one place": (lambda: scenes.new_mesh(np.ones((30, 3))), "30 in one place"),
    "one line": (lambda: scenes.new_cloud(line()), "20 on one line"),
    "no scale": (flat_object, "its scale is zero along an axis"),
    "vertex group": (group_in_the_way, 'vertex group "ts_normal" is in the way'),
}


@pytest.mark.parametrize("operator", OPERATORS)
@pytest.mark.parametrize("case", REFUSED)
def test_refused_with_a_sentence_and_untouched(operator, case):
    make, sentence = REFUSED[case]
    obj = make()
    before = scenes.snapshot(obj)
    with pytest.raises(
        RuntimeError, match=rf"^Error: {obj.name}: .*{sentence}"
    ) as found:
        getattr(bpy.ops.timescale, operator)()
    assert "Traceback" not in str(found.value)
    assert str(found.value).strip().count("\n") == 0
    assert scenes.snapshot(obj) == before


@pytest.mark.parametrize("operator", [*OPERATORS, "clear_results"])
def test_nothing_selected(operator):
    with pytest.raises(RuntimeError, match="Select a mesh or point cloud"):
        getattr(bpy.ops.timescale, operator)()


@pytest.mark.parametrize("operator", [*OPERATORS, "clear_results"])
def test_only_a_light_selected(operator):
    scenes.link(bpy.data.objects.new("L", bpy.data.lights.new("L", "POINT")))
    with pytest.raises(RuntimeError, match="Select a mesh or point cloud"):
        getattr(bpy.ops.timescale, operator)()


def test_all_bad_objects_are_named():
    first, second = (
        scenes.new_mesh([], name="First"),
        scenes.new_mesh([], name="Second"),
    )
    scenes.select(first, second)
    with pytest.raises(RuntimeError) as found:
        bpy.ops.timescale.estimate_normals()
    assert "First: its mesh has no points" in str(found.value)
    assert "Second: its mesh has no points" in str(found.value)


def test_refusal_in_edit_mode_stays_in_edit_mode():
    obj = scenes.new_mesh(scenes.ball(5))
    bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(RuntimeError, match="at least 9"):
        bpy.ops.timescale.estimate_normals()
    assert obj.mode == "EDIT"


def test_mesh_in_edit_mode_elsewhere():
    """As when a script names the objects itself."""
    obj = scenes.sphere(3)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.context.view_layer.objects.active = None
    with (
        bpy.context.temp_override(selected_objects=[obj]),
        pytest.raises(RuntimeError, match="leave Edit Mode first"),
    ):
        bpy.ops.timescale.estimate_normals()


def linked(tmp_path, *, cloud=False):
    """An object of another file."""
    obj = scenes.new_cloud(scenes.ball()) if cloud else scenes.sphere(3)
    if not cloud:
        obj.shape_key_add(name="Basis")
    obj.name = "Far"
    path = str(tmp_path / "library.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.objects = ["Far"]
    return scenes.link(wanted.objects[0])


@pytest.mark.parametrize("cloud", [False, True])
@pytest.mark.parametrize("operator", [*OPERATORS, "clear_results"])
def test_linked_data(operator, cloud, tmp_path):
    obj = linked(tmp_path, cloud=cloud)
    before = obj.data.attributes.keys()
    with pytest.raises(RuntimeError, match=r"belongs to another file.*Make Local"):
        getattr(bpy.ops.timescale, operator)()
    assert obj.data.attributes.keys() == before


def test_library_override_until_it_is_made_local(tmp_path):
    far = linked(tmp_path)
    context = bpy.context
    obj = far.override_hierarchy_create(
        context.scene, context.view_layer, do_fully_editable=True
    )
    scenes.select(obj)
    with pytest.raises(RuntimeError, match=r"belongs to another file.*Make Local"):
        bpy.ops.timescale.estimate_normals()
    assert "ts_normal" not in obj.data.attributes
    # What the sentence says to do.
    bpy.ops.object.make_local(type="SELECT_OBDATA")
    assert bpy.ops.timescale.estimate_normals() == {"FINISHED"}


def test_duplicate_points_get_one_normal():
    ball = scenes.ball()
    obj = scenes.new_cloud(np.concatenate([ball, ball[:100]]))
    bpy.ops.timescale.estimate_normals()
    normals = scenes.get(obj, "ts_normal")
    np.testing.assert_array_equal(normals[600:], normals[:100])
    assert scenes.angles(normals[:600], ball).max() < 0.1


def test_coplanar_points_have_the_normal_of_the_plane():
    rng = np.random.default_rng(0)
    flat = np.concatenate([rng.random((40, 2)), np.zeros((40, 1))], axis=1)
    obj = scenes.new_cloud(flat)
    bpy.ops.timescale.estimate_normals()
    normals = scenes.get(obj, "ts_normal")
    np.testing.assert_allclose(np.abs(normals), np.tile([0, 0, 1], (40, 1)), atol=1e-6)
    assert len(np.unique(np.sign(normals[:, 2]))) == 1


def test_mesh_with_fewer_vertices_than_a_patch_takes_those_of_its_faces():
    bpy.ops.mesh.primitive_cube_add()
    obj = bpy.context.object
    bpy.ops.timescale.estimate_normals()
    expected = scenes.points_of(obj) / np.sqrt(3)
    np.testing.assert_allclose(scenes.get(obj, "ts_normal"), expected, atol=1e-6)


def test_faces_of_any_number_of_corners():
    bpy.ops.mesh.primitive_cylinder_add(vertices=24)
    obj = bpy.context.object
    assert bpy.ops.timescale.compare_delaunay() == {"FINISHED"}
    assert scenes.get(obj, "ts_valid").all()
