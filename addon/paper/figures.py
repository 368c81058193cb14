# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's figures 1 and 3 to 7, and the orders, on pages of `display.picture`."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...core import (
    Comparison,
    GridSurface,
    TimeScale,
    compare_normals,
    estimate_normals,
)
from ...core.experiment import METHODS, SURFACES, baseline_normals
from ...core.neighbors.graph import delaunay_simplices
from .. import bridge
from ..display import picture
from ..display.nodes import Scale
from ..display.picture import Panel
from . import plots
from .plots import FAINT, ORANGE, TEAL, Array, Color
from .results import FIGURES

View = tuple[float, float]

INK = picture.INK
PALE = (0.9, 0.9, 0.91)
# Turn and tilt from where the sheets of each surface hide each other least.
VIEWS = {"phi1": (math.radians(10), math.radians(45)), "phi2": picture.VIEW}
LABELS = {"phi1": "φ₁", "phi2": "φ₂"}
# Fig. 1: where on the grid, which normal, its parameters, its derivatives.
CASES = (
    ((0, 1), "N₁", "(t₁, s₂)", "∂φ/Δ₁t × ∂φ/◊₂s"),
    ((1, 1), "N₂", "(t₂, s₂)", "∂φ/◊₁t × ∂φ/◊₂s"),
    ((3, 1), "N₃", "(t₄, s₂)", "∂φ/∇₁t × ∂φ/◊₂s"),
    ((2, 3), "N₄", "(t₃, s₄)", "∂φ/◊₁t × ∂φ/∇₂s"),
    ((1, 0), "N₅", "(t₂, s₁)", "∂φ/◊₁t × ∂φ/Δ₂s"),
)


@dataclass(frozen=True)
class Sample:
    """One sample of one of the paper's surfaces, and what is found on it."""

    surface: str
    seed: int = 0

    @cached_property
    def _drawn(self) -> tuple[Array, Array, Array]:
        shape, count = SURFACES[self.surface]
        return shape.sample(count, self.seed)

    @property
    def points(self) -> Array:
        """(n, 3) float64."""
        return self._drawn[0]

    @property
    def truth(self) -> Array:
        """(n, 3) float64, the normals of the smooth surface."""
        return self._drawn[1]

    @cached_property
    def triangles(self) -> Array:
        """(m, 3) int, the Delaunay triangulation of the parameters."""
        return delaunay_simplices(self._drawn[2])

    @cached_property
    def baseline(self) -> Array:
        """(n, 3) float64, N_D of the triangles."""
        return baseline_normals("parameters", self.points, self._drawn[2])

    @cached_property
    def estimates(self) -> dict[str, Array]:
        """Normals by the paper's method and by the default, (n, 3) each."""
        return {
            name: estimate_normals(self.points, settings=METHODS[name]).normals
            for name in ("paper", "auto")
        }

    @cached_property
    def comparisons(self) -> dict[str, Comparison]:
        """How they compare with the baseline and the truth."""
        return {
            name: compare_normals(normals, self.baseline, truth=self.truth)
            for name, normals in self.estimates.items()
        }


def draw(
    folder: Path,
    orders: Sequence[dict[str, Any]],
    *,
    progress: Callable[[float, str], object],
    width: int = 1200,
) -> None:
    """Write all figures as PNG into a folder.

    Parameters
    ----------
    orders : sequence of dict
        "convergence" of results.json.
    progress : callable
        Called with a share from 0.65 to 1 and what is next.
    width : int
        In pixels; the height is 9/16 of it.
    """
    samples = {name: Sample(name) for name in SURFACES}
    drawings: tuple[Callable[[Any], None], ...] = (
        grid_surface,
        partial(surfaces, samples=samples),
        partial(triangulations, samples=samples),
        partial(errors, sample=samples["phi1"]),
        partial(errors, sample=samples["phi2"]),
        partial(winning_points, samples=samples),
        partial(plot_orders, rows=orders),
    )
    for index, (name, drawing) in enumerate(zip(FIGURES, drawings, strict=True)):
        progress(0.65 + 0.35 * index / len(FIGURES), name)
        with picture.page(width) as scene:
            # Sharp edges, which also make smaller files.
            scene.cycles.pixel_filter_type = "BOX"
            drawing(scene)
            scene.render.filepath = str((folder / name).resolve())
            bpy.ops.render.render(write_still=True, scene=scene.name)


