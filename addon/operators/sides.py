# SPDX-License-Identifier: GPL-3.0-or-later
"""Flip / Reorient Normals: the sides of normals that are there, and nothing else."""

from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from bpy.props import EnumProperty, StringProperty
from bpy.types import Context, Event, Menu

from ... import core
from ...core.orient.orientation import Orientation, find_orientation
from ...core.orient.pieces import connected_pieces
from ...core.progress import Progress
from .. import bridge
from ..display.pointing import Ray, ray_under_mouse
from ..settings.choices import ORIENTATIONS
from ..settings.layouts import draw_guides
from ..settings.properties import GuideObjects, SideOptions, reference_of
from ..settings.scene import Returned
from .jobs import Job, viewpoint_of
from .run import OnSelection

_MODES = {
    "flip": "Turns every normal over",
    **{mode: tip for mode, tip in ORIENTATIONS.items() if mode != "none"},
}
_PARTS = {
    "auto": "The selection in Edit Mode, else every point",
    "all": "Every point",
    "selected": "Points selected in Edit Mode; sides are judged by the whole",
    "piece": (
        "What hangs together with the active vertex, the point under the mouse, or "
        "called from a button the one nearest to the 3D cursor"
    ),
}


@dataclass(frozen=True)
class Task:
    """What to turn, and toward what.

    Attributes
    ----------
    mode : str
        "flip", or an orientation of the core.
    rows : (n,) bool or None
        The points that may turn; None for all.
    seed : int or None
        The point whose piece may turn.
    guides : dict
        What `find_orientation` needs beside the mode, in the world.
    attribute : str
        Where points without an estimate have their normals.
    """

    mode: str
    rows: Any
    seed: int | None
    guides: dict[str, Any]
    attribute: str


class TIMESCALE_OT_reorient_normals(OnSelection, SideOptions, GuideObjects):
    """Signs of normals that are there already, estimated or not."""

    bl_idname = "timescale.reorient_normals"
    bl_label = "Flip / Reorient Normals"
    bl_description = (
        "Turn normals that are there to the other side, and change nothing else of "
        "them: estimated ones, custom normals of meshes, and vectors that points "
        "brought from a file"
    )
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    mode: EnumProperty(
        name="Mode",
        description="Which side the normals face",
        items=[(m, m.replace("_", " ").title(), tip) for m, tip in _MODES.items()],
        default="flip",
    )
    part: EnumProperty(
        name="Points",
        description="Which normals may turn",
        items=[(part, part.title(), tip) for part, tip in _PARTS.items()],
        default="auto",
    )
    attribute: StringProperty(
        name="Normals",
        description="Vector attribute with the normals of points without an estimate",
        default="normal",
    )

    # What is pointed at: an active vertex, or a ray under the mouse.
    _vertex: int | None = None
    _ray: Ray | None = None
    _editing = False

    def invoke(self, context: Context, event: Event) -> Returned:
        """Remember what is pointed at, and go on."""
        self._ray = ray_under_mouse(context, event)
        self._look(context)
        return super().invoke(context, event)

    def execute(self, context: Context) -> Returned:
        """Remember what is edited, and go on."""
        self._look(context)
        return super().execute(context)

    def _look(self, context: Context) -> None:
        self._editing = bridge.in_edit_mode(context)
        obj = context.object
        self._vertex = None if obj is None else bridge.active_vertex(obj)

    def read(self, job: Job) -> None:
        """Read the normals that are there, and which of them may turn."""
        options: Any = self
        super().read(job)
        job.geometry = bridge.read_geometry(job.obj)
        job.fingerprint = bridge.fingerprint(job.obj)
        job.normals = bridge.read_facing(job.obj, options.attribute)
        part = options.part
        if part == "auto":
            part = "selected" if self._editing else "all"
        job.task = Task(
            options.mode,
            bridge.read_selected(job.obj) if part == "selected" else None,
            self._seed(job) if part == "piece" else None,
            self._guides(job),
            options.attribute,
        )

    def _seed(self, job: Job) -> int:
        if job.obj != bpy.context.object:
            raise core.InputError("it is not the active one, whose piece turns")
        if self._vertex is not None:
            return self._vertex
        if self._ray is not None:
            return job.geometry.first_along(*self._ray)
        return job.geometry.nearest(bpy.context.scene.cursor.location)

    def _guides(self, job: Job) -> dict[str, Any]:
        options: Any = self
        guides: dict[str, Any] = {"nested": options.nested}
        if options.mode == "viewpoint":
            guides["viewpoint"] = viewpoint_of(job, options)
        if options.mode == "reference":
            guide = reference_of(options)
            if guide is None:
                found = bridge.read_normals(job.obj, options.reference)
                guides["reference"] = job.geometry.to_world(found)
            else:
                job.guide = bridge.read_surface(guide)
        return guides

    @staticmethod
    def compute(job: Job, progress: Progress) -> None:
        """Find the sides, and turn what may turn."""
        shape, task = job.geometry, job.task
        normals = shape.to_world(job.normals)
        rows = (normals != 0).any(axis=1)
        if task.rows is not None:
            rows &= task.rows
        if task.seed is not None:
            piece = connected_pieces(shape.points, normals, shape.faces)
            rows &= piece == piece[task.seed]
        job.valid = rows
        if job.guide is not None:
            task.guides["reference"] = job.guide.normals_near(shape.points)
        job.orientation = _sides(task, shape, normals, progress)

    def write(self, job: Job) -> None:
        """Turn them over and say how many."""
        turned = job.valid & (job.orientation.signs < 0)
        bridge.turn_normals(job.obj, turned, job.task.attribute)
        if job.task.mode != "flip" and bridge.has_estimate(job.obj):
            _write_report(job)
        counts = {"turned": int(turned.sum()), "looked": int(job.valid.sum())}
        job.notes += [("WARNING", text) for text in job.orientation.warnings]
        job.notes.append(("INFO", TURNED.format_map(counts)))
        job.done = True

    def draw(self, context: Context) -> None:
        """Show the settings in the panel of the last operation."""
        options: Any = self
        layout: Any = self.layout
        layout.use_property_split = True
        layout.prop(options, "mode")
        layout.prop(options, "part")
        draw_guides(layout, options, options.mode, context.object)
        if context.object is not None and not bridge.has_estimate(context.object):
            layout.prop_search(options, "attribute", context.object.data, "attributes")


