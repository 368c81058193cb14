# SPDX-License-Identifier: GPL-3.0-or-later
"""Show Patch: the surface that the method fits around one point, as objects.

New objects show the patch, the grid of its two time scales, the points that the
forward and backward jumps lead to, and the tangents whose cross product is the normal.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np
from bpy.types import Context, Object, Operator

from ...core import GridSurface, InputError, Settings
from ...core.neighborhoods import neighborhoods_of_all
from .. import bridge
from ..bridge import making
from ..settings.properties import patches_of
from ..settings.scene import Returned, settings_of
from .picking import picked_of

# Across a patch drawn as a surface.
_STEPS = 33
# Widths of lines and dots, in distances from a point to its neighbors.
_THIN, _THICK, _DOT = 0.006, 0.02, 0.06

# What is made, and its color.
COLORS = {
    "Patch": (0.30, 0.55, 0.78, 1.0),
    "Time-Scale Grid": (0.10, 0.10, 0.12, 1.0),
    "Neighbors": (0.93, 0.80, 0.25, 1.0),
    "Jump Points": (0.85, 0.25, 0.12, 1.0),
    "Tangents": (0.13, 0.72, 0.78, 1.0),
    "Normal": (0.95, 0.95, 0.95, 1.0),
}


@dataclass(frozen=True)
class View:
    """A patch in the world, relative to its point.

    Attributes
    ----------
    place : (3,) float64
        The point.
    reach : float
        Distance of the farthest neighbor.
    surface, grid : GridSurface
        The patch evenly, and over its time scales.
    neighbors, jumps : (k, 3), (j, 3) float64
    tangents, normal : (2, 3), (3,) float64
        Where they end.
    """

    place: np.ndarray
    reach: float
    surface: GridSurface
    grid: GridSurface
    neighbors: np.ndarray
    jumps: np.ndarray
    tangents: np.ndarray
    normal: np.ndarray


def view_of(shape: bridge.Geometry, row: int, settings: Settings) -> View:
    """Fit the patch of one point.

    Raises
    ------
    InputError
        When the point has too few neighbors for a patch.
    """
    source, place = neighborhoods_of_all(shape.points, shape.faces, settings)
    patches = source.fit(place[[row]])
    if not patches.valid[0]:
        raise InputError("this point has too few neighbors for a patch")
    grid = patches.bundle()
    even = [
        np.linspace(*extent)[:, None]
        for extent in (
            (scale.min(), scale.max(), _STEPS) for scale in (patches.x, patches.y)
        )
    ]
    surface = replace(patches, x=even[0], y=even[1]).bundle()
    i, j = (int(np.flatnonzero(T.points == 0)[0]) for T in (grid.T1, grid.T2))
    beside = [(i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)]
    n1, n2 = grid.points.shape[:2]
    jumps = [grid.points[a, b] for a, b in beside if 0 <= a < n1 and 0 <= b < n2]
    weights = source.settings.weights
    along = [t[i, j] for t in grid.tangents(weights=weights)]
    along.append(patches.normals(weights=weights)[0])
    reach = float(patches.reach[0])
    frame = np.stack([patches.u[:, 0], patches.v[:, 0], patches.n[:, 0]])
    local = np.stack([patches.x[:, 0], patches.y[:, 0], patches.z[:, 0]], axis=1)
    tangents = np.array(along) / np.linalg.norm(along, axis=1, keepdims=True)
    return View(
        shape.points[row],
        reach,
        surface,
        grid,
        local @ frame * reach,
        np.array(jumps),
        0.8 * reach * tangents[:2],
        0.8 * reach * tangents[2],
    )


def show(context: Context, view: View, name: str) -> list[Object]:
    """Make the objects of a view, in a collection of their own."""
    home = bpy.data.collections.new(f"Patch of {name}")
    context.scene.collection.children.link(home)
    surface, grid = view.surface.points, view.grid.points
    parts = {
        "Patch": making.new_sheet(surface),
        "Time-Scale Grid": making.new_lines(
            [*grid, *grid.swapaxes(0, 1)], _THIN * view.reach
        ),
        "Neighbors": making.new_dots(view.neighbors, 1.5 * _DOT * view.reach),
        "Jump Points": making.new_dots(view.jumps, _DOT * view.reach),
        "Tangents": making.new_lines(
            [np.array([np.zeros(3), end]) for end in view.tangents],
            _THICK * view.reach,
        ),
        "Normal": making.new_lines(
            [np.array([np.zeros(3), view.normal])], _THICK * view.reach
        ),
    }
    made = []
    for part, data in parts.items():
        data.name = part
        data.materials.append(_paint(part))
        obj = bpy.data.objects.new(part, data)
        obj.location = view.place.tolist()
        # The points that it is about would hide it.
        obj.show_in_front = True
        home.objects.link(obj)
        made.append(obj)
    return made


def _paint(part: str) -> bpy.types.Material:
    name = f"Time-Scale {part.removeprefix('Time-Scale ')}"
    found: Any = bpy.data.materials.get(name)
    if found is None:
        found = bpy.data.materials.new(name)
        found.diffuse_color = COLORS[part]
        found.roughness = 0.8
    return found


class TIMESCALE_OT_show_patch(Operator):
    """The method at one point, to look at."""

    bl_idname = "timescale.show_patch"
    bl_label = "Show Patch"
    bl_description = (
        "Make objects of the patch at a point: its time-scale grid, jump points and "
        "tangents.\nThe point is the active vertex in Edit Mode, else the picked one, "
        "else the nearest to the 3D cursor"
    )
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Ask for a mesh or point cloud."""
        if context.object is not None and context.object.type in bridge.TYPES:
            return True
        cls.poll_message_set("Select a mesh or point cloud")
        return False

    def execute(self, context: Context) -> Returned:
        """Read, fit, make."""
        obj = context.object
        picked = bridge.active_vertex(obj)
        try:
            with bridge.object_mode(context):
                shape = bridge.read_geometry(obj)
                if picked is None:
                    picked = picked_of(obj)
                if picked is None:
                    picked = shape.nearest(context.scene.cursor.location)
                shape = parted(shape, obj, settings_of(context).split)
                view = view_of(shape, picked, settings_used(context, obj))
                show(context, view, obj.name)
        except InputError as error:
            self.report({"ERROR"}, f"{obj.name}: {error}")
            return {"CANCELLED"}
        self.report({"INFO"}, f"Patch of point {picked:,}")
        return {"FINISHED"}


def parted(
    shape: bridge.Geometry, obj: Object, split: Collection[str]
) -> bridge.Geometry:
    """Return the shape as the estimate takes it: marked edges end patches."""
    fans = bridge.read_fans(obj, split)
    if fans is None:
        return shape
    return replace(shape, points=shape.points[fans.vertex], faces=fans.faces)


def settings_used(context: Context, obj: Object) -> Settings:
    """Return the settings of the last estimate, else those of the scene."""
    summary = bridge.read_summary(obj).get("estimate")
    if summary is None:
        return patches_of(settings_of(context))
    names = ("method", "neighbors", "graph", "patch", "weights")
    return Settings(**{name: summary[name] for name in names})


register, unregister = bpy.utils.register_classes_factory((TIMESCALE_OT_show_patch,))
