# SPDX-License-Identifier: GPL-3.0-or-later
"""From points to normals: settings, neighborhoods, patches, signs."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from .faces import fan_width, mean_edge, vertex_normals
from .graph import NearestNeighbors, NeighborGraph
from .inputs import (
    BoolArray,
    FloatArray,
    InputError,
    IntArray,
    as_choice,
    as_faces,
    as_normals,
    as_points,
)
from .orientation import MODES, find_orientation
from .patch import BIQUADRATIC, CUBIC, LEAST_NEIGHBORS, Patches, fit_patches
from .scale import choose_scale
from .sheets import separate, suspects
from .timescale import WEIGHTS

PATCHES = {"biquadratic": BIQUADRATIC, "cubic": CUBIC}

METHODS = ("auto", "time_scale", "paper")
GRAPHS = ("auto", "nearest", "delaunay", "mesh")

# Points whose patches are fitted in one go: their arrays stay in the cache.
_CHUNK = 4096

# Up to here the fits run in double precision; beyond, their time counts and the
# spacing of so many points leaves rounding in single precision far below the error
# of the patch.
_DOUBLE_UP_TO = 200_000

# Neighbors of `time_scale` when none are asked for: near twice the unknowns.
_NEIGHBORS = 16

# Neighbors from which on all terms up to degree three are fitted.
_CUBIC_FROM = 12

# A mesh is noisy when its vertices stray from patches by this share of an edge: clean
# ones, decimated ones too, stay below half of it. Then patches reach over three rings.
_NOISY = 0.15
_WIDER = {"neighbors": 30, "patch": "biquadratic"}

# Of a mesh's patch, see `_with_faces`.
_WELL_FITTED, _WIDE_FAN = 0.1, 0.5

# Share of the progress that is the estimate's; the rest is the orientation's.
_FITTED = 0.8


def _setting(default, doc, *, choices=None, limits=None):
    return field(
        default=default, metadata={"doc": doc, "choices": choices, "limits": limits}
    )


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How normals are estimated. Every field has a default that works.

    Raises
    ------
    InputError
        When a value is not among the choices or outside its limits.
    """

    method: str = _setting(
        "auto",
        "auto chooses scale and weights from the data, time_scale fits a patch to a "
        "fixed number of neighbors, paper is Table 1 of the paper to the letter",
        choices=METHODS,
    )
    neighbors: int | None = _setting(
        None, "Neighbors of each point; None chooses", limits=(LEAST_NEIGHBORS, 1000)
    )
    radius: float | None = _setting(
        None, "Largest distance of a neighbor, in object units", limits=(0.0, None)
    )
    graph: str = _setting(
        "auto",
        "Who is a neighbor: the nearest points, Delaunay edges, or mesh edges",
        choices=GRAPHS,
    )
    patch: str = _setting(
        "auto",
        "Terms of a patch: biquadratic are those of the paper, cubic all up to "
        "degree three",
        choices=("auto", *PATCHES),
    )
    weights: str = _setting(
        "second_order",
        "Weights of the diamond derivative; method paper has the paper's",
        choices=WEIGHTS,
    )
    sheets: bool = _setting(
        True,
        "Tell neighbors apart where they lie on several sheets or beyond a crease; "
        "method paper does not",
        choices=(True, False),
    )
    orientation: str = _setting(
        "auto", "How the sides of the normals are found", choices=MODES
    )
    viewpoint: object = _setting(
        None, "Where normals should face with orientation viewpoint: (3,) or (n, 3)"
    )
    reference: object = _setting(
        None, "Normals to agree with under orientation reference: (n, 3)"
    )
    threads: int | None = _setting(
        None, "Threads at work; None takes all cores", limits=(1, 1024)
    )

    def __post_init__(self):
        for item in fields(self):
            value = getattr(self, item.name)
            if item.metadata["choices"] is not None:
                as_choice(value, item.metadata["choices"], name=item.name)
            elif value is not None and item.metadata["limits"] is not None:
                _check_limits(item.name, value, *item.metadata["limits"])
        for name in ("neighbors", "threads"):
            value = getattr(self, name)
            if value is not None and int(value) != value:
                raise InputError(f"expected {name} to be a whole number, got {value}")


