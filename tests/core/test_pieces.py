# SPDX-License-Identifier: GPL-3.0-or-later
"""Pieces: by edges of faces, and by the sheets that points lie on."""

import numpy as np
import pytest

from core import shapes
from core.orient.pieces import connected_pieces


def test_vertices_hang_together_along_faces():
    faces = np.array([[0, 1, 2], [2, 3, 1], [4, 5, 6]])
    points = np.random.default_rng(0).normal(size=(8, 3))
    piece = connected_pieces(points, points, faces)
    np.testing.assert_array_equal(piece, [0, 0, 0, 0, 1, 1, 1, 2])


@pytest.mark.parametrize("gap", [1.0, 0.1, 0.08])
def test_sheets_are_pieces_however_close(gap):
    # 2000 points on a unit sphere are 0.08 apart, 0.14 to the sixth neighbor.
    points, normals, _ = shapes.SPHERE.sample(2000, 1)
    both = np.concatenate([points, points * (1 + gap)])
    signs = np.random.default_rng(0).choice([-1, 1], (4000, 1))
    piece = connected_pieces(both, np.tile(normals, (2, 1)) * signs)
    np.testing.assert_array_equal(piece, np.repeat([0, 1], 2000))


def test_a_crease_parts_nothing():
    u, v = np.random.default_rng(0).uniform(0.005, 1, (2, 2000))
    none = np.zeros(2000)
    floor, wall = np.stack([u, v, none], axis=1), np.stack([none, v, u], axis=1)
    normals = np.repeat(np.eye(3)[[2, 0]], 2000, axis=0)
    assert not connected_pieces(np.concatenate([floor, wall]), normals).any()


def test_a_single_point_is_a_piece():
    np.testing.assert_array_equal(connected_pieces(np.zeros((1, 3)), np.eye(3)[:1]), 0)
