# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands `estimate` and `repair` on one file: a shape, a scene, or in tiles."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ... import core
from ...core.orient.winding import find_flipped_faces
from ...core.progress import Progress, between
from .. import files
from ..files.shape import Shape
from ..tiles import large
from ..tiles.cluster import tile_runner
from . import snapshot
from .options import to_settings
from .output import OutputError, silence, whole
from .sources import is_scene, normals_at, read_other, scenes_module
from .task import Task

# Share of the progress that is the estimate's; reading and writing have the rest.
READ, ESTIMATED = 0.1, 0.9

# Of work in tiles where nothing else was said.
_MEMORY = 2 << 30


def estimate(task: Task, progress: Progress) -> dict[str, Any]:
    """Estimate the normals of a file and write them with it."""
    assert task.target is not None
    target = Path(task.target)
    _check_target(task, target)
    if is_scene(task.source):
        return _estimate_scene(task, target, progress)
    if task.memory is not None or task.scheduler is not None:
        return _estimate_large(task, target, progress)
    shape = files.read(Path(task.source))
    turned: dict[str, Any] = {}
    if task.settings.get("winding") == "repaired" and shape.faces is not None:
        shape, turned = _wound_alike(shape, task)
    progress(READ)
    normals, valid, row = estimated(shape, task, progress)
    row |= turned
    progress(ESTIMATED)
    shape = replace(shape, normals=_kept(shape, normals, valid))
    return row | _write_result(task, shape)


def _estimate_large(task: Task, target: Path, progress: Progress) -> dict[str, Any]:
    """Estimate the normals of a file in tiles, here or on other machines."""
    if task.image is not None or "reference" in task.settings:
        raise OutputError("--image and --reference are for files that fit into memory")
    if target.suffix.lower() != Path(task.source).suffix.lower():
        raise OutputError("in tiles a file keeps its format: choose another output")
    memory = task.memory or _MEMORY
    with (
        tile_runner(task.scheduler) as fit,
        whole(target, overwrite=task.overwrite) as path,
    ):
        return large.estimate(
            Path(task.source),
            path,
            to_settings(task.settings),
            memory=memory,
            fit=fit,
            progress=progress,
        )


def _estimate_scene(
    task: Task, target: Path, progress: Progress, *, repair: bool = False
) -> dict[str, Any]:
    """Estimate the normals of all objects of a scene and write it with them."""
    if not is_scene(task.target or ""):
        raise OutputError("a scene becomes a scene: .blend, .glb, .gltf or .usd")
    if task.image is not None or "reference" in task.settings:
        raise OutputError("--image and --reference are for files of one shape")
    scenes = scenes_module(task.source)
    settings = to_settings(task.settings)
    with silence():
        scenes.open_scene(Path(task.source))
        rows = scenes.estimate(settings, progress, repair=repair)
    done = [row for row in rows if "error" not in row]
    if not done:
        raise files.FileError(f"{rows[0]['name']}: {rows[0]['error']}")
    with whole(target, overwrite=task.overwrite) as path, silence():
        scenes.save_scene(path)
    counts = ["points", "valid", "invalid", "from_faces"]
    counts += ["faces", "flipped_faces"] if repair else []
    totals = {name: sum(row[name] for row in done) for name in counts}
    wrong = [f"{row['name']}: {row['error']}" for row in rows if "error" in row]
    return totals | {"objects": rows, "warnings": wrong}


def _check_target(task: Task, target: Path) -> None:
    """Raise before anything is computed when the result could not be written."""
    if not files.format_of(target).holds_normals:
        raise OutputError(
            f"{target.suffix} has no normals of points: choose another output, .ply"
        )
    with whole(target, overwrite=task.overwrite):
        pass