def _check_limits(name, value, low, high):
    try:
        inside = low <= value and (high is None or value <= high)
    except TypeError:
        inside = False
    if not inside or (low == 0.0 and value == 0):
        span = f"above {low:g}" if high is None else f"from {low:g} to {high:g}"
        raise InputError(f"expected {name} {span}, got {value!r}")


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
    pieces : int
        Pieces that were oriented each on its own; 0 where no pieces were looked for.
    """

    normals: FloatArray
    valid: BoolArray
    settings: Settings
    condition: FloatArray | None = None
    from_faces: int = 0
    separated: int = 0
    noise: float = 0.0
    pieces: int = 0

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
            "orientation": self.settings.orientation,
            "pieces": self.pieces,
        }


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
    fitted with Eq. (2); the normal is the cross product of the diamond derivatives
    of the patch. Points that share a place count once and get the same normal.
    """
    settings = settings or Settings()
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
    settings = _about(settings, center, len(points))
    if settings.method == "paper":
        settings = replace(settings, weights="paper", sheets=False)
    report = progress or _silent
    report(0.0)
    kept, inverse = unique_points(centered) if faces is None else (None, None)
    if kept is None or inverse is None:
        return _estimate(centered, faces, settings, report)
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
    )


def _silent(_share):
    """Report progress to nobody."""


def unique_points(
    points: FloatArray,
) -> tuple[IntArray | None, IntArray | None]:
    """Find points that share a place.

    Returns
    -------
    kept : (u,) int or None
        One point of each place, increasing.
    inverse : (n,) int or None
        Which of the kept ones each point is; None for both where all differ.
    """
    # Sorting one hash a point is many times faster than sorting the points: most
    # clouds hold no twins, and this is all they pay.
    bits = (points + 0.0).view(np.uint64)
    factors = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9])
    mixed = (bits ^ (bits >> np.uint64(29))) * factors.astype(np.uint64)
    key = mixed[:, 0] ^ (mixed[:, 1] >> np.uint64(7)) ^ (mixed[:, 2] << np.uint64(9))
    key = np.sort(key)
    if not (key[1:] == key[:-1]).any():
        return None, None
    _, first, inverse = np.unique(
        points, axis=0, return_index=True, return_inverse=True
    )
    if len(first) == len(points):
        return None, None
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[inverse.ravel()]


def neighborhoods(
    points: FloatArray, faces: IntArray | None, settings: Settings
) -> "tuple[Nearest | Rings, Settings]":
    """Return who is whose neighbor, and how many, as the settings ask.

    Parameters
    ----------
    points : (n, 3) float64, centered, all different where there are no faces
    faces : (m, 3) int or None
    settings : Settings

    Returns
    -------
    source : Nearest or Rings
        `source.fit(rows)` gives the Patches of points; `source.chunks()` the rows
        in an order and number that is good for memory.
    settings : Settings
        As used: what "auto" and None became.
    """
    graph = settings.graph
    if graph == "auto":
        alone = "delaunay" if settings.method == "paper" else "nearest"
        graph = alone if faces is None else "mesh"
    if graph == "mesh" and faces is None:
        raise InputError('expected faces for graph "mesh", got points alone')
    if graph != "nearest":
        settings = replace(settings, graph=graph, **_fixed(settings))
        return Rings(points, faces, settings), settings
    nearest = NearestNeighbors(points)
    if settings.method == "auto" and settings.neighbors is None:
        patch, count = choose_scale(nearest)
        patch = patch if settings.patch == "auto" else settings.patch
        settings = replace(settings, neighbors=count, patch=patch)
    fixed = _fixed(settings)
    fixed["neighbors"] = min(fixed["neighbors"], len(points) - 1)
    settings = replace(settings, graph=graph, **fixed)
    return Nearest(nearest, settings), settings


def _fixed(settings):
    """Return neighbors and patch as asked for, or good ones without a look."""
    paper = settings.method == "paper"
    count = settings.neighbors or (LEAST_NEIGHBORS if paper else _NEIGHBORS)
    patch = settings.patch
    if patch == "auto":
        # Nine unknowns want a few neighbors more than nine.
        patch = "biquadratic" if paper or count < _CUBIC_FROM else "cubic"
    return {"neighbors": count, "patch": patch}


