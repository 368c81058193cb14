# SPDX-License-Identifier: GPL-3.0-or-later
"""Marked edges of a mesh split its custom normals."""

import json

import bpy
import numpy as np
import pytest
import scenes
from bl_ext.user_default.timescale_normals.addon import bridge

# The worst of sixteen bits in tangent space, in degrees.
SIXTEEN_BITS = 0.81
# Free normals are stored in single precision.
ROUNDING = 1e-4
WORST = {"free": ROUNDING, "tangent_space": SIXTEEN_BITS}
STORAGES = pytest.mark.parametrize("storage", WORST)


def run(**settings):
    return bpy.ops.timescale.estimate_normals(**settings)


def mark(obj, name, values):
    """Set a mark of edges or faces as the interface does, (e,) or (m,) bool."""
    items = obj.data.polygons if name == "use_smooth" else obj.data.edges
    items.foreach_set(name, np.asarray(values, bool))
    obj.data.update()


def cube():
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.object.shade_smooth()
    return bpy.context.object


def face_of_corner(obj):
    return np.repeat(
        np.arange(len(obj.data.polygons)), [p.loop_total for p in obj.data.polygons]
    )


def face_normals(obj):
    """Normals of the faces at their corners, (c, 3)."""
    normals = np.array([p.normal[:] for p in obj.data.polygons])
    return normals[face_of_corner(obj)]


def cylinder():
    """A tube of many quads between two fans of triangles, and which edges are rims."""
    bpy.ops.mesh.primitive_cylinder_add(vertices=64, end_fill_type="TRIFAN")
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide(number_cuts=3)
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.object.shade_smooth()
    obj = bpy.context.object
    points = scenes.points_of(obj)
    flat = np.hypot(points[:, 0], points[:, 1])
    ends = np.array([e.vertices[:] for e in obj.data.edges])
    z = points[ends, 2]
    on_rim = (flat[ends] > 0.995).all(axis=1) & (np.abs(z) > 0.999).all(axis=1)
    return obj, on_rim & (z[:, 0] == z[:, 1])


def of_cylinder(obj):
    """True normals of the corners of a cylinder."""
    points = scenes.points_of(obj)[scenes.corner_vertices(obj)]
    flat = face_normals(obj)
    side = np.abs(flat[:, 2:]) < 0.5
    return np.where(side, points * [1, 1, 0], np.sign(flat) * [0, 0, 1])


def error(obj, expected):
    return scenes.angles(scenes.corner_normals(obj), expected).max()


def summary(obj):
    return json.loads(obj.data.timescale_normals.summary)["estimate"]


@STORAGES
def test_cube_of_sharp_edges_has_the_normals_of_its_faces(storage):
    obj = cube()
    mark(obj, "use_edge_sharp", np.ones(12))
    before = scenes.snapshot(obj)
    run(storage=storage)
    assert error(obj, face_normals(obj)) < WORST[storage]
    diagonal = scenes.points_of(obj)
    assert scenes.angles(scenes.get(obj, "ts_normal"), diagonal).max() < ROUNDING
    found = summary(obj)
    assert (found["points"], found["valid"], found["normals"]) == (8, 8, 24)
    bpy.ops.timescale.clear_results()
    assert scenes.snapshot(obj) == before


@STORAGES
def test_without_splitting_a_cube_is_round(storage):
    obj = cube()
    mark(obj, "use_edge_sharp", np.ones(12))
    run(storage=storage, split=set())
    expected = scenes.points_of(obj)[scenes.corner_vertices(obj)]
    assert error(obj, expected) < WORST[storage]


@STORAGES
def test_cylinder_with_sharp_rims_has_flat_ends_and_a_round_side(storage):
    obj, rims = cylinder()
    mark(obj, "use_edge_sharp", rims)
    before = scenes.snapshot(obj)
    run(storage=storage, split=set())
    assert error(obj, of_cylinder(obj)) > 20
    run(storage=storage)
    # The subdivided rims are chords of a circle: the side is a prism of 64 faces.
    assert error(obj, of_cylinder(obj)) < 360 / 64
    bpy.ops.timescale.clear_results()
    assert scenes.snapshot(obj) == before


