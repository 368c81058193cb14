# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces that wind against the others: found piece by piece, and turned.

Two triangles that share an edge wind alike when they run along it in opposite
directions. Along such edges the pieces of a mesh are made consistent; then each is
turned outward as a whole.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..inputs import (
    BoolArray,
    FloatArray,
    InputError,
    IntArray,
    as_choice,
    as_faces,
    as_points,
)
from ..mesh.faces import face_vectors, unit
from .nesting import depths
from .tree import spread_signs

# What a piece inside another one is: the wall of a cavity, or a body of its own.
NESTED = ("cavity", "outward")

# An open piece has an outside when its faces look away from its middle as clearly as
# this: a flat sheet does not at all, a sphere without its lower half by 0.5.
_CLEAR = 0.2
# Of a closed piece all that is more than rounding counts.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Winding:
    """How the m triangles of a mesh wind.

    Attributes
    ----------
    flipped : (m,) bool
        Which to turn over, so that neighbors wind alike and pieces face outward.
    piece : (m,) int
        The piece of each, counted from 0: what hangs together along edges of two
        triangles, places that several vertices share counting as one.
    inconsistent : int
        Edges whose two triangles wind against each other as they came.
    onesided : int
        Edges where they still do when all `flipped` are turned: the piece has one
        side only, as a Moebius strip.
    nonmanifold : int
        Edges of more than two triangles.
    border : int
        Edges of one triangle.
    """

    flipped: BoolArray
    piece: IntArray
    inconsistent: int
    onesided: int
    nonmanifold: int
    border: int

    @property
    def turned(self) -> int:
        """How many triangles are flipped."""
        return int(self.flipped.sum())

    def repaired(self, faces: IntArray) -> IntArray:
        """Return the triangles (m, 3) with the flipped ones turned over."""
        return np.where(self.flipped[:, None], faces[:, ::-1], faces)


def find_flipped_faces(
    points: ArrayLike, faces: ArrayLike, *, nested: str = "cavity"
) -> Winding:
    """Find the triangles that wind against the others or look inward.

    Parameters
    ----------
    points : (n, 3) array_like of float
    faces : (m, 3) array_like of int
    nested : "cavity" | "outward"
        Closed pieces inside others: walls of a cavity, which face it, or bodies of
        their own.

    Returns
    -------
    Winding

    Raises
    ------
    InputError
        When there are no faces, or an array has the wrong shape.

    Notes
    -----
    A piece is turned by the sign of its volume. Where that says little, as for a flat
    sheet, the side on which it has most of its area as it came is kept.

    Examples
    --------
    >>> points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    >>> faces = [[0, 2, 1], [0, 1, 3], [0, 2, 3], [1, 2, 3]]
    >>> find_flipped_faces(points, faces).flipped
    array([False, False,  True, False])
    """
    points = as_points(points)
    triangles = as_faces(faces, len(points))
    as_choice(nested, NESTED, name="nested")
    if triangles is None:
        raise InputError("expected at least one face, got none")
    sides = _Sides.of(len(points), _welded(points, triangles))
    pairs, sign = sides.pairs
    inconsistent = int((sign < 0).sum())
    vectors = face_vectors(points, triangles)
    label, piece = _consistent(len(triangles), pairs, sign, vectors)
    closed = np.ones(piece.max() + 1, dtype=bool)
    closed[piece[sides.loose]] = False
    outward = _outward(points, triangles, vectors, label, piece, closed)
    if nested == "cavity" and closed.sum() > 1:
        outward[depths(points, triangles, piece, closed) % 2 == 1] *= -1
    apart = sign * label[pairs[:, 0]] * label[pairs[:, 1]] < 0
    return Winding(
        label * outward[piece] < 0,
        piece,
        inconsistent,
        int(apart.sum()),
        int((sides.count > 2).sum()),
        int((sides.count == 1).sum()),
    )


def wound_alike(points: FloatArray, faces: IntArray, *, nested: str) -> IntArray:
    """Return triangles (m, 3), turned where pieces wind against themselves.

    Pieces that wind alike stay, inward ones too.
    """
    winding = find_flipped_faces(points, faces, nested=nested)
    some = np.bincount(winding.piece, winding.flipped)
    whole = np.bincount(winding.piece)
    mixed = (some > 0) & (some < whole)
    turned = winding.flipped & mixed[winding.piece]
    return np.where(turned[:, None], faces[:, ::-1], faces)