class _Source:
    """Patches of points, whatever their neighborhoods come from.

    A subclass has `chunks()`, and `_offsets(rows)` that returns what `fit_patches`
    takes.
    """

    def __init__(self, points, settings):
        self.points = points
        self.settings = settings
        self.paper = settings.method == "paper"
        many = len(points) > _DOUBLE_UP_TO and not self.paper
        self.dtype = np.float32 if many else np.float64

    def _offsets(self, rows):
        raise NotImplementedError

    def fit(self, rows: IntArray) -> Patches:
        """Return the Patches of the given (m,) points."""
        offsets, reach = self._offsets(rows)
        return fit_patches(
            offsets,
            reach,
            terms=PATCHES[self.settings.patch],
            chart="global" if self.paper else "principal",
        )

    def _scaled(self, offsets, reach):
        offsets *= 1 / np.where(reach > 0, reach, 1)
        return offsets.astype(self.dtype, copy=False)


class Nearest(_Source):
    """Patches over nearest points."""

    def __init__(self, nearest, settings):
        super().__init__(nearest.points, settings)
        self.nearest = nearest
        # Coordinates in the order of the tree's leaves, each axis on its own: a
        # chunk gathers from memory that is close together.
        self.sorted = np.ascontiguousarray(self.points[nearest.order].T)
        self.rank = nearest.rank

    def chunks(self) -> list[IntArray]:
        """Return the rows chunk by chunk, leaf by leaf."""
        order = self.nearest.order
        return [order[at : at + _CHUNK] for at in range(0, len(order), _CHUNK)]

    def _offsets(self, rows):
        index, distance = self.nearest.neighbors(
            rows, self.settings.neighbors, radius=self.settings.radius
        )
        at, here = self.rank[index.T], self.rank[rows]
        offsets = np.empty((3, *at.shape))
        for axis in range(3):
            np.take(self.sorted[axis], at, out=offsets[axis])
            offsets[axis] -= self.sorted[axis][here]
        reach = distance.max(axis=1)
        return self._scaled(offsets, reach), reach


class Rings(_Source):
    """Patches over the rings of a graph: Delaunay edges or mesh edges."""

    def __init__(self, points, faces, settings):
        super().__init__(points, settings)
        if settings.graph == "mesh":
            graph = NeighborGraph.mesh(len(points), faces)
        else:
            graph = NeighborGraph.delaunay(points)
        self.graph = graph.extended(settings.neighbors)

    def chunks(self) -> list[IntArray]:
        """Return the rows chunk by chunk, those of like degree together."""
        degrees = self.graph.degrees
        order = np.argsort(degrees, kind="stable")
        # A rectangle is as wide as its last row is long.
        size = np.cumsum(np.maximum(degrees[order], 1))
        cuts = np.searchsorted(size, np.arange(1, size[-1], _CHUNK * _NEIGHBORS))[1:]
        return [rows for rows in np.split(order, cuts) if len(rows)]

    def _offsets(self, rows):
        at = self.graph.neighbors(rows).T
        offsets = np.stack(
            [axis[at] - axis[rows] for axis in np.ascontiguousarray(self.points.T)]
        )
        distance = np.sqrt((offsets * offsets).sum(axis=0))
        if self.settings.radius is not None:
            offsets *= distance <= self.settings.radius
            distance *= distance <= self.settings.radius
        reach = distance.max(axis=0, initial=0)
        return self._scaled(offsets, reach), reach


def _estimate(points, faces, settings, report):
    """Estimate and orient the normals of centered points that differ."""
    asked = settings
    source, settings = neighborhoods(points, faces, asked)
    fitted = _fit(source, report)
    if _wants_wider(points, faces, fitted, asked):
        source, settings = neighborhoods(points, faces, replace(asked, **_WIDER))
        fitted = _fit(source, report)
    normals, valid = fitted.normals, fitted.valid
    separated = from_faces = 0
    if settings.sheets and isinstance(source, Nearest):
        normals, separated = _with_sheets(source, fitted)
    if faces is not None:
        normals, valid, from_faces = _with_faces(points, faces, fitted, settings)
    orientation = find_orientation(
        points,
        normals,
        mode=settings.orientation,
        faces=faces,
        viewpoint=settings.viewpoint,
        reference=settings.reference,
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
        orientation.pieces,
    )


@dataclass(frozen=True)
class _Fitted:
    """What the patches of all points say: see Estimate and Patches, rows (n,)."""

    normals: FloatArray
    valid: BoolArray
    misfit: FloatArray
    noise: float
    condition: FloatArray | None


