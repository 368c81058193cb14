# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's normals of meshes: its own, and those of its Weighted Normal modifier.

Run by a Python that has bpy, on a folder of meshes that `meshes` wrote:

    .venv/blender-5.2/bin/python tests/benchmarks/blender_normals.py FOLDER

Each FOLDER/NAME.npz holds points (n, 3), faces (m, 3) and sharp edges (e, 2); the
corner normals (m, 3, 3) of each method go to FOLDER/NAME.found.npz.
"""

import sys
from pathlib import Path

import bpy
import numpy as np

MODES = ("FACE_AREA", "CORNER_ANGLE", "FACE_AREA_WITH_ANGLE")


def main(folder):
    for path in sorted(Path(folder).glob("*.npz")):
        if path.name.endswith(".found.npz"):
            continue
        given = np.load(path)
        found = {"Blender": corner_normals(given, None)}
        for mode in MODES:
            name = f"Blender, Weighted Normal {mode.lower()}"
            found[name] = corner_normals(given, mode)
        np.savez(path.with_suffix(".found.npz"), **found)


def corner_normals(given, mode):
    """Return the corner normals (m, 3, 3) with a mode of the modifier, or without."""
    mesh = bpy.data.meshes.new("Mesh")
    faces = given["faces"]
    mesh.from_pydata(given["points"].tolist(), [], faces.tolist(), shade_flat=False)
    if len(given["sharp"]):
        mark_sharp(mesh, given["sharp"])
    obj = bpy.data.objects.new("Mesh", mesh)
    bpy.context.collection.objects.link(obj)
    if mode:
        modifier = obj.modifiers.new("Weighted Normal", "WEIGHTED_NORMAL")
        modifier.mode = mode
        modifier.keep_sharp = True
    shown = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    normals = np.empty(9 * len(faces), dtype=np.float32)
    shown.corner_normals.foreach_get("vector", normals)
    bpy.data.objects.remove(obj)
    bpy.data.meshes.remove(mesh)
    return normals.reshape(-1, 3, 3)


def mark_sharp(mesh, edges):
    ends = np.empty(2 * len(mesh.edges), dtype=np.int32)
    mesh.edges.foreach_get("vertices", ends)
    ends = np.sort(ends.reshape(-1, 2), axis=1)
    sharp = np.sort(edges, axis=1)
    size = int(ends.max()) + 1
    marked = np.isin(ends @ [size, 1], sharp @ [size, 1])
    mesh.attributes.new("sharp_edge", "BOOLEAN", "EDGE")
    mesh.attributes["sharp_edge"].data.foreach_set("value", marked)


if __name__ == "__main__":
    main(sys.argv[1])
