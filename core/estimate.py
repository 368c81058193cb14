# SPDX-License-Identifier: GPL-3.0-or-later
"""From points to normals: patches, sheets, faces, signs."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from .fitted import fit_all, in_threads
from .guides import reference_normals
from .inputs import (
    BoolArray,
    FloatArray,
    InputError,
    IntArray,
    as_faces,
    as_points,
)
from .meshes import WIDER, wants_wider, with_faces
from .neighborhoods import Nearest, neighborhoods, neighborhoods_of_all, unique_points
from .orientation import Orientation, find_orientation
from .patch import LEAST_NEIGHBORS, Patches
from .settings import Settings
from .sheets import separate, suspects
from .surface import GridSurface
from .winding import Winding, find_flipped_faces

# Share of the progress that is the estimate's; the rest is the orientation's.
_FITTED = 0.8


@dataclass(frozen=True)
class Estimate:
    """Normals, and how they came about.

    Attributes
    ----------
    normals : (n, 3) float64
        Unit; zero where not valid.
    valid : (n,) bool
    settings : Settings
        As used: what "auto" and None became.
    condition : (n,) float64 or None
        Condition numbers of Eq. (3), by method "paper".
    from_faces : int
        Vertices whose normal is that of their faces, because a patch had too little
        to go by or left the cone of the faces.
    separated : int
        Points whose neighbors were told apart because they lie on several sheets.
    noise : float
        What the residuals say about the noise of the points: a standard deviation,
        in object units, the median over all patches.
    orientation : Orientation
        How the sides were found, and how sure they are.
    winding : Winding or None
        Which faces were turned over before, where settings asked for it.
    """

    normals: FloatArray
    valid: BoolArray
    settings: Settings
    condition: FloatArray | None = None
    from_faces: int = 0
    separated: int = 0
    noise: float = 0.0
    orientation: Orientation | None = None
    winding: Winding | None = None
    _input: tuple[FloatArray, IntArray | None] | None = field(default=None, repr=False)

    def patches(self, rows: ArrayLike) -> Patches:
        """Return the patches of some points, fitted again as they were.

        Before points are told apart by sheets and faces have their say.

        Parameters
        ----------
        rows : (m,) array_like of int
        """
        source, place = self._source
        return source.fit(place[np.asarray(rows)])

    def bundle(self, i: int) -> GridSurface:
        """Return the part of Table 1's bundle S that belongs to point i.

        The patch over the grid N(i) x N(i), in the coordinates of the input.
        """
        if self._input is None:
            raise InputError("expected an estimate of estimate_normals for a bundle")
        return self.patches([i]).bundle(origin=self._input[0][i])

    @cached_property
    def _source(self):
        """Return neighborhoods, and the place in them of each point of the input."""
        if self._input is None:
            raise InputError("expected an estimate of estimate_normals for patches")
        return neighborhoods_of_all(*self._input, self.settings)

    def summary(self) -> dict[str, object]:
        """Return what a report needs, as a dict of plain values."""
        return {
            "points": len(self.valid),
            "valid": int(self.valid.sum()),
            "invalid": int((~self.valid).sum()),
            "from_faces": self.from_faces,
            "method": self.settings.method,
            "neighbors": self.settings.neighbors,
            "patch": self.settings.patch,
            "noise": self.noise,
            "separated": self.separated,
            "graph": self.settings.graph,
            "weights": self.settings.weights,
            "flipped_faces": 0 if self.winding is None else self.winding.turned,
        } | ({} if self.orientation is None else self.orientation.summary())

    @property
    def pieces(self) -> int:
        """Pieces that were oriented each on its own; 0 where a guide decided."""
        return 0 if self.orientation is None else self.orientation.pieces

    @property
    def orientation_confidence(self) -> FloatArray:
        """(n,) float64, how sure the side of each normal is, 0 to 1."""
        if self.orientation is None:
            return np.zeros(len(self.valid))
        return self.orientation.confidence


def estimate_normals(
    points: ArrayLike,
    *,
    faces: ArrayLike | None = None,
    settings: Settings | None = None,
    progress: Callable[[float], object] | None = None,
) -> Estimate:
    """Estimate the unit normals of a surface from points on it.

    Parameters
    ----------
    points : (n, 3) array_like of float
        Any scale and offset.
    faces : (m, 3) array_like of int, optional
        Triangles of a mesh over the points.
    settings : Settings, optional
    progress : callable, optional
        Called with the share done, 0 to 1, in the calling thread. Whatever it
        raises ends the work and goes to the caller.

    Returns
    -------
    Estimate
        Rows that cannot be estimated (fewer than eight neighbors, neighbors on a
        line) are zero and not valid.

    Raises
    ------
    InputError
        When the input is not (n, 3) finite numbers, has fewer than nine points and
        no faces, or all of it lies in one place or on one line.

    Notes
    -----
    At each point the neighbors are moved to the origin, turned into a chart and
    fitted with a patch; the normal is the cross product of the diamond derivatives
    of the patch. Points that share a place count once and get the same normal.

    Examples
    --------
    >>> from core import estimate_normals, shapes
    >>> points, normals, _ = shapes.SPHERE.sample(500)
    >>> estimate = estimate_normals(points)
    >>> bool(((estimate.normals * normals).sum(axis=1) > 0.9999).all())
    True
    """
    asked = settings or Settings()
    points = as_points(points)
    faces = as_faces(faces, len(points))
    if faces is None and len(points) <= LEAST_NEIGHBORS:
        raise InputError(
            f"expected at least {LEAST_NEIGHBORS + 1} points, one and the "
            f"{LEAST_NEIGHBORS} neighbors that a patch needs, got {len(points)}"
        )
    center = points.mean(axis=0)
    centered = points - center
    _check_spread(centered)
    settings = _about(asked, center, points)
    winding = None
    if faces is not None and settings.winding == "repaired":
        winding = find_flipped_faces(centered, faces, nested=settings.nested)
        faces = winding.repaired(faces)
    if settings.method == "paper":
        settings = replace(settings, weights="paper", sheets=False)
    report = progress or _silent
    report(0.0)
    kept, inverse = unique_points(centered) if faces is None else (None, None)
    if kept is None or inverse is None:
        estimate = _estimate(centered, faces, settings, report)
        return replace(
            estimate,
            settings=_as_asked(estimate, asked),
            winding=winding,
            _input=(points, faces),
        )
    if len(kept) <= LEAST_NEIGHBORS:
        raise InputError(
            f"expected at least {LEAST_NEIGHBORS + 1} places for a patch, got "
            f"{len(points)} points in {len(kept)} places"
        )
    estimate = _estimate(centered[kept], None, _of_rows(settings, kept), report)
    return replace(
        estimate,
        normals=estimate.normals[inverse],
        valid=estimate.valid[inverse],
        condition=None if estimate.condition is None else estimate.condition[inverse],
        orientation=_of_places(estimate.orientation, inverse),
        settings=_as_asked(estimate, asked),
        _input=(points, None),
    )


def _of_places(orientation, inverse):
    """Return the orientation of points of which several share a place."""
    return replace(
        orientation,
        signs=orientation.signs[inverse],
        confidence=orientation.confidence[inverse],
    )


def _as_asked(estimate, asked):
    """Return the settings as used, with the places and normals as the caller gave."""
    return replace(
        estimate.settings, viewpoint=asked.viewpoint, reference=asked.reference
    )


def _silent(_share):
    """Report progress to nobody."""


def _estimate(points, faces, settings, report):
    """Estimate and orient the normals of centered points that differ."""
    asked = settings
    source, settings = neighborhoods(points, faces, asked)
    fitted = fit_all(source, lambda share: report(_FITTED * share))
    if wants_wider(points, faces, fitted, asked):
        source, settings = neighborhoods(points, faces, replace(asked, **WIDER))
        fitted = fit_all(source, lambda share: report(_FITTED * share))
    normals, valid = fitted.normals, fitted.valid
    separated = from_faces = 0
    if settings.sheets and isinstance(source, Nearest):
        normals, separated = _with_sheets(source, fitted)
    if faces is not None:
        normals, valid, from_faces = with_faces(points, faces, fitted, settings)
    report(_FITTED)
    orientation = find_orientation(
        points,
        normals,
        mode=settings.orientation,
        faces=faces,
        viewpoint=settings.viewpoint,
        reference=settings.reference,
        nested=settings.nested,
        threads=settings.threads,
        nearest=source.nearest if isinstance(source, Nearest) else None,
    )
    report(1.0)
    return Estimate(
        normals * orientation.signs[:, None],
        valid,
        replace(settings, orientation=orientation.mode),
        fitted.condition,
        from_faces,
        separated,
        fitted.noise,
        orientation,
    )


def _with_sheets(source, fitted):
    """Return normals made from each point's own sheet, and for how many."""
    rows, noise = suspects(fitted.misfit, fitted.valid)
    if not len(rows):
        return fitted.normals, 0

    def run(work, chunks):
        for _ in in_threads(work, chunks, source.settings.threads):
            pass

    normals = separate(
        source.nearest, fitted.normals, fitted.misfit, rows, noise, run=run
    )
    return normals, len(rows)