def count_inconsistent(faces: IntArray, count: int) -> int:
    """Return how many edges of two triangles these run along in the same direction.

    Parameters
    ----------
    faces : (m, 3) int
    count : int
        Number of vertices.
    """
    key = (faces * np.int64(count) + np.roll(faces, -1, axis=1)).ravel()
    key.sort()
    if not (key[1:] == key[:-1]).any():
        # So it is with most meshes, and quickly said.
        return 0
    return int((_Sides.of(count, faces).pairs[1] < 0).sum())


@dataclass(frozen=True)
class _Sides:
    """The sides of triangles, edge by edge.

    Attributes
    ----------
    face : (h,) int
    forward : (h,) bool
        Whether the side runs from the lower vertex to the higher one.
    start, count : (e,) int
        Where the sides of each edge begin, and how many they are.
    """

    face: IntArray
    forward: BoolArray
    start: IntArray
    count: IntArray

    @classmethod
    def of(cls, count, faces):
        """Sort the sides of the triangles that have three corners."""
        whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        tail, head = faces[whole].ravel(), np.roll(faces[whole], -1, axis=1).ravel()
        key = np.minimum(tail, head) * np.int64(count) + np.maximum(tail, head)
        order = np.argsort(key, kind="stable")
        key = key[order]
        start = np.flatnonzero(np.append(True, key[1:] != key[:-1])[: len(key)])
        face = np.repeat(np.flatnonzero(whole), 3)[order]
        return cls(
            face, (tail < head)[order], start, np.diff(np.append(start, len(key)))
        )

    @property
    def pairs(self):
        """Triangles (p, 2) that share an edge with nobody else, signs (p,) int8."""
        first = self.start[self.count == 2]
        sign = np.where(self.forward[first] == self.forward[first + 1], -1, 1)
        return (
            np.stack([self.face[first], self.face[first + 1]], axis=1),
            sign.astype(np.int8),
        )

    @property
    def loose(self):
        """The triangles, (l,) int, at edges that not just two share."""
        return self.face[np.repeat(self.count != 2, self.count)]


def _welded(points, faces):
    """Return the triangles over places: vertices at borders that share one are one."""
    sides = _Sides.of(len(points), faces)
    corners = np.unique(faces[sides.face[sides.start[sides.count == 1]]])
    if not len(corners):
        return faces
    _, first, inverse = np.unique(
        points[corners], axis=0, return_index=True, return_inverse=True
    )
    place = np.arange(len(points))
    place[corners] = corners[first[inverse.ravel()]]
    return place[faces]


def _consistent(count, pairs, sign, vectors):
    """Return signs (count,) int8 that make triangles wind alike, and their pieces."""
    if (sign > 0).all():
        from scipy import sparse

        graph = sparse.coo_array(
            (np.ones(len(pairs), dtype=bool), pairs.T), shape=(count, count)
        )
        _, piece = sparse.csgraph.connected_components(graph, directed=False)
        return np.ones(count, dtype=np.int8), piece
    # Over flat edges first: where a piece has one side only, it breaks at a crease.
    facing = unit(vectors)
    doubt = 1 - np.abs((facing[pairs[:, 0]] * facing[pairs[:, 1]]).sum(axis=1))
    return spread_signs(count, pairs, np.maximum(doubt, 0), sign)


def _outward(points, faces, vectors, label, piece, closed):
    """Return the sign of each piece, (pieces,), that turns its faces outward."""
    size = np.linalg.norm(vectors, axis=1)
    area = np.maximum(np.bincount(piece, size), 1e-300)
    center = points[faces].mean(axis=1)
    middle = np.stack(
        [np.bincount(piece, size * axis) / area for axis in center.T], axis=1
    )
    arm = center - middle[piece]
    volume = np.bincount(piece, label * (arm * vectors).sum(axis=1))
    most = np.bincount(piece, np.linalg.norm(arm, axis=1) * size)
    says = np.abs(volume) > np.where(closed, _ROUNDING, _CLEAR) * most
    majority = np.bincount(piece, label * size)
    return np.where(np.where(says, volume, majority) < 0, -1, 1)
