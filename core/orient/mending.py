# SPDX-License-Identifier: GPL-3.0-or-later
"""What the surface around points says of their sides, against single poles."""

from dataclasses import dataclass

import numpy as np

from ..inputs import BoolArray, FloatArray, IntArray
from ..neighbors.graph import NearestNeighbors
from .tree import spread_signs

# Neighbors are one smooth surface when the line between them leaves their mean tangent
# plane, and their normals turn, by less than this.
_SLOPE = 0.08
_TURN = 0.98
# Slopes at which neighbors begin not to be heard.
_SCALE = (0.005, 0.12)
# Points less sure than this of their side ask more neighbors: sheets that touch part
# with the square of the distance, so that those farther off tell them apart.
_UNSURE = 0.3
_NEIGHBORS, _MORE_NEIGHBORS = 10, 32
_ROUNDS = 2
# A point is inside a smooth surface when this share of its neighbors is.
_INSIDE = 0.65
# Smooth surfaces of this many points speak with one voice, if the votes of their poles
# differ from zero by this share.
_MANY = 12
_FIRM = 0.4
# Doubt at which a sign no longer spreads from a point to its neighbor.
_CUT = 0.6


@dataclass(frozen=True)
class Surface:
    """How points, all m of a cloud or some, and k neighbors lie on one surface.

    Attributes
    ----------
    index : (m, k) int
    cosine : (m, k) float64, between the normals as given
    slope : (m, k) float64, of the line between the points over their mean tangent plane
    """

    index: IntArray
    cosine: FloatArray
    slope: FloatArray

    @classmethod
    def through(cls, place: FloatArray, facing: FloatArray) -> "Surface":
        """Look at the ten nearest of each point (m, 3) with its normal (m, 3)."""
        return cls.around(np.arange(len(place)), place, facing, _NEIGHBORS)

    @classmethod
    def around(
        cls, rows: IntArray, place: FloatArray, facing: FloatArray, count: int
    ) -> "Surface":
        """Look at the nearest of some of the points (n, 3) with normals (n, 3)."""
        here, own = place[rows], facing[rows]
        nearest = NearestNeighbors(place)
        distance, index = nearest.others(min(count, len(place) - 1), here)
        theirs = facing[index]
        cosine = np.einsum("mkc,mc->mk", theirs, own)
        mean = np.where(cosine < 0, -1, 1)[..., None] * theirs + own[:, None]
        length = np.sqrt(2 + 2 * np.abs(cosine))
        height = np.einsum("mkc,mkc->mk", place[index] - here[:, None], mean)
        slope = np.abs(height) / np.maximum(length * distance, 1e-300)
        return cls(index, cosine, slope)

    def edges(self, some: BoolArray) -> tuple[IntArray, FloatArray, IntArray]:
        """Return edges (e, 2), doubts (e,) and signs (e,) of some of the neighbors."""
        row, column = np.nonzero(some)
        cosine, slope = self.cosine[row, column], self.slope[row, column]
        sign = np.where(cosine < 0, -1, 1).astype(np.int8)
        edges = np.stack([row, self.index[row, column]], axis=1)
        return edges, np.maximum(1 - np.abs(cosine) + slope, 0), sign

    @property
    def smooth(self) -> BoolArray:
        """(m, k) bool, which neighbors are clearly on one surface with the point."""
        return (self.slope < _SLOPE) & (np.abs(self.cosine) > _TURN)

    def disagreement(self, signs: IntArray) -> float:
        """Return the share of smooth neighbors that signs turn to opposite sides."""
        apart = np.sign(self.cosine) * signs[:, None] * signs[self.index] < 0
        return float((apart & self.smooth).sum() / max(1, self.smooth.sum()))

    def pieces(self) -> IntArray:
        """Return the connected piece of each point, (m,) int."""
        edges, doubt, sign = self.edges(np.ones(self.index.shape, dtype=bool))
        return spread_signs(len(self.index), edges, doubt, sign)[1]


