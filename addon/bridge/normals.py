# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of an object: those that are there, and new ones in their place."""

from dataclasses import replace

import numpy as np
from bpy.types import Mesh, Object

from ...core.inputs import as_normals
from ...core.mesh.faces import fan_means, unit
from . import arrays, custom_normals, polygons
from .arrays import BACKUP, KINDS, Array, ObjectError
from .geometry import Corners, times
from .objects import changed, data_of, is_cloud
from .results import (
    COLOR,
    claim,
    clear_results,
    has_estimate,
    is_ours,
    read_attribute,
    write_results,
)
from .shapes import deforms


def read_corner_normals(obj: Object) -> Array:
    """Return the normals that a mesh is shaded with, (c, 3) float64."""
    return arrays.corner_normals(data_of(obj)).astype(np.float64)


def read_facing(obj: Object, name: str) -> Array:
    """Return the normals that the points of an object show, (n, 3) float64.

    The estimated ones; where there are none, those of an attribute, and of a mesh with
    faces the means of what its corners are shaded with.

    Raises
    ------
    AttributeMismatchError
        When points without faces have no such attribute.
    """
    if has_estimate(obj) or is_cloud(obj):
        return read_normals(obj, _kept_in(obj, name))
    mesh = data_of(obj)
    shown = arrays.corner_normals(mesh).astype(np.float64)
    return fan_means(shown, arrays.corner_vertices(mesh), len(mesh.vertices))


def _kept_in(obj: Object, name: str) -> str:
    return "ts_normal" if has_estimate(obj) else name


def read_normals(obj: Object, name: str) -> Array:
    """Return a vector attribute of the points at length one, (n, 3) float64.

    Raises
    ------
    InputError
        When there is no such attribute, or values in it are not finite.
    """
    vectors = read_attribute(obj, name, "FLOAT_VECTOR")
    return unit(as_normals(vectors, len(vectors), name=f'values in "{name}"'))


def read_normals_before(obj: Object) -> Array:
    """Return the normals that points had before any run, (n, 3) float64.

    Raises
    ------
    ObjectError
        When they had none.
    """
    data = data_of(obj)
    ours = BACKUP if is_ours(data) else ""
    for name in (f"{ours}ts_normal", "normal"):
        if name in data.attributes:
            return read_normals(obj, name)
    raise ObjectError(
        'it has no normals to blend with, neither "ts_normal" nor "normal"; '
        "choose all points and a strength of 1"
    )


def read_places(obj: Object, name: str) -> Array:
    """Return a vector attribute of the points as places of the world, (n, 3) float64.

    Raises
    ------
    InputError
        When there is no such attribute, or values in it are not finite.
    """
    places = read_attribute(obj, name, "FLOAT_VECTOR")
    places = as_normals(places, len(places), name=f'values in "{name}"')
    matrix = np.array(obj.matrix_world)
    return times(places, matrix[:3, :3].T) + matrix[:3, 3]


def read_shaded(obj: Object) -> Array | None:
    """Return the mean of the normals that Blender shades each vertex with, (n, 3).

    Zero at vertices without a face; None for points alone.
    """
    if is_cloud(obj):
        return None
    mesh = data_of(obj)
    vertex = arrays.corner_vertices(mesh)
    return fan_means(arrays.corner_normals(mesh), vertex, len(mesh.vertices))


def write_estimate(
    obj: Object,
    normals: Array,
    valid: Array,
    *,
    storage: str,
    weight: Array | None = None,
    before: Array | None = None,
    corners: Corners | None = None,
) -> None:
    """Write normals (n, 3) and valid (n,) of an object in place of earlier results.

    Vertices that are not valid keep the normals they had before any run; in tangent
    space the automatic ones, where they had free ones, which have no such form.

    Parameters
    ----------
    storage : "auto" | "free" | "tangent_space"
        How custom normals of meshes are kept.
    weight : (n,) float, optional
        Share of the new normals, 0 to 1; the rest are those that were there before
        any run. Of meshes this holds for custom normals alone.
    before : (n, 3) float, optional
        What the rest is where there are no faces.
    corners : Corners, optional
        Custom normals where edges part the mesh.
    """
    # Earlier results are not what an invalid vertex should keep.
    clear_results(obj)
    data = data_of(obj)
    if is_cloud(obj):
        claim(data)
        if weight is not None and before is not None:
            normals = custom_normals.mixed(before, normals, weight * valid)
    else:
        if storage == "auto":
            mixed = weight is not None and custom_normals.has_free(data)
            storage = "tangent_space" if deforms(obj) and not mixed else "free"
        if weight is None and corners is None:
            _write_of_vertices(data, normals, valid, storage)
        else:
            _write_of_corners(data, normals, valid, storage, weight, corners)
    write_results(obj, {"ts_normal": normals, "ts_valid": valid})


def _write_of_vertices(mesh: Mesh, normals: Array, valid: Array, storage: str) -> None:
    """Make the normals those of the mesh; corners of the other vertices keep theirs."""
    kept = ~valid[arrays.corner_vertices(mesh)]
    before = arrays.corner_normals(mesh) if kept.any() else None
    claim(mesh)
    custom_normals.write_vertices(mesh, normals, kept, storage, before)


def _write_of_corners(
    mesh: Mesh,
    normals: Array,
    valid: Array,
    storage: str,
    weight: Array | None,
    corners: Corners | None,
) -> None:
    """Mix normals into those that the corners have."""
    vertices = arrays.corner_vertices(mesh)
    new, share = normals[vertices], valid[vertices].astype(np.float64)
    if corners is not None:
        new, share = corners.normals, corners.valid.astype(np.float64)
    if weight is not None:
        share *= weight[vertices]
    shown = custom_normals.mixed(arrays.corner_normals(mesh), new, share)
    edges = None if corners is None else corners.edges
    claim(mesh)
    custom_normals.write_corners(mesh, shown, share == 0, storage, edges)


def turn_normals(obj: Object, turned: Array, name: str) -> None:
    """Turn over the normals of some points, (n,) bool, where `read_facing` found them.

    Custom normals of a mesh that had no result are set aside before, as in a run.
    """
    data = data_of(obj)
    if has_estimate(obj) or is_cloud(obj):
        name = _kept_in(obj, name)
        vectors = arrays.read(data, name, "FLOAT_VECTOR")
        vectors[turned] *= -1
        arrays.put(data.attributes[name].data, KINDS["FLOAT_VECTOR"], vectors)
    if not is_cloud(obj):
        shown = arrays.corner_normals(data)
        if not is_ours(data):
            claim(data)
        custom_normals.turn(data, shown, turned)
    changed(data)


def turn_faces(obj: Object, which: Array, corners: Corners) -> Corners:
    """Turn some faces of a mesh, (f,) bool, over; return its corners as they are then.

    Not a part of what `clear_results` brings back.
    """
    was = turn_over(obj, which)
    return replace(corners, normals=corners.normals[was], valid=corners.valid[was])


def turn_over(obj: Object, which: Array) -> Array:
    """Turn some faces of a mesh, (f,) bool; return where each corner was, (c,) int."""
    return polygons.turn_over(data_of(obj), which)


def write_preview(obj: Object, colors: Array) -> None:
    """Color the points of a mesh, (n, 4), in place of earlier results."""
    clear_results(obj)
    claim(data_of(obj))
    write_results(obj, {COLOR: colors})
