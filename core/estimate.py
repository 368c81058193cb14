# SPDX-License-Identifier: GPL-3.0-or-later
"""From points to normals: patches, sheets, faces, signs."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from .fields import from_patches
from .inputs import (
    BoolArray,
    FloatArray,
    InputError,
    IntArray,
    as_faces,
    as_points,
    centered_parts,
    check_size,
    extent_of,
)
from .mesh.creases import parting_edges
from .mesh.faces import fan_means, split_fans
from .mesh.meshes import MeshNormals
from .neighborhoods import Nearest, neighborhoods_of_all, unique_points
from .orient.guides import reference_normals
from .orient.orientation import (
    Orientation,
    find_orientation,
    sides_of_mesh,
    with_disagreement,
)
from .orient.winding import (
    Winding,
    count_inconsistent,
    find_flipped_faces,
    wound_alike,
)
from .patches.patch import LEAST_NEIGHBORS, Patches
from .progress import Progress, between, silent
from .settings import Settings
from .surface import GridSurface
from .threads import hold_memory

# Where the progress stands when neighbors are found, and when patches are fitted; the
# rest is the orientation's.
_FOUND, _FITTED = 0.1, 0.7


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
        Vertices whose normal is a mean of those of faces, at the vertex or beyond.
    mesh : MeshNormals or None
        What a mesh showed of itself, parted where edges part it.
    separated : int
        Points whose neighbors were told apart because they lie on several sheets.
    noise : float
        Of the points, a standard deviation in object units: what the residuals say,
        the median over all patches; of a mesh by method "auto" what it shows itself.
    confidence : (n,) float32
        How far each normal is to be trusted, 0 to 1: 1 / (1 + e^2 / 100), e being the
        root mean square error expected of points like it, in degrees; of a mesh's
        vertex how far its faces turn from the normal. Zero where not valid.
    scale : (n,) float32
        The reach of the patches that the normal is made from, in object units; of a
        mesh's vertex the length of its longest edge.
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
    confidence: FloatArray | None = None
    scale: FloatArray | None = None
    orientation: Orientation | None = None
    winding: Winding | None = None
    mesh: MeshNormals | None = None
    _fans: tuple[FloatArray, IntArray] | None = field(default=None, repr=False)
    _input: tuple[FloatArray, IntArray | None] | None = field(default=None, repr=False)

    @property
    def corner_normals(self) -> FloatArray | None:
        """(m, 3, 3) float64, the normals at the corners of the faces; None without.

        Those of the vertices but where edges part the mesh; zero where not valid.
        """
        if self._fans is not None:
            normals, fans = self._fans
            return normals[fans]
        if self._input is None or self._input[1] is None:
            return None
        return self.normals[self._input[1]]

    def patches(self, rows: ArrayLike) -> Patches:
        """Return the patches of some points, fitted again as they were.

        Before points are told apart by sheets, patches of other sizes are blended in
        and faces have their say.

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
            "mesh": None if self.mesh is None else self.mesh.kind,
            "smoothed": 0 if self.mesh is None else self.mesh.smoothed,
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
    sharp: ArrayLike | None = None,
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Estimate the unit normals of a surface from points on it.

    Parameters
    ----------
    points : (n, 3) array_like of float
        Any scale and offset.
    faces : (m, 3) array_like of int, optional
        Triangles of a mesh over the points.
    sharp : (e, 2) array_like of int, optional
        Edges that part the mesh, in addition to those of `Settings.sharp_angle`:
        `Estimate.corner_normals` are made from one side each.
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
    if faces is not None:
        return _of_mesh(points, faces, sharp, asked, progress or silent)
    if len(points) <= LEAST_NEIGHBORS:
        raise InputError(
            f"expected at least {LEAST_NEIGHBORS + 1} points, one and the "
            f"{LEAST_NEIGHBORS} neighbors that a patch needs, got {len(points)}"
        )
    extent = extent_of(points)
    _check_spread(points, extent)
    center = extent.center
    settings = _about(asked, center, points)
    if settings.method == "paper":
        settings = replace(settings, weights="paper", sheets=False)
    report = progress or silent
    report(0.0)
    hold_memory()
    kept, inverse = unique_points(points, center)
    if kept is None or inverse is None:
        estimate = _estimate(points, None, settings, report, center=center)
        return replace(
            estimate, settings=_as_asked(estimate, asked), _input=(points, None)
        )
    if len(kept) <= LEAST_NEIGHBORS:
        raise InputError(
            f"expected at least {LEAST_NEIGHBORS + 1} places for a patch, got "
            f"{len(points)} points in {len(kept)} places"
        )
    settings = _of_rows(settings, kept)
    estimate = _estimate(points[kept], None, settings, report, center=center)
    return replace(
        estimate,
        normals=estimate.normals[inverse],
        valid=estimate.valid[inverse],
        condition=None if estimate.condition is None else estimate.condition[inverse],
        confidence=estimate.confidence[inverse],
        scale=estimate.scale[inverse],
        orientation=_of_places(estimate.orientation, inverse),
        settings=_as_asked(estimate, asked),
        _input=(points, None),
    )


