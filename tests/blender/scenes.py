# SPDX-License-Identifier: GPL-3.0-or-later
"""Makers of test objects, and what can be read back of them."""

import bpy
import numpy as np
from bpy.types import Object

FIELDS = {"FLOAT_VECTOR": "vector", "FLOAT2": "vector", "FLOAT_COLOR": "color"}
DTYPES = {
    "FLOAT": np.float32,
    "FLOAT2": np.float32,
    "FLOAT_VECTOR": np.float32,
    "FLOAT_COLOR": np.float32,
    "BOOLEAN": np.bool_,
    "INT": np.int32,
    "INT16_2D": np.int16,
    "INT32_2D": np.int32,
}
WIDTHS = {"FLOAT_VECTOR": 3, "FLOAT_COLOR": 4}
WIDTHS |= dict.fromkeys(("FLOAT2", "INT16_2D", "INT32_2D"), 2)


def select(*objects: Object) -> None:
    """Select these alone; the first is active."""
    for obj in bpy.context.selected_objects:
        obj.select_set(False)
    for obj in objects:
        obj.select_set(True)
    bpy.context.view_layer.objects.active = objects[0] if objects else None


def new_mesh(points, faces=(), *, name="Mesh") -> Object:
    """A selected mesh object; faces may have any number of corners."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(np.asarray(points, dtype=np.float64).tolist(), [], list(faces))
    return link(bpy.data.objects.new(name, mesh))


def link(obj: Object) -> Object:
    bpy.context.collection.objects.link(obj)
    select(obj)
    return obj


def new_cloud(points, **attributes) -> Object:
    """A selected point cloud; 4.5 has no other way than converting a mesh."""
    obj = new_mesh(points, name="Cloud")
    for name, values in attributes.items():
        put(obj, name, "FLOAT_VECTOR", values)
    bpy.ops.object.convert(target="POINTCLOUD")
    return bpy.context.object


def sphere(subdivisions=4, radius=1.0) -> Object:
    """An icosphere around the origin, whose normals are its points by the radius."""
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=subdivisions, radius=radius)
    return bpy.context.object


def ball(n=600, seed=0):
    """Even points on the unit sphere, which are their own normals, (n, 3) float32."""
    turn = np.arange(n) * (np.pi * (3 - np.sqrt(5))) + seed
    z = 1 - (2 * np.arange(n) + 1) / n
    flat = np.sqrt(1 - z * z)
    points = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
    return points.astype(np.float32)


def plane(side=8) -> Object:
    """A flat grid of quads in z = 0."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=side, y_subdivisions=side)
    return bpy.context.object


def put(obj: Object, name, kind, values, *, domain="POINT") -> None:
    """Write an attribute as a user's script would."""
    obj.data.attributes.new(name, kind, domain)
    flat = np.ascontiguousarray(values, DTYPES[kind]).ravel()
    obj.data.attributes[name].data.foreach_set(FIELDS.get(kind, "value"), flat)


def get(obj: Object, name):
    """The values of an attribute, (n,) or (n, width)."""
    return read(obj.data, name)


def read(data, name):
    """The same of a mesh or point cloud, evaluated ones too."""
    attribute = data.attributes[name]
    width = WIDTHS.get(attribute.data_type, 1)
    flat = np.empty(len(attribute.data) * width, DTYPES[attribute.data_type])
    attribute.data.foreach_get(FIELDS.get(attribute.data_type, "value"), flat)
    return flat if width == 1 else flat.reshape(-1, width)


def points_of(obj: Object):
    return get(obj, "position")


def corner_vertices(obj: Object):
    return get(obj, ".corner_vert")


def corner_normals(obj: Object):
    """What Blender shades with, (c, 3)."""
    flat = np.empty(3 * len(obj.data.loops), np.float32)
    obj.data.corner_normals.foreach_get("vector", flat)
    return flat.reshape(-1, 3)


def set_tangent_normals(obj: Object, seed=0) -> None:
    """Custom normals of the user's own, bent away from the automatic ones."""
    rng = np.random.default_rng(seed)
    bent = corner_normals(obj) + rng.normal(scale=0.2, size=(len(obj.data.loops), 3))
    bent /= np.linalg.norm(bent, axis=1, keepdims=True)
    obj.data.normals_split_custom_set(bent.tolist())


def set_free_normals(obj: Object, domain="POINT", seed=0) -> None:
    rng = np.random.default_rng(seed)
    count = obj.data.attributes.domain_size(domain)
    put(
        obj, "custom_normal", "FLOAT_VECTOR", rng.normal(size=(count, 3)), domain=domain
    )
    obj.data.update()


def snapshot(obj: Object) -> dict:
    """Everything that a run may change, bit for bit."""
    data = obj.data
    # Shading is computed again, not taken from what Blender remembers.
    data.update_tag()
    result = {
        a.name: (a.data_type, a.domain, get(obj, a.name).tobytes())
        for a in data.attributes
    }
    result["keys"] = sorted(data.keys())
    result["record"] = data.is_property_set("timescale_normals")
    if obj.type == "MESH":
        data.update()
        result["active color"] = data.attributes.active_color_name
        result["default color"] = data.attributes.default_color_name
        result["shading"] = corner_normals(obj).tobytes()
    return result


def angles(a, b):
    """Angles between rows in degrees; opposite sides count as 180."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    sine = np.linalg.norm(np.cross(a, b), axis=1)
    return np.degrees(np.arctan2(sine, (a * b).sum(axis=1)))