# The figures


def grid_surface(scene: Any) -> None:
    """Fig. 1: a surface over two isolated time scales, and its five kinds of normal."""
    grid = GridSurface.graph(
        TimeScale([0.0, 1.0, 2.4, 3.2]),
        TimeScale([0.0, 0.7, 2.0, 3.0]),
        lambda t, s: 0.6 * np.sin(0.9 * t) * np.cos(0.8 * s - 0.9),
    )
    points, normals = grid.points, grid.normals()
    tips = {at: points[at] + 0.75 * normals[at] for at, *_ in CASES}
    flat = points.reshape(-1, 3)
    quads = _quads(points)
    sides = np.concatenate([quads[:, [k, (k + 1) % 4]] for k in range(4)])
    a, b = np.unique(np.sort(sides, axis=1), axis=0).T
    starts = np.array([points[at] for at in tips])
    layers = [
        _surface(flat, quads, normals.reshape(-1, 3)),
        _solid(_tubes(flat[a], flat[b], 0.012), INK),
        _dots(flat, 0.05, INK),
        _solid(_arrows(starts, np.array(list(tips.values()))), ORANGE),
    ]
    _title(scene, "A surface over 𝕋₁ × 𝕋₂ and the five kinds of its normals")
    view = math.radians(-24), math.radians(34)
    to_page = picture.lay(scene, layers, (-2.8, -0.3), (9.2, 6.4), view=view)
    for i, digit in enumerate("₁₂₃₄"):
        _label(scene, f"t{digit}", to_page, points[i, 0], (-0.14, -0.42))
        _label(scene, f"s{digit}", to_page, points[-1, i], (0.34, -0.24))
    for row, (at, label, where, how) in enumerate(CASES):
        _label(scene, label, to_page, tips[at], (0.2, 0.1))
        y = 1.5 - 0.75 * row
        picture.write(scene, f"{label} at {where}", (3.1, y), 0.27, align="LEFT")
        picture.write(scene, how, (5.5, y), 0.27, align="LEFT")


def surfaces(scene: Any, *, samples: dict[str, Sample]) -> None:
    """Fig. 3: the smooth surfaces and the points sampled on them."""
    _title(scene, "The surfaces and the points sampled on them")
    for x, (name, sample) in zip((-4, 4), samples.items(), strict=True):
        layers = [
            _smooth(name),
            _dots(sample.points, 0.0035 * _size(sample.points), TEAL),
        ]
        title = f"{LABELS[name]}: {len(sample.points):,} points"
        _panel(scene, layers, title, (x, 7.0), VIEWS[name])


def triangulations(scene: Any, *, samples: dict[str, Sample]) -> None:
    """Fig. 4: the Delaunay triangulations of the parameters, on the surfaces."""
    _title(scene, "Delaunay triangulations of the parameters, on the surfaces")
    for x, (name, sample) in zip((-4, 4), samples.items(), strict=True):
        points, faces = sample.points, sample.triangles
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        a, b = np.unique(np.sort(edges, axis=1), axis=0).T
        layers = [
            _solid((points, faces), PALE),
            _solid(_tubes(points[a], points[b], 0.0009 * _size(points)), TEAL),
        ]
        title = f"{LABELS[name]}: {len(faces):,} triangles"
        _panel(scene, layers, title, (x, 7.0), VIEWS[name])


