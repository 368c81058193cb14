# SPDX-License-Identifier: GPL-3.0-or-later
"""Neighbor graphs against brute force and known triangulations."""

import numpy as np
import pytest

from core import InputError, NeighborGraph, shapes
from core.neighbors.graph import NearestNeighbors, delaunay_simplices


def brute_force(points, count):
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    return np.sort(distance, axis=1)[:, :count]


def test_nearest_are_the_nearest():
    points = np.random.default_rng(0).normal(size=(300, 3))
    rows = np.arange(300)
    index, distance = NearestNeighbors(points).neighbors(rows, 7)
    np.testing.assert_allclose(distance, brute_force(points, 7))
    np.testing.assert_allclose(
        np.linalg.norm(points[index] - points[:, None], axis=-1), distance
    )
    assert (index != rows[:, None]).all()


def test_a_point_is_not_its_own_neighbor_among_twins():
    points = np.repeat(np.eye(3), 5, axis=0)
    rows = np.arange(15)
    index, distance = NearestNeighbors(points).neighbors(rows, 3)
    assert (distance == 0).all()
    assert (index != rows[:, None]).all()


def test_radius_leaves_the_point_itself_in_the_row():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]])
    index, distance = NearestNeighbors(points).neighbors(np.arange(3), 2, radius=1.5)
    np.testing.assert_array_equal(index, [[1, 0], [0, 1], [2, 2]])
    np.testing.assert_array_equal(distance, [[1, 0], [1, 0], [0, 0]])


def test_mesh_rings():
    # A strip of four triangles over six vertices.
    faces = [[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4]]
    graph = NeighborGraph.mesh(6, faces)
    np.testing.assert_array_equal(graph.row(0), [1, 2])
    np.testing.assert_array_equal(graph.row(3), [1, 2, 4, 5])
    np.testing.assert_array_equal(graph.degrees, [2, 3, 4, 4, 3, 2])
    assert len(graph.edges) == 9
    grown = graph.extended(3)
    np.testing.assert_array_equal(grown.row(0), [1, 2, 3, 4])
    # Rows that were long enough stay as they were.
    np.testing.assert_array_equal(grown.row(3), [1, 2, 4, 5])


def test_extension_stops_at_the_end_of_a_piece():
    graph = NeighborGraph.mesh(7, [[0, 1, 2], [3, 4, 5], [4, 5, 6]])
    grown = graph.extended(8)
    np.testing.assert_array_equal(grown.degrees, [2, 2, 2, 3, 3, 3, 3])


def test_extension_by_rings_is_distance_in_the_graph():
    from scipy.sparse.csgraph import shortest_path

    _points, _, parameters = shapes.PLANE.sample(120, 3)
    graph = NeighborGraph.mesh(120, delaunay_simplices(parameters))
    steps = shortest_path(graph.matrix, unweighted=True)
    grown = graph.extended(10)
    for i in range(120):
        rings = next(r for r in range(1, 9) if (steps[i] <= r).sum() - 1 >= 10)
        expected = np.flatnonzero((steps[i] <= rings) & (steps[i] > 0))
        np.testing.assert_array_equal(grown.row(i), expected)


def test_neighbors_fill_rows_with_the_point_itself():
    graph = NeighborGraph.from_edges(4, [[0, 1], [0, 2]])
    np.testing.assert_array_equal(
        graph.neighbors(np.array([1, 0, 3])), [[0, 1], [1, 2], [3, 3]]
    )


def test_delaunay_of_a_cube_and_its_center():
    corners = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1]), axis=-1).reshape(-1, 3)
    points = np.concatenate([corners, [[0.5, 0.5, 0.5]]]).astype(float)
    graph = NeighborGraph.delaunay(points)
    np.testing.assert_array_equal(graph.row(8), np.arange(8))


def test_delaunay_of_a_plane_is_planar():
    points, _, parameters = shapes.PLANE.sample(200, 1)
    tilted = points @ np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    graph = NeighborGraph.delaunay(tilted)
    expected = NeighborGraph.mesh(200, delaunay_simplices(parameters))
    np.testing.assert_array_equal(graph.edges, expected.edges)


def test_delaunay_of_a_sphere_has_no_hub():
    points, _, _ = shapes.SPHERE.sample(1000, 0)
    assert NeighborGraph.delaunay(points).degrees.max() < 200


def test_delaunay_does_not_depend_on_the_order():
    points, _, _ = shapes.SPHERE.sample(300, 0)
    order = np.random.default_rng(0).permutation(300)
    graph, shuffled = (
        NeighborGraph.delaunay(points),
        NeighborGraph.delaunay(points[order]),
    )
    expected = np.sort(order[shuffled.edges], axis=1)
    assert set(map(tuple, expected)) == set(map(tuple, graph.edges))


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        ([[0, 1, 9]], "0 to 3"),
        ([[0, 1, -1]], "-1"),
        ([[0.0, 1.0, 2.0]], "integers"),
        ([[0, 1]], r"\(m, 3\)"),
        ([], "at least one face"),
    ],
)
def test_bad_faces(faces, message):
    with pytest.raises(InputError, match=message):
        NeighborGraph.mesh(4, faces)
