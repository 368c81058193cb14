# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes and corners of meshes and point clouds as arrays: the hinge of the bridge.

The other rooms of the bridge call it; the errors are everyone's.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from bpy.types import Mesh, PointCloud

from ...core import InputError

Data = Mesh | PointCloud
Array = np.ndarray

# Blender takes an attribute of this name for the normals of a mesh: INT16_2D in the
# tangent space of each corner, or FLOAT_VECTOR ("free").
CUSTOM_NORMAL = "custom_normal"
# The leading dot hides an attribute from menus and exporters.
BACKUP = ".timescale_backup."


class ObjectError(InputError):
    """An object that cannot be read or written as it is; the text names the remedy."""


class AttributeMismatchError(InputError):
    """An attribute that is missing or of another type, domain or size."""


@dataclass(frozen=True)
class Kind:
    """How foreach_get and foreach_set want the values of an attribute type."""

    field: str
    dtype: type
    width: int


# Other dtypes than these are ten times slower or refused.
KINDS = {
    "FLOAT": Kind("value", np.float32, 1),
    "FLOAT_VECTOR": Kind("vector", np.float32, 3),
    "FLOAT_COLOR": Kind("color", np.float32, 4),
    "BOOLEAN": Kind("value", np.bool_, 1),
    "INT": Kind("value", np.int32, 1),
    "INT16_2D": Kind("value", np.int16, 2),
}


def read(data: Data, name: str, kind: str, *, domain: str = "POINT") -> Array:
    """Return the values of an attribute, (n,) or (n, width)."""
    expected = f'a {kind} attribute "{name}" on {domain}'
    if name not in data.attributes:
        raise AttributeMismatchError(f"expected {expected}, found none of this name")
    attribute: Any = data.attributes[name]
    if (attribute.data_type, attribute.domain) != (kind, domain):
        raise AttributeMismatchError(
            f"expected {expected}, found {attribute.data_type} on {attribute.domain}"
        )
    return get(attribute.data, KINDS[kind])


def get(values: Any, kind: Kind) -> Array:
    """Return a field of all items, (n,) or (n, width)."""
    flat: Array = np.empty(len(values) * kind.width, dtype=kind.dtype)
    values.foreach_get(kind.field, flat)
    return flat if kind.width == 1 else flat.reshape(-1, kind.width)


def write(
    data: Any, name: str, kind: str, values: Array, *, domain: str = "POINT"
) -> None:
    """Make an attribute of the values."""
    # Fetched by name: before 5.1 a reference dies with the next attribute.
    data.attributes.new(name, kind, domain)
    put(data.attributes[name].data, KINDS[kind], values)


def put(target: Any, kind: Kind, values: Array) -> None:
    """Write a field of all items."""
    target.foreach_set(kind.field, np.ascontiguousarray(values, kind.dtype).ravel())


def remove(data: Data, name: str) -> None:
    """Remove an attribute, where it is there."""
    if name in data.attributes:
        data.attributes.remove(data.attributes[name])


def triangles(mesh: Mesh) -> Array:
    """Return the corners of the triangles of all faces, (m, 3) int32."""
    if len(mesh.loops) == 3 * len(mesh.polygons):
        return np.arange(len(mesh.loops), dtype=np.int32).reshape(-1, 3)
    mesh.calc_loop_triangles()
    return get(mesh.loop_triangles, Kind("loops", np.int32, 3))


def corner_vertices(mesh: Mesh) -> Array:
    """Return the vertex of each corner, (c,) int32."""
    return read(mesh, ".corner_vert", "INT", domain="CORNER")


def corner_normals(mesh: Mesh) -> Array:
    """Return the normals that Blender shades with, (c, 3) float32."""
    return get(mesh.corner_normals, KINDS["FLOAT_VECTOR"])
