# SPDX-License-Identifier: GPL-3.0-or-later
"""The baseline: against closed forms and against scipy's triangulation."""

import numpy as np
import pytest
from scipy.spatial import Delaunay

from core import InputError, compare_normals, delaunay_normals, shapes
from core.delaunay import _star
from core.mesh.faces import vertex_normals


def test_area_weights_of_the_paper_written_out():
    points = np.array([[0.0, 0, 0], [2, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = [[0, 1, 2], [0, 2, 3]]
    # Areas 1 and 1/2, normals z and x: at vertex 0 and 2 their weighted mean.
    mean = np.array([0.5, 0, 1]) / np.hypot(0.5, 1)
    np.testing.assert_allclose(
        delaunay_normals(points, faces=faces), [mean, [0, 0, 1], mean, [1, 0, 0]]
    )


def test_a_vertex_without_faces_has_no_normal():
    points = np.eye(4, 3)
    normals = delaunay_normals(points, faces=[[0, 1, 2], [3, 3, 0]])
    np.testing.assert_array_equal(normals[3], 0)
    np.testing.assert_allclose(normals[:3], np.full((3, 3), 3**-0.5))


def test_max_weights_are_exact_on_a_sphere():
    points, normals, _ = shapes.SPHERE.sample(300, 0)
    faces = Delaunay(points[:, :2] / (1 + points[:, 2:])).simplices
    # Stereographic projection: every triangle but those at the far pole is a face
    # of the sphere's own triangulation, and inner vertices have all of theirs.
    inner = points[:, 2] > -0.5
    found = vertex_normals(points, faces, weights="max")
    cosine = np.abs((found * normals).sum(axis=1))[inner]
    np.testing.assert_allclose(cosine, 1, atol=1e-12)


def test_parameters():
    points, normals, parameters = shapes.PHI1.sample(2571, 1)
    found = delaunay_normals(points, parameters=parameters)
    summary = compare_normals(found, found, truth=normals).summary()
    # Section 2 of the notes on the method measures 1.3e-2 on such samples.
    assert 0.01 < summary["error_baseline_median"] < 0.02


def star_of_the_first(points):
    x, y = points.T[:, :, None]
    corners = [corner for _, *ab in _star(x, y) for corner in np.concatenate(ab)]
    return set(corners)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_star_is_the_delaunay_neighborhood(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(40, 2))
    points[0] = 0
    triangulation = Delaunay(points)
    start, neighbors = triangulation.vertex_neighbor_vertices
    expected = set(neighbors[start[0] : start[1]])
    assert star_of_the_first(points) == expected


def test_star_of_a_hull_vertex_is_open():
    rng = np.random.default_rng(3)
    points = np.concatenate([[[0.0, 0]], rng.uniform(0.1, 1, (30, 2))])
    start, neighbors = Delaunay(points).vertex_neighbor_vertices
    expected = set(neighbors[start[0] : start[1]])
    assert star_of_the_first(points) == expected


def test_points_alone_agree_with_the_triangulation_of_a_plane_graph():
    points, normals, parameters = shapes.PARABOLOID.sample(1000, 1)
    alone = delaunay_normals(points)
    told = delaunay_normals(points, parameters=parameters)
    # The tangent planes differ from the parameter plane, so some stars do too; the
    # errors of the two baselines are alike.
    alone = compare_normals(alone, told, truth=normals).summary()
    assert alone["compared"] == 1000
    ratio = alone["error_estimate_median"] / alone["error_baseline_median"]
    assert 0.8 < ratio < 1.2


def test_twins_and_a_plane():
    points, _, _ = shapes.PLANE.sample(200, 1)
    normals = delaunay_normals(np.concatenate([points, points]))
    np.testing.assert_allclose(
        np.abs(normals), np.tile([0, 0, 1], (400, 1)), atol=1e-12
    )


def test_large_offsets():
    points, _, _ = shapes.SPHERE.sample(500, 1)
    far = delaunay_normals(points + [500000.0, 5000000.0, 100])
    # Coordinates of 5e6 are rounded to 1e-9, edges are 0.1 long.
    np.testing.assert_allclose(far, delaunay_normals(points), atol=1e-6)


def test_bad_input():
    points = np.eye(3)
    with pytest.raises(InputError, match="both"):
        delaunay_normals(points, faces=[[0, 1, 2]], parameters=points[:, :2])
    with pytest.raises(InputError, match="parameters"):
        delaunay_normals(points, parameters=points)
    with pytest.raises(InputError, match="at least 3"):
        delaunay_normals(points[:2])


def test_delaunay_from_the_points_alone_says_how_far_it_is():
    points, _, _ = shapes.TORUS.sample(50_000, 0, even=False)
    seen = []
    delaunay_normals(points, progress=seen.append)
    assert seen == sorted(seen)
    assert len(seen) > 2
    assert 0 <= seen[0] < seen[-1] <= 1