@STORAGES
@pytest.mark.parametrize("marks", ["seams", "materials"])
def test_seams_and_borders_split_when_asked(storage, marks):
    obj, rims = cylinder()
    if marks == "seams":
        mark(obj, "use_seam", rims)
    else:
        for name in "ab":
            obj.data.materials.append(bpy.data.materials.new(name))
        ends = [abs(p.normal.z) > 0.5 for p in obj.data.polygons]
        obj.data.polygons.foreach_set("material_index", np.array(ends, np.int32))
        obj.data.update()
    before = scenes.snapshot(obj)
    run(storage=storage)
    assert error(obj, of_cylinder(obj)) > 20
    run(storage=storage, split={marks})
    assert error(obj, of_cylinder(obj)) < 360 / 64
    # Edges made sharp for the run are no marks of the user's for the next.
    run(storage=storage)
    assert error(obj, of_cylinder(obj)) > 20
    run(storage=storage, split={marks})
    bpy.ops.timescale.clear_results()
    assert scenes.snapshot(obj) == before


@STORAGES
def test_clear_brings_marks_and_normals_back(storage):
    obj, rims = cylinder()
    rng = np.random.default_rng(0)
    mark(obj, "use_edge_sharp", rng.random(len(rims)) < 0.02)
    mark(obj, "use_seam", rims)
    scenes.set_tangent_normals(obj)
    before = scenes.snapshot(obj)
    for _ in range(2):
        run(storage=storage, split={"sharp", "seams"}, strength=0.6)
        bpy.ops.timescale.compare_delaunay(split={"sharp", "seams"})
    assert scenes.snapshot(obj)["shading"] != before["shading"]
    bpy.ops.timescale.clear_results()
    assert scenes.snapshot(obj) == before


def test_edges_made_sharp_by_the_user_since_stay_sharp():
    obj, rims = cylinder()
    mark(obj, "use_seam", rims)
    run(storage="tangent_space", split={"seams"})
    sharp = scenes.get(obj, "sharp_edge")
    np.testing.assert_array_equal(sharp, rims)
    chosen = np.flatnonzero(~rims)[:5]
    sharp[chosen] = True
    mark(obj, "use_edge_sharp", sharp)
    bpy.ops.timescale.clear_results()
    np.testing.assert_array_equal(np.flatnonzero(scenes.get(obj, "sharp_edge")), chosen)


@STORAGES
def test_flat_faces_among_smooth_ones_stay_flat(storage):
    obj, _ = cylinder()
    ends = np.array([abs(p.normal.z) > 0.5 for p in obj.data.polygons])
    mark(obj, "use_smooth", ~ends)
    run(storage=storage)
    flat = ends[face_of_corner(obj)]
    found = scenes.corner_normals(obj)
    assert scenes.angles(found[flat], face_normals(obj)[flat]).max() < WORST[storage]
    assert error(obj, of_cylinder(obj)) < 360 / 64


def test_mesh_that_is_flat_all_over_gets_smooth():
    obj = cube()
    bpy.ops.object.shade_flat()
    run()
    assert error(obj, scenes.points_of(obj)[scenes.corner_vertices(obj)]) < ROUNDING


@STORAGES
def test_only_selected_vertices_of_a_split_mesh_change(storage):
    obj, rims = cylinder()
    mark(obj, "use_edge_sharp", rims)
    before = scenes.corner_normals(obj)
    above = scenes.points_of(obj)[:, 2] > 0
    obj.data.attributes.remove(obj.data.attributes[".select_vert"])
    scenes.put(obj, ".select_vert", "BOOLEAN", above)
    run(region="selected", storage=storage)
    chosen = above[scenes.corner_vertices(obj)]
    after = scenes.corner_normals(obj)
    np.testing.assert_array_equal(after[~chosen], before[~chosen])
    off = scenes.angles(after[chosen], of_cylinder(obj)[chosen])
    assert off.max() < 360 / 64


@STORAGES
def test_corners_without_a_normal_keep_theirs(storage):
    """Of a cube beside a face without area, whose corners have no normal."""
    obj = cube()
    points, faces = scenes.points_of(obj), [p.vertices[:] for p in obj.data.polygons]
    line = [(5, 0, 0), (6, 0, 0), (7, 0, 0)]
    obj = scenes.new_mesh(np.concatenate([points, line]), [*faces, (8, 9, 10)])
    mark(obj, "use_edge_sharp", np.ones(len(obj.data.edges)))
    before = scenes.snapshot(obj)
    kept = scenes.corner_normals(obj)[-3:]
    run(storage=storage)
    assert error_of_cube(obj) < WORST[storage]
    np.testing.assert_array_equal(scenes.corner_normals(obj)[-3:], kept)
    assert list(scenes.get(obj, "ts_valid")) == [True] * 8 + [False] * 3
    assert summary(obj)["invalid"] == 3
    bpy.ops.timescale.clear_results()
    assert scenes.snapshot(obj) == before


def error_of_cube(obj):
    found = scenes.corner_normals(obj)[:24]
    return scenes.angles(found, face_normals(obj)[:24]).max()


