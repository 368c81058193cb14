# SPDX-License-Identifier: GPL-3.0-or-later
"""Inside and outside: exact on closed surfaces, however close their sheets."""

from functools import partial

import numpy as np
import pytest

from core import shapes
from core.orient.orientation import find_orientation
from core.orient.poles import label_poles
from core.orient.representatives import measure, representatives
from core.orient.sides import find_sides
from core.orient.smoothing import smooth
from core.orient.tree import spread_signs


def scrambled(normals, seed=0):
    signs = np.random.default_rng(seed).choice([-1, 1], len(normals))
    return normals * signs[:, None]


def wrong_share(points, normals, given=None):
    """Share of the points whose side is not that of the true normals."""
    mixed = scrambled(normals if given is None else given)
    sides = find_sides(points, mixed)
    assert sides is not None
    return float(((mixed * sides.signs[:, None] * normals).sum(axis=1) <= 0).mean())


def box(count, half, seed=0):
    """Points on the faces of a box, and their outward normals."""
    rng = np.random.default_rng(seed)
    half = np.asarray(half, dtype=float)
    area = np.repeat(half.prod() / half, 2)
    face = rng.choice(6, count, p=area / area.sum())
    axis, side, row = face // 2, np.where(face % 2, 1.0, -1.0), np.arange(count)
    points = rng.uniform(-1, 1, (count, 3)) * half
    points[row, axis] = side * half[axis]
    normals = np.zeros((count, 3))
    normals[row, axis] = side
    return points, normals


def bowl(count, spacings, seed=0):
    """Two half spheres, a few spacings apart, without the rim between them."""
    rng = np.random.default_rng(seed)
    gap = spacings * np.sqrt(4 * np.pi / count)
    normals = rng.normal(size=(count, 3))
    normals[:, 2] = -np.abs(normals[:, 2])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = normals.copy()
    points[::2] *= 1 - gap
    normals[::2] *= -1
    return points, normals


def wave(count, seed=0):
    """An open height field."""
    x, y = np.random.default_rng(seed).uniform(-1, 1, (2, count))
    normals = np.stack(
        [
            -np.cos(4 * x) * np.cos(3 * y),
            0.75 * np.sin(4 * x) * np.sin(3 * y),
            1 + 0 * x,
        ],
        axis=1,
    )
    points = np.stack([x, y, 0.25 * np.sin(4 * x) * np.cos(3 * y)], axis=1)
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def test_signs_along_a_tree_of_the_lightest_edges():
    # The heavy edges contradict the light ones; the last two nodes are a part apart.
    edges = np.array([[0, 1], [1, 2], [0, 2], [2, 1], [4, 3]])
    weight = np.array([0.1, 0.2, 0.9, 0.8, 0.0])
    sign = np.array([-1, -1, -1, 1, -1], dtype=np.int8)
    label, part = spread_signs(5, edges, weight, sign, root=2)
    np.testing.assert_array_equal(label, [1, -1, 1, 1, -1])
    np.testing.assert_array_equal(part == part[0], [True, True, True, False, False])


def test_a_long_path_is_walked_in_few_rounds():
    count = 100_000
    edges = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
    sign = np.random.default_rng(0).choice([-1, 1], count - 1).astype(np.int8)
    label, _ = spread_signs(count, edges, np.ones(count - 1), sign)
    np.testing.assert_array_equal(label, np.cumprod(np.append(1, sign)))


def test_without_edges_every_node_is_its_own():
    none = np.empty((0, 2), dtype=int)
    label, part = spread_signs(3, none, np.empty(0), np.empty(0, dtype=np.int8))
    np.testing.assert_array_equal(label, 1)
    np.testing.assert_array_equal(np.sort(part), [0, 1, 2])


def test_poles_of_a_sphere_are_its_center_and_far_away():
    points, normals, _ = shapes.SPHERE.sample(500, 1)
    labels = label_poles(points, -normals, np.full(500, 0.15))
    np.testing.assert_array_equal(labels.signs, -1)
    assert not labels.open
    # The outer pole stands over a triangle that may lean by the angle between
    # neighbors, 0.16: both together by less than one and a half of it.
    assert labels.clarity.min() > np.cos(0.24)


@pytest.mark.parametrize("name", ["sphere", "torus", "bumpy"])
def test_closed_surfaces_face_outward(name):
    points, normals, _ = shapes.ALL[name].sample(3000, 1)
    assert wrong_share(points, normals) == 0


def test_flat_sides_and_a_grid_on_them():
    assert wrong_share(*box(6000, (1, 1, 1))) == 0
    # Thousands of points in one plane, four on every circle.
    u, v = (a.ravel() for a in np.meshgrid(*[np.linspace(-0.95, 0.95, 20)] * 2))
    one = np.ones_like(u)
    sides = [
        np.stack(np.roll([s * one, u, v], k, axis=0)) for s in (-1, 1) for k in range(3)
    ]
    points = np.concatenate([side.T for side in sides])
    normals = np.where(np.abs(points) == 1, points, 0)
    assert wrong_share(points, normals) == 0