def _check_spread(centered):
    """Raise InputError when all points are in one place or on one line."""
    size = np.abs(centered).max()
    if size == 0:
        raise InputError(
            f"expected points that differ, got {len(centered)} in one place"
        )
    scaled = centered / size
    spread = np.linalg.eigvalsh(scaled.T @ scaled)
    # Twelve digits of a square are six of a width: single-precision coordinates of
    # a line are rounded by a tenth of that.
    if spread[1] <= 1e-12 * spread[2]:
        raise InputError(
            f"expected points that span a plane, got {len(centered)} on one line"
        )


def _about(settings, center, points):
    """Return the settings with their positions relative to `center`, checked."""
    viewpoint, reference = settings.viewpoint, settings.reference
    if viewpoint is not None:
        viewpoint = np.asarray(viewpoint, dtype=np.float64) - center
    if reference is not None:
        reference = reference_normals(reference, points)
    return replace(settings, viewpoint=viewpoint, reference=reference)


def _of_rows(settings, rows):
    """Return the settings for some of the points."""
    viewpoint, reference = settings.viewpoint, settings.reference
    if viewpoint is not None and np.ndim(viewpoint) == 2:
        viewpoint = viewpoint[rows]
    if reference is not None:
        reference = reference[rows]
    return replace(settings, viewpoint=viewpoint, reference=reference)