def _fit(source, report):
    """Return the _Fitted of all points of a source."""
    n = len(source.points)
    normals, valid = np.zeros((n, 3)), np.zeros(n, dtype=bool)
    misfit, noise = np.zeros((2, n), dtype=np.float32)
    condition = np.full(n, np.inf) if source.paper else None

    def work(rows):
        patches = source.fit(rows)
        normals[rows] = patches.normals(weights=source.settings.weights)
        valid[rows] = patches.valid
        misfit[rows] = patches.misfit
        noise[rows] = patches.noise
        if condition is not None:
            condition[rows] = patches.condition

    chunks = source.chunks()
    for done in _in_threads(work, chunks, source.settings.threads):
        report(_FITTED * done / len(chunks))
    middle = float(np.median(noise[valid])) if valid.any() else 0.0
    return _Fitted(normals, valid, misfit, middle, condition)


def _with_sheets(source, fitted):
    """Return normals made from each point's own sheet, and for how many."""
    rows, noise = suspects(fitted.misfit, fitted.valid)
    if not len(rows):
        return fitted.normals, 0

    def run(work, chunks):
        for _ in _in_threads(work, chunks, source.settings.threads):
            pass

    normals = separate(
        source.nearest, fitted.normals, fitted.misfit, rows, noise, run=run
    )
    return normals, len(rows)


def _in_threads(work, items, threads):
    """Call work(item) for every item and yield how many are done, in this thread.

    The items say what is computed together, never the number of threads: results do
    not depend on it.
    """
    threads = min(threads or os.cpu_count() or 1, len(items))
    if threads == 1:
        for done, item in enumerate(items, 1):
            work(item)
            yield done
        return
    pool = ThreadPoolExecutor(threads)
    try:
        futures = [pool.submit(work, item) for item in items]
        for done, future in enumerate(futures, 1):
            future.result()
            yield done
    finally:
        # Reached with work left when the caller was cancelled: drop what waits.
        pool.shutdown(cancel_futures=True)


def _with_faces(points, faces, fitted, settings):
    """Let the faces speak where a patch has too little to say.

    Vertices without a valid patch take the mean of their faces' normals, weighted by
    angle. Method "auto" also takes it where the patch is not clearly better founded:
    where it misses the vertices by more than a tenth of what the faces turn, or the
    faces turn by more than half a right angle or so, as at creases and on coarse
    meshes. Under noise the faces are no guide, and patches stand.
    """
    guide = vertex_normals(points, faces, weights="angle")
    has_face = (guide != 0).any(axis=1)
    doubtful = ~fitted.valid
    if settings.method == "auto" and not _is_noisy(points, faces, fitted):
        width = fan_width(points, faces, guide)
        doubtful |= (fitted.misfit > _WELL_FITTED * width) | (width > _WIDE_FAN)
    replaced = doubtful & has_face
    normals = np.where(replaced[:, None], guide, fitted.normals)
    return normals, fitted.valid | replaced, int(replaced.sum())


def _wants_wider(points, faces, fitted, asked):
    """Whether a noisy mesh was fitted with neighbors that nobody asked for."""
    automatic = asked.method == "auto" and asked.neighbors is None
    return faces is not None and automatic and _is_noisy(points, faces, fitted)


def _is_noisy(points, faces, fitted):
    """Whether the vertices of a mesh stray far from smooth patches through them."""
    return fitted.noise > _NOISY * mean_edge(points, faces)


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


def _about(settings, center, count):
    """Return the settings with their positions relative to `center`, checked."""
    viewpoint, reference = settings.viewpoint, settings.reference
    if viewpoint is not None:
        viewpoint = np.asarray(viewpoint, dtype=np.float64) - center
    if reference is not None:
        reference = as_normals(reference, count, name="reference normals")
    return replace(settings, viewpoint=viewpoint, reference=reference)


def _of_rows(settings, rows):
    """Return the settings for some of the points."""
    viewpoint, reference = settings.viewpoint, settings.reference
    if viewpoint is not None and np.ndim(viewpoint) == 2:
        viewpoint = viewpoint[rows]
    if reference is not None:
        reference = reference[rows]
    return replace(settings, viewpoint=viewpoint, reference=reference)
