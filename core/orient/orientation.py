# SPDX-License-Identifier: GPL-3.0-or-later
"""Consistent signs for normals that are known up to their side.

References
----------
[1] H. Hoppe et al., "Surface Reconstruction from Unorganized Points", SIGGRAPH 1992:
    signs spread along a minimum spanning tree of 1 - |n_i . n_j|.
[2] See `poles`.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from ..inputs import (
    FloatArray,
    IntArray,
    as_choice,
    as_faces,
    as_normals,
    as_points,
)
from ..neighbors.graph import NearestNeighbors, NeighborGraph
from ..progress import Progress, silent
from .guides import agreeing, face_directions, reference_normals, toward
from .sides import Sides, find_sides
from .tree import spread_signs
from .winding import NESTED, count_inconsistent

# Normals (n, 3), or the vertices and faces of a mesh.
Reference = ArrayLike | tuple[ArrayLike, ArrayLike]

MODES = (
    "auto",
    "poles",
    "propagate",
    "viewpoint",
    "outward",
    "faces",
    "reference",
    "none",
)

# Neighbors in the graph along which signs spread.
_NEIGHBORS = 10

# Below this confidence a sign counts as uncertain, and more uncertain signs than this
# share are worth a warning.
_UNCERTAIN = 0.3
_MANY = 0.05


@dataclass(frozen=True)
class Orientation:
    """Signs of normals, and how they were found.

    Attributes
    ----------
    signs : (n,) int8, +1 or -1
    mode : str
        What "auto" became.
    pieces : int
        Connected pieces that were oriented each on its own.
    confidence : (n,) float
        0 (a guess) to 1 (all evidence agrees); 1 where a guide decided.
    disagreeing : float
        Share of the neighbors on one smooth surface that face opposite sides.
    inconsistent : int
        Edges whose faces wind against each other, where faces decided.
    warnings : tuple of str
        Sentences that say where the evidence is thin.
    """

    signs: IntArray
    mode: str
    pieces: int
    confidence: FloatArray = field(default_factory=lambda: np.ones(0))
    disagreeing: float = 0.0
    inconsistent: int = 0
    warnings: tuple[str, ...] = ()

    @property
    def uncertain(self) -> float:
        """Share of the points whose side is uncertain."""
        if not len(self.confidence):
            return 0.0
        return float((self.confidence < _UNCERTAIN).mean())

    def summary(self) -> dict[str, object]:
        """Return what a report needs, as a dict of plain values."""
        return {
            "orientation": self.mode,
            "pieces": self.pieces,
            "turned": int((self.signs < 0).sum()),
            "disagreeing": self.disagreeing,
            "inconsistent": self.inconsistent,
            "uncertain": self.uncertain,
            "warnings": list(self.warnings),
        }


def orient_normals(
    points: ArrayLike,
    normals: ArrayLike,
    *,
    mode: str = "auto",
    faces: ArrayLike | None = None,
    viewpoint: ArrayLike | None = None,
    reference: Reference | None = None,
    graph: NeighborGraph | None = None,
    nested: str = "cavity",
) -> FloatArray:
    """Turn normals to consistent sides.

    Parameters
    ----------
    points, normals : (n, 3) array_like of float
        Rows of `normals` that are zero stay zero and are left out.
    mode : "auto" | "poles" | "propagate" | "viewpoint" | "outward" | "faces" |
            "reference" | "none"
        "auto": "faces" where there are faces, else "poles".
        "poles": by what is inside and outside, found from the poles of the points
        [2]; by "propagate" where that cannot work, as in a plane.
        "propagate": along a minimum spanning tree of the neighbor graph [1], each
        piece turned so that its outermost points look out.
        "viewpoint": toward a point. "outward": away from the center of each piece.
        "faces": to the side on which the faces wind counterclockwise.
        "reference": to the side of given normals or of a mesh. "none": as they are.
    faces : (m, 3) array_like of int, optional
    viewpoint : (3,) or (n, 3) array_like of float, optional
        One point for all, or one for each (a sensor's path).
    reference : (n, 3) array_like of float, or (vertices, faces), optional
        Normals, or a mesh, of which the nearest place counts.
    graph : NeighborGraph, optional
        Where signs may spread under "propagate"; by default the ten nearest
        neighbors.
    nested : "cavity" | "outward"
        Pieces inside others under "poles": walls of a cavity, which face it, or
        bodies of their own.

    Returns
    -------
    (n, 3) float64

    Raises
    ------
    InputError
        When an array has the wrong shape or what the mode needs is missing.
    """
    points = as_points(points)
    normals = as_normals(normals, len(points))
    orientation = find_orientation(
        points,
        normals,
        mode=mode,
        faces=as_faces(faces, len(points)),
        viewpoint=viewpoint,
        reference=reference,
        graph=graph,
        nested=nested,
    )
    return normals * orientation.signs[:, None]


def find_orientation(
    points: FloatArray,
    normals: FloatArray,
    *,
    mode: str,
    faces: IntArray | None = None,
    viewpoint: ArrayLike | None = None,
    reference: Reference | None = None,
    graph: NeighborGraph | None = None,
    nested: str = "cavity",
    threads: int | None = None,
    nearest: NearestNeighbors | None = None,
    progress: Progress = silent,
) -> Orientation:
    """Return the Orientation of checked arrays; see `orient_normals`.

    `nearest` are the neighbors of the very points, where someone has asked before;
    `progress` is called with the share done, 0 to 1.
    """
    as_choice(mode, MODES, name="orientation")
    as_choice(nested, NESTED, name="nested")
    if mode == "auto":
        mode = "poles" if faces is None else "faces"
    if mode == "poles":
        found = _by_poles(points, normals, nested, threads, nearest, progress)
        if found is not None:
            return found
        mode = "propagate"
    if mode in ("propagate", "outward"):
        return _by_pieces(points, normals, mode, graph, progress)
    if mode == "none":
        return _decided(normals, mode)
    if mode == "viewpoint":
        return _decided(normals, mode, toward(points, viewpoint))
    if mode == "reference":
        return _decided(normals, mode, reference_normals(reference, points))
    return _by_faces(points, normals, faces)


def _decided(normals, mode, directions=None):
    """Agree with directions (n, 3) as a guide has them, or leave sides as they are."""
    # No direction at all leaves every side as it is.
    signs: IntArray = np.ones(len(normals), dtype=np.int8)
    if directions is not None:
        signs = agreeing(normals, directions)
    x, y, z = normals.T
    known = x != 0
    for other in (y, z):
        known |= other != 0
    return Orientation(signs, mode, 0, known.astype(np.float32))


def _by_faces(points, normals, faces):
    """Agree with the faces, and say where these do not agree with each other."""
    found = _decided(normals, "faces", face_directions(points, faces))
    return with_disagreement(found, faces, len(points))


def sides_of_mesh(normals: FloatArray) -> Orientation:
    """Return the Orientation of normals (n, 3) that are on the faces' side as it is."""
    return _decided(normals, "faces")


def with_disagreement(found: Orientation, faces: IntArray, count: int) -> Orientation:
    """Return what was found, saying where faces do not agree with each other.

    Parameters
    ----------
    faces : (m, 3) int
    count : int
        Number of vertices.
    """
    inconsistent = count_inconsistent(faces, count)
    if not inconsistent:
        return found
    return replace(
        found,
        inconsistent=inconsistent,
        warnings=(
            f"{inconsistent:,} edges join faces that wind against each other: the side "
            "there is that of most of the faces around.",
        ),
    )


def _by_poles(points, normals, nested, threads, nearest, progress):
    """Orient by inside and outside; None where there is neither."""
    valid = (normals != 0).any(axis=1)
    rows = slice(None) if valid.all() else np.flatnonzero(valid)
    sides = find_sides(
        points[rows],
        normals[rows],
        nearest=nearest if valid.all() else None,
        workers=threads or -1,
        progress=progress,
    )
    if sides is None:
        return None
    signs = np.ones(len(points), dtype=np.int8)
    confidence = np.zeros(len(points))
    signs[rows], confidence[rows] = sides.signs, sides.confidence
    if nested == "outward":
        outward = normals[rows] * sides.signs[:, None]
        signs[rows] *= _looking_out(points[rows], outward, sides.piece)[sides.piece]
    return Orientation(
        signs,
        "poles",
        int(sides.piece.max()) + 1,
        confidence,
        sides.disagreeing,
        warnings=_warnings(sides),
    )


def _warnings(sides: Sides) -> tuple[str, ...]:
    """Say where the evidence for the sides is thin."""
    found = []
    share = (sides.confidence < _UNCERTAIN).mean()
    if share > _MANY:
        found.append(
            f"The side of {share:.0%} of the points is uncertain: sheets as close as "
            "the points, sheets that cross, or noise."
        )
    if sides.narrow:
        found.append(
            "Sheets lie so close to each other, for so many points, that their sides "
            "are a guess."
        )
    if sides.open:
        found.append(
            "The surface is open: its sides agree with each other, but which one is "
            "outside is a guess."
        )
    return tuple(found)


def _by_pieces(points, normals, mode, graph, progress):
    """Orient each piece on its own, by propagation or away from its center."""
    if graph is None and len(points) > 1:
        graph = NeighborGraph.nearest(points, _NEIGHBORS)
    elif graph is None:
        graph = NeighborGraph.from_edges(len(points), [])
    progress(0.3)
    edges, doubt, relation = _between_valid(graph, normals)
    progress(0.5)
    tree, labels = spread_signs(len(points), edges, doubt, relation)
    progress(0.9)
    if mode == "propagate":
        signs = tree * _looking_out(points, normals * tree[:, None], labels)[labels]
    else:
        signs = agreeing(normals, points - _centers(points, labels)[labels])
    valid = (normals != 0).any(axis=1)
    apart = relation * signs[edges[:, 0]] * signs[edges[:, 1]] < 0
    return Orientation(
        signs.astype(np.int8),
        mode,
        len(np.unique(labels[valid])),
        np.where(valid, _support(len(points), edges, 1 - doubt, apart), 0.0),
        float(apart.mean()) if len(edges) else 0.0,
    )


def _support(count, edges, weight, apart):
    """Return how far the neighbors of each point agree with it, (count,) 0 to 1."""
    ends = edges.ravel()
    both = np.repeat(weight, 2)
    total = np.bincount(ends, both, minlength=count)
    against = np.bincount(ends, both * np.repeat(apart, 2), minlength=count)
    share = np.divide(against, total, out=np.full(count, 0.5), where=total > 0)
    return np.abs(1 - 2 * share)


def _between_valid(graph, normals):
    """Return edges (e, 2) between valid points with [1]'s doubts and signs, (e,)."""
    edges = graph.edges
    valid = (normals != 0).any(axis=1)
    edges = edges[valid[edges].all(axis=1)]
    cosine = (normals[edges[:, 0]] * normals[edges[:, 1]]).sum(axis=1)
    sign = np.where(cosine < 0, -1, 1).astype(np.int8)
    return edges, np.maximum(1 - np.abs(cosine), 0), sign


def _centers(points, labels):
    """Return the mean point of each piece, (pieces, 3)."""
    size = np.bincount(labels)
    sums = [np.bincount(labels, points[:, axis]) for axis in range(3)]
    return np.stack(sums, axis=1) / size[:, None]


def _looking_out(points, normals, labels):
    """Return the sign for each piece that makes its outermost points look out.

    In each of many directions the farthest point of a closed surface has the
    direction itself as its normal: the pieces take the sign that most of these
    points, weighted by how clearly they say so, ask for.
    """
    order = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[order], np.arange(labels.max() + 1))
    votes = np.zeros(len(starts))
    for direction in _directions():
        height = points[order] @ direction
        top = np.maximum.reduceat(height, starts)
        at_top = height == top[labels[order]]
        facing = normals[order] @ direction
        votes += np.add.reduceat(np.where(at_top, facing, 0), starts)
    return np.where(votes < 0, -1, 1)


def _directions():
    """Return 26 directions: to the faces, edges and corners of a cube, (26, 3)."""
    steps = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1)
    steps = steps.reshape(-1, 3)[np.arange(27) != 13]
    return steps / np.linalg.norm(steps, axis=1, keepdims=True)