def errors(scene: Any, *, sample: Sample) -> None:
    """Fig. 5 and 6: the errors of both methods and of the baseline, side by side."""
    _title(scene, f"Errors on {LABELS[sample.surface]}, {len(sample.points):,} points")
    scale = Scale(
        1e-4, 1.0, "Largest coordinate of the difference from the true normal"
    )
    paper, auto = sample.comparisons["paper"], sample.comparisons["auto"]
    shown = (
        ("paper", sample.estimates["paper"], paper.error_estimate),
        ("auto", sample.estimates["auto"], auto.error_estimate),
        ("Delaunay of the parameters", sample.baseline, auto.error_baseline),
    )
    for x, (title, normals, error) in zip((-5.3, 0, 5.3), shown, strict=True):
        layer = _points(sample.points, normals, error)
        told = f"{title}: median {np.nanmedian(error):.2g}"
        _panel(scene, [layer], told, (x, 4.9), VIEWS[sample.surface], scale=scale)
    picture.draw_bar(scene, scale, (0, -3.4), (7.0, 0.22))


def winning_points(scene: Any, *, samples: dict[str, Sample]) -> None:
    """Fig. 7: where the paper's method and ours are nearer than the baseline."""
    _title(scene, "Points where the method is nearer to the true normal than Delaunay")
    gray, teal = _winner_colors()
    panels = [(s, m) for s in samples.values() for m in ("paper", "auto")]
    for x, (sample, method) in zip((-6, -2, 2, 6), panels, strict=True):
        wins, points = sample.comparisons[method].wins, sample.points
        assert wins is not None
        radius = picture.point_radius(_object(points, ()))
        layers = [
            _points(points[part], sample.truth[part], color=color, radius=radius)
            for part, color in ((~wins, gray), (wins, teal))
        ]
        title = f"{LABELS[sample.surface]}, {method}: {wins.sum():,} of {len(wins):,}"
        _panel(scene, layers, title, (x, 3.3), VIEWS[sample.surface])
    _key(scene, ((teal, "Nearer than Delaunay"), (gray, "Not nearer")), -3.5)


def plot_orders(scene: Any, *, rows: Sequence[dict[str, Any]]) -> None:
    """Errors of both weights over the largest gap, with slopes 1 and 2."""
    _title(scene, "Order of the ◊-derivative where gaps alternate 3 : 1")
    shown = (
        (-4, "function", "Derivatives of", "Largest error"),
        (4, "surface", "Normals of", "Largest angle, radians"),
    )
    for x, kind, what, label in shown:
        found = [row for row in rows if row["kind"] == kind and row["ratio"] != 1]
        title = (
            f"{what} {', '.join(LABELS.get(row['name'], row['name']) for row in found)}"
        )
        picture.write(scene, title, (x + 0.4, 3.35), 0.27)
        plots.plot(scene, found, (x - 2.6, -2.45, 6.0, 5.2), label)
    _key(
        scene,
        (
            (ORANGE, "Weights of the paper"),
            (TEAL, "Second-order weights"),
            (FAINT, "Slopes 1 and 2"),
        ),
        -4.0,
    )


# What they are made of


def _title(scene: Any, text: str) -> None:
    picture.write(scene, text, (0, 3.95), 0.38)


def _panel(
    scene: Any,
    layers: Sequence[Panel],
    title: str,
    frame: tuple[float, float],
    view: View,
    *,
    scale: Scale | None = None,
) -> None:
    """Lay objects below a title; the frame is its middle and its width."""
    x, width = frame
    height = 6.6 if scale is None and width > 5 else 5.6
    y = 0.1 - (6.6 - height) / 20 - (0.4 if height > 6 else 0)
    picture.write(scene, title, (x, 3.3), min(0.27, 0.075 * width))
    picture.lay(scene, layers, (x, y), (width, height), scale=scale, view=view)


def _key(scene: Any, entries: Sequence[tuple[Color, str]], y: float) -> None:
    """Draw colored squares with what they stand for, in a row."""
    step = 4.4
    for index, (color, text) in enumerate(entries):
        x = step * (index - len(entries) / 2) + 0.4
        corners = np.array([(0, 0), (0.26, 0), (0.26, 0.26), (0, 0.26)]) + (x, y)
        plots.fill(scene, corners, [(0, 1, 2, 3)], color)
        picture.write(scene, text, (x + 0.42, y + 0.04), 0.25, align="LEFT")


