# SPDX-License-Identifier: GPL-3.0-or-later
"""What the operators leave: attributes and a summary, and what was there before them.

Results are attributes under the names in RESULTS and, on meshes with faces, custom
normals. What was there under these names before is kept on the data itself, renamed,
and comes back with `clear_results`: renaming is exact for every type, and backups that
are attributes follow edits, copies, files and undo as the data does.
"""

import json
from collections.abc import Mapping
from typing import Any, cast

import bmesh
import numpy as np
from bpy.types import Mesh, Object

from . import arrays, custom_normals
from .arrays import BACKUP, CUSTOM_NORMAL, KINDS, Array, Data, ObjectError
from .objects import TYPES, changed, data_of

# What the operators leave, one value a point.
RESULTS = {
    "ts_normal": "FLOAT_VECTOR",
    "ts_valid": "BOOLEAN",
    "ts_side_confidence": "FLOAT",
    "ts_confidence": "FLOAT",
    "ts_scale": "FLOAT",
    "delaunay_normal": "FLOAT_VECTOR",
    "ts_error": "FLOAT",
    "delaunay_error": "FLOAT",
    "ts_angle": "FLOAT",
    "delaunay_angle": "FLOAT",
    "ts_error_color": "FLOAT_COLOR",
    "delaunay_error_color": "FLOAT_COLOR",
}
COLOR = "ts_error_color"
# Colors of the baseline, while both are shown side by side.
COLOR_BESIDE = "delaunay_error_color"
# What they are kept in while a mesh is edited.
_LAYERS = {
    "FLOAT": "float",
    "FLOAT_VECTOR": "float_vector",
    "FLOAT_COLOR": "float_color",
    "BOOLEAN": "bool",
}
# The number of each point marks data as ours, and shows whether points came or went
# since. The leading dot hides an attribute from menus and exporters.
_MARK = ".timescale_points"


def check_writable(obj: Object) -> None:
    """Raise ObjectError when results could not be written to the object's data."""
    data, kind = data_of(obj), TYPES[obj.type]
    if not data.is_editable or data.override_library:
        raise ObjectError(
            f"its {kind} belongs to another file; "
            f"use Object > Relations > Make Local > Selected Objects and Data first"
        )
    if obj.mode == "EDIT" or getattr(data, "is_editmode", False):
        raise ObjectError(f"its {kind} is in Edit Mode; leave Edit Mode first")
    taken = obj.vertex_groups.keys() if obj.type == "MESH" else ()
    for name in (*RESULTS, CUSTOM_NORMAL):
        # Blender would call the attribute "name.001".
        if name in taken:
            raise ObjectError(f'its vertex group "{name}" is in the way; rename it')


def read_attribute(obj: Object, name: str, kind: str) -> Array:
    """Return an attribute of the points, (n,) or (n, width).

    Raises
    ------
    AttributeMismatchError
        When there is none of this name, type and domain.
    """
    return arrays.read(data_of(obj), name, kind)


def values_at(obj: Object, row: int) -> dict[str, Any]:
    """Return the results at a point, in Edit Mode too, as plain values by name."""
    data = data_of(obj)
    if obj.mode != "EDIT":
        there = (data.attributes[name] for name in RESULTS if name in data.attributes)
        kinds = {item.name: KINDS[item.data_type].field for item in there}
        found = {
            name: getattr(data.attributes[name].data[row], field)
            for name, field in kinds.items()
        }
    else:
        edited = bmesh.from_edit_mesh(data)
        edited.verts.ensure_lookup_table()
        vertex, layers = edited.verts[row], edited.verts.layers
        kept = {
            name: getattr(layers, _LAYERS[RESULTS[name]]).get(name) for name in RESULTS
        }
        found = {name: vertex[layer] for name, layer in kept.items() if layer}
    return {
        name: tuple(value) if hasattr(value, "__len__") else value
        for name, value in found.items()
    }


def has_attribute(obj: Object, name: str) -> bool:
    """Whether there is an attribute of this name."""
    return name in data_of(obj).attributes


