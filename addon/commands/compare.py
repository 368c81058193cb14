# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `compare` on one file: a shape, or a scene object by object."""

from pathlib import Path
from typing import Any

import numpy as np

from ... import core
from ...core.comparison import angle
from ...core.mesh.faces import unit
from ...core.progress import Progress
from .. import files
from ..files.shape import Shape
from . import snapshot
from .estimate import ESTIMATED, READ, among, estimated
from .output import OutputError, silence, whole
from .sources import is_scene, normals_at, read_other, scenes_module
from .task import Task


def compare(task: Task, progress: Progress) -> dict[str, Any]:
    """Compare normals with Delaunay's and with the ones that count as right."""
    if is_scene(task.source):
        return _compare_scene(task, progress)
    shape = files.read(Path(task.source))
    other = None if task.truth is None else read_other(task.truth)
    return _compare_shape(shape, other, task, progress)


def _compare_scene(task: Task, progress: Progress) -> dict[str, Any]:
    """Compare object by object; the truth is another scene with the same names."""
    if task.image is not None or "reference" in task.settings:
        raise OutputError("--image and --reference are for files of one shape")
    scenes = scenes_module(task.source)
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
        truth, matched = normals_at(shape, other, task.truth or "")
    progress(READ)
    row: dict[str, Any] = {"points": len(shape.points), "matched": matched}
    if task.normals == "file":
        if shape.normals is None:
            raise files.FileError("expected normals in the file, got none")
        ours = shape.normals
    else:
        ours, _, more = estimated(shape, task, progress)
        row |= more
    progress(ESTIMATED)
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
        shape.points[finite], faces=among(finite, shape.faces)
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
