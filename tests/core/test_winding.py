# SPDX-License-Identifier: GPL-3.0-or-later
"""Winding: turned faces found, pieces outward, cavities inward."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from core import InputError, shapes
from core.mesh.faces import face_vectors
from core.orient.nesting import depths
from core.orient.winding import count_inconsistent, find_flipped_faces


def ball(count=300, radius=1.0, center=(0, 0, 0)):
    """A closed mesh of a sphere, wound outward."""
    points = shapes.SPHERE.sample(count, 1)[0]
    faces = ConvexHull(points).simplices
    inward = (face_vectors(points, faces) * points[faces[:, 0]]).sum(axis=1) < 0
    faces[inward] = faces[inward, ::-1]
    return points * radius + center, faces


def together(*meshes):
    """One mesh of several."""
    count = np.cumsum([0, *(len(points) for points, _ in meshes)])
    return np.concatenate([points for points, _ in meshes]), np.concatenate(
        [faces + at for (_, faces), at in zip(meshes, count, strict=False)]
    )


def grid(rows, columns):
    """Triangles over a grid of vertices, all wound alike."""
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (
        part.ravel()
        for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    )
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def turned(faces, share, seed=0):
    some = np.random.default_rng(seed).uniform(size=len(faces)) < share
    return np.where(some[:, None], faces[:, ::-1], faces), some


@pytest.mark.parametrize("share", [0.0, 0.05, 0.5, 1.0])
def test_turned_faces_of_a_closed_mesh_are_found(share):
    points, faces = ball()
    mixed, some = turned(faces, share)
    found = find_flipped_faces(points, mixed)
    np.testing.assert_array_equal(found.flipped, some)
    assert (found.border, found.nonmanifold, found.onesided) == (0, 0, 0)
    repaired = found.repaired(mixed)
    # Each triangle starts at any of its corners, but runs around the same way.
    assert (
        (face_vectors(points, repaired) * points[faces[:, 0]]).sum(axis=1) > 0
    ).all()
    assert find_flipped_faces(points, repaired).inconsistent == 0


def test_edges_that_disagree_are_counted():
    points, faces = ball()
    faces[7] = faces[7, ::-1]
    assert find_flipped_faces(points, faces).inconsistent == 3
    # Each of the three edges is run along twice in the same direction.
    assert count_inconsistent(faces, len(points)) == 3


def test_pieces_are_turned_each_on_its_own():
    points, faces = together(
        ball(), ball(center=(5, 0, 0), radius=0.1), ball(center=(0, 9, 0), radius=3)
    )
    size = len(faces) // 3
    faces[:size] = faces[:size, ::-1]
    found = find_flipped_faces(points, faces)
    np.testing.assert_array_equal(found.flipped, np.arange(len(faces)) < size)
    assert found.piece.max() == 2


def test_nested_pieces_are_cavities_or_bodies():
    # A ball in a cavity in a ball, and one beside them.
    points, faces = together(
        ball(), ball(radius=0.8), ball(radius=0.5), ball(center=(3, 0, 0))
    )
    size = len(faces) // 4
    number = np.arange(len(faces)) // size
    found = find_flipped_faces(points, faces)
    np.testing.assert_array_equal(found.flipped, number == 1)
    assert not find_flipped_faces(points, faces, nested="outward").flipped.any()


def test_depths_of_many_pieces_in_one():
    rng = np.random.default_rng(0)
    inside = rng.uniform(-0.5, 0.5, (60, 3))
    outside = rng.uniform(-0.5, 0.5, (40, 3)) + [3.0, 0, 0]
    meshes = [ball(30, 1e-3, at) for at in np.concatenate([inside, outside])]
    points, faces = together(ball(), *meshes)
    size = [len(each) for _, each in (ball(), *meshes)]
    piece = np.repeat(np.arange(101), size)
    found = depths(points, faces, piece, np.ones(101, dtype=bool))
    np.testing.assert_array_equal(found, np.repeat([0, 1, 0], [1, 60, 40]))


def test_split_vertices_are_one_place():
    # As an STL file has them: every triangle on its own.
    points, faces = ball()
    mixed, some = turned(faces, 0.3)
    found = find_flipped_faces(
        points[mixed.ravel()], np.arange(mixed.size).reshape(-1, 3)
    )
    np.testing.assert_array_equal(found.flipped, some)
    assert found.border == 0


def test_a_flat_sheet_keeps_the_side_of_most_of_it():
    y, x = np.meshgrid(*[np.linspace(0, 1, 9)] * 2)
    points = np.stack([x.ravel(), y.ravel(), np.zeros(81)], axis=1)
    for faces in (grid(9, 9), grid(9, 9)[:, ::-1]):
        mixed, some = turned(faces, 0.2)
        np.testing.assert_array_equal(find_flipped_faces(points, mixed).flipped, some)


def test_an_open_bowl_faces_outward():
    points, faces = ball()
    faces = faces[points[faces, 2].min(axis=1) < 0.3][:, ::-1]
    assert find_flipped_faces(points, faces).flipped.all()


def test_a_strip_with_one_side_breaks_once():
    turn = np.linspace(0, 2 * np.pi, 41)[:-1]
    across = np.linspace(-0.3, 0.3, 4)
    t, s = np.meshgrid(turn, across, indexing="ij")
    r = 1 + s * np.cos(t / 2)
    points = np.stack([r * np.cos(t), r * np.sin(t), s * np.sin(t / 2)], axis=-1)
    number = np.arange(160).reshape(40, 4)
    # Once around, the strip meets itself upside down.
    number = np.concatenate([number, number[:1, ::-1]])
    a, b = number[:-1, :-1].ravel(), number[1:, :-1].ravel()
    c, d = number[1:, 1:].ravel(), number[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    found = find_flipped_faces(points.reshape(-1, 3), faces)
    assert found.onesided >= 3
    assert found.piece.max() == 0


def test_edges_of_three_faces_and_faces_without_area():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 1], [0, -1, -1]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 0, 1]])
    found = find_flipped_faces(points, faces)
    assert (found.nonmanifold, found.border) == (1, 6)
    assert not found.flipped.any()


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_scale_and_place_do_not_matter(scale):
    points, faces = together(ball(), ball(radius=0.5))
    mixed, _ = turned(faces, 0.3)
    moved = find_flipped_faces((points + [1e3, -1e3, 1e3]) * scale, mixed)
    here = find_flipped_faces(points, mixed)
    np.testing.assert_array_equal(moved.flipped, here.flipped)


def test_the_order_of_faces_does_not_matter():
    points, faces = together(ball(), ball(radius=0.5))
    mixed, _ = turned(faces, 0.3)
    order = np.random.default_rng(1).permutation(len(mixed))
    np.testing.assert_array_equal(
        find_flipped_faces(points, mixed[order]).flipped,
        find_flipped_faces(points, mixed).flipped[order],
    )


def test_without_faces_there_is_nothing_to_wind():
    with pytest.raises(InputError, match="at least one face"):
        find_flipped_faces(np.eye(3), np.empty((0, 3), dtype=int))
