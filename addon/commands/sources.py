# SPDX-License-Identifier: GPL-3.0-or-later
"""What commands read: scenes, and files that another one is held against."""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ...core.neighbors.graph import NearestNeighbors
from .. import files
from ..files.shape import Shape

# Points are those of another file when they are no farther than that, in diagonals.
_SAME_PLACE = 1e-5


def is_scene(name: str) -> bool:
    """Whether a file is one that Blender opens."""
    return files.format_of(Path(name)).needs_blender


def scenes_module(name: str) -> Any:
    """Return the module that opens scenes, where Blender is there."""
    if not find_spec("bpy"):
        raise files.FileError(
            f"{Path(name).suffix} files need Blender: run "
            "blender -b --command timescale_normals, or install bpy"
        )
    return import_module(".scenes", __package__)


def read_other(name: str) -> Shape:
    """Read a file that another one is held against."""
    try:
        return files.read(Path(name))
    except files.FileError as error:
        raise files.FileError(f"{name}: {error}") from None


def normals_at(shape: Shape, other: Shape, name: str) -> tuple[Any, str]:
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
