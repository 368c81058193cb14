# SPDX-License-Identifier: GPL-3.0-or-later
"""One file on its way through a command: read, compute, write, say how it went.

A Task is plain values, so that it can be handed to another process.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ... import core
from ...core.comparison import angle
from ...core.mesh.faces import unit
from ...core.neighbors.graph import NearestNeighbors
from ...core.orient.winding import find_flipped_faces
from .. import files
from ..files.shape import Shape
from . import large, snapshot
from .cluster import tile_runner
from .options import to_settings
from .output import OutputError, silence, whole

Progress = Callable[[float], object]

# What may go wrong with one file; the others are done all the same.
EXPECTED = (files.FileError, OutputError, core.InputError, OSError, MemoryError)

# Share of the progress that is the estimate's; reading and writing have the rest.
_READ, _ESTIMATED = 0.1, 0.9

# Of work in tiles where nothing else was said.
_MEMORY = 2 << 30

# Points are those of another file when they are no farther than that, in diagonals.
_SAME_PLACE = 1e-5


@dataclass(frozen=True)
class Task:
    """What is to be done with a file.

    Attributes
    ----------
    command : "estimate" | "compare" | "repair"
    source : str
    target : str or None
        The file to be written.
    settings : dict
        Those that were given, see `options`.
    overwrite : bool
    skip_existing : bool
        Whether a file that has come to be there is right as it is.
    image : str or None
        A picture to be written.
    truth : str or None
        The file with the normals that count as right, of `compare`.
    normals : "estimate" | "file"
        Which normals `compare` is about.
    fail_above : float or None
        Degrees.
    signed : bool
        Whether a normal on the wrong side is off by more than 90 degrees.
    memory : int or None
        Bytes that may be used: the file is done in tiles.
    scheduler : str or None
        The address of a Dask scheduler whose workers do the tiles.
    """

    command: str
    source: str
    target: str | None = None
    settings: dict[str, Any] = field(default_factory=dict)
    overwrite: bool = False
    skip_existing: bool = False
    image: str | None = None
    truth: str | None = None
    normals: str = "estimate"
    fail_above: float | None = None
    signed: bool = False
    memory: int | None = None
    scheduler: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the task as plain values."""
        return asdict(self)


def attempt(task: Task, progress: Progress) -> dict[str, Any]:
    """Do a task and return its row of the report, whatever happens to the file."""
    start = time.perf_counter()
    row: dict[str, Any] = {"input": task.source, "output": task.target}
    try:
        files.check_is_file(Path(task.source))
        row |= {"status": "done"} | _COMMANDS[task.command](task, progress)
    except EXPECTED as error:
        # Somebody else, such as the rest of a run before, was faster.
        there = task.target is not None and Path(task.target).exists()
        if isinstance(error, OutputError) and task.skip_existing and there:
            return row | {"status": "skipped"}
        row |= {"status": "failed", "error": _sentence(error)}
    return row | {"seconds": round(time.perf_counter() - start, 3)}


def _sentence(error: BaseException) -> str:
    if isinstance(error, MemoryError):
        return "needs more memory than there is"
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return " ".join(str(error).split())


def _estimate(task: Task, progress: Progress) -> dict[str, Any]:
    """Estimate the normals of a file and write them with it."""
    assert task.target is not None
    target = Path(task.target)
    _check_target(task, target)
    if _is_scene(task.source):
        return _estimate_scene(task, target, progress)
    if task.memory is not None or task.scheduler is not None:
        return _estimate_large(task, target, progress)
    shape = files.read(Path(task.source))
    turned: dict[str, Any] = {}
    if task.settings.get("winding") == "repaired" and shape.faces is not None:
        shape, turned = wound_alike(shape, task)
    progress(_READ)
    normals, valid, row = estimated(shape, task, progress)
    row |= turned
    progress(_ESTIMATED)
    return row | write_result(task, replace(shape, normals=kept(shape, normals, valid)))


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


def _is_scene(name: str) -> bool:
    return files.format_of(Path(name)).needs_blender


def _scenes(name: str) -> Any:
    """Return the module that opens scenes, where Blender is there."""
    if not find_spec("bpy"):
        raise files.FileError(
            f"{Path(name).suffix} files need Blender: run "
            "blender -b --command timescale_normals, or install bpy"
        )
    return import_module(".scenes", __package__)