def _of_mesh(points, faces, sharp, asked, report):
    """Estimate the normals of a mesh, parted at sharp edges."""
    winding, alike = _wound_alike(points, faces, asked)
    edges = parting_edges(points, alike, asked.sharp_angle, sharp)
    if not len(edges):
        estimate = _of_whole_mesh(points, alike, asked, report)
        estimate = replace(estimate, _input=(points, faces))
    else:
        fans, vertex = split_fans(len(points), alike, edges)
        parted = _of_whole_mesh(points[vertex], fans, _of_rows(asked, vertex), report)
        if alike is not faces:
            # Each corner where the caller has it.
            turned = (alike != faces).any(axis=1)
            fans = np.where(turned[:, None], fans[:, ::-1], fans)
        estimate = _joined(parted, points, vertex, fans)
    orientation = estimate.orientation
    if orientation.mode == "faces" and winding is None:
        orientation = with_disagreement(orientation, faces, len(points))
    return replace(
        estimate,
        settings=_as_asked(estimate, asked),
        orientation=orientation,
        winding=winding,
    )


def _wound_alike(points, faces, asked):
    """Return the Winding where the caller wants it, and faces that wind alike.

    Method "auto" sums what faces say, which makes sense only where they wind alike:
    pieces that do not are taken as if they did.
    """
    if asked.winding == "repaired":
        winding = find_flipped_faces(points, faces, nested=asked.nested)
        return winding, winding.repaired(faces)
    if asked.method != "auto" or not count_inconsistent(faces, len(points)):
        return None, faces
    return None, wound_alike(points, faces, nested=asked.nested)


def _joined(parted, points, vertex, fans):
    """Return the Estimate of a mesh from that of its fans."""
    count = len(points)
    normals = fan_means(parted.normals, vertex, count)
    # The first fans are those of the vertices.
    return replace(
        parted,
        normals=normals,
        valid=(normals != 0).any(axis=1),
        condition=None if parted.condition is None else parted.condition[:count],
        confidence=parted.confidence[:count],
        scale=parted.scale[:count],
        orientation=_of_places(parted.orientation, slice(count)),
        _fans=(parted.normals, fans),
        _input=(points[vertex], fans),
    )


def _of_whole_mesh(points, faces, asked, report):
    """Estimate the normals of a mesh that nothing parts."""
    extent = extent_of(points)
    _check_spread(points, extent)
    center = extent.mean
    settings = _about(asked, center, points)
    if settings.method == "paper":
        settings = replace(settings, weights="paper", sheets=False)
    report(0.0)
    return _estimate(points - center, faces, settings, report)


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


def _estimate(points, faces, settings, report, *, center=None):
    """Estimate and orient the normals of points that differ, less their center."""
    told = between(report, _FOUND, _FITTED)
    found, source = from_patches(points, faces, settings, told, center=center)
    settings, mesh, normals = found.settings, found.mesh, found.field.normals
    report(_FITTED)
    told = between(report, _FITTED, 1.0)
    orientation = _sides(points, normals, faces, settings, source, told)
    report(1.0)
    # The order of so many points takes memory that the rest of the result needs.
    del source
    if mesh is not None:
        normals = normals * orientation.signs[:, None]
    elif orientation.mode != "none":
        # Nobody else has these: no second copy of so many.
        normals *= orientation.signs[:, None]
    confidence = found.field.confidence
    confidence[~found.valid] = 0
    return Estimate(
        normals,
        found.valid,
        replace(settings, orientation=orientation.mode),
        found.condition,
        0 if mesh is None else mesh.from_faces,
        found.separated,
        found.noise,
        confidence,
        found.field.scale,
        orientation,
        mesh=mesh,
    )


def _sides(points, normals, faces, settings, source, progress):
    """Return the Orientation of normals."""
    by_faces = faces is not None and settings.orientation in ("auto", "faces")
    if settings.method == "auto" and by_faces:
        # Means and patches of a mesh are on the side of its faces as it is; under
        # noise the faces at a vertex alone are no guide.
        return sides_of_mesh(normals)
    return find_orientation(
        # Not even a centered copy is made where nobody looks at it.
        points if settings.orientation == "none" else source.points,
        normals,
        mode=settings.orientation,
        faces=faces,
        viewpoint=settings.viewpoint,
        reference=settings.reference,
        nested=settings.nested,
        threads=settings.threads,
        nearest=source.nearest if isinstance(source, Nearest) else None,
        progress=progress,
    )


def _check_spread(points, extent):
    """Raise InputError when all points are in one place or on one line."""
    size = extent.size
    if size == 0:
        raise InputError(f"expected points that differ, got {len(points)} in one place")
    check_size(size)
    scaled = (part / size for part in centered_parts(points, extent.mean))
    spread = np.linalg.eigvalsh(sum(part.T @ part for part in scaled))
    # Twelve digits of a square are six of a width: single-precision coordinates of
    # a line are rounded by a tenth of that.
    if spread[1] <= 1e-12 * spread[2]:
        raise InputError(
            f"expected points that span a plane, got {len(points)} on one line"
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
