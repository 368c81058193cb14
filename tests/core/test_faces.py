# SPDX-License-Identifier: GPL-3.0-or-later
"""Vertices parted along edges."""

import numpy as np
import pytest

from core import estimate_normals
from core.mesh.faces import face_vectors, fan_means, split_fans, unit

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4)]
QUADS.append((1, 5, 7, 3))
FACES = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])
CREASES = np.array([(q[i], q[(i + 1) % 4]) for q in QUADS for i in range(4)])
NO_EDGES = np.zeros((0, 2), int)


def test_without_edges_nothing_is_parted():
    fans, vertex = split_fans(8, FACES, NO_EDGES)
    np.testing.assert_array_equal(fans, FACES)
    np.testing.assert_array_equal(vertex, np.arange(8))


def test_cube_falls_apart_into_its_sides():
    fans, vertex = split_fans(8, FACES, CREASES)
    assert len(vertex) == 24
    np.testing.assert_array_equal(vertex[fans], FACES)
    sides = [set(pair.ravel()) for pair in fans.reshape(6, 2, 3)]
    assert [len(side) for side in sides] == [4] * 6
    assert len(set.union(*sides)) == 24


def test_estimate_on_fans_has_the_normals_of_the_sides():
    fans, vertex = split_fans(8, FACES, CREASES)
    found = estimate_normals(CUBE[vertex], faces=fans)
    expected = np.repeat(unit(face_vectors(CUBE, FACES))[:, None], 3, axis=1)
    np.testing.assert_allclose(found.normals[fans], expected, atol=1e-12)


def test_mean_of_the_sides_of_a_cube_is_its_diagonal():
    fans, vertex = split_fans(8, FACES, CREASES)
    found = estimate_normals(CUBE[vertex], faces=fans).normals
    np.testing.assert_allclose(fan_means(found, vertex, 8), unit(CUBE), atol=1e-12)
    nothing = fan_means(np.array([[0, 0, 1.0], [0, 0, -1.0]]), np.zeros(2, int), 2)
    assert (nothing == 0).all()


def test_edge_that_ends_inside_parts_nothing_at_its_end():
    # A disk of six triangles around vertex 0.
    faces = np.array([(0, i + 1, (i + 1) % 6 + 1) for i in range(6)])
    fans, vertex = split_fans(7, faces, np.array([(1, 0)]))
    np.testing.assert_array_equal(vertex, [*range(7), 1])
    assert len(np.unique(fans[faces == 0])) == 1
    _, vertex = split_fans(7, faces, np.array([(1, 0), (0, 4)]))
    np.testing.assert_array_equal(np.bincount(vertex), [2, 2, 1, 1, 2, 1, 1])


def test_edge_of_three_triangles_keeps_them_together_or_parts_all():
    faces = np.array([(0, 1, 2), (0, 1, 3), (0, 1, 4)])
    fans, vertex = split_fans(5, faces, np.array([(2, 0)]))
    assert len(vertex) == 5
    fans, vertex = split_fans(5, faces, np.array([(0, 1)]))
    assert len(vertex) == 9
    assert len(np.unique(fans)) == 9


def test_vertices_without_a_face_keep_their_number():
    fans, vertex = split_fans(11, FACES, CREASES)
    np.testing.assert_array_equal(vertex[:11], np.arange(11))
    assert not np.isin(fans, [8, 9, 10]).any()


@pytest.mark.parametrize("seed", range(3))
def test_fans_are_those_of_a_walk_around_each_vertex(seed):
    rng = np.random.default_rng(seed)
    grid = np.arange(25).reshape(5, 5)
    a, b, c, d = (
        grid[i : i + 4, j : j + 4].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))
    )
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = sides[rng.random(len(sides)) < 0.4]
    fans, vertex = split_fans(25, faces, edges)
    cut = {frozenset(edge) for edge in edges.tolist()}
    for v in range(25):
        groups = [{i} for i in np.flatnonzero((faces == v).any(axis=1))]
        for other in range(25):
            if frozenset((v, other)) in cut:
                continue
            around = (faces == v).any(axis=1) & (faces == other).any(axis=1)
            near = set(np.flatnonzero(around)) if v != other else set()
            hit = [group for group in groups if group & near]
            if hit:
                groups = [g for g in groups if g not in hit] + [set.union(*hit)]
        assert (vertex == v).sum() == len(groups)
        for group in groups:
            rows = sorted(group)
            assert len(np.unique(fans[rows][faces[rows] == v])) == 1