def _estimate_scene(
    task: Task, target: Path, progress: Progress, *, repair: bool = False
) -> dict[str, Any]:
    """Estimate the normals of all objects of a scene and write it with them."""
    if not _is_scene(task.target or ""):
        raise OutputError("a scene becomes a scene: .blend, .glb, .gltf or .usd")
    if task.image is not None or "reference" in task.settings:
        raise OutputError("--image and --reference are for files of one shape")
    scenes = _scenes(task.source)
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


def write_result(task: Task, shape: Shape) -> dict[str, Any]:
    """Write a shape and a picture of it; return what the report says of them."""
    row: dict[str, Any] = {}
    if task.target is not None:
        with whole(Path(task.target), overwrite=task.overwrite) as path:
            row["lost"] = files.write(path, shape)
    if task.image is not None:
        with whole(Path(task.image), overwrite=task.overwrite) as path:
            snapshot.draw(path, shape.points, snapshot.shaded(shape.normals))
    return row


def estimated(
    shape: Shape, task: Task, progress: Progress
) -> tuple[Any, Any, dict[str, Any]]:
    """Return normals (n, 3), where they are valid (n,), and what there is to say.

    Points that are not finite have none.
    """
    finite = np.isfinite(shape.points).all(axis=1)
    points, faces, reference = shape.points, shape.faces, _reference(task, shape)
    if not finite.all():
        points, faces = points[finite], _among(finite, faces)
        if isinstance(reference, np.ndarray):
            reference = reference[finite]

    def show(share: float) -> None:
        progress(_READ + (_ESTIMATED - _READ) * share)

    # Faces that were to be turned over have been.
    given = task.settings | {"winding": "as_is"}
    found = core.estimate_normals(
        points, faces=faces, settings=to_settings(given, reference), progress=show
    )
    normals, valid = np.zeros(shape.points.shape), np.zeros(len(finite), dtype=bool)
    normals[finite], valid[finite] = found.normals, found.valid
    count, good = len(valid), int(valid.sum())
    row = found.summary() | {"points": count, "valid": good, "invalid": count - good}
    return normals, valid, row | {"faces": _face_count(shape)}


def _face_count(shape: Shape) -> int:
    return 0 if shape.polygons is None else len(shape.polygons.sizes)


def _among(finite: Any, faces: Any) -> Any:
    """Return faces over the finite points alone."""
    if faces is None:
        return None
    place = np.cumsum(finite) - 1
    return place[faces[finite[faces].all(axis=1)]]


def kept(shape: Shape, normals: Any, valid: Any) -> Any:
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
    return _normals_at(shape, other, name)[0]


def read_other(name: str) -> Shape:
    """Read a file that another one is held against."""
    try:
        return files.read(Path(name))
    except files.FileError as error:
        raise files.FileError(f"{name}: {error}") from None


def _normals_at(shape: Shape, other: Shape, name: str) -> tuple[Any, str]:
    """Return another shape's normals at the points of a shape, and how they were found.

    In order, where its points are the same; else of the nearest point.
    """
    if other.normals is None:
        raise files.FileError(f"{name}: expected normals, got none")
    size = np.linalg.norm(
        np.nanmax(other.points, axis=0) - np.nanmin(other.points, axis=0)
    )
    if len(other.points) == len(shape.points):
        away = np.abs(other.points - shape.points)
        if not (away > _SAME_PLACE * size).any():
            return other.normals, "order"
    good = np.isfinite(np.hstack([other.points, other.normals])).all(axis=1)
    tree = NearestNeighbors(np.asarray(other.points[good], dtype=np.float64)).tree
    _, at = tree.query(np.nan_to_num(shape.points))
    return other.normals[good][at], "nearest"


def _compare(task: Task, progress: Progress) -> dict[str, Any]:
    """Compare normals with Delaunay's and with the ones that count as right."""
    if _is_scene(task.source):
        return _compare_scene(task, progress)
    shape = files.read(Path(task.source))
    other = None if task.truth is None else read_other(task.truth)
    return _compare_shape(shape, other, task, progress)


def _compare_scene(task: Task, progress: Progress) -> dict[str, Any]:
    """Compare object by object; the truth is another scene with the same names."""
    if task.image is not None or "reference" in task.settings:
        raise OutputError("--image and --reference are for files of one shape")
    scenes = _scenes(task.source)
    with silence():
        shapes = scenes.read_shapes(Path(task.source))
        others = scenes.read_shapes(Path(task.truth)) if task.truth else {}
    rows = []
    for name, shape in shapes.items():
        if task.truth is not None and name not in others:
            raise files.FileError(f"{task.truth}: expected an object {name}, got none")
        row = _compare_shape(shape, others.get(name), task, progress)
        rows.append({"name": name} | row)
    checks = [row["check"] for row in rows]
    total = checks[0] | {
        "compared": sum(check["compared"] for check in checks),
        "opposite": sum(check["opposite"] for check in checks),
        "max": max(check["max"] for check in checks),
        "mean": None,
    }
    if task.fail_above is not None:
        total["above"] = sum(check["above"] for check in checks)
        total["failed"] = any(check["failed"] for check in checks)
    points = sum(row["points"] for row in rows)
    return {"points": points, "objects": rows, "check": total}


