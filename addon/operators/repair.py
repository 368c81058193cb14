# SPDX-License-Identifier: GPL-3.0-or-later
"""Repair Normals: one click for meshes that shade badly, or a look at what it would do.

What a mesh shows of itself decides what its normals become (`core/mesh/meshes.py`);
faces that wind against the others are found, and turned over where that is asked for.
"""

from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from bpy.props import BoolProperty, FloatProperty
from bpy.types import Context

from ... import core
from ...core.mesh.creases import find_sharp_edges
from ...core.mesh.faces import angles_between
from ...core.orient.winding import Winding, find_flipped_faces
from ...core.progress import Progress
from .. import bridge
from ..display import dress
from ..settings.properties import EstimateOptions
from ..settings.scene import Returned
from . import jobs
from .jobs import Job
from .run import OnSelection

# From this many degrees on a corner counts as changed: less is hardly seen.
_SEEN = 1.0
# What a preview has the last color for.
_STRONG = 30.0


@dataclass
class Task:
    """What is to be repaired, and what was found.

    Attributes
    ----------
    faces : Faces
        The corners of the triangles, and the edges that part the mesh.
    angle : float or None
        Edges whose faces turn by more part it as well, in radians.
    shown : (c, 3) float64
        The normals that the corners have, in object space.
    turn : bool
        Whether faces that wind against the others are to be turned over.
    winding : Winding
    """

    faces: bridge.Faces
    angle: float | None
    shown: Any
    turn: bool
    winding: Winding | None = None


# The same choices as for an estimate.
_SPLIT, _REGION, _VERTEX_GROUP, _STRENGTH, _STORAGE = (
    EstimateOptions.__annotations__[name]
    for name in ("split", "region", "vertex_group", "strength", "storage")
)


class TIMESCALE_OT_repair_normals(OnSelection):
    """Normals that a mesh's own evidence speaks for."""

    bl_idname = "timescale.repair_normals"
    bl_label = "Repair Normals"
    bl_description = (
        "Look for noise, steps, slivers and flipped faces, and give the mesh the "
        "normals that fit it best.\n"
        "Vertices stay where they are, and a clean mesh keeps the normals of its faces"
    )
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    sharp_angle: FloatProperty(
        name="Sharp Angle",
        description=(
            "Edges whose faces turn by more part the normals, as marked ones do; "
            "180 degrees part none. Noise turns faces too"
        ),
        default=np.pi,
        min=np.radians(1),
        max=np.pi,
        subtype="ANGLE",
    )
    turn_faces: BoolProperty(
        name="Flip Faces",
        description="Turn over faces that wind against the others or look inward",
        default=True,
    )
    preview: BoolProperty(
        name="Preview",
        description="Only color how far normals would turn, and change nothing else",
    )
    split: _SPLIT
    region: _REGION
    vertex_group: _VERTEX_GROUP
    strength: _STRENGTH
    storage: _STORAGE

    def read(self, job: Job) -> None:
        """Read the shape, the edges that part it and the normals that it has."""
        options: Any = self
        super().read(job)
        if bridge.is_cloud(job.obj):
            raise core.InputError("it has no faces to repair; estimate normals instead")
        job.settings = core.Settings()
        job.geometry = bridge.read_geometry(job.obj)
        job.fingerprint = bridge.fingerprint(job.obj)
        jobs.read_weight(job, options)
        angle = options.sharp_angle
        job.task = Task(
            bridge.read_faces(job.obj, options.split),
            angle if angle < np.pi else None,
            bridge.read_corner_normals(job.obj),
            options.turn_faces,
        )

    @staticmethod
    def compute(job: Job, progress: Progress) -> None:
        """Find flipped faces, then the normals."""
        shape, task = job.geometry, job.task
        task.winding = find_flipped_faces(shape.points, shape.faces)
        faces = task.winding.repaired(shape.faces)
        edges = task.faces.marked
        if task.angle is not None:
            # Within a face that is not flat nothing is parted.
            found = find_sharp_edges(shape.points, faces, task.angle)
            edges = edges | task.faces.edges_among(found)
        job.estimate = core.estimate_normals(
            shape.points, faces=faces, sharp=task.faces.ends[edges], progress=progress
        )
        # Each corner where the mesh has it.
        turned = task.winding.flipped[:, None, None]
        normals = job.estimate.corner_normals
        normals = np.where(turned, normals[:, ::-1], normals)
        normals = shape.to_object(task.faces.at_corners(normals))
        job.corners = bridge.Corners(normals, (normals != 0).any(axis=1), edges)
        job.normals = shape.to_object(job.estimate.normals)
        job.valid = job.estimate.valid

    def write(self, job: Job) -> None:
        """Write normals, or colors alone."""
        options: Any = self
        angles = _turned_by(job)
        if options.preview:
            bridge.write_preview(job.obj, _colors(job, angles))
            job.notes.append(("INFO", WOULD.format(**_counts(job, angles))))
        else:
            dress.hide_beside(job.obj)
            corners = job.corners
            faces = _to_turn(job)
            if job.task.turn and faces.any():
                corners = bridge.turn_faces(job.obj, faces, corners)
            bridge.write_estimate(
                job.obj,
                job.normals,
                job.valid,
                storage=options.storage,
                weight=job.weight,
                corners=corners if corners.edges.any() else None,
            )
            bridge.write_summary(job.obj, {"estimate": jobs.summary_of(job)})
            job.notes.append(("INFO", DID.format(**_counts(job, angles))))
        job.done = True

    def write_all(self, context: Context, done: Any) -> Returned:
        """Write, and show the colors of a preview."""
        options: Any = self
        returned = super().write_all(context, done)
        objects = [job.obj for job in done if job.done]
        (dress.show if options.preview else dress.hide)(context, objects)
        return returned

    def draw(self, context: Context) -> None:
        """Show the settings in the panel of the last operation."""
        layout: Any = self.layout
        layout.use_property_split = True
        draw_repair(layout, self, context.object)


