# SPDX-License-Identifier: GPL-3.0-or-later
"""Which points of an object someone means: a selection, or a vertex group."""

import numpy as np
from bpy.types import Object, PointCloud

from . import arrays
from .arrays import Array, ObjectError
from .objects import data_of


def read_weight(obj: Object, region: str, vertex_group: str) -> Array:
    """Return the share of each vertex in a region of a mesh, (n,) float64, 0 to 1.

    Parameters
    ----------
    region : "all" | "selected" | "group"

    Raises
    ------
    ObjectError
        When nothing is selected or there is no such vertex group.
    """
    mesh = data_of(obj)
    count = mesh.attributes.domain_size("POINT")
    if region == "all":
        return np.ones(count)
    if isinstance(mesh, PointCloud):
        raise ObjectError("a point cloud has no groups or selection; choose all points")
    if region == "selected":
        # Blender leaves the attribute out where nothing is selected.
        if ".select_vert" not in mesh.attributes:
            raise ObjectError("none of its vertices is selected")
        return arrays.read(mesh, ".select_vert", "BOOLEAN").astype(np.float64)
    if vertex_group not in obj.vertex_groups:
        raise ObjectError(f'it has no vertex group "{vertex_group}"')
    number = obj.vertex_groups[vertex_group].index
    weight = np.zeros(count)
    # Blender gives these weights one vertex at a time.
    for index, vertex in enumerate(mesh.vertices):
        for element in vertex.groups:
            if element.group == number:
                weight[index] = element.weight
    return weight


def read_selected(obj: Object) -> Array:
    """Return which points are selected in Edit Mode, (n,) bool.

    Raises
    ------
    ObjectError
        When none is.
    """
    data = data_of(obj)
    name = ".selection" if isinstance(data, PointCloud) else ".select_vert"
    # Blender leaves the attribute out where nothing is selected, or all points are.
    chosen = np.full(data.attributes.domain_size("POINT"), name == ".selection")
    if name in data.attributes:
        chosen = arrays.read(data, name, data.attributes[name].data_type) > 0
    if not chosen.any():
        raise ObjectError("none of its points is selected")
    return chosen