def _compare_shape(
    shape: Shape, other: Shape | None, task: Task, progress: Progress
) -> dict[str, Any]:
    truth, matched = None, None
    if other is not None:
        truth, matched = _normals_at(shape, other, task.truth or "")
    progress(_READ)
    row: dict[str, Any] = {"points": len(shape.points), "matched": matched}
    if task.normals == "file":
        if shape.normals is None:
            raise files.FileError("expected normals in the file, got none")
        ours = shape.normals
    else:
        ours, _, more = estimated(shape, task, progress)
        row |= more
    progress(_ESTIMATED)
    baseline, name = _baseline(shape, task, truth, progress)
    comparison = core.compare_normals(_plain(ours), baseline, truth=_plain(truth))
    row |= comparison.summary() | {"baseline": name}
    right = baseline if truth is None else _plain(truth)
    row["check"] = _check(task, _plain(ours), right, "truth" if task.truth else name)
    if task.image is not None:
        measure = "deviation" if truth is None else "error_estimate"
        with whole(Path(task.image), overwrite=task.overwrite) as path:
            snapshot.draw(path, shape.points, comparison.colors(measure))
    return row


def _plain(normals: Any) -> Any:
    """Return normals as finite numbers; those that were not are zero."""
    if normals is None:
        return None
    normals = np.asarray(normals, dtype=np.float64)
    return np.where(np.isfinite(normals).all(axis=1, keepdims=True), normals, 0.0)


def _baseline(
    shape: Shape, task: Task, truth: Any, progress: Progress
) -> tuple[Any, str]:
    """Return what the normals are held against, and its name."""
    if task.normals == "file" and truth is None:
        return estimated(shape, task, progress)[0], "estimate"
    finite = np.isfinite(shape.points).all(axis=1)
    normals = np.zeros(shape.points.shape)
    normals[finite] = core.delaunay_normals(
        shape.points[finite], faces=_among(finite, shape.faces)
    )
    return normals, "delaunay"


def _check(task: Task, ours: Any, right: Any, name: str) -> dict[str, Any]:
    """Return how far normals are from those that count as right, in degrees."""
    both = (ours != 0).any(axis=1) & (right != 0).any(axis=1)
    ours, right = unit(ours[both]), unit(right[both])
    known = angle(ours, right)
    opposite = (ours * right).sum(axis=1) < 0
    if task.signed:
        known = np.where(opposite, 180 - known, known)
    row: dict[str, Any] = {
        "reference": name,
        "signed": task.signed,
        "compared": len(known),
        "opposite": int(opposite.sum()),
        "max": float(known.max(initial=0)),
        "mean": float(known.mean()) if len(known) else None,
    }
    if task.fail_above is not None:
        above = int((known > task.fail_above).sum())
        row |= {"limit": task.fail_above, "above": above}
        row["failed"] = above > 0 or not len(known)
    return row


def _repair(task: Task, progress: Progress) -> dict[str, Any]:
    """Wind the faces of a mesh alike and outward, and estimate its normals."""
    assert task.target is not None
    with whole(Path(task.target), overwrite=task.overwrite):
        files.format_of(Path(task.target))
    if _is_scene(task.source):
        return _estimate_scene(task, Path(task.target), progress, repair=True)
    shape = files.read(Path(task.source))
    if shape.polygons is None or shape.faces is None:
        raise files.FileError("expected a mesh to repair, got points alone")
    shape, turned = wound_alike(shape, task)
    normals, valid, row = estimated(shape, task, progress)
    progress(_ESTIMATED)
    normals = np.where(valid[:, None], normals, 0.0)
    return row | turned | write_result(task, replace(shape, normals=normals))


def wound_alike(shape: Shape, task: Task) -> tuple[Shape, dict[str, Any]]:
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


_COMMANDS: dict[str, Callable[[Task, Progress], dict[str, Any]]] = {
    "estimate": _estimate,
    "compare": _compare,
    "repair": _repair,
}
