# SPDX-License-Identifier: GPL-3.0-or-later
"""Curves of errors over steps, flat on a page of `display.picture`."""

import math
from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from ..display import nodes, picture

Array = np.ndarray
Color = tuple[float, float, float]

ORANGE = (0.62, 0.12, 0.02)
TEAL = (0.0, 0.2, 0.23)
FAINT = (0.3, 0.3, 0.31)
# Higher than anything that stands on the page.
ABOVE = 50


def plot(
    scene: Any,
    rows: Sequence[dict[str, Any]],
    frame: tuple[float, float, float, float],
    label: str,
) -> None:
    """Draw errors over steps, both as powers of ten, in a frame x, y, width, height."""
    x, y, width, height = frame
    values = np.array([row[w] for row in rows for w in ("paper", "second_order")])
    steps = np.array(rows[0]["step"])
    low = np.array([_decade(steps.min()), _decade(values.min())])
    high = np.array([-_decade(1 / steps.max()), -_decade(1 / values.max())])

    def place(step, error):
        share = (np.log10(np.stack([step, error], axis=-1)) - low) / (high - low)
        return share * (width, height) + (x, y)

    for power in range(low[1], high[1] + 1):
        at = y + height * (power - low[1]) / (high[1] - low[1])
        _line(scene, np.array([(x, at), (x + width, at)]), 0.008, FAINT)
        picture.write(scene, _ten(power), (x - 0.14, at - 0.08), 0.2, align="RIGHT")
    for power in range(low[0], high[0] + 1):
        at = x + width * (power - low[0]) / (high[0] - low[0])
        _line(scene, np.array([(at, y), (at, y + height)]), 0.008, FAINT)
        picture.write(scene, _ten(power), (at, y - 0.32), 0.2)
    picture.write(scene, "Largest gap", (x + width / 2, y - 0.75), 0.22)
    picture.write(scene, label, (x - 0.7, y + height + 0.2), 0.22, align="LEFT")
    for row in rows:
        for weights, color in (("paper", ORANGE), ("second_order", TEAL)):
            track = place(steps, np.array(row[weights]))
            _line(scene, track, 0.035, color, height=1)
            _marks(scene, track, color)
    for slope, weights in ((1, "paper"), (2, "second_order")):
        # Above all curves of these weights, over the finer half of the steps.
        above = 3 * max(row[weights][-1] for row in rows)
        ends = steps[[len(steps) // 2, -1]]
        track = place(ends, above * (ends / steps[-1]) ** slope)
        _line(scene, track, 0.025, FAINT, height=2)
        at = track.mean(axis=0) + (-0.15, 0.1)
        picture.write(scene, f"slope {slope}", tuple(at), 0.2, align="RIGHT")


def _decade(value: float) -> int:
    """Return the power of ten below a value, or equal up to rounding."""
    return math.floor(math.log10(value) + 1e-9)


def _ten(power: int) -> str:
    return "10" + str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def _line(
    scene: Any, track: Array, width: float, color: Color, *, height: float = 0
) -> None:
    """Draw a line through (n, 2) places."""
    along = track[1:] - track[:-1]
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    side = np.stack([-along[:, 1], along[:, 0]], axis=1) * (width / 2)
    corners = [track[:-1] - side, track[1:] - side, track[1:] + side, track[:-1] + side]
    count = len(along)
    faces = np.arange(4) * count + np.arange(count)[:, None]
    fill(scene, np.concatenate(corners), faces.tolist(), color, height=height)


def _marks(scene: Any, track: Array, color: Color) -> None:
    """Draw a dot at each of (n, 2) places."""
    turns = np.linspace(0, 2 * np.pi, 17)[:-1]
    disk = 0.07 * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    corners = (track[:, None] + disk).reshape(-1, 2)
    faces = np.arange(len(corners)).reshape(len(track), -1)
    fill(scene, corners, faces.tolist(), color, height=3)


def fill(
    scene: Any,
    corners: Array,
    faces: Sequence[Sequence[int]],
    color: Color,
    *,
    height: float = 0,
) -> None:
    """Draw flat faces over (n, 2) corners; what is higher hides what is lower."""
    mesh = bpy.data.meshes.new("Figure")
    level = np.full((len(corners), 1), ABOVE - 10 + height)
    mesh.from_pydata(np.hstack([corners, level]).tolist(), [], faces)
    ink, emission = nodes.glow("Figure")
    emission.inputs["Color"].default_value = (*color, 1)
    mesh.materials.append(ink)
    picture.add(scene, mesh)