def _write_result(task: Task, shape: Shape) -> dict[str, Any]:
    """Write a shape and a picture of it; return what the report says of them."""
    row: dict[str, Any] = {}
    if task.target is not None:
        with whole(Path(task.target), overwrite=task.overwrite) as path:
            row["lost"] = files.write(path, shape)
    if task.image is not None:
        with whole(Path(task.image), overwrite=task.overwrite) as path:
            snapshot.draw(path, shape.points, snapshot.shaded(shape.normals))
    return row


def repair(task: Task, progress: Progress) -> dict[str, Any]:
    """Wind the faces of a mesh alike and outward, and estimate its normals."""
    assert task.target is not None
    with whole(Path(task.target), overwrite=task.overwrite):
        files.format_of(Path(task.target))
    if is_scene(task.source):
        return _estimate_scene(task, Path(task.target), progress, repair=True)
    shape = files.read(Path(task.source))
    if shape.polygons is None or shape.faces is None:
        raise files.FileError("expected a mesh to repair, got points alone")
    shape, turned = _wound_alike(shape, task)
    normals, valid, row = estimated(shape, task, progress)
    progress(ESTIMATED)
    normals = np.where(valid[:, None], normals, 0.0)
    return row | turned | _write_result(task, replace(shape, normals=normals))


def _wound_alike(shape: Shape, task: Task) -> tuple[Shape, dict[str, Any]]:
    """Return a mesh whose faces wind alike and outward, and what the report says."""
    assert shape.polygons is not None
    nested = task.settings.get("nested", "cavity")
    winding = find_flipped_faces(shape.points, shape.faces, nested=nested)
    turned = np.zeros(len(shape.polygons.sizes), dtype=bool)
    turned[shape.polygons.face_of_triangle[winding.flipped]] = True
    return replace(shape, polygons=shape.polygons.turned(turned)), {
        "flipped_faces": int(turned.sum()),
        "pieces": int(winding.piece.max()) + 1,
        "inconsistent_edges": winding.inconsistent,
        "onesided_edges": winding.onesided,
        "nonmanifold_edges": winding.nonmanifold,
        "border_edges": winding.border,
    }


def estimated(
    shape: Shape, task: Task, progress: Progress
) -> tuple[Any, Any, dict[str, Any]]:
    """Return normals (n, 3), where they are valid (n,), and what there is to say.

    Points that are not finite have none.
    """
    finite = np.isfinite(shape.points).all(axis=1)
    points, faces, reference = shape.points, shape.faces, _reference(task, shape)
    if not finite.all():
        points, faces = points[finite], among(finite, faces)
        if isinstance(reference, np.ndarray):
            reference = reference[finite]

    # Faces that were to be turned over have been.
    given = task.settings | {"winding": "as_is"}
    found = core.estimate_normals(
        points,
        faces=faces,
        settings=to_settings(given, reference),
        progress=between(progress, READ, ESTIMATED),
    )
    normals, valid = np.zeros(shape.points.shape), np.zeros(len(finite), dtype=bool)
    normals[finite], valid[finite] = found.normals, found.valid
    count, good = len(valid), int(valid.sum())
    row = found.summary() | {"points": count, "valid": good, "invalid": count - good}
    return normals, valid, row | {"faces": _face_count(shape)}


def _face_count(shape: Shape) -> int:
    return 0 if shape.polygons is None else len(shape.polygons.sizes)


def among(finite: Any, faces: Any) -> Any:
    """Return faces over the finite points alone."""
    if faces is None:
        return None
    place = np.cumsum(finite) - 1
    return place[faces[finite[faces].all(axis=1)]]


def _kept(shape: Shape, normals: Any, valid: Any) -> Any:
    """Return normals, and where there are none the ones of before."""
    if shape.normals is None:
        return normals
    return np.where(valid[:, None], normals, shape.normals)


def _reference(task: Task, shape: Shape) -> Any:
    name = task.settings.get("reference")
    if name is None:
        return None
    other = read_other(name)
    if other.normals is None and other.faces is not None:
        return other.points, other.faces
    return normals_at(shape, other, name)[0]