def mend(
    surface: Surface,
    place: FloatArray,
    facing: FloatArray,
    signs: IntArray,
    clarity: FloatArray,
    *,
    trust: float = 1.0,
) -> tuple[IntArray, FloatArray]:
    """Let smooth surface outvote the poles of single points.

    Parameters
    ----------
    surface : Surface
        Through `place` and `facing`.
    place, facing : (m, 3) float64
        Points and normals as given.
    signs : (m,) int8
    clarity : (m,) float64
        How clearly the poles said so; 0 where they were not asked.
    trust : float
        How far a sign spreads along the surface before a point believes its poles
        rather than its neighbors.

    Returns
    -------
    signs : (m,) int8
    sure : (m,) float64, 0 to 1

    Notes
    -----
    Where sheets cross or touch, inside and outside change places and the poles are
    right about that; a surface that goes on through the crossing keeps its side. So
    smooth parts of the surface decide as one, by the sum of the votes of their poles,
    and signs spread from them to the points between. Last, every point listens to the
    neighbors on its own sheet, and to more of them where it is not sure.
    """
    common, settled = _parts(surface, signs, clarity)
    new = _spread(surface, common, settled, clarity, trust)
    clarity = np.where(new == signs, clarity, 0.1)
    new, sure = _listen(surface, np.arange(len(new)), new, clarity)
    unsure = np.flatnonzero(sure < _UNSURE)
    if len(unsure):
        wider = Surface.around(unsure, place, facing, _MORE_NEIGHBORS)
        new, sure[unsure] = _listen(wider, unsure, new, clarity)
    return new, sure


def _listen(surface, rows, signs, clarity):
    """Let some points take the side of the neighbors on their own sheet.

    Returns
    -------
    signs : (m,) int8, of all points
    sure : float64, 0 to 1, of the points in `rows`
    """
    signs = signs.copy()
    # Where two sheets touch, the neighbors on a point's own are those of least slope.
    least = np.partition(surface.slope, 1, axis=1)[:, 1:2]
    scale = np.clip(2 * least, *_SCALE)
    weight = np.exp(-((surface.slope / scale) ** 2)) * surface.cosine**2
    for _ in range(_ROUNDS):
        said = signs * (0.05 + clarity)
        heard = (weight * np.sign(surface.cosine) * said[surface.index]).sum(axis=1)
        value = heard + said[rows]
        signs[rows] = np.where(value < 0, -1, 1)
    sure = np.abs(value) / (1.05 * (1 + weight.sum(axis=1)))
    return signs, np.clip(sure, 0, 1)


def _parts(surface, signs, clarity):
    """Give each smooth part of the surface one sign.

    Returns
    -------
    signs : (m,) int8
    settled : (m,) bool
        Whether the point is in such a part.
    """
    m = len(signs)
    smooth_edge = surface.smooth
    inside = smooth_edge.mean(axis=1) > _INSIDE
    smooth_edge = smooth_edge & inside[:, None] & inside[surface.index]
    relative, part = spread_signs(m, *surface.edges(smooth_edge))
    votes = relative * signs * (0.02 + clarity)
    net, total = np.bincount(part, votes), np.bincount(part, np.abs(votes))
    many = np.bincount(part) > _MANY
    firm = many & (np.abs(net) > _FIRM * total)
    common = relative * np.where(net < 0, -1, 1)[part]
    return np.where(firm[part], common, signs).astype(np.int8), many[part]


def _spread(surface, signs, settled, clarity, trust):
    """Spread signs from settled points along the surface, (m,) int8.

    A node beside the points holds their labels: settled points hang on it at no
    doubt, the others by what their poles said.
    """
    m = len(signs)
    edges, doubt, sign = surface.edges(np.ones(surface.index.shape, dtype=bool))
    near = doubt < _CUT
    own = np.where(settled, 0, trust * (1.2 - clarity) + 9 * (clarity == 0))
    label, _ = spread_signs(
        m + 1,
        np.concatenate([edges[near], np.stack([np.arange(m), np.full(m, m)], axis=1)]),
        np.concatenate([doubt[near], own]),
        np.concatenate([sign[near], signs]),
        m,
    )
    return label[:m]
