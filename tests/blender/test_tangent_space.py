# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals in tangent space are, to the bit, those that Blender's own methods keep."""

import bpy
import numpy as np
import pytest
import scenes
from bl_ext.user_default.timescale_normals.addon.bridge import custom_normals


def monkey():
    bpy.ops.mesh.primitive_monkey_add()
    bpy.ops.object.shade_smooth()


def sharp_cylinder():
    bpy.ops.mesh.primitive_cylinder_add(vertices=24)
    bpy.ops.object.shade_smooth_by_angle()


def half_flat():
    bpy.ops.mesh.primitive_uv_sphere_add()
    mesh = bpy.context.object.data
    mesh.polygons.foreach_set("use_smooth", np.arange(len(mesh.polygons)) % 2 == 0)


def fan_of_three_faces_and_a_line():
    """Three faces at one edge, a face without area, a vertex without faces."""
    points = [(0, 0, 0), (0, 0, 1), (1, 0, 0), (-1, 1, 0), (-1, -1, 0)]
    points += [(3, 0, 0), (4, 0, 0), (5, 0, 0), (9, 9, 9)]
    scenes.new_mesh(points, [(0, 1, 2), (0, 1, 3), (0, 1, 4), (5, 6, 7)])
    bpy.ops.object.shade_smooth()


def keyed():
    """A shape key that is on, and moves the points away from those of the mesh."""
    obj = scenes.sphere(3)
    bpy.ops.object.shade_smooth()
    obj.shape_key_add(name="Basis")
    key = obj.shape_key_add(name="Flat")
    for place in key.data:
        place.co.z *= 0.2
    key.value = 1.0


MESHES = [monkey, sharp_cylinder, half_flat, fan_of_three_faces_and_a_line, keyed]
MESHES += [scenes.plane, bpy.ops.mesh.primitive_cube_add]


def tilted(obj, rows):
    """The normals of corners, bent at random."""
    rng = np.random.default_rng(1)
    normals = scenes.corner_normals(obj)[rows]
    normals = normals + rng.normal(scale=0.3, size=normals.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return normals.astype(np.float32)


def kept(mesh):
    """What a mesh keeps of custom normals, and its sharp edges."""
    sharp = np.zeros(len(mesh.edges), bool)
    mesh.edges.foreach_get("use_edge_sharp", sharp)
    return scenes.read(mesh, "custom_normal"), sharp


@pytest.mark.parametrize("make", MESHES)
def test_of_vertices(make):
    make()
    obj = bpy.context.object
    corner = np.zeros(len(obj.data.vertices), int)
    vertices = scenes.corner_vertices(obj)
    corner[vertices] = np.arange(len(vertices))
    normals = tilted(obj, corner)
    bits, sharp = custom_normals.in_tangent_space(obj.data, normals, "POINT")
    obj.data.normals_split_custom_set_from_vertices(normals.tolist())
    expected = kept(obj.data)
    np.testing.assert_array_equal(bits, expected[0])
    np.testing.assert_array_equal(sharp, expected[1])


@pytest.mark.parametrize("make", MESHES)
def test_of_corners(make):
    make()
    obj = bpy.context.object
    normals = tilted(obj, slice(None))
    # Zeros ask for the automatic normal.
    normals[::7] = 0
    bits, sharp = custom_normals.in_tangent_space(obj.data, normals, "CORNER")
    obj.data.normals_split_custom_set(normals.tolist())
    expected = kept(obj.data)
    np.testing.assert_array_equal(bits, expected[0])
    np.testing.assert_array_equal(sharp, expected[1])


def test_nothing_is_left_behind():
    keyed()
    obj = bpy.context.object
    before = scenes.snapshot(obj), everything()
    normals = tilted(obj, slice(None))
    custom_normals.in_tangent_space(obj.data, normals, "CORNER")
    assert (scenes.snapshot(obj), everything()) == before


def everything():
    parts = ("scenes", "objects", "meshes", "node_groups", "shape_keys")
    return {part: getattr(bpy.data, part).keys() for part in parts}