def _sides(
    task: Task, shape: bridge.Geometry, normals: np.ndarray, progress: Progress
) -> Orientation:
    if task.mode == "flip":
        return Orientation(np.full(len(normals), -1, dtype=np.int8), "flip", 0)
    return find_orientation(
        shape.points,
        normals,
        mode=task.mode,
        faces=shape.faces,
        progress=progress,
        **task.guides,
    )


def _write_report(job: Job) -> None:
    """Let attribute and panel say how sure the sides are now."""
    sure = bridge.read_attribute(job.obj, "ts_side_confidence", "FLOAT")
    sure[job.valid] = job.orientation.confidence[job.valid]
    bridge.write_results(job.obj, {"ts_side_confidence": sure})
    estimate = bridge.read_summary(job.obj)["estimate"]
    if job.valid.all():
        estimate |= job.orientation.summary()
    bridge.write_summary(job.obj, {"estimate": estimate})


TURNED = "{turned:,} of {looked:,} normals turned over"


# The stubs of append and remove leave out the menu that draws.
def _draw_menu(menu: Menu, _context: Context) -> None:
    menu.layout.separator()
    menu.layout.operator(TIMESCALE_OT_reorient_normals.bl_idname)


_register_classes, _unregister_classes = bpy.utils.register_classes_factory(
    (TIMESCALE_OT_reorient_normals,)
)


def register() -> None:
    """Add the operator, also to the menu of normals in Edit Mode."""
    _register_classes()
    bpy.types.VIEW3D_MT_edit_mesh_normals.append(_draw_menu)  # type: ignore[arg-type]


def unregister() -> None:
    """Remove them."""
    bpy.types.VIEW3D_MT_edit_mesh_normals.remove(_draw_menu)  # type: ignore[arg-type]
    _unregister_classes()
