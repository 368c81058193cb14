# SPDX-License-Identifier: GPL-3.0-or-later
"""Clouds in tiles: each with as much around it as its normals depend on.

A tile is a box of space with the points in it, its *own*, and those within a margin
around it, its *halo*. A normal is exact, the same as from the whole cloud, where all
points that it depends on are known; how far that reaches is known once it is computed.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .fitted import fit_all
from .graph import NearestNeighbors
from .inputs import BoolArray, FloatArray, InputError, IntArray
from .neighborhoods import Nearest, neighborhoods, unique_points
from .orientation import find_orientation
from .patch import LEAST_NEIGHBORS
from .scale import choose_scale
from .settings import Settings
from .sheets import CANDIDATES, STAGES, separate, suspects
from .threads import in_threads

# How the sides of the normals of tiles can be found.
ORIENTATIONS = ("auto", "poles", "propagate", "outward", "viewpoint", "none")
_LOCAL = ("viewpoint", "none")

# A halo is so many neighborhoods wide, as most of so many points have them: what is
# told apart by sheets depends on neighbors of neighbors, five times over.
_WIDTHS, _ASKED = 6, 10_000

# Guides that a normal takes its side from.
_GUIDES = 6
_CHUNK = 100_000


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


def resolve(points: FloatArray, settings: Settings) -> tuple[Settings, float, float]:
    """Choose for a whole cloud what "auto" and None stand for, by parts of it.

    Parameters
    ----------
    points : (n, 3) float64
        Parts of the cloud, each with all points that are there.
    settings : Settings

    Returns
    -------
    settings : Settings
        With kind and size of the patches.
    noise : float
        The misfit of most points, as an angle: see `sheets.suspects`.
    margin : float
        A halo as wide as most points need.

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
    kept, _ = unique_points(points)
    points = points if kept is None else points[kept]
    if settings.method == "auto" and settings.neighbors is None:
        patch, count = choose_scale(NearestNeighbors(points))
        patch = patch if settings.patch == "auto" else settings.patch
        settings = replace(settings, neighbors=count, patch=patch)
    source, settings = neighborhoods(points, None, settings)
    assert isinstance(source, Nearest)
    fitted = fit_all(source, lambda _share: None)
    noise = suspects(fitted.misfit, fitted.valid)[1]
    rows = np.arange(0, len(points), max(1, len(points) // _ASKED))
    count = min(max(settings.neighbors or 0, CANDIDATES), len(points) - 1)
    _, distance = source.nearest.neighbors(rows, count)
    margin = _WIDTHS * float(np.median(distance[:, -1]))
    return settings, noise, max(margin, settings.radius or 0.0)


def fit_tile(
    points: FloatArray,
    own: int,
    depth: FloatArray,
    settings: Settings,
    noise: float,
) -> Tile:
    """Estimate the normals of a tile: a pure function, whatever the machine.

    Parameters
    ----------
    points : (n, 3) float64
        The own points, and behind them the halo, in the coordinates of the whole
        cloud less one place that is the same for all tiles.
    own : int
        How many are own.
    depth : (n,) float64
        How far around each point all points of the cloud are given.
    settings : Settings
        As `resolve` returns them.
    noise : float
        The misfit of most points of the cloud.

    Returns
    -------
    Tile
    """
    kept, inverse = unique_points(points)
    places = points if kept is None else points[kept]
    back = slice(own) if inverse is None else inverse[:own]
    if len(places) <= LEAST_NEIGHBORS:
        lost = np.zeros(own, dtype=bool)
        return Tile(np.zeros((own, 3)), lost, np.isinf(depth[:own]))
    few = len(places) <= (settings.neighbors or 0)
    if few:
        settings = replace(settings, neighbors=len(places) - 1)
    source = Nearest(NearestNeighbors(places, threads=settings.threads), settings)
    fitted = fit_all(source, lambda _share: None)
    normals = fitted.normals
    rows = suspects(fitted.misfit, fitted.valid, noise)[0]
    rows = rows if settings.sheets else rows[:0]
    if len(rows):
        normals = separate(
            source.nearest, normals, fitted.misfit, rows, noise, run=_runner(settings)
        )
    needed = fitted.reach if settings.radius is None else settings.radius
    needed = np.inf if few else needed
    depth = depth if kept is None else depth[kept]
    # Room for rounding: distances come from products.
    exact = np.asarray(needed) * (1 + 1e-6) <= depth
    if len(rows):
        exact = _exact_after(source.nearest, exact, depth, rows)
    return Tile(normals[back], fitted.valid[back], exact[back])


def _runner(settings):
    """Return a function that calls work(chunk) for all chunks, in threads."""

    def run(work, chunks):
        for _ in in_threads(work, chunks, settings.threads):
            pass

    return run


def _exact_after(nearest, exact, depth, rows):
    """Return which normals are exact after points were told apart by sheets.

    At every stage a point depends on its candidates as the stage before left them.
    """
    count = min(CANDIDATES, len(nearest.points) - 1)
    index, distance = nearest.neighbors(rows, count)
    known = distance[:, -1] * (1 + 1e-6) <= depth[rows]
    if count < CANDIDATES:
        known &= ~np.isfinite(depth[rows])
    for _ in range(STAGES):
        after = exact.copy()
        after[rows] = exact[rows] & known & exact[index].all(axis=1)
        exact = after
    return exact


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
) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """Find the sides of a cloud's guides, its thinned points.

    Parameters
    ----------
    points, normals : (g, 3) float64
    settings : Settings

    Returns
    -------
    normals : (g, 3) float64, facing outward
    confidence : (g,) float64
    warnings : tuple of str
    """
    found = find_orientation(
        points,
        normals,
        mode=settings.orientation,
        nested=settings.nested,
        threads=settings.threads,
    )
    return normals * found.signs[:, None], found.confidence, found.warnings


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


def depth_in_box(points: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return how far inside a box points (n, 3) are, (n,); inf in an endless one."""
    return np.minimum(points - low, high - points).min(axis=1)


def distance_to(points: FloatArray, others: FloatArray) -> FloatArray:
    """Return the distance of each point (n, 3) to the nearest of others, (n,)."""
    if not len(points):
        return np.empty(0)
    return np.asarray(NearestNeighbors(others).tree.query(points)[0])


@dataclass(frozen=True)
class Partition:
    """Space cut into boxes by planes across the axes, one box a tile.

    Attributes
    ----------
    axis, cut : (2^d - 1,)
        Of the planes, halves of halves: the children of i are 2 i + 1 and 2 i + 2.
    low, high : (2^d, 3) float64
        Corners of the boxes, infinite at the border.
    """

    axis: IntArray
    cut: FloatArray
    low: FloatArray
    high: FloatArray

    @classmethod
    def of(cls, sample: FloatArray, depth: int) -> "Partition":
        """Cut space so that 2^depth boxes hold as many points of a sample each."""
        axis = np.zeros(2**depth - 1, dtype=np.int64)
        cut = np.zeros(2**depth - 1)
        parts = [(sample, np.full(3, -np.inf), np.full(3, np.inf))]
        for node in range(len(axis)):
            points, low, high = parts[node]
            span = np.ptp(points, axis=0) if len(points) else np.ones(3)
            axis[node] = along = int(span.argmax())
            values = points[:, along]
            cut[node] = at = float(np.median(values)) if len(values) else 0.0
            left = values < at
            split_low, split_high = low.copy(), high.copy()
            split_high[along] = split_low[along] = at
            parts.append((points[left], low, split_high))
            parts.append((points[~left], split_low, high))
        leaves = parts[len(axis) :]
        return cls(
            axis,
            cut,
            np.array([leaf[1] for leaf in leaves]),
            np.array([leaf[2] for leaf in leaves]),
        )

    def __len__(self) -> int:
        return len(self.low)

    def box_of(self, points: FloatArray) -> IntArray:
        """Return the box of each point, (n,) int."""
        node = np.zeros(len(points), dtype=np.int64)
        rows = np.arange(len(points))
        while len(self.axis) and node[0] < len(self.axis):
            right = points[rows, self.axis[node]] >= self.cut[node]
            node = 2 * node + 1 + right
        return node - len(self.axis)
