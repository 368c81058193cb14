# SPDX-License-Identifier: GPL-3.0-or-later
"""The outward side of every point of a cloud, from the poles of a part of it.

A cloud is made fit for `poles`: noise is smoothed away, what is dense is thinned, lone
points are left out. What the poles say of these *representatives* is mended where the
smooth surface around contradicts it, and taken back to all points.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ..inputs import FloatArray, IntArray
from ..neighbors.graph import NearestNeighbors
from ..progress import Progress, between, silent
from .hearing import Hearing
from .mending import Surface, mend
from .poles import label_poles
from .representatives import choose, measure
from .smoothing import reach_of_fits, smooth

# Representatives at most: the triangulation and what follows take some 30 microseconds
# for each.
_MOST = 30_000
# A tetrahedron and one point more.
_FEWEST = 5

# A point is lone when its neighbors are this many times farther than theirs are, and
# off the surface when its neighbors stand this steeply above or below it.
_LONE = 4.0
_STEEP = 0.25

# Where the progress stands when the cloud is made fit, and when the poles have spoken
# and been heard; within the first of these, when representatives are chosen.
_SMOOTHED, _HEARD = 0.3, 0.9
_CHOSEN = 0.5

Result = TypeVar("Result")
Other = TypeVar("Other")


@dataclass(frozen=True)
class Sides:
    """Signs of normals, and how sure they are.

    Attributes
    ----------
    signs : (n,) int8
    confidence : (n,) float64
        0 (a guess) to 1 (all evidence agrees).
    noise : float
        Standard deviation of the points about their surface, in object units; 0 where
        they were taken as they are.
    open : bool
        Whether the outside reaches both sides of the surface.
    piece : (n,) int
        The connected piece of each point, counted from 0.
    disagreeing : float
        Share of the neighbors on one smooth surface that face opposite sides.
    narrow : bool
        Whether sheets are so close that the representatives do not tell them apart.
    """

    signs: IntArray
    confidence: FloatArray
    noise: float
    open: bool
    piece: IntArray
    disagreeing: float
    narrow: bool


def find_sides(
    points: FloatArray,
    normals: FloatArray,
    *,
    nearest: NearestNeighbors | None = None,
    most: int = _MOST,
    workers: int = -1,
    progress: Progress = silent,
) -> Sides | None:
    """Find the signs that turn normals outward.

    Parameters
    ----------
    points : (n, 3) float64
    normals : (n, 3) float64, unit
    nearest : NearestNeighbors, optional
        Of the points, where there is one already.
    most : int
        About how many representatives are triangulated at most.
    workers : int
        Threads of the searches for neighbors; -1 takes all cores.
    progress : callable
        Called with the share done, 0 to 1, in the calling thread.

    Returns
    -------
    Sides, or None where the points have no tetrahedra: too few, or in a plane.
    """
    if len(points) < _FEWEST or _is_flat(points):
        return None
    nearest = nearest or NearestNeighbors(points)
    spacing, noise = measure(nearest, normals)
    if not spacing > 0:
        return None
    told = between(progress, 0.0, _SMOOTHED)
    chosen, narrow = choose(nearest, normals, spacing, noise, most)
    told(_CHOSEN)
    place, facing = nearest.points[chosen], normals[chosen]
    if noise:
        reach = reach_of_fits(spacing, noise)
        told = between(told, _CHOSEN, 1.0)
        place, facing = smooth(
            nearest, place, facing, reach, workers=workers, progress=told
        )
    progress(_SMOOTHED)
    solid, far = _solid(place, facing)
    if solid.sum() < _FEWEST:
        return None

    def look():
        surface = Surface.through(place, facing)
        heard = Hearing.of(
            nearest,
            normals,
            place,
            facing,
            noise=noise,
            workers=workers,
            progress=between(progress, _SMOOTHED, _HEARD),
        )
        return surface, heard, surface.pieces()[heard.index[:, 0]]

    labels, (surface, heard, piece) = _both(
        lambda: label_poles(place[solid], facing[solid], far[solid]),
        look,
        apart=workers != 1,
    )
    if labels is None:
        return None
    progress(_HEARD)
    said, clarity = np.ones(len(chosen), dtype=np.int8), np.zeros(len(chosen))
    said[solid], clarity[solid] = labels.signs, labels.clarity
    trust = 0.3 if noise else 1.0
    signs, sure = mend(surface, place, facing, said, clarity, trust=trust)
    found, confidence = heard.vote(signs, sure)
    if not noise:
        found[chosen], confidence[chosen] = signs, sure
    disagreeing = surface.disagreement(signs)
    return Sides(found, confidence, noise, labels.open, piece, disagreeing, narrow)


def _both(
    first: Callable[[], Result], second: Callable[[], Other], *, apart: bool
) -> tuple[Result, Other]:
    """Return what both do, at the same time where they may run in threads apart.

    The triangulation keeps one core busy; another has time for all the rest.
    """
    if not apart:
        return first(), second()
    with ThreadPoolExecutor(1) as pool:
        begun = pool.submit(first)
        done = second()
        return begun.result(), done


def _is_flat(points):
    """Whether all points lie in one plane to within rounding."""
    centered = points - points.mean(axis=0)
    spread = np.linalg.eigvalsh(centered.T @ (centered / len(points)))
    return not spread[0] > 1e-14 * spread[2]


def _solid(place, facing):
    """Find the points that belong to a surface.

    Returns
    -------
    solid : (m,) bool
        False for lone points and for those that stand off the points around.
    far : (m,) float64
        The distance to the sixth neighbor.
    """
    count = min(8, len(place) - 1)
    distance, index = NearestNeighbors(place).others(count, place)
    far = distance[:, min(6, count) - 1]
    lone = far > _LONE * np.median(far[index], axis=1)
    height = np.abs(
        np.einsum("mkc,mc->mk", place[index] - place[:, None], facing)[:, :6]
    )
    slope = np.median(height / np.maximum(distance[:, :6], 1e-300), axis=1)
    # Where the whole cloud is steep, as coarse samples are, none of it is special.
    steep = slope > np.clip(6 * np.median(slope), _STEEP, 0.6)
    return ~(lone | steep), far