def _label(
    scene: Any, text: str, to_page: Matrix, point: Array, shift: tuple[float, float]
) -> None:
    place = to_page @ Vector(point.tolist())
    picture.write(scene, text, (place.x + shift[0], place.y + shift[1]), 0.26)


def _object(
    points: Array, faces: Sequence[Sequence[int]] | Array, **attributes: Array
) -> bpy.types.Object:
    mesh = bpy.data.meshes.new("Figure")
    mesh.from_pydata(np.asarray(points).tolist(), [], np.asarray(faces).tolist())
    made = bpy.data.objects.new("Figure", mesh)
    bridge.write_results(made, attributes)
    return made


def _surface(points: Array, faces: Array, normals: Array) -> Panel:
    """A gray surface, shaded by normals."""
    return Panel(_object(points, faces, ts_normal=normals), "", "ts_normal")


def _smooth(name: str) -> Panel:
    """A surface of the paper, finely sampled."""
    shape, _ = SURFACES[name]
    parameters = shape.grid(240, 240)
    t, s = np.moveaxis(parameters, -1, 0)
    points, normals = shape.point(t, s), shape.normal(t, s)
    return _surface(points.reshape(-1, 3), _quads(points), normals.reshape(-1, 3))


def _quads(points: Array) -> Array:
    """Return the faces of a grid of points (n1, n2, 3), (m, 4) int."""
    number = np.arange(points[..., 0].size).reshape(points.shape[:2])
    corners = [number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]]
    return np.stack(corners, axis=-1).reshape(-1, 4)


def _points(
    points: Array,
    normals: Array,
    error: Array | None = None,
    *,
    color: Color | None = None,
    radius: float | None = None,
) -> Panel:
    """Points that close to a surface, colored by their error or all alike."""
    if error is None:
        made = _object(points, (), ts_normal=normals)
        return Panel(made, "", "ts_normal", color=color, radius=radius)
    made = _object(points, (), ts_normal=normals, ts_error=error)
    return Panel(made, "", "ts_normal", "ts_error")


def _dots(points: Array, radius: float, color: Color) -> Panel:
    return Panel(_object(points, ()), "", None, color=color, radius=radius)


def _solid(shape: tuple[Array, Array], color: Color) -> Panel:
    return Panel(_object(*shape), "", None, color=color)


def _tubes(starts: Array, ends: Array, radius: float) -> tuple[Array, Array]:
    """Return vertices and faces of bars with six sides from starts to ends, (n, 3)."""
    return _bars(starts, ends, radius, radius)


def _arrows(starts: Array, ends: Array) -> tuple[Array, Array]:
    """Return vertices and faces of arrows."""
    necks = ends - 0.24 * (ends - starts)
    shafts, shaft_faces = _bars(starts, necks, 0.022, 0.022)
    heads, head_faces = _bars(necks, ends, 0.075, 0.0)
    faces = np.concatenate([shaft_faces, head_faces + len(shafts)])
    return np.concatenate([shafts, heads]), faces


def _bars(starts, ends, first, last):
    along = ends - starts
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    # The axis that a bar is least along is never parallel to it.
    across = np.cross(along, np.eye(3)[np.abs(along).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    other = np.cross(along, across)
    turns = np.arange(6) * (np.pi / 3)
    ring = np.cos(turns)[:, None, None] * across + np.sin(turns)[:, None, None] * other
    vertices = np.concatenate([starts + first * ring, ends + last * ring])
    count = len(starts)
    corner = np.arange(6)
    after = (corner + 1) % 6
    sides = np.stack([corner, after, after + 6, corner + 6], axis=1) * count
    faces = sides[:, None, :] + np.arange(count)[None, :, None]
    return vertices.reshape(-1, 3), faces.reshape(-1, 4)


def _size(points: Array) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _winner_colors() -> tuple[Color, Color]:
    """Return the colors that the core gives to points lost and won."""
    ours, theirs = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    colors = Comparison(ours, ours, ours, theirs).colors("wins")[:, :3].tolist()
    lost, won = (tuple(color) for color in colors)
    return lost, won