def test_sheets_two_spacings_apart():
    # The narrow sides are two points wide: one in a thousand may guess.
    assert wrong_share(*box(10_000, (1, 1, 0.03))) <= 0.001
    # Without its rim the bowl is open there: the same.
    assert wrong_share(*bowl(10_000, 2.0)) <= 0.001


@pytest.mark.parametrize("seed", range(3))
def test_sheets_closer_than_some_holes_between_their_points(seed):
    # A few points see the far side through a hole in the other sheet.
    points, normals = bowl(10_000, 1.2, seed)
    assert wrong_share(points, normals) <= 0.05


def test_linked_rings():
    points, normals, _ = shapes.TORUS.sample(3000, 1)
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    both = np.concatenate([points, points @ turn.T + [1, 0, 0]])
    sides = np.concatenate([normals, normals @ turn.T])
    assert wrong_share(both, sides) == 0
    assert find_orientation(both, sides, mode="auto").pieces == 2


@pytest.mark.parametrize(("noise", "most"), [(0.006, 0.002), (0.012, 0.005)])
def test_noise_wider_than_the_spacing(noise, most):
    points, normals, _ = shapes.SPHERE.sample(15_000, 1, even=False)
    assert wrong_share(shapes.add_noise(points, noise, 2), normals) <= most


def test_noise_and_spacing_are_measured():
    points, normals, _ = shapes.SPHERE.sample(8000, 1, even=False)
    spacing, noise = measure(_nearest(points), normals)
    # The side of the square that each of 8000 has on the sphere.
    assert spacing == pytest.approx(np.sqrt(4 * np.pi / 8000), rel=0.1)
    assert noise == 0
    moved = points * (1 + 0.05 * np.random.default_rng(0).normal(size=(8000, 1)))
    _, noise = measure(_nearest(moved), normals)
    assert noise == pytest.approx(0.05, rel=0.2)


def test_smoothing_brings_points_back_to_the_surface():
    points, normals, _ = shapes.SPHERE.sample(8000, 1, even=False)
    rng = np.random.default_rng(0)
    moved = points * (1 + 0.03 * rng.normal(size=(8000, 1)))
    place, facing = smooth(_nearest(moved), moved[:300], normals[:300], 0.15)
    # Six unknowns from some forty neighbors, of which Gaussian weights count a half.
    assert np.std(np.linalg.norm(place, axis=1)) < 0.5 * 0.03
    assert np.abs((facing * place).sum(axis=1)).min() > 0.8


