# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes as files: .blend, glTF and USD, opened, estimated and written by Blender.

They are opened in place of what Blender has open, and so in the background only.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from ... import core
from ...core.orient.winding import find_flipped_faces
from ...core.progress import Progress
from .. import bridge
from ..files.shape import FileError, Polygons, Shape
from ..operators import jobs
from ..operators.jobs import Job

_NOT_IN_A_WINDOW = "scenes are opened in the background only: use blender -b"


def open_scene(path: Path) -> None:
    """Open a scene in place of the one that is open.

    Raises
    ------
    FileError
        When it cannot be read, or has no mesh and no point cloud.
    """
    if not bpy.app.background:
        raise FileError(_NOT_IN_A_WINDOW)
    if not path.is_file():
        raise FileError("cannot be read: there is no such file")
    suffix, path = path.suffix.lower(), path.resolve()
    try:
        if suffix == ".blend":
            # Scripts in files from elsewhere stay asleep.
            bpy.ops.wm.open_mainfile(
                filepath=str(path), load_ui=False, use_scripts=False
            )
        else:
            bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
            _READERS[suffix](str(path))
    except RuntimeError as error:
        said = " ".join(str(error).replace("Error:", "").split())
        raise FileError(f"cannot be read by Blender: {said[:160]}") from None
    if not shapes_of_scene():
        raise FileError("expected meshes or point clouds in the scene, got none")


def save_scene(path: Path) -> None:
    """Write the scene that is open."""
    _WRITERS[path.suffix.lower()](str(path.resolve()))
    if not path.exists():
        raise FileError(f"Blender did not write {path.name}")


def _read_gltf(path: str) -> None:
    # What shares a place is one vertex again: seams are no borders.
    bpy.ops.import_scene.gltf(filepath=path, merge_vertices=True)


def _write_gltf(path: str) -> None:
    kind = "GLB" if path.lower().endswith(".glb") else "GLTF_EMBEDDED"
    try:
        bpy.ops.export_scene.gltf(filepath=path, export_format=kind)
    except TypeError:
        # From 4.5 on buffers stand beside the file.
        bpy.ops.export_scene.gltf(filepath=path, export_format="GLTF_SEPARATE")


def _read_usd(path: str) -> None:
    bpy.ops.wm.usd_import(filepath=path)


def _write_usd(path: str) -> None:
    bpy.ops.wm.usd_export(filepath=path, export_normals=True)


def _write_blend(path: str) -> None:
    # A copy: what is open keeps its name, and links stay right.
    bpy.ops.wm.save_as_mainfile(filepath=path, copy=True, relative_remap=True)


_READERS = {
    ".glb": _read_gltf,
    ".gltf": _read_gltf,
    ".usd": _read_usd,
    ".usda": _read_usd,
    ".usdc": _read_usd,
    ".usdz": _read_usd,
}
_WRITERS = {
    ".blend": _write_blend,
    ".glb": _write_gltf,
    ".gltf": _write_gltf,
    ".usd": _write_usd,
    ".usda": _write_usd,
    ".usdc": _write_usd,
    ".usdz": _write_usd,
}


@dataclass(frozen=True)
class _Options:
    """What operators ask beside Settings, as their defaults have it."""

    storage: str = "auto"
    use_modifiers: bool = False
    split: frozenset[str] = frozenset({"sharp"})


def shapes_of_scene() -> list[Job]:
    """Return a job for every mesh and point cloud of the scene, by name."""
    found = bridge.shapes_of_scene(bpy.context)
    return [Job(obj.session_uid, obj.name) for obj in found]


def estimate(
    settings: core.Settings, progress: Progress, *, repair: bool = False
) -> list[dict[str, Any]]:
    """Estimate the normals of all objects of the scene and write them to the objects.

    Parameters
    ----------
    settings : core.Settings
    progress : callable
    repair : bool
        Wind the faces of meshes alike and outward before.

    Returns
    -------
    list of dict
        What there is to say about each object.
    """
    options: Any = _Options()
    todo, rows = shapes_of_scene(), []
    for number, job in enumerate(todo):

        def show(share: float, number: int = number) -> None:
            progress((number + share) / len(todo))

        try:
            bridge.check_writable(job.obj)
            turned = _wound_alike(job, settings.nested) if repair else {}
            job.settings = settings
            job.geometry = bridge.read_geometry(job.obj)
            jobs.read_split(job, options)
            jobs.estimate(job, show)
            jobs.write_estimate(job, options)
            rows.append({"name": job.name} | jobs.summary_of(job) | turned)
        except core.InputError as error:
            rows.append({"name": job.name, "error": str(error)})
    return rows


def _wound_alike(job: Job, nested: str) -> dict[str, Any]:
    """Turn over faces that wind against the others or inward; return how many."""
    shape = bridge.read_geometry(job.obj)
    if shape.faces is None:
        raise core.InputError("expected a mesh to repair, got points alone")
    winding = find_flipped_faces(shape.points, shape.faces, nested=nested)
    turned = bridge.read_faces(job.obj, ()).faces_of(winding.flipped)
    if turned.any():
        bridge.turn_over(job.obj, turned)
    return {"faces": len(turned), "flipped_faces": int(turned.sum())}


def read_shapes(path: Path) -> dict[str, Shape]:
    """Return the shape of every object of a scene in a file, by name.

    In world space, triangulated; normals are those that Blender shades meshes with.
    """
    open_scene(path)
    shapes = {}
    for job in shapes_of_scene():
        geometry = bridge.read_geometry(job.obj)
        faces = geometry.faces
        polygons = None if faces is None else Polygons.of_rows(faces)
        normals = bridge.read_shaded(job.obj)
        if normals is not None:
            normals = geometry.to_world(normals)
        shapes[job.name] = Shape(geometry.points, polygons, normals)
    return shapes
