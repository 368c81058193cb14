# SPDX-License-Identifier: GPL-3.0-or-later
"""The normals that patches give at all points, by the method that is asked for."""

from dataclasses import dataclass
from itertools import count

from .auto.blend import (
    Exact,
    Field,
    Noisy,
    blend,
    error_of_misfit,
    is_enough,
    is_noisy,
    points_of_block,
)
from .auto.coarse import noise_in_spacings
from .inputs import BoolArray, FloatArray, IntArray
from .mesh.faces import Triangles
from .mesh.meshes import MeshNormals, choose_normals, with_faces
from .neighborhoods import Nearest, Rings, neighborhoods
from .patches.fitted import Fitted, fit_all
from .patches.sheets import STAGES, separate, suspects
from .progress import Progress, between, silent
from .settings import Settings
from .threads import in_threads

# Where the progress stands when patches of one size are fitted, and when points are
# told apart by sheets; the rest goes to blending.
_FITTED, _PARTED = 0.6, 0.8


@dataclass(frozen=True)
class Found:
    """What the patches give, before faces and sides: see Estimate.

    Attributes
    ----------
    condition : (n,) float64 or None
        See Estimate.
    mesh : MeshNormals or None
        Where there are faces.
    """

    field: Field
    valid: BoolArray
    settings: Settings
    noise: float
    separated: int = 0
    condition: FloatArray | None = None
    mesh: MeshNormals | None = None


def from_patches(
    points: FloatArray,
    faces: IntArray | None,
    asked: Settings,
    report: Progress,
    *,
    center: FloatArray | None = None,
) -> tuple[Found, Nearest | Rings]:
    """Return the normals of points that differ, less their center, and neighborhoods.

    What the neighbors were looked up with takes memory as long as somebody holds it.
    """
    source, settings = neighborhoods(points, faces, asked, center=center)
    if faces is not None:
        return _of_mesh(points, faces, source, settings, report), source
    return _of_points(asked, source, settings, report), source


def _of_points(asked, source, settings, report):
    """Return what the patches of points give."""
    if not (isinstance(source, Nearest) and is_automatic(asked, source.count)):
        fitted, field, separated = _of_one_size(source, report)
        valid, noise, condition = fitted.valid, fitted.noise, fitted.condition
        return Found(field, valid, settings, noise, separated, condition)
    nearest = source.nearest
    level, noise = noise_in_spacings(source.asked)
    source.asked.forget()
    if is_noisy(level, settings.neighbors or 0):
        run = _runner(settings, report, 2)
        least = points_of_block(settings.neighbors or 0, settings.patch)
        field = blend(Noisy(nearest, level, noise, least=least), run)
        valid = (field.normals != 0).any(axis=1)
        return Found(field, valid, settings, noise)
    fitted, field, separated = _of_one_size(source, report)
    run = _runner(settings, between(report, _PARTED, 1.0), 2)
    _, typical = suspects(fitted.misfit, fitted.valid)
    cloud = Exact(nearest, field, fitted.normals, fitted.misfit, typical)
    field = blend(cloud, run)
    valid, noise = fitted.valid, fitted.noise
    return Found(field, valid, settings, noise, separated)


def _of_mesh(points, faces, source, settings, report):
    """Return what the patches and faces of a mesh give."""
    triangles = Triangles(points, faces)
    if settings.method == "auto":
        condition = None
        # The graph of a source of their own goes when the patches are there.
        mesh = choose_normals(
            triangles, lambda: fit_all(Rings(points, faces, settings), report)
        )
    else:
        fitted = fit_all(source, report)
        mesh, condition = with_faces(triangles, fitted), fitted.condition
    turned = triangles.fan_width(mesh.normals)
    field = Field(mesh.normals, error_of_misfit(turned), triangles.longest_edges)
    return Found(field, mesh.valid, settings, mesh.noise, 0, condition, mesh)


def is_automatic(asked: Settings, count: int) -> bool:
    """Whether size and kind of the patches are left to the data, point by point."""
    return (
        asked.method == "auto"
        and asked.neighbors is None
        and asked.patch == "auto"
        and asked.radius is None
        and asked.weights == "second_order"
        and is_enough(count)
    )


def _of_one_size(source, report):
    """Return patches of one size, their Field, and how many points were told apart."""
    fitted = fit_all(source, between(report, 0.0, _FITTED))
    told = between(report, _FITTED, _PARTED)
    return fitted, *base_field(source, fitted, told)


def base_field(
    source: Nearest | Rings, fitted: Fitted, report: Progress = silent
) -> tuple[Field, int]:
    """Return the Field of patches of one size, and how many points were told apart."""
    normals, separated = fitted.normals, 0
    if source.settings.sheets and isinstance(source, Nearest):
        normals, separated = _with_sheets(source, fitted, report)
    return Field(normals, error_of_misfit(fitted.misfit), fitted.reach), separated


def _with_sheets(source, fitted, report):
    """Return normals made from each point's own sheet, and for how many."""
    rows, noise = suspects(fitted.misfit, fitted.valid)
    if not len(rows):
        return fitted.normals, 0
    run = _runner(source.settings, report, 1 + STAGES)
    normals = separate(
        source.nearest, fitted.normals, fitted.misfit, rows, noise, run=run
    )
    return normals, len(rows)


def _runner(settings, report, rounds):
    """Return a function that calls work(chunk) for all chunks, so many times over."""
    turns = count()

    def run(work, chunks):
        turn = next(turns)
        for done in in_threads(work, chunks, settings.threads):
            report((turn + done / len(chunks)) / rounds)

    return run