def test_outliers_change_nothing():
    points, normals, _ = shapes.BUMPY.sample(5000, 1)
    rng = np.random.default_rng(0)
    stray = rng.uniform(-1.4, 1.4, (100, 3))
    normal = rng.normal(size=(100, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    cloud = np.concatenate([points, stray])
    sides = find_sides(cloud, np.concatenate([normals, normal]))
    np.testing.assert_array_equal(sides.signs[:5000], 1)


def test_uneven_density():
    points, normals, _ = shapes.TORUS.sample(30_000, 1, even=False)
    rng = np.random.default_rng(0)
    stripe = np.floor(points[:, 0] * 8) % 2 == 0
    kept = rng.uniform(size=30_000) < np.where(stripe, 0.6, 0.05)
    assert wrong_share(points[kept], normals[kept]) <= 0.002


def test_an_open_surface_is_consistent_and_said_to_be_open():
    points, normals = wave(5000)
    sides = find_sides(points, scrambled(normals))
    assert sides.open
    assert wrong_share(points, normals) in (0, 1)
    found = find_orientation(points, normals, mode="auto")
    assert found.warnings and "open" in found.warnings[0]


@pytest.mark.parametrize(
    ("shape", "count", "most"), [(shapes.PHI1, 2571, 0.013), (shapes.PHI2, 2295, 0.02)]
)
@pytest.mark.parametrize("seed", [0, 1, 5])
def test_crossing_sheets(shape, count, most, seed):
    points, normals, _ = shape.sample(count, seed)
    share = wrong_share(points, normals)
    assert min(share, 1 - share) <= most


def test_sides_do_not_depend_on_the_order():
    points, normals = bowl(4000, 1.5)
    normals = scrambled(normals)
    order = np.random.default_rng(1).permutation(4000)
    first, second = (
        find_sides(points, normals),
        find_sides(points[order], normals[order]),
    )
    np.testing.assert_array_equal(second.signs, first.signs[order])
    np.testing.assert_allclose(second.confidence, first.confidence[order], atol=1e-12)


def test_sides_do_not_depend_on_the_threads():
    # More points than representatives, and noise: every search is in it.
    points, normals, _ = shapes.BUMPY.sample(8000, 3, even=False)
    points, normals = shapes.add_noise(points, 0.005, 1), scrambled(normals)
    one, all_cores = (
        find_sides(points, normals, most=3000, workers=workers) for workers in (1, -1)
    )
    np.testing.assert_array_equal(one.signs, all_cores.signs)
    np.testing.assert_array_equal(one.confidence, all_cores.confidence)
    np.testing.assert_array_equal(one.piece, all_cores.piece)


def test_sides_do_not_depend_on_those_that_came_in():
    points, normals = bowl(4000, 1.5)
    for seed in range(3):
        assert wrong_share(points, normals, scrambled(normals, seed)) == 0


def test_points_that_share_a_place():
    points, normals, _ = shapes.BUMPY.sample(2000, 1)
    order = np.random.default_rng(0).permutation(10_000) % 2000
    assert wrong_share(points[order], normals[order]) == 0


def test_a_sphere_by_latitude_and_longitude():
    # All on one sphere, rows of them on one circle, crowded at the ends.
    t, s = np.meshgrid((np.arange(60) + 0.5) * np.pi / 60, np.arange(120) * np.pi / 60)
    flat = np.sin(t)
    normals = np.stack([flat * np.cos(s), flat * np.sin(s), np.cos(t)], axis=-1)
    normals = normals.reshape(-1, 3)
    assert wrong_share(normals.copy(), normals) == 0


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_sides_turn_and_move_with_the_points(scale, offset):
    points, normals, _ = shapes.BUMPY.sample(2000, 3)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    moved = points @ turn.T * scale + offset * scale
    assert wrong_share(moved, normals @ turn.T) == 0


def test_representatives_keep_their_distance_and_number():
    points, _, _ = shapes.SPHERE.sample(5000, 1, even=False)
    rows = representatives(points, 0.01, 1000)
    assert 500 < len(rows) <= 1100
    order = np.random.default_rng(0).permutation(5000)
    np.testing.assert_array_equal(
        points[order][representatives(points[order], 0.01, 1000)], points[rows]
    )


def test_a_thinned_cloud_has_the_same_sides():
    points, normals, _ = shapes.TORUS.sample(6000, 1)
    sides = find_sides(points, scrambled(normals), most=1000)
    found = scrambled(normals) * sides.signs[:, None]
    assert ((found * normals).sum(axis=1) > 0).all()


@pytest.mark.parametrize("thin", [0.1, 0.08])
def test_more_representatives_tell_thin_plates_apart(thin):
    """A thousand on the plate are 0.09 apart: half of the points would be wrong.

    What is wrong now stands at the rim, which so few representatives see coarsely.
    """
    points, normals = box(20_000, (1, 1, thin / 2))
    sides = find_sides(points, scrambled(normals), most=1000)
    found = scrambled(normals) * sides.signs[:, None]
    assert not sides.narrow
    assert ((found * normals).sum(axis=1) < 0).mean() < 0.02


def test_plates_too_thin_are_said_to_be(monkeypatch):
    points, normals = box(20_000, (1, 1, 0.02))
    normals = scrambled(normals)
    # All of the points are few enough to be asked.
    assert find_orientation(points, normals, mode="poles").warnings == ()
    few = partial(find_sides, most=1000)
    monkeypatch.setattr("core.orient.orientation.find_sides", few)
    said = find_orientation(points, normals, mode="poles").warnings
    assert any("close to each other" in sentence for sentence in said)


def test_nested_pieces():
    points, normals, _ = shapes.SPHERE.sample(1500, 1)
    both, sides = np.concatenate([points, points / 2]), np.tile(normals, (2, 1))
    cavity = find_orientation(both, sides, mode="poles")
    np.testing.assert_array_equal(cavity.signs, np.repeat([1, -1], 1500))
    bodies = find_orientation(both, sides, mode="poles", nested="outward")
    np.testing.assert_array_equal(bodies.signs, 1)
    assert cavity.pieces == bodies.pieces == 2


@pytest.mark.parametrize("count", [1, 2, 4, 5, 6, 9])
def test_few_points(count):
    points = np.random.default_rng(count).normal(size=(count, 3))
    found = find_orientation(points, points, mode="auto")
    assert set(found.signs) <= {-1, 1}
    assert np.isfinite(found.confidence).all()


def test_where_there_is_no_inside_signs_spread_from_point_to_point():
    rng = np.random.default_rng(0)
    flat = np.append(rng.uniform(size=(500, 2)), np.zeros((500, 1)), axis=1)
    up = np.tile([0.0, 0, 1], (500, 1))
    for points in (flat, np.zeros((500, 3)), flat * [1, 0, 0]):
        found = find_orientation(points, up, mode="auto")
        assert found.mode == "propagate"
        assert len(set(found.signs)) == 1


def test_the_report_says_where_evidence_is_thin():
    points, normals, _ = shapes.SPHERE.sample(2000, 1)
    sure = find_orientation(points, normals, mode="auto")
    assert sure.uncertain == 0 and sure.warnings == () and sure.disagreeing == 0
    assert sure.summary()["turned"] == 0
    rng = np.random.default_rng(0)
    cloud = rng.uniform(size=(2000, 3))
    unsure = find_orientation(cloud, normals, mode="auto")
    assert unsure.uncertain > 0.5
    assert "uncertain" in unsure.warnings[0]


def _nearest(points):
    from core.neighbors.graph import NearestNeighbors

    return NearestNeighbors(points)
