# SPDX-License-Identifier: GPL-3.0-or-later
"""Signs: exact on analytic shapes, whatever the signs that came in."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from core import InputError, Settings, estimate_normals, orient_normals, shapes
from core.mesh.faces import face_vectors


def scrambled(normals, seed=0):
    signs = np.random.default_rng(seed).choice([-1, 1], len(normals))
    return normals * signs[:, None]


def wrong_sides(points, normals, **options):
    oriented = orient_normals(points, scrambled(normals), **options)
    return int(((oriented * normals).sum(axis=1) <= 0).sum())


@pytest.mark.parametrize("name", ["sphere", "torus", "bumpy"])
def test_propagation_turns_closed_surfaces_outward(name):
    points, normals, _ = shapes.ALL[name].sample(2000, 1)
    assert wrong_sides(points, normals, mode="propagate") == 0
    assert wrong_sides(points, normals) == 0


def test_each_piece_is_turned_on_its_own():
    points, normals, _ = shapes.SPHERE.sample(500, 1)
    two = np.concatenate([points, points + [5, 0, 0], points * 0.2 + [0, 9, 0]])
    assert wrong_sides(two, np.tile(normals, (3, 1)), mode="propagate") == 0
    assert wrong_sides(two, np.tile(normals, (3, 1)), mode="outward") == 0


def test_an_open_surface_is_consistent():
    points, normals, _ = shapes.PARABOLOID.sample(1000, 2)
    assert wrong_sides(points, normals, mode="propagate") in (0, 1000)


def test_viewpoint():
    points, normals, _ = shapes.PLANE.sample(300, 1)
    up = orient_normals(
        points, scrambled(normals), mode="viewpoint", viewpoint=(0, 0, 5)
    )
    np.testing.assert_array_equal(up, np.tile([0, 0, 1], (300, 1)))
    # A path that dives below the plane halfway.
    path = np.tile([0.0, 0, 5], (300, 1))
    path[150:, 2] = -5
    mixed = orient_normals(points, scrambled(normals), mode="viewpoint", viewpoint=path)
    np.testing.assert_array_equal(mixed[:150, 2], 1)
    np.testing.assert_array_equal(mixed[150:, 2], -1)


def test_reference_and_none():
    points, normals, _ = shapes.SPHERE.sample(300, 1)
    mixed = scrambled(normals)
    np.testing.assert_array_equal(
        orient_normals(points, mixed, mode="reference", reference=normals), normals
    )
    np.testing.assert_array_equal(orient_normals(points, mixed, mode="none"), mixed)


def test_a_mesh_as_reference():
    points, normals, _ = shapes.SPHERE.sample(2000, 1, even=False)
    mixed = scrambled(normals)
    # A cube of twelve large triangles around the sphere, wound inward.
    corner = np.array(np.meshgrid(*[[-2.0, 2.0]] * 3, indexing="ij")).reshape(3, -1).T
    faces = ConvexHull(corner).simplices
    out = face_vectors(corner, faces) * corner[faces].mean(axis=1)
    faces = np.where(out.sum(axis=1, keepdims=True) > 0, faces[:, ::-1], faces)
    found = orient_normals(
        points + 1e4, mixed, mode="reference", reference=(corner + 1e4, faces)
    )
    np.testing.assert_array_equal(found, -normals)
    estimate = estimate_normals(
        points, settings=Settings(orientation="reference", reference=(corner, faces))
    )
    assert ((estimate.normals * normals).sum(axis=1) < 0).all()


def test_small_parts_of_large_triangles_stand_for_them():
    # One triangle of a thousand others' size: its middle is far from its ends.
    vertices = np.array([[0.0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 1], [0, 0, 1.1]])
    vertices = np.append(vertices, [[0.1, 0, 1]], axis=0)
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    points = np.array([[9.5, 0.1, 0.1], [0.1, 9.5, 0.1], [0.01, 0, 1.0]])
    up = np.tile([0.0, -1, 1] / np.sqrt(2), (3, 1))
    found = orient_normals(points, up, mode="reference", reference=(vertices, faces))
    # The small one faces y.
    np.testing.assert_array_equal(found, up * [[1], [1], [-1]])


def test_edges_whose_faces_disagree_are_reported_and_repaired():
    points = shapes.SPHERE.sample(500, 1)[0]
    faces = ConvexHull(points).simplices
    inward = (face_vectors(points, faces) * points[faces[:, 0]]).sum(axis=1) < 0
    faces = np.where(inward[:, None], faces[:, ::-1], faces).astype(np.int64)
    mixed = faces.copy()
    mixed[::2] = mixed[::2, ::-1]
    asis = estimate_normals(points, faces=mixed)
    assert asis.orientation.inconsistent > 100
    assert "wind against" in asis.orientation.warnings[0]
    fixed = estimate_normals(points, faces=mixed, settings=Settings(winding="repaired"))
    assert fixed.orientation.inconsistent == 0
    assert fixed.orientation.warnings == ()
    assert fixed.summary()["flipped_faces"] == len(mixed[::2])
    np.testing.assert_array_equal(
        fixed.normals, estimate_normals(points, faces=faces).normals
    )


def test_faces_and_loose_vertices():
    # A tetrahedron wound inward, and a loose vertex beside its last corner.
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1.1]])
    faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    center = points[:4].mean(axis=0)
    outward = points - center
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    found = orient_normals(points, scrambled(outward), mode="faces", faces=faces)
    np.testing.assert_array_equal(found, -outward)


def test_zero_normals_stay_zero_and_part_nothing():
    points, normals, _ = shapes.SPHERE.sample(1000, 1)
    normals[::7] = 0
    oriented = orient_normals(points, scrambled(normals))
    np.testing.assert_array_equal(oriented, normals)


def test_order_does_not_matter():
    points, normals, _ = shapes.BUMPY.sample(800, 5)
    mixed = scrambled(normals)
    order = np.random.default_rng(1).permutation(800)
    np.testing.assert_array_equal(
        orient_normals(points[order], mixed[order]),
        orient_normals(points, mixed)[order],
    )


@settings(max_examples=12, deadline=None)
@given(
    st.sampled_from(["sphere", "torus", "bumpy"]),
    st.integers(0, 1000),
    st.sampled_from([1e-6, 1.0, 1e6]),
    st.sampled_from([0.0, 1e6]),
    st.sampled_from([1, 2, 5]),
)
def test_sides_do_not_depend_on_how_a_cloud_comes(name, seed, size, offset, threads):
    points, normals, _ = shapes.ALL[name].sample(1500, 1)
    rng = np.random.default_rng(seed)
    turn, order = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.permutation(1500)
    moved = size * (points[order] @ turn.T + offset)
    found = estimate_normals(moved, settings=Settings(threads=threads))
    truth = normals[order] @ turn.T
    assert ((found.normals * truth).sum(axis=1) > 0).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mode": "sideways"}, "orientation"),
        ({"mode": "viewpoint"}, "a viewpoint"),
        ({"mode": "viewpoint", "viewpoint": (1, 2)}, "shape"),
        ({"mode": "reference"}, "reference normals"),
        ({"mode": "reference", "reference": [[0, 0, 1]]}, "9 reference normals"),
        ({"mode": "faces"}, "faces"),
        ({"mode": "reference", "reference": ([[0, 0, 1]], [[0, 0, 1]])}, "from 0 to 0"),
    ],
)
def test_what_a_mode_needs(options, message):
    points = np.random.default_rng(0).normal(size=(9, 3))
    with pytest.raises(InputError, match=message):
        orient_normals(points, points, **options)
