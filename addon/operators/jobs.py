# SPDX-License-Identifier: GPL-3.0-or-later
"""One object on its way through an operator, and the steps that it takes.

What is read from Blender travels in a Job. Computing touches nothing but the Job, so
that it may run in a thread, and nothing is written before all of it is done.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from bpy.types import Context, Object

from ... import core
from ...core.mesh.faces import fan_means
from ...core.progress import Progress, between
from .. import bridge
from ..display import coloring
from ..settings.properties import place_of, reference_of, to_core
from ..settings.scene import Options

# Where the progress stands when a guide is asked, before an estimate; and in a
# comparison when the estimate is there, and the triangulation.
_GUIDED = 0.2
_ESTIMATED, _TRIANGULATED = 0.6, 0.6


@dataclass
class Job:
    """What was read, what was computed, what there is to say.

    Attributes
    ----------
    uid, name : int, str
        The object, by what outlives undo and editing: references to Blender's data
        do not.
    fingerprint : tuple
        Of the shape that was read.
    weight : (n,) float64 or None
        Share of the estimate in the normals; None is all of it.
    before : (n, 3) float64 or None
        What the rest of the normals of points without faces is.
    fans : Fans or None
        How edges part a mesh. The estimate is then of fans, the rest of vertices.
    corners : Corners or None
        The normals where edges part a mesh, in object space.
    orientation : Orientation or None
        Sides of normals that were there before.
    estimate : Estimate or None
        None where an earlier one is compared.
    normals, baseline, truth : (n, 3) float64 or None
        Of the estimate, of the Delaunay triangulation and as given, in object space.
    valid : (n,) bool or None
        Where the estimate has normals.
    surface : Surface or None
        Where `truth` is to be taken from.
    guide : Surface or None
        Whose side the normals are to take.
    task : object
        What an operator wants beside settings, in its own terms.
    stale : bool
        Whether someone changed or removed the object while its job was computed.
    notes : list of (level, sentence)
    """

    uid: int
    name: str
    settings: core.Settings = field(init=False)
    geometry: bridge.Geometry = field(init=False)
    comparison: core.Comparison = field(init=False)
    fingerprint: tuple = ()
    weight: Any = None
    before: Any = None
    fans: Any = None
    corners: bridge.Corners | None = None
    orientation: Any = None
    estimate: core.Estimate | None = None
    normals: Any = None
    valid: Any = None
    baseline: Any = None
    truth: Any = None
    surface: bridge.Surface | None = None
    guide: bridge.Surface | None = None
    task: Any = None
    done: bool = False
    error: str = ""
    stale: bool = False
    notes: list[tuple[Any, str]] = field(default_factory=list)

    @property
    def obj(self) -> Object:
        """The object; raises ObjectError where it is gone."""
        return bridge.find_object(self.uid)

    def attempt(self, step: Callable[..., None], *arguments: object) -> None:
        """Take a step unless one before has failed; bad input ends this job alone."""
        if self.error:
            return
        try:
            step(self, *arguments)
        except core.InputError as error:
            self.error = str(error)


def jobs_of(context: Context) -> list[Job]:
    """Return a job for every selected mesh and point cloud."""
    return [Job(obj.session_uid, obj.name) for obj in bridge.targets(context)]


# Read


def read_shape(job: Job, options: Options) -> None:
    """Read settings and shape of an object that results can be written to."""
    bridge.check_writable(job.obj)
    job.settings = to_core(options)
    job.geometry = bridge.read_geometry(job.obj, evaluated=options.use_modifiers)
    job.fingerprint = bridge.fingerprint(job.obj)
    if options.use_modifiers and options.storage == "tangent_space":
        raise core.InputError(AFTER_MODIFIERS)
    if job.settings.orientation == "viewpoint":
        job.settings = replace(job.settings, viewpoint=viewpoint_of(job, options))
    if job.settings.orientation == "reference":
        read_reference(job, options)


def viewpoint_of(job: Job, options: Any) -> Any:
    """Return the place in the world that normals are to face, or one for each point."""
    if not options.viewpoint_attribute:
        return place_of(options)
    return bridge.read_places(job.obj, options.viewpoint_attribute)


def read_reference(job: Job, options: Options) -> None:
    """Read the normals whose side is taken, or remember the surface that has them."""
    guide = reference_of(options)
    if guide is not None:
        job.guide = bridge.read_surface(guide)
        return
    reference = bridge.read_normals(job.obj, options.reference)
    reference = job.geometry.to_world(reference)
    job.settings = replace(job.settings, reference=reference)


def read_weight(job: Job, options: Options) -> None:
    """Read how much of the estimate each vertex is to have."""
    if options.region == "all" and options.strength == 1:
        return
    if bridge.is_cloud(job.obj):
        job.before = bridge.read_normals_before(job.obj)
    job.weight = options.strength * bridge.read_weight(
        job.obj, options.region, options.vertex_group
    )


def read_split(job: Job, options: Options) -> None:
    """Read which edges of a mesh keep normals apart."""
    if not options.split:
        return
    fans = bridge.read_fans(job.obj, options.split, evaluated=options.use_modifiers)
    if fans is not None and job.settings.graph not in {"auto", "mesh"}:
        job.notes.append(("WARNING", NOT_SPLIT))
    else:
        job.fans = fans


def read_truth(job: Job, options: Options, surface: bridge.Surface | None) -> None:
    """Read the true normals, or remember the surface that has them."""
    job.surface = surface
    if surface is None and options.truth:
        job.truth = bridge.read_normals(job.obj, options.truth)


def read_earlier_estimate(job: Job) -> None:
    """Read the estimate that is there."""
    if bridge.has_estimate(job.obj):
        job.normals = bridge.read_normals(job.obj, "ts_normal")


def check_same(job: Job) -> None:
    """Raise ObjectError where the object is gone or no longer has its shape."""
    if bridge.fingerprint(job.obj) != job.fingerprint:
        raise bridge.ObjectError(CHANGED)


# Compute


def estimate(job: Job, progress: Progress) -> None:
    """Estimate the normals of the shape as it stands in the world."""
    shape, settings, fans = job.geometry, job.settings, job.fans
    points, faces = shape.points, shape.faces
    if job.guide is not None:
        near = job.guide.normals_near(points, between(progress, 0.0, _GUIDED))
        settings = replace(settings, reference=near)
        progress = between(progress, _GUIDED, 1.0)
    if fans is not None:
        points, faces = points[fans.vertex], fans.faces
        settings = _of_fans(settings, fans.vertex)
    found = core.estimate_normals(
        points, faces=faces, settings=settings, progress=progress
    )
    job.estimate, job.normals = found, shape.to_object(found.normals)
    job.valid = found.valid
    if fans is not None:
        job.corners = bridge.Corners(
            job.normals[fans.corner], found.valid[fans.corner], fans.edges
        )
        job.normals = fan_means(job.normals, fans.vertex, len(shape.points))
        job.valid = (job.normals != 0).any(axis=1)


def _of_fans(settings: core.Settings, vertex: Any) -> core.Settings:
    """Return settings with what each vertex brings given to its fans."""
    viewpoint: Any = settings.viewpoint
    reference: Any = settings.reference
    if np.ndim(viewpoint) == 2:
        viewpoint = viewpoint[vertex]
    if reference is not None:
        reference = reference[vertex]
    return replace(settings, viewpoint=viewpoint, reference=reference)


def estimate_and_compare(job: Job, progress: Progress) -> None:
    """Estimate where there is no estimate, triangulate, compare.

    In object space, so that errors can be checked against the attributes.
    """
    shape = job.geometry
    if job.normals is None:
        estimate(job, between(progress, 0.0, _ESTIMATED))
        progress = between(progress, _ESTIMATED, 1.0)
    told = between(progress, 0.0, _TRIANGULATED)
    found = core.delaunay_normals(shape.points, faces=shape.faces, progress=told)
    job.baseline = shape.to_object(found)
    progress(_TRIANGULATED)
    if job.surface is not None:
        told = between(progress, _TRIANGULATED, 1.0)
        job.truth = shape.to_object(job.surface.normals_near(shape.points, told))
    job.comparison = core.compare_normals(job.normals, job.baseline, truth=job.truth)


# Write


def write_estimate(job: Job, options: Options) -> None:
    """Write normals and validity, and say how many and from what."""
    storage = options.storage
    if storage == "auto" and options.use_modifiers:
        # Others would be turned once more by what deforms the mesh.
        storage = "free"
    bridge.write_estimate(
        job.obj,
        job.normals,
        job.valid,
        storage=storage,
        weight=job.weight,
        before=job.before,
        corners=job.corners,
    )
    # The first fans are those of the vertices.
    estimate, count = job.estimate, len(job.valid)
    results = {
        "ts_side_confidence": estimate.orientation_confidence,
        "ts_confidence": estimate.confidence,
        "ts_scale": estimate.scale,
    }
    results = {name: values[:count] for name, values in results.items()}
    bridge.write_results(job.obj, results)
    summary = summary_of(job)
    bridge.write_summary(job.obj, {"estimate": summary})
    if summary["invalid"]:
        job.notes.append(("WARNING", KEPT.format_map(summary)))
    job.notes += [("WARNING", warning) for warning in summary.get("warnings", ())]
    sentence = WITH_FACES if summary["from_faces"] else ESTIMATED
    if summary["from_faces"] == summary["normals"]:
        sentence = BY_FACES
    sentence = sentence.format_map(summary)
    if summary["noise_percent"] and not summary["from_faces"]:
        sentence += f", noise {summary['noise_percent']:.2g} %"
    if job.weight is not None and not job.weight.all():
        sentence += IN_REGION.format(int((job.weight > 0).sum()))
    job.notes.append(("INFO", sentence))
    job.done = True


def summary_of(job: Job) -> dict[str, Any]:
    """Return what is to be said about an estimate, in points of the object."""
    summary = job.estimate.summary()
    # Which side a patch had before it was given one is no news to anyone.
    summary.pop("turned", None)
    summary["normals"] = summary["valid"]
    if job.fans is not None:
        valid = int(job.valid.sum())
        counts = {"points": len(job.valid), "valid": valid}
        summary |= counts | {"invalid": len(job.valid) - valid}
    summary["noise_percent"] = _noise_percent(job)
    return summary


def _noise_percent(job: Job) -> float | None:
    """Return the noise in per cent of the diagonal, which means more than a length."""
    noise = job.estimate.noise
    if noise is None:
        return None
    # Axis by axis: by rows it takes ten times as long.
    size = float(np.linalg.norm([np.ptp(axis) for axis in job.geometry.points.T]))
    return 100 * noise / size if size else None


def write_comparison(job: Job, options: Options) -> None:
    """Write the other side, errors and colors, and say which side is nearer."""
    found, summary = job.comparison, job.comparison.summary()
    error, angle = found.error_estimate, found.angle_estimate
    if job.truth is None:
        error, angle = found.deviation, found.angle_deviation
    results = {
        "delaunay_normal": job.baseline,
        "ts_error": error,
        "delaunay_error": found.error_baseline,
        "ts_angle": angle,
        "delaunay_angle": found.angle_baseline,
    }
    bridge.write_results(job.obj, results)
    bridge.write_summary(job.obj, {"comparison": summary})
    measure = coloring.possible(options.color_by, found)
    look = coloring.Look(measure, options.color_limit, options.color_map)
    coloring.write_colors(job.obj, found, look)
    if measure != options.color_by:
        job.notes.append(("INFO", "without true normals, colors show the difference"))
    if bridge.is_split(job.obj):
        job.notes.append(("INFO", MEANS))
    if summary["compared"]:
        sentence = DIFFERENCE if job.truth is None else NEARER
        job.notes.append(("INFO", sentence.format_map(summary)))
    else:
        job.notes.append(("WARNING", "no point has a normal on both sides"))
    job.done = True


AFTER_MODIFIERS = (
    "normals in tangent space are turned by its modifiers once more; "
    "choose Free or turn After Modifiers off"
)
NOT_SPLIT = (
    "marked edges do not part it, because neighbors are not those of the mesh; "
    "choose Auto or Mesh as Graph"
)
CHANGED = "its shape changed while its normals were computed; run again"
MEANS = (
    "where edges split its normals, the mean of each vertex is compared with that of "
    "all faces around it"
)
ESTIMATED = "{normals:,} normals, each from {neighbors} neighbors"
WITH_FACES = "{normals:,} normals, {from_faces:,} of them by the faces around them"
BY_FACES = "{normals:,} normals, all by the faces around them"
IN_REGION = "; {:,} vertices of the region have them"
KEPT = (
    "{invalid:,} of {points:,} points had too few neighbors for a normal; "
    "they keep the one they had"
)
NEARER = (
    "the estimate is nearer to the true normal at {wins_percent:.1f} % of "
    "{compared:,} points; RMS error {angle_estimate_rms:.3g} degrees, "
    "Delaunay {angle_baseline_rms:.3g}"
)
DIFFERENCE = (
    "the two normals of {compared:,} points differ by {angle_deviation_rms:.3g} "
    "degrees (RMS), {angle_deviation_max:.3g} at most"
)