def draw_repair(layout: Any, options: Any, obj: Any) -> None:
    """Show what can be chosen."""
    layout.prop(options, "preview")
    layout.prop(options, "turn_faces")
    layout.column().prop(options, "split")
    layout.prop(options, "sharp_angle")
    layout.prop(options, "region")
    if options.region == "group":
        layout.prop_search(options, "vertex_group", obj, "vertex_groups", text=" ")
    layout.prop(options, "storage")


def _turned_by(job: Job) -> Any:
    """Return by how many degrees the normal of each corner turns, (c,)."""
    angles = angles_between(job.corners.normals, job.task.shown) * job.corners.valid
    return angles if job.weight is None else angles * job.weight[_vertices(job)]


def _to_turn(job: Job) -> Any:
    """Return which faces (f,) bool of the region to turn over."""
    turned = job.task.winding.flipped
    if job.weight is not None:
        within = job.weight[job.task.faces.vertices][job.task.faces.triangles] > 0
        turned = turned & within.all(axis=1)
    return job.task.faces.faces_of(turned)


def _vertices(job: Job) -> Any:
    return job.task.faces.vertices


def _counts(job: Job, angles: Any) -> dict[str, Any]:
    """Return what the report counts."""
    mesh = job.estimate.mesh
    noise = {"clean": "no noise", "stepped": "steps of voxels"}.get(mesh.kind)
    return {
        "faces": int(_to_turn(job).sum()),
        "done": "flipped" if job.task.turn else "wind against the others",
        "noise": noise or f"noise of {mesh.noise / mesh.edge:.2g} edges",
        "changed": 100 * float((angles > _SEEN).mean()),
        "most": float(angles.max(initial=0)),
    }


def _colors(job: Job, angles: Any) -> Any:
    """Return colors of the vertices by the most that a corner of each turns."""
    most = np.zeros(len(job.normals))
    np.maximum.at(most, _vertices(job), angles)
    return core.Comparison(most, most).colors("deviation", limit=_STRONG)


DID = (
    "{faces:,} faces {done}, {noise} found, {changed:.0f} % of corners improved, "
    "by {most:.0f} degrees at most"
)
WOULD = (
    "{faces:,} faces wind against the others, {noise} found, {changed:.0f} % of "
    "corners would turn, by {most:.0f} degrees at most"
)

register, unregister = bpy.utils.register_classes_factory(
    (TIMESCALE_OT_repair_normals,)
)