def write_results(obj: Object, results: Mapping[str, Array | None]) -> None:
    """Write arrays under names in RESULTS; None removes what is there."""
    data = data_of(obj)
    for name, values in results.items():
        arrays.remove(data, name)
        if values is not None:
            arrays.write(data, name, RESULTS[name], values)
    if COLOR in results and isinstance(data, Mesh):
        data.attributes.active_color_name = COLOR
    changed(data)


def clear_results(obj: Object) -> bool | None:
    """Remove all results and bring back what was there before the first run.

    Returns
    -------
    bool or None
        Whether points came or went in between, so that what was there came back
        for those that remain; None when there was nothing to clear.
    """
    data = data_of(obj)
    if not is_ours(data):
        return None
    edited = is_edited(data)
    colors = {}
    if isinstance(data, Mesh):
        colors = _colors_before(data)
        custom_normals.soften(data)
    arrays.remove(data, _MARK)
    for name in (*RESULTS, CUSTOM_NORMAL):
        arrays.remove(data, name)
        if BACKUP + name in data.attributes:
            data.attributes[BACKUP + name].name = name
    for use, before in colors.items():
        setattr(data.attributes, use, before if before in data.attributes else "")
    data.property_unset("timescale_normals")
    changed(data)
    return edited


def has_estimate(obj: Object) -> bool:
    """Whether the object holds an estimate of the points it has now."""
    data = data_of(obj)
    # The summary is lost where Blender converts a mesh to a point cloud.
    there = "ts_normal" in data.attributes and "estimate" in read_summary(obj)
    return there and is_ours(data) and not is_edited(data)


def has_comparison(obj: Object) -> bool:
    """Whether the object holds a comparison; cheap enough for a panel."""
    return obj.type in TYPES and "comparison" in read_summary(obj)


def is_split(obj: Object) -> bool:
    """Whether an object's estimate differs on both sides of edges."""
    found = read_summary(obj).get("estimate", {})
    return found.get("normals", 0) > found.get("valid", 0)


def record_of(obj: Object) -> Any:
    """Return what a run leaves on the object's data beside attributes."""
    return data_of(obj).timescale_normals


def color_signature(obj: Object) -> tuple[str, float, str, str]:
    """Return what differs when an object's colors mean something else."""
    record = record_of(obj)
    return record.color_by, record.color_limit, record.color_map, record.summary


def read_summary(obj: Object | None) -> dict[str, dict[str, Any]]:
    """Return what the last run said about an object; empty where there was none."""
    if obj is None or obj.type not in TYPES:
        return {}
    if not data_of(obj).is_property_set("timescale_normals"):
        # Looking at the record would make one.
        return {}
    summary = data_of(obj).timescale_normals.summary
    return json.loads(summary) if summary else {}


def write_summary(obj: Object, summary: Mapping[str, dict[str, Any]]) -> None:
    """Keep plain values for the panel, in addition to those there."""
    record = data_of(obj).timescale_normals
    record.summary = json.dumps(read_summary(obj) | dict(summary))


def is_ours(data: Data) -> bool:
    """Whether the data holds results, or did before its points changed."""
    return _MARK in data.attributes


def claim(data: Data) -> None:
    """Set aside what has our names, and mark the data as ours."""
    if isinstance(data, Mesh):
        record = cast(Any, data).timescale_normals
        record.active_color = data.attributes.active_color_name or ""
        record.default_color = data.attributes.default_color_name or ""
    for name in (*RESULTS, CUSTOM_NORMAL):
        if name in data.attributes:
            data.attributes[name].name = BACKUP + name
    arrays.write(data, _MARK, "INT", np.arange(data.attributes.domain_size("POINT")))


def is_edited(data: Data) -> bool:
    """Whether points came, went or changed places since our run."""
    numbers = arrays.read(data, _MARK, "INT")
    return not np.array_equal(numbers, np.arange(len(numbers)))


def _colors_before(mesh: Any) -> dict[str, str]:
    """Return the roles that our colors have on the mesh, and who had them before."""
    record = mesh.timescale_normals
    roles = {
        "active_color_name": record.active_color,
        "default_color_name": record.default_color,
    }
    # Blender gave the role to the backup where it was renamed in it.
    ours = (COLOR, BACKUP + COLOR)
    return {r: name for r, name in roles.items() if getattr(mesh.attributes, r) in ours}
