# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lines show the normals of an object."""

from dataclasses import dataclass

import numpy as np
from bpy.types import Object

from ...core.mesh.faces import unit
from .. import bridge

# Lines of one method; more would hide the surface and slow the viewport down.
MOST = 50_000


@dataclass(frozen=True)
class Lines:
    """What is drawn of one object, in the world.

    Attributes
    ----------
    estimate, baseline : (2 m, 3) float32
        Both ends of each line; baseline is empty where it is not shown.
    invalid : (i, 3) float32
        Points without a normal.
    """

    estimate: np.ndarray
    baseline: np.ndarray
    invalid: np.ndarray


def spacing(points: np.ndarray, count: int) -> float:
    """Return about how far `count` of the points (n, 3) on a surface are apart."""
    return float(np.linalg.norm(np.ptp(points, axis=0)) / np.sqrt(count))


def lines_of(obj: Object, *, share: float, length: float, baseline: bool) -> Lines:
    """Return the lines of an object.

    Parameters
    ----------
    share : float
        Of the points that get a line, 0 to 1; never more than MOST.
    length : float
        Of a line, in distances between lines.
    baseline : bool
        Whether the normals of the triangulation are shown too.
    """
    matrix = np.array(obj.matrix_world)
    points = bridge.read_points(obj) @ matrix[:3, :3].T + matrix[:3, 3]
    count = max(1, min(MOST, round(share * len(points))))
    # The same points every time: lines must not jump when a setting changes.
    rows = np.random.default_rng(0).permutation(len(points))[:count]
    size = length * spacing(points, count)
    starts, ends, side = points[rows], {}, None
    for name in ("ts_normal", "delaunay_normal"):
        if name == "ts_normal" or (baseline and bridge.has_attribute(obj, name)):
            normals = bridge.read_attribute(obj, name, "FLOAT_VECTOR")[rows]
            # Normals go to the world by the inverse transpose.
            normals = unit(normals @ np.linalg.inv(matrix[:3, :3]))
            # A triangulation of points alone knows no outside.
            side = normals if side is None else side
            normals[(normals * side).sum(axis=1) < 0] *= -1
            there = (normals != 0).any(axis=1)
            pairs = np.stack([starts, starts + size * normals], axis=1)[there]
            ends[name] = pairs.reshape(-1, 3).astype(np.float32)
    valid = bridge.read_attribute(obj, "ts_valid", "BOOLEAN")
    nothing = np.zeros((0, 3), np.float32)
    return Lines(
        ends["ts_normal"],
        ends.get("delaunay_normal", nothing),
        points[~valid][:MOST].astype(np.float32),
    )
