# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators on selected objects: which steps a job takes, and what they are called.

What happens between the steps is in `run`, what happens in them is in `jobs`.
"""

from collections.abc import Sequence

import bpy
from bpy.props import StringProperty
from bpy.types import Context

from ...core import InputError
from ...core.progress import Progress
from .. import bridge
from ..display import dress
from ..settings.layouts import draw_colors, draw_compare, draw_details, draw_estimate
from ..settings.properties import (
    CompareOptions,
    EstimateOptions,
    GuideObjects,
    truth_of,
)
from ..settings.scene import Returned
from . import jobs
from .jobs import Job
from .run import OnSelection


class TIMESCALE_OT_estimate_normals(OnSelection, EstimateOptions, GuideObjects):
    """Custom normals and attributes from patches and their derivatives."""

    bl_idname = "timescale.estimate_normals"
    bl_label = "Estimate Normals"
    bl_description = (
        "Fit a patch around every point and derive its normal on time scales.\n"
        "Meshes get custom normals; meshes and point clouds get the attributes "
        "ts_normal, ts_valid, ts_confidence, ts_scale and ts_side_confidence.\n"
        "Objects that share a mesh share the result, computed at the scale of the "
        "active one"
    )
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    def read(self, job: Job) -> None:
        """Read the shape, and how much of it is to change."""
        jobs.read_shape(job, self)
        jobs.read_weight(job, self)
        jobs.read_split(job, self)

    @staticmethod
    def compute(job: Job, progress: Progress) -> None:
        """Estimate."""
        jobs.estimate(job, progress)

    def write(self, job: Job) -> None:
        """Write normals."""
        jobs.write_estimate(job, self)

    def write_all(self, context: Context, jobs: Sequence[Job]) -> Returned:
        """Write, and hide the colors of an earlier comparison, which is gone."""
        returned = super().write_all(context, jobs)
        dress.hide(context, [job.obj for job in jobs if job.done])
        return returned

    def draw(self, context: Context) -> None:
        """Show the settings in the panel of the last operation."""
        self.layout.use_property_split = True
        draw_estimate(self.layout, self, context.object)
        draw_details(self.layout, self, context.object)


class TIMESCALE_OT_compare_delaunay(
    OnSelection, EstimateOptions, GuideObjects, CompareOptions
):
    """Errors and colors of the estimate and of the triangulation."""

    bl_idname = "timescale.compare_delaunay"
    bl_label = "Compare with Delaunay"
    bl_description = (
        "Measure the normals of a triangulation and the estimated ones, which are "
        "made first where there are none.\n"
        "With true normals, ts_error and delaunay_error hold the largest difference "
        "to them in a coordinate; without, ts_error holds that of the two sides to "
        "each other and delaunay_error is left out. ts_angle and delaunay_angle hold "
        "the same in degrees, ts_error_color shows them"
    )
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    truth_object: StringProperty(
        name="True Surface",
        description="Mesh whose nearest surface has the true normals",
    )

    def read_all(self, jobs: Sequence[Job]) -> None:
        """Read the true surface once for all."""
        self._surface, self._missing = None, ""
        try:
            obj = truth_of(self)
            self._surface = bridge.read_surface(obj) if obj else None
        except InputError as error:
            self._missing = str(error)
        super().read_all(jobs)

    def read(self, job: Job) -> None:
        """Read the shape, the true normals and the estimate that is there."""
        if self._missing:
            raise InputError(self._missing)
        jobs.read_shape(job, self)
        jobs.read_truth(job, self, self._surface)
        jobs.read_earlier_estimate(job)
        if job.normals is None:
            jobs.read_weight(job, self)
            jobs.read_split(job, self)

    @staticmethod
    def compute(job: Job, progress: Progress) -> None:
        """Estimate where needed, triangulate, compare."""
        jobs.estimate_and_compare(job, progress)

    def write(self, job: Job) -> None:
        """Write errors and colors."""
        if job.estimate is not None:
            dress.hide_beside(job.obj)
            jobs.write_estimate(job, self)
        jobs.write_comparison(job, self)

    def write_all(self, context: Context, jobs: Sequence[Job]) -> Returned:
        """Write, and show the colors when asked to."""
        returned = super().write_all(context, jobs)
        if self.show_colors:
            dress.show(context, [job.obj for job in jobs if job.done])
        return returned

    def draw(self, context: Context) -> None:
        """Show the settings in the panel of the last operation."""
        self.layout.use_property_split = True
        draw_compare(self.layout, self, context.object)
        draw_colors(self.layout, self)
        draw_estimate(self.layout, self, context.object)
        draw_details(self.layout, self, context.object)


class TIMESCALE_OT_clear_results(OnSelection):
    """The way back to what was there before the first run."""

    bl_idname = "timescale.clear_results"
    bl_label = "Clear Results"
    bl_description = (
        "Remove estimated normals, errors and colors, and bring back the custom "
        "normals and attributes that were there before"
    )
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set
    takes_time = False

    def write(self, job: Job) -> None:
        """Restore what was there."""
        edited = bridge.clear_results(job.obj)
        if edited is None:
            job.notes.append(("INFO", "there is nothing to clear"))
            return
        job.done = True
        if edited:
            job.notes.append(("WARNING", EDITED))

    def write_all(self, context: Context, jobs: Sequence[Job]) -> Returned:
        """Hide the colors that are gone."""
        returned = super().write_all(context, jobs)
        dress.hide(context, [job.obj for job in jobs if job.done])
        return returned


EDITED = (
    "points were added or removed since; earlier normals and attributes came back "
    "for those that remain"
)

CLASSES = (
    TIMESCALE_OT_estimate_normals,
    TIMESCALE_OT_compare_delaunay,
    TIMESCALE_OT_clear_results,
)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
