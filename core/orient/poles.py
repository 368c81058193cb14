# SPDX-License-Identifier: GPL-3.0-or-later
"""Inside and outside by the poles of the Voronoi cells.

The tetrahedra of a Delaunay complex of points on a surface lie on one side of it or the
other (slivers aside). The *poles* of a point are the centers of the largest spheres
through it that hold no point, one on each side: farthest corners of its Voronoi cell
[1].

References
----------
[1] N. Amenta, S. Choi, R. Kolluri, "The Power Crust", Solid Modeling 2001.
"""

from dataclasses import dataclass

import numpy as np

from ..inputs import BoolArray, FloatArray, IntArray
from .tree import spread_signs

# Shift of each point before the triangulation, in units of its spacing. Thousands of
# points on one sphere, in one plane or around one axis have no Delaunay complex of
# their own, and qhull is three times slower on them; a hundredth of the spacing turns
# no pole by more than a degree.
_SHAKE = 0.01

# Doubt below which spheres meet so deeply that they may lead around a point.
_DEEP = 0.5

# Share of the poles that may contradict one outside all around a closed surface.
_CLOSED = 0.02

# Spheres this many spacings wide that meet do so in the open: in proportion to their
# width, to a hundredth at most, the doubt is less. Without this one point that looks
# through a hole between others would outweigh all that joins two rooms.
_WIDE = 4.0
_TRUST = 100.0

# A surface is open when the border between inside and outside runs between spheres
# that nearly agree and are as wide, as often as along a rim: its length goes with the
# square root of the number of points.
_OPEN = 0.3

# Radius of the shell of points that stand for the outside, in units of the cloud's.
_SHELL = 6.0
_SHELL_POINTS = 62


@dataclass(frozen=True)
class PoleLabels:
    """Which side of points is outside.

    Attributes
    ----------
    signs : (n,) int8
        What turns each given normal outward.
    clarity : (n,) float64
        0 to 1: how clearly the two poles of each point say so.
    open : bool
        Whether the surface is so open that the outside reaches both of its sides.
    cells : (t,) int8
        +1 for tetrahedra of the `delaunay_complex` that are outside, -1 inside.
    """

    signs: IntArray
    clarity: FloatArray
    open: bool
    cells: IntArray


@dataclass(frozen=True)
class Complex:
    """Delaunay tetrahedra with their neighbors and circumspheres.

    Attributes
    ----------
    corners, neighbors : (t, 4) int
        Neighbor -1 where there is none.
    centers : (t, 3) float64
    radii : (t,) float64
    sound : (t,) bool
        False for tetrahedra so flat that they have no center.
    """

    corners: IntArray
    neighbors: IntArray
    centers: FloatArray
    radii: FloatArray
    sound: BoolArray


