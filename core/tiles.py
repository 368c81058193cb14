# SPDX-License-Identifier: GPL-3.0-or-later
"""Clouds in tiles: each with as much around it as its normals depend on.

A tile is a box of space with the points in it, its *own*, and those within a margin
around it, its *halo*. What is chosen for a cloud is chosen once, by points from all
over it. A normal is exact, the same as from the whole cloud, where all points that it
depends on are known; how far that reaches is known once it is computed.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .auto.blend import (
    VOTERS,
    Exact,
    Field,
    Noisy,
    blend,
    error_of_misfit,
    is_noisy,
    points_of_block,
)
from .auto.coarse import halvings, noise_in_spacings
from .auto.ladder import EXACT, NOISY
from .fields import is_automatic
from .inputs import BoolArray, FloatArray, InputError, IntArray
from .neighborhoods import Nearest, of_nearest, unique_points
from .neighbors.graph import NearestNeighbors
from .orient.orientation import Orientation, find_orientation
from .patches.asked import MOST, Asked
from .patches.fitted import fit_all
from .patches.patch import LEAST_NEIGHBORS
from .patches.scale import patches_of
from .patches.sheets import CANDIDATES, STAGES, counts_of_steps, separate, suspects
from .progress import silent
from .settings import PATCHES, Settings
from .threads import in_threads

# How the sides of the normals of tiles can be found.
ORIENTATIONS = ("auto", "poles", "propagate", "outward", "viewpoint", "none")
_LOCAL = ("viewpoint", "none")

# A halo is so many neighborhoods wide, as most points have them: what is told apart by
# sheets depends on neighbors of neighbors, five times over. Nothing is told apart in
# noise, but there patches have more neighbors, and normals vote.
_WIDTHS, _WIDTHS_NOISY = 6, 2

# Points of a part of the cloud that is looked at, and how many of it are asked.
PART, _OF_PART = MOST + 278, 4

# Neighbors that each round of blending takes, the first fits and the second votes.
_ROUNDS = (max(EXACT), VOTERS["exact"] - 1)

# Guides that a normal takes its side from.
_GUIDES = 6
_CHUNK = 100_000


@dataclass(frozen=True)
class Plan:
    """What is decided once for a whole cloud.

    Attributes
    ----------
    settings : Settings
        With kind and size of the patches.
    count : int
        The points of the cloud.
    blended : bool
        Whether size and kind are left to the data, point by point.
    level, noise : float
        See `coarse.noise_in_spacings`; level is zero where the points are exact.
    misfit : float
        Of most points, as an angle: see `sheets.suspects`.
    margin : float
        A halo as wide as most points need.
    """

    settings: Settings
    count: int
    blended: bool
    level: float
    noise: float
    misfit: float
    margin: float

    @property
    def block(self) -> float:
        """How many points a block has at least: see `points_of_block`."""
        return points_of_block(self.settings.neighbors or 0, self.settings.patch)

    @property
    def halvings(self) -> int | None:
        """How often the cloud is halved to blocks; None where each point is one."""
        return halvings(self.count, self.level, self.block)


@dataclass(frozen=True)
class Tile:
    """What is known of the m own points of a tile.

    Attributes
    ----------
    normals : (m, 3) float64
        Unit, whatever their side; zero where not valid.
    valid : (m,) bool
    exact : (m,) bool
        Whether all that the normal depends on was known.
    """

    normals: FloatArray
    valid: BoolArray
    exact: BoolArray


def asked_of_parts(parts: list[FloatArray], count: int) -> Asked:
    """Return the points that are asked, from parts of a cloud.

    Parameters
    ----------
    parts : list of (p, 3) float64
        Each all that is around its first point, nearest first.
    count : int
        The points of the cloud.
    """
    most = min(MOST, count - 1)
    found = []
    for given in parts:
        kept, _ = unique_points(given)
        part = given if kept is None else given[kept]
        for row in range(min(_OF_PART, len(part) - 1)):
            offsets = np.delete(part, row, axis=0) - part[row]
            order = np.argsort((offsets * offsets).sum(axis=1))[:most]
            # Few points that differ: the farthest stands in for those that lack.
            order = np.pad(order, (0, most - len(order)), mode="edge")
            found.append(offsets[order])
    if not found:
        raise InputError("expected points that differ, got all in one place")
    offsets = np.ascontiguousarray(np.stack(found).T)
    return Asked(count, lambda _count: offsets)


def plan_of(asked: Asked, settings: Settings) -> Plan:
    """Choose for a whole cloud what "auto" and None stand for.

    Raises
    ------
    InputError
        When the settings ask for what only a whole cloud has.
    """
    if settings.method == "paper" or settings.graph not in ("auto", "nearest"):
        raise InputError(
            "expected nearest points as neighbors for a cloud in tiles, got "
            f"method {settings.method} with graph {settings.graph}"
        )
    if settings.orientation not in ORIENTATIONS:
        raise InputError(
            f"expected orientation to be one of {ORIENTATIONS} for a cloud in tiles, "
            f"got {settings.orientation!r}"
        )
    blended = is_automatic(settings, asked.count)
    settings = of_nearest(settings, asked)
    count = settings.neighbors or 0
    level, noise = noise_in_spacings(asked) if blended else (0.0, 0.0)
    level = level if is_noisy(level, count) else 0.0
    patches = patches_of(asked, count, PATCHES[settings.patch])
    misfit = suspects(patches.misfit, patches.valid)[1]
    if level:
        times = halvings(asked.count, level, points_of_block(count, settings.patch))
        block = 1.0 if times is None else asked.count / 2**times
        margin = _WIDTHS_NOISY * _reach(asked, max(NOISY) * block)
    else:
        margin = _WIDTHS * _reach(asked, max(count, CANDIDATES))
    margin = max(margin, settings.radius or 0.0)
    return Plan(settings, asked.count, blended, level, noise, misfit, margin)


def _reach(asked, count):
    """Return the distance of the neighbor of that number, of most points."""
    known = min(count, MOST, asked.count - 1)
    return float(np.median(asked.around(int(known))[1]) * np.sqrt(count / known))


def misfit_counts(
    points: FloatArray, own: int, depth: FloatArray, plan: Plan
) -> IntArray:
    """Return `sheets.counts_of_steps` of the own points of a tile.

    Takes what `fit_tile` takes, whatever the depth.
    """
    del depth
    kept, inverse = unique_points(points)
    places = points if kept is None else points[kept]
    # Points that share a place count once.
    mine = np.arange(own) if inverse is None else np.unique(inverse[:own])
    if len(places) <= (plan.settings.neighbors or 0):
        return counts_of_steps(np.empty(0))
    fitted = fit_all(_source(places, plan), silent)
    return counts_of_steps(fitted.misfit[mine][fitted.valid[mine]])


def fit_tile(points: FloatArray, own: int, depth: FloatArray, plan: Plan) -> Tile:
    """Estimate the normals of a tile of exact points: a pure function.

    Parameters
    ----------
    points : (n, 3) float64
        The own points, and behind them the halo, in the coordinates of the whole
        cloud less one place that is the same for all tiles.
    own : int
        How many are own.
    depth : (n,) float64
        How far around each point all points of the cloud are given.
    plan : Plan
    """
    kept, inverse = unique_points(points)
    places = points if kept is None else points[kept]
    back = slice(own) if inverse is None else inverse[:own]
    if len(places) <= LEAST_NEIGHBORS:
        lost = np.zeros(own, dtype=bool)
        return Tile(np.zeros((own, 3)), lost, np.isinf(depth[:own]))
    settings, blended = plan.settings, plan.blended
    few = len(places) <= max(settings.neighbors or 0, max(EXACT) if blended else 0)
    if few:
        fewer = min(settings.neighbors or 0, len(places) - 1)
        settings, blended = replace(settings, neighbors=fewer), False
    source = _source(places, replace(plan, settings=settings))
    nearest, fitted, run = source.nearest, fit_all(source, silent), _runner(settings)
    normals = fitted.normals
    rows = suspects(fitted.misfit, fitted.valid, plan.misfit)[0]
    rows = rows if settings.sheets else rows[:0]
    if len(rows):
        normals = separate(nearest, normals, fitted.misfit, rows, plan.misfit, run=run)
    needed = fitted.reach if settings.radius is None else settings.radius
    needed = np.inf if few else needed
    depth = depth if kept is None else depth[kept]
    exact = _known(needed, depth)
    if len(rows):
        exact = _exact_after(nearest, exact, depth, rows, (CANDIDATES,) * STAGES)
    if blended:
        field = Field(normals, error_of_misfit(fitted.misfit), fitted.reach)
        cloud = Exact(nearest, field, fitted.normals, fitted.misfit, plan.misfit)
        normals = blend(cloud, run).normals
        exact = _exact_after(nearest, exact, depth, cloud.rows, _ROUNDS)
    return Tile(normals[back], fitted.valid[back], exact[back])


def _source(places, plan):
    nearest = NearestNeighbors(places, threads=plan.settings.threads, cloud=plan.count)
    return Nearest(nearest, plan.settings)


def _runner(settings):
    """Return a function that calls work(chunk) for all chunks, in threads."""

    def run(work, chunks):
        for _ in in_threads(work, chunks, settings.threads):
            pass

    return run


def _known(needed, depth):
    """Return where all that is needed is given, with room for rounding."""
    return np.asarray(needed) * (1 + 1e-6) <= depth


def _exact_after(nearest, exact, depth, rows, rounds):
    """Return which normals are exact after rounds over neighbors.

    In every round the normal of a row is made again from its neighbors, so many of
    them, as the round before left them.
    """
    most = min(max(rounds), len(nearest.points) - 1)
    index = np.empty((len(rows), most), dtype=np.int32)
    distance = np.empty((len(rows), most))
    for at in range(0, len(rows), _CHUNK):
        part = slice(at, at + _CHUNK)
        index[part], distance[part] = nearest.neighbors(rows[part], most)
    for count in rounds:
        needed = distance[:, count - 1] if count <= most else np.inf
        known = _known(needed, depth[rows])
        after = exact.copy()
        after[rows] = exact[rows] & known & exact[index[:, :count]].all(axis=1)
        exact = after
    return exact


def fit_noisy_tile(
    points: FloatArray,
    depth: FloatArray,
    blocks: FloatArray,
    around: FloatArray,
    plan: Plan,
) -> Tile:
    """Estimate the normals of a tile of a cloud with noise: a pure function.

    Parameters
    ----------
    points : (m, 3) float64
        The own points, in the coordinates of `fit_tile`.
    depth : (m,) float64
        How far around each of them all blocks are given.
    blocks : (b, 3) float64
        The means of blocks of points, of the tile and around.
    around : (b,) float64
        How far around each mean all of them are given.
    plan : Plan
    """
    exact = np.zeros(len(points), dtype=bool)
    if len(blocks) <= max(NOISY):
        return Tile(np.zeros((len(points), 3)), exact, exact)
    threads = plan.settings.threads
    coarse = NearestNeighbors(blocks, threads=threads, cloud=plan.count)
    nearest = NearestNeighbors(points, threads=threads, cloud=plan.count)
    run = _runner(plan.settings)
    field = blend(Noisy(nearest, plan.level, plan.noise, coarse=coarse), run)
    first = _known(_reach_of(coarse, max(NOISY)), around)
    for at in range(0, len(points), _CHUNK):
        part = slice(at, at + _CHUNK)
        distance, index = coarse.tree.query(
            points[part], k=VOTERS["noisy"], workers=threads or -1
        )
        exact[part] = _known(distance[:, -1], depth[part]) & first[index].all(axis=1)
    return Tile(field.normals, (field.normals != 0).any(axis=1), exact)


def _reach_of(nearest, count):
    """Return the distance of the neighbor of that number, for all points."""
    reach = np.empty(len(nearest))
    for rows in nearest.runs(count):
        reach[rows] = nearest.neighbors(rows, count)[1][:, -1]
    return reach


def thinned(points: FloatArray, size: float) -> IntArray:
    """Return the first point in each filled cell of a grid, (m,) int, increasing.

    Parameters
    ----------
    points : (n, 3) float64
    size : float
        Side of the cells, which are those of space, the same for all tiles.
    """
    cell = np.floor(points / size).astype(np.int64)
    factors = np.array([73_856_093, 19_349_663, 83_492_791])
    # Two cells with one key cost a guide, and there are many.
    _, first = np.unique((cell * factors).sum(axis=1), return_index=True)
    return np.sort(first)


def orient_guides(
    points: FloatArray, normals: FloatArray, settings: Settings
) -> tuple[FloatArray, Orientation]:
    """Find the sides of a cloud's guides, its thinned points.

    Parameters
    ----------
    points, normals : (g, 3) float64
    settings : Settings

    Returns
    -------
    normals : (g, 3) float64, facing outward
    Orientation
    """
    found = find_orientation(
        points,
        normals,
        mode=settings.orientation,
        nested=settings.nested,
        threads=settings.threads,
    )
    return normals * found.signs[:, None], found


def facing(
    points: FloatArray,
    normals: FloatArray,
    settings: Settings,
    guides: tuple[FloatArray, FloatArray, FloatArray] | None,
) -> FloatArray:
    """Return normals turned to the sides of the guides around them, (n, 3).

    Parameters
    ----------
    points, normals : (n, 3) float64
    settings : Settings
        With the viewpoint in the coordinates of the points.
    guides : points (g, 3), outward normals (g, 3), confidence (g,), or None
        None where the mode of orientation needs none.
    """
    if settings.orientation in _LOCAL or guides is None:
        viewpoint: Any = settings.viewpoint
        found = find_orientation(
            points, normals, mode=settings.orientation, viewpoint=viewpoint
        )
        return normals * found.signs[:, None]
    place, outward, sure = guides
    tree = NearestNeighbors(place).tree
    signs = np.ones(len(points))
    count = min(_GUIDES, len(place))
    for at in range(0, len(points), _CHUNK):
        part = slice(at, at + _CHUNK)
        answer = tree.query(points[part], k=count, workers=settings.threads or -1)
        distance, index = (np.reshape(a, (-1, count)) for a in answer)
        far = np.maximum(distance[:, -1:], 1e-300)
        theirs = outward[index]
        offset = points[part][:, None] - place[index]
        height = np.einsum("mkc,mkc->mk", offset, theirs) / (0.35 * far)
        # As in `sides`: guides on another sheet stand above or below the point.
        weight = np.exp(-(height**2) - (distance / far) ** 2) * (0.05 + sure[index])
        agree = np.einsum("mkc,mc->mk", theirs, normals[part])
        signs[part] = np.where((weight * agree).sum(axis=1) < 0, -1, 1)
    return normals * signs[:, None]


def distance_to(points: FloatArray, others: FloatArray) -> FloatArray:
    """Return the distance of each point (n, 3) to the nearest of others, (n,)."""
    if not len(points):
        return np.empty(0)
    return np.asarray(NearestNeighbors(others).tree.query(points)[0])
