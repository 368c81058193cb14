# SPDX-License-Identifier: GPL-3.0-or-later
"""A clean mesh on an exact surface, and its true normals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from core.mesh.faces import face_vectors, unit

# What a turn of a normal weighs beside a distance, as a share of the solid's size, when
# a face looks for its piece: both sides of a crease are near, one faces as it does.
_TURN_WEIGHT = 0.1


@dataclass(frozen=True)
class Solid:
    """A clean mesh on an exact surface.

    Attributes
    ----------
    points, faces : (n, 3) float64, (m, 3) int
    piece : (m,) int
        Which of the pieces each face belongs to.
    normals : list of callables (p, 3) -> (p, 3)
        The unit normals of the pieces.
    field : callable (p, 3) -> (p,) or None
        Negative inside, zero on the surface of smooth solids.
    cells : int
        Voxels along the longest side, so that the thinnest part is three wide.
    """

    name: str
    points: np.ndarray
    faces: np.ndarray
    piece: np.ndarray
    normals: Sequence[Callable]
    field: Callable | None = None
    cells: int = 32

    @property
    def creased(self):
        return len(self.normals) > 1

    def corner_truth(self, points, faces, piece):
        """Return the normals of the faces' pieces at their corners, (m, 3, 3)."""
        truth = np.empty((len(faces), 3, 3))
        for number, normals in enumerate(self.normals):
            at = piece == number
            truth[at] = normals(points[faces[at]].reshape(-1, 3)).reshape(-1, 3, 3)
        return truth

    def pieces_near(self, points, faces):
        """Return the pieces of the faces of another mesh of the same solid."""
        size = _TURN_WEIGHT * np.ptp(self.points, axis=0).max()
        own, other = (
            np.hstack([p[f].mean(axis=1), size * unit(face_vectors(p, f))])
            for p, f in ((self.points, self.faces), (points, faces))
        )
        return self.piece[cKDTree(own).query(other)[1]]

    def sharp_edges(self):
        """Return the edges (e, 2) between faces whose pieces meet at an angle."""
        ends, first, second = paired_sides(self.faces)
        apart = self.piece[first] != self.piece[second]
        ends, first, second = ends[apart], first[apart], second[apart]
        middle = self.points[ends].mean(axis=1)
        cosine = np.empty(len(ends))
        for i, (p, a, b) in enumerate(zip(middle, first, second, strict=True)):
            one, two = (self.normals[self.piece[f]](p[None])[0] for f in (a, b))
            cosine[i] = one @ two
        return ends[cosine < np.cos(np.radians(20))]


def paired_sides(faces):
    """Return the sides that two faces share: ends (s, 2), both faces (s,) each."""
    sides = np.sort(
        np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1
    )
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort(sides.T)
    sides, owner = sides[order], owner[order]
    same = np.flatnonzero((sides[1:] == sides[:-1]).all(axis=1))
    return sides[same], owner[same], owner[same + 1]


def cut(squares):
    """Return the squares as triangles, cut at random, and the square of each."""
    turn = np.random.default_rng(1).random(len(squares)) < 0.5
    squares = np.where(turn[:, None], np.roll(squares, 1, axis=1), squares)
    faces = np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])
    return faces, np.tile(np.arange(len(squares)), 2)