def label_poles(
    points: FloatArray, normals: FloatArray, spacing: FloatArray
) -> PoleLabels | None:
    """Find the outward side of points on a surface.

    Parameters
    ----------
    points : (n, 3) float64
        All different; the distances between neighbors alike within a few times.
    normals : (n, 3) float64, unit
        Either side.
    spacing : (n,) float64
        About the distance to the neighbors of each point.

    Returns
    -------
    PoleLabels, or None where the points have no Delaunay tetrahedra.

    Notes
    -----
    Neighboring tetrahedra are joined as "same side", doubted by 1 - cos of the angle
    at which their circumspheres meet: spheres that share most of their inside lie on
    one side, the more surely the wider they are. The two poles of a point are joined
    as "opposite sides", doubted by 1 + cos of the angle between them. Signs spread
    along the minimum spanning tree from tetrahedra at a far shell around the points,
    which are outside.
    """
    n = len(points)
    cells = delaunay_complex(points, spacing)
    if cells is None:
        return None
    above, below, clarity = find_poles(cells, points, normals)
    near, side, doubt = _meeting(cells)
    star = _stars(cells, near, side, doubt < _DEEP)
    both = np.flatnonzero((above >= 0) & (below >= 0))
    clarity[both[star[above[both]] == star[below[both]]]] = 0
    outer = np.flatnonzero((cells.corners >= n).any(axis=1))
    poles = np.stack([above, below], axis=1)[both] // 4
    wide = cells.radii[near].min(axis=1) / (_WIDE * np.median(spacing))
    label = _labels(
        near,
        doubt / np.clip(wide, 1, _TRUST),
        poles,
        clarity[both],
        outer,
        len(cells.corners),
    )
    up, down = label[above // 4], label[below // 4]
    signs = np.where(above >= 0, up, -down).astype(np.int8)
    clarity[(above < 0) | (below < 0) | (up == down)] = 0
    parted = (label[near[:, 0]] != label[near[:, 1]]) & (doubt < 0.1)
    is_open = bool((parted & (wide > 1)).sum() > _OPEN * np.sqrt(n))
    return PoleLabels(signs, clarity, is_open, label)


def _labels(near, doubt, poles, clarity, outer, count):
    """Label cells +1 outside and -1 inside, (count,) int8.

    The shell is taken as one outside, unless too many poles contradict: both sides of
    an open surface may reach it.
    """
    edges = np.concatenate([near, poles])
    weight = np.concatenate([doubt, 1 - clarity])
    sign = np.repeat(np.array([1, -1], dtype=np.int8), [len(near), len(poles)])
    ties = np.stack([outer[:-1], outer[1:]], axis=1)
    tied, _ = spread_signs(
        count,
        np.concatenate([edges, ties]),
        np.concatenate([weight, np.zeros(len(ties))]),
        np.concatenate([sign, np.ones(len(ties), dtype=np.int8)]),
        int(outer[0]),
    )
    against = _contradiction(tied, poles, clarity)
    if against < _CLOSED:
        return tied
    free, _ = spread_signs(count, edges, weight, sign, int(outer[0]))
    if _contradiction(free, poles, clarity) >= against:
        return tied
    return free if free[outer].sum() >= 0 else -free


def _contradiction(label, poles, clarity):
    """Return the share of the poles that lie on one side instead of two."""
    broken = label[poles[:, 0]] == label[poles[:, 1]]
    return (broken * clarity).sum() / max(clarity.sum(), 1e-300)


def delaunay_complex(points: FloatArray, spacing: FloatArray) -> Complex | None:
    """Return the Delaunay complex of points and the shell around them, or None.

    See `label_poles`; corners from n on are those of the shell.
    """
    from scipy.spatial import Delaunay, QhullError

    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    size = np.linalg.norm(points - middle, axis=1).max()
    seen = (points - middle) / size
    seen = seen + (_SHAKE * spacing / size)[:, None] * _directions(seen)
    seen = np.concatenate([seen, _shell()])
    try:
        found = Delaunay(seen)
    except QhullError:
        return None
    corners: IntArray = found.simplices
    centers, radii, sound = _circumspheres(seen, corners)
    return Complex(
        corners, found.neighbors, centers * size + middle, radii * size, sound
    )


def _directions(points):
    """Return shifts, at most one long, that depend on nothing but the place."""
    mixed = points @ np.array([[1.0, 1.7, 2.9], [2.3, 3.1, 1.3], [3.7, 1.1, 1.9]])
    return np.sin(1e6 * mixed) / np.sqrt(3)


def _shell():
    """Return points all around, not quite on a sphere, (m, 3)."""
    i = np.arange(_SHELL_POINTS)
    z = 1 - (2 * i + 1) / _SHELL_POINTS
    turn = i * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    return (_SHELL + 0.3 * np.sin(7.0 * i))[:, None] * np.stack(
        [r * np.cos(turn), r * np.sin(turn), z], axis=1
    )


def _circumspheres(points, corners):
    """Return centers (t, 3), radii (t,), and whether there is a center (t,)."""
    origin = points[corners[:, 0]]
    a, b, c = (points[corners[:, i]] - origin for i in (1, 2, 3))
    bc, ca, ab = np.cross(b, c), np.cross(c, a), np.cross(a, b)
    volume = (a * bc).sum(axis=1)
    aa, bb, cc = ((e * e).sum(axis=1)[:, None] for e in (a, b, c))
    longest = np.maximum(np.maximum(aa, bb), cc)[:, 0]
    sound = np.abs(volume) > 1e-14 * longest**1.5
    offset = (aa * bc + bb * ca + cc * ab) / np.where(sound, 2 * volume, 1)[:, None]
    offset[~sound] = 0
    return origin + offset, np.linalg.norm(offset, axis=1), sound


def find_poles(
    cells: Complex, points: FloatArray, normals: FloatArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the poles above and below each point, and their clarity, 3 x (n,).

    A pole is said as 4 x cell + the point's corner in it; -1 for none.
    Clarity is -cos of the angle between the poles, at least 0.
    """
    n = len(points)
    vertex = cells.corners.ravel()
    keep = np.flatnonzero((vertex < n) & np.repeat(cells.sound, 4))
    keep = keep[np.argsort(vertex[keep], kind="stable")]
    vertex, cell = vertex[keep], keep // 4
    arm = cells.centers[cell] - points[vertex]
    height = (arm * normals[vertex]).sum(axis=1)
    starts = np.searchsorted(vertex, np.arange(n))
    reach = cells.radii[cell]
    above = _farthest(vertex, starts, np.where(height > 0, reach, 0), keep)
    below = _farthest(vertex, starts, np.where(height < 0, reach, 0), keep)
    up, down = (
        (cells.centers[at // 4] - points) / cells.radii[at // 4][:, None]
        for at in (above, below)
    )
    clarity = np.clip(-(up * down).sum(axis=1), 0, 1)
    return above, below, clarity


def _farthest(vertex, starts, reach, corner):
    """Return the corner of the largest positive reach at each vertex, -1 for none."""
    top = np.maximum.reduceat(reach, np.minimum(starts, len(reach) - 1))
    best = np.flatnonzero((reach == top[vertex]) & (reach > 0))
    result = np.full(len(starts), -1)
    # Backward, so that of equal ones the first stays.
    result[vertex[best[::-1]]] = corner[best[::-1]]
    return result


def _stars(cells, near, side, deep):
    """Part the cells around each point where their spheres meet at shallow angles.

    Returns
    -------
    (4 t,) int
        A part for each corner of each cell. Two corners at the same point are in the
        same part where deeply meeting spheres lead from one cell to the other around
        the point.
    """
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    a, b, side = near[deep, 0], near[deep, 1], side[deep]
    rows, columns = [], []
    for turn in (1, 2, 3):
        slot = (side + turn) % 4
        shared = cells.corners[a, slot]
        rows.append(4 * a + slot)
        columns.append(4 * b + (cells.corners[b] == shared[:, None]).argmax(axis=1))
    row, column = np.concatenate(rows), np.concatenate(columns)
    size = cells.corners.size
    graph = sparse.coo_matrix(
        (np.ones(len(row), dtype=np.int8), (row, column)), shape=(size, size)
    )
    return connected_components(graph, directed=False)[1]


def _meeting(cells):
    """Return neighboring cells, and how doubtful it is that they are on one side.

    Returns
    -------
    pairs : (e, 2) int
    side : (e,) int
        The corner of the first cell that the second does not share.
    doubt : (e,) float64, 0 to 2
        1 - cos of the angle at which their spheres meet.
    """
    cell, side = (a.ravel() for a in np.indices(cells.corners.shape))
    other = cells.neighbors.ravel()
    once = (other > cell) & cells.sound[cell] & cells.sound[other]
    a, b = cell[once], other[once]
    apart = ((cells.centers[a] - cells.centers[b]) ** 2).sum(axis=1)
    ra, rb = cells.radii[a], cells.radii[b]
    cosine = (ra * ra + rb * rb - apart) / (2 * ra * rb)
    return np.stack([a, b], axis=1), side[once], 1 - np.clip(cosine, -1, 1)