def test_mirrored_and_scaled_objects_split_too():
    obj = cube()
    mark(obj, "use_edge_sharp", np.ones(12))
    obj.scale, obj.rotation_euler = (2, -1, 0.5), (0.3, 0.2, 0.1)
    run(storage="free")
    assert error(obj, face_normals(obj)) < ROUNDING


def test_reference_gives_the_sides_of_all_fans():
    obj = cube()
    mark(obj, "use_edge_sharp", np.ones(12))
    scenes.put(obj, "inward", "FLOAT_VECTOR", -scenes.points_of(obj))
    run(storage="free", orientation="reference", reference="inward")
    assert error(obj, -face_normals(obj)) < ROUNDING


def test_shape_after_modifiers_is_split_at_marks_after_modifiers():
    obj, _ = cylinder()
    taper = obj.modifiers.new("Taper", "SIMPLE_DEFORM")
    taper.deform_method, taper.deform_axis = "TAPER", "Z"
    group = bpy.data.node_groups.new("Sharpen", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        group.interface.new_socket(
            "Geometry", in_out=direction, socket_type="NodeSocketGeometry"
        )
    nodes, links = group.nodes, group.links
    ends = [nodes.new(f"NodeGroup{name}") for name in ("Input", "Output")]
    angle = nodes.new("GeometryNodeInputMeshEdgeAngle")
    wide = nodes.new("FunctionNodeCompare")
    wide.inputs[1].default_value = 1.0
    store = nodes.new("GeometryNodeStoreNamedAttribute")
    store.data_type, store.domain = "BOOLEAN", "EDGE"
    store.inputs["Name"].default_value = "sharp_edge"
    links.new(ends[0].outputs[0], store.inputs["Geometry"])
    links.new(angle.outputs["Unsigned Angle"], wide.inputs[0])
    links.new(wide.outputs[0], store.inputs["Value"])
    links.new(store.outputs["Geometry"], ends[1].inputs[0])
    obj.modifiers.new("Sharpen", "NODES").node_group = group
    run(use_modifiers=True)
    assert obj.data.attributes["custom_normal"].domain == "CORNER"
    flat = np.abs(face_normals(obj)[:, 2]) > 0.5
    up = np.array([0, 0, 1]) * np.sign(face_normals(obj)[flat])
    assert scenes.angles(scenes.corner_normals(obj)[flat], up).max() < 0.1


def test_neighbors_from_elsewhere_do_not_split_and_say_so(capfd):
    obj, rims = cylinder()
    mark(obj, "use_edge_sharp", rims)
    assert run(graph="nearest") == {"FINISHED"}
    assert "marked edges do not part it" in capfd.readouterr().out
    assert obj.data.attributes["custom_normal"].domain == "POINT"


def test_faces_of_many_corners_are_parted_as_a_whole():
    bpy.ops.mesh.primitive_cylinder_add(vertices=24, end_fill_type="NGON")
    bpy.ops.object.shade_smooth()
    obj = bpy.context.object
    ends = np.array([e.vertices[:] for e in obj.data.edges])
    z = scenes.points_of(obj)[ends, 2]
    mark(obj, "use_edge_sharp", z[:, 0] == z[:, 1])
    run(storage="free")
    assert error(obj, of_cylinder(obj)) < 0.1


def test_marks_that_change_meanwhile_are_noticed():
    """Of a run beside the window, which must not write what no longer fits."""
    obj, rims = cylinder()
    seen = {bridge.fingerprint(obj)}
    for name in ("use_edge_sharp", "use_seam"):
        mark(obj, name, rims)
        seen.add(bridge.fingerprint(obj))
    mark(obj, "use_smooth", np.zeros(len(obj.data.polygons)))
    seen.add(bridge.fingerprint(obj))
    obj.data.polygons[0].material_index = 1
    seen.add(bridge.fingerprint(obj))
    assert len(seen) == 5
    assert bridge.fingerprint(obj) in seen


def test_comparison_says_that_it_is_one_of_means(capfd):
    obj, rims = cylinder()
    bpy.ops.timescale.compare_delaunay()
    assert "the mean of each vertex" not in capfd.readouterr().out
    bpy.ops.timescale.clear_results()
    mark(obj, "use_edge_sharp", rims)
    bpy.ops.timescale.compare_delaunay()
    assert "the mean of each vertex" in capfd.readouterr().out


def test_points_have_no_edges_to_split_at():
    obj = scenes.new_cloud(scenes.ball())
    assert run(split={"sharp", "seams", "materials"}) == {"FINISHED"}
    assert scenes.get(obj, "ts_valid").all()
