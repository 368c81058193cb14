# SPDX-License-Identifier: GPL-3.0-or-later
"""Patches of points, chunk by chunk, over the neighborhoods the settings ask for."""

from dataclasses import replace
from functools import cached_property

import numpy as np

from .inputs import FloatArray, InputError, IntArray, centered_parts, extent_of
from .neighbors.graph import NearestNeighbors, NeighborGraph
from .patches.asked import Asked
from .patches.patch import LEAST_NEIGHBORS, Patches, fit_patches, precision
from .patches.scale import choose_scale
from .settings import PATCHES, Settings

# Points whose patches are fitted in one go: their arrays stay in the cache.
_CHUNK = 4096

# Neighbors of `time_scale` when none are asked for: near twice the unknowns.
_NEIGHBORS = 16

# Neighbors from which on all terms up to degree three are fitted.
_CUBIC_FROM = 12


def neighborhoods(
    points: FloatArray,
    faces: IntArray | None,
    settings: Settings,
    *,
    center: FloatArray | None = None,
) -> "tuple[Nearest | Rings, Settings]":
    """Return who is whose neighbor, and how many, as the settings ask.

    Parameters
    ----------
    points : (n, 3) float64, all different where there are no faces
    faces : (m, 3) int or None
    settings : Settings
    center : (3,), optional
        Taken off the points.

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
        points = points if center is None else points - center
        return Rings(points, faces, settings), settings
    nearest = NearestNeighbors(points, center=center, threads=settings.threads)
    asked = Asked.of(nearest)
    settings = of_nearest(settings, asked)
    return Nearest(nearest, settings, asked), settings


def of_nearest(settings: Settings, asked: Asked) -> Settings:
    """Return the settings for nearest points, with kind and size of the patches."""
    if settings.method == "auto" and settings.neighbors is None:
        patch, count = choose_scale(asked)
        patch = patch if settings.patch == "auto" else settings.patch
        settings = replace(settings, neighbors=count, patch=patch)
    fixed = _fixed(settings)
    fixed["neighbors"] = min(fixed["neighbors"], asked.count - 1)
    return replace(settings, graph="nearest", **fixed)


def neighborhoods_of_all(
    points: FloatArray, faces: IntArray | None, settings: Settings
) -> "tuple[Nearest | Rings, IntArray]":
    """Return the neighborhoods of points as they come, of which some share a place.

    Parameters
    ----------
    points : (n, 3) float64
    settings : Settings
        As used for all of them: see Estimate.

    Returns
    -------
    source : Nearest or Rings
    place : (n,) int
        The row of the source that each point is.
    """
    place: IntArray = np.arange(len(points))
    points = points - extent_of(points).center
    kept, inverse = unique_points(points) if faces is None else (None, None)
    if kept is not None and inverse is not None:
        points, place = points[kept], inverse
    return neighborhoods(points, faces, settings)[0], place


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

    A subclass has `points`, `chunks()`, and `_offsets(rows)` that returns what
    `fit_patches` takes.
    """

    def __init__(self, count, settings, cloud=None):
        self.count = count
        self.settings = settings
        self.paper = settings.method == "paper"
        self.dtype = np.dtype(float) if self.paper else precision(cloud or count)

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
        inverse = 1 / np.where(reach > 0, reach, 1)
        result = np.empty(offsets.shape, dtype=self.dtype)
        return np.multiply(offsets, inverse, out=result, casting="same_kind")


class Nearest(_Source):
    """Patches over nearest points, of which some are asked about the whole cloud."""

    def __init__(self, nearest, settings, asked=None):
        super().__init__(len(nearest), settings, nearest.cloud)
        self.nearest = nearest
        self.asked = asked or Asked.of(nearest)

    @property
    def points(self) -> FloatArray:
        """(n, 3) float64, centered."""
        return self.nearest.points

    def chunks(self) -> list[IntArray]:
        """Return the rows chunk by chunk, leaf by leaf."""
        return self.nearest.runs(self.settings.neighbors)

    def _offsets(self, rows):
        offsets, distance = self.nearest.offsets(
            rows, self.settings.neighbors, radius=self.settings.radius
        )
        # Nearest come first, but for those that a radius leaves out.
        # From coordinates alone: a part of a cloud has the same as all of it.
        within = self.settings.radius is None
        farthest = offsets[:, -1]
        reach = np.sqrt((farthest * farthest).sum(axis=0))
        reach = reach if within else distance.max(axis=1)
        return self._scaled(offsets, reach), reach


class Rings(_Source):
    """Patches over the rings of a graph: Delaunay edges or mesh edges."""

    def __init__(self, points, faces, settings):
        super().__init__(len(points), settings)
        self.points = points
        self._faces = faces

    @cached_property
    def graph(self) -> NeighborGraph:
        """Who is whose neighbor; a noisy mesh may never ask."""
        if self.settings.graph == "mesh":
            graph = NeighborGraph.mesh(len(self.points), self._faces)
        else:
            graph = NeighborGraph.delaunay(self.points)
        return graph.extended(self.settings.neighbors)

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


def unique_points(
    points: FloatArray, center: FloatArray | None = None
) -> tuple[IntArray | None, IntArray | None]:
    """Find points that share a place.

    Parameters
    ----------
    points : (n, 3) float64
    center : (3,), optional
        Taken off the points: those that are alike then share a place.

    Returns
    -------
    kept : (u,) int or None
        One point of each place, increasing.
    inverse : (n,) int or None
        Which of the kept ones each point is; None for both where all differ.
    """
    # Sorting one hash a point is many times faster than sorting the points: most
    # clouds hold no twins, and this is all they pay.
    center = np.zeros(3) if center is None else center
    key = np.empty(len(points), dtype=np.uint64)
    at = 0
    for part in centered_parts(points, center):
        key[at : at + len(part)] = _hashes(part)
        at += len(part)
    key.sort()
    if not (key[1:] == key[:-1]).any():
        return None, None
    _, first, inverse = np.unique(
        points - center, axis=0, return_index=True, return_inverse=True
    )
    if len(first) == len(points):
        return None, None
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[inverse.ravel()]


def _hashes(points):
    """Return a number for each point (n, 3) that equal points share, (n,) uint64."""
    # Adding zero makes one zero of the two.
    bits = (points + 0.0).view(np.uint64)
    factors = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9])
    mixed = (bits ^ (bits >> np.uint64(29))) * factors.astype(np.uint64)
    return mixed[:, 0] ^ (mixed[:, 1] >> np.uint64(7)) ^ (mixed[:, 2] << np.uint64(9))
