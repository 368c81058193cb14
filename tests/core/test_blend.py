# SPDX-License-Identifier: GPL-3.0-or-later
"""Sizes chosen point by point: ladder, blocks, votes, nets, and the whole."""

import numpy as np
import pytest

from core import Settings, compare_normals, estimate_normals, shapes
from core.auto.coarse import block_means, halvings, noise_in_spacings
from core.auto.ladder import EXACT, NOISY, fit_ladder, turn
from core.auto.nets import nets
from core.auto.votes import count_votes
from core.neighbors.graph import NearestNeighbors
from core.patches.asked import Asked

AUTO = Settings(orientation="none")


def angles(normals, truth):
    return np.degrees(np.arccos(np.abs((normals * truth).sum(axis=-1)).clip(0, 1)))


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def turned(seed):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def noisy_sphere(level, count=20_000, seed=1):
    """Return a sphere whose noise is `level` spacings thick, normals, and the noise."""
    points, normals, _ = shapes.SPHERE.sample(count, seed, even=False)
    noise = level * np.sqrt(4 * np.pi / count)
    rng = np.random.default_rng(seed)
    return points + rng.normal(0, noise, points.shape), normals, noise


@pytest.mark.parametrize("steps", [EXACT, NOISY], ids=["exact", "noisy"])
def test_every_patch_of_the_ladder_finds_a_plane(steps):
    points, _, _ = shapes.PLANE.sample(2000, 1, even=False)
    turn = turned(3)
    nearest = NearestNeighbors(points @ turn.T)
    normals, reach, features = fit_ladder(nearest, np.arange(50), steps)
    along = np.abs(np.einsum("cim,i->cm", normals, turn[:, 2]))
    # Single precision.
    np.testing.assert_allclose(along, 1, atol=1e-5)
    assert (reach > 0).all()
    assert np.isfinite(features).all()


def test_features_do_not_depend_on_size_place_or_turn():
    points, _, _ = shapes.BUMPY.sample(3000, 1, even=False)
    rows = np.arange(0, 3000, 30)
    first = fit_ladder(NearestNeighbors(points), rows, NOISY)[2]
    moved = 40 * points @ turned(1).T + 7
    second = fit_ladder(NearestNeighbors(moved), rows, NOISY)[2]
    # Logarithms of squares down to 1e-6: rounding shows where these are all there is.
    assert np.median(np.abs(first - second)) < 1e-3
    assert np.quantile(np.abs(first - second), 0.99) < 0.1


def test_turns_are_told_apart_down_to_rounding():
    """A cosine in single precision would not tell an angle of 0.0003 from none."""
    rng = np.random.default_rng(0)
    a, side = (rng.normal(size=(3, 1000)) for _ in range(2))
    a /= np.linalg.norm(a, axis=0)
    side -= (side * a).sum(axis=0) * a
    side /= np.linalg.norm(side, axis=0)
    for angle in (0.0, 3e-4, 0.1, np.pi / 2):
        b = np.cos(angle) * a + np.sin(angle) * side
        found = turn(a.astype(np.float32), -b.astype(np.float32))
        # All below a thousandth is alike; 2e-7 is three roundings.
        expected = np.log(np.sin(angle) ** 2 + 1e-6)
        np.testing.assert_allclose(found, expected, atol=3e-3)


@pytest.mark.parametrize("level", [0.1, 0.5, 2.0, 4.0])
def test_noise_is_found_in_units_of_the_spacing(level):
    points, _, noise = noisy_sphere(level)
    found, absolute = noise_in_spacings(Asked.of(NearestNeighbors(points)))
    # Sixteen neighbors leave a quadratic patch little to go by, and at four spacings
    # the neighborhoods bend: what is wanted is a level, not a measurement.
    assert found == pytest.approx(level, rel=0.5)
    assert absolute == pytest.approx(noise, rel=0.5)


def test_exact_points_show_no_noise():
    points, _, _ = shapes.BUMPY.sample(20_000, 1, even=False)
    assert noise_in_spacings(Asked.of(NearestNeighbors(points)))[0] < 0.01


def test_blocks_hold_all_points_and_neighbors_only():
    points, _, _ = noisy_sphere(2.0)
    means, label = block_means(points, halvings(len(points), 2.0))
    sizes = np.bincount(label, minlength=len(means))
    assert sizes.sum() == len(points)
    # Halves of halves differ by one.
    assert np.ptp(sizes) <= 1
    assert 3 <= sizes.mean() <= 9
    for axis in range(3):
        total = np.bincount(label, points[:, axis])
        np.testing.assert_allclose(total / sizes, means[:, axis], atol=1e-12)
    away = np.linalg.norm(points - means[label], axis=1)
    assert away.mean() < 3 * np.sqrt(4 * np.pi / len(means))


def test_points_without_noise_are_their_own_blocks():
    assert halvings(500, 0.1) is None
    assert halvings(500, 0.1, least=8) is None
    assert 2 ** halvings(512, 0.5, least=8) == 64


def test_faint_noise_on_a_smooth_surface():
    """Blocks reach as far as the surface is smooth: no one size is clearly better.

    With blocks as the noise alone asks for, `auto` errs a sixth more than that.
    """
    points, truth, _ = shapes.SPHERE.sample(20_000, 1)
    noisy = shapes.add_noise(points, 0.003, seed=2)
    fixed = Settings(
        method="time_scale", neighbors=615, patch="biquadratic", orientation="none"
    )
    best, found = (
        rms(angles(estimate_normals(noisy, settings=each).normals, truth))
        for each in (fixed, AUTO)
    )
    assert found < 1.05 * best


def test_votes_find_both_sides_of_an_edge():
    """At an edge some rule elects each side, and agreeing ones that of the point."""
    rng = np.random.default_rng(0)
    count, m = 32, 20
    along = rng.uniform(-1, 1, (count, m))
    across = rng.uniform(-1, 1, (count, m))
    across[0], along[0] = 0.05, 0
    flat = np.stack([along, across, np.zeros_like(along)])
    wall = np.stack([along, np.zeros_like(along), across])
    points = np.where(across > 0, flat, wall)
    normals = np.zeros_like(points)
    normals[2] = across > 0
    normals[1] = across <= 0
    offsets = points - points[:, :1]
    order = np.argsort((offsets**2).sum(axis=0), axis=0)
    offsets, normals = (
        np.take_along_axis(a, order[None], 1) for a in (offsets, normals)
    )
    elected, features = count_votes(
        offsets.astype(np.float32),
        normals.astype(np.float32),
        np.zeros((count, m), dtype=np.float32),
        0.0,
    )
    assert np.isfinite(features).all()
    up, aside = np.abs(elected[:, 2]), np.abs(elected[:, 1])
    # Candidate 6 is elected by those whose planes pass through the point.
    assert np.median(up[6]) > 0.99
    assert (aside.max(axis=0) > 0.99).all()


def test_nets_are_small_and_whole():
    assert set(nets()) == {"exact fit", "exact vote", "noisy fit", "noisy vote"}
    for net in nets().values():
        for part in (net.choice, net.doubt):
            assert all(np.isfinite(matrix).all() for matrix, _ in part.layers)
            assert (part.scale > 0).all()
            assert sum(matrix.size for matrix, _ in part.layers) < 20_000


def test_a_blend_is_one_of_equal_candidates():
    """Whatever the weights; and whatever the sides."""
    net = nets()["exact vote"]
    count = len(net.choice.layers[-1][1])
    normal = np.array([0.6, 0.0, 0.8], dtype=np.float32)
    sides = np.where(np.arange(count) % 2, 1, -1)
    candidates = (sides[:, None, None] * normal[:, None]).astype(np.float32)
    features = net.choice.mean[:, None] + net.choice.scale[:, None]
    found, weights, _ = net.blend(features, candidates)
    np.testing.assert_allclose(np.abs(found[:, 0] @ normal), 1, atol=1e-6)
    np.testing.assert_allclose(weights.sum(axis=0), 1, atol=1e-5)


@pytest.mark.parametrize("count", [500, 1000, 20_000])
def test_smooth_points_stay_as_time_scale_has_them(count):
    """Within the ten per cent that choosing may cost on clean data."""
    points, normals, _ = shapes.BUMPY.sample(count, 1, even=False)
    auto = estimate_normals(points, settings=AUTO)
    fixed = Settings(method="time_scale", neighbors=16, orientation="none")
    fixed = estimate_normals(points, settings=fixed)
    assert rms(angles(auto.normals, normals)) <= 1.1 * rms(
        angles(fixed.normals, normals)
    )


@pytest.mark.parametrize(("level", "best"), [(0.4, 2.5), (2, 9), (4, 17)])
def test_noise_asks_for_wide_patches(level, best):
    """In degrees, twice what was measured; sixteen neighbors have over 35."""
    points, normals, _ = noisy_sphere(level)
    estimate = estimate_normals(points, settings=AUTO)
    assert estimate.valid.all()
    assert rms(angles(estimate.normals, normals)) < best


def test_confidence_is_low_where_errors_are():
    """The tenth of the points that is trusted least has half of the squared error."""
    points, normals = cube(12_000)
    estimate = estimate_normals(points, settings=AUTO)
    square = angles(estimate.normals, normals) ** 2
    least = np.argsort(estimate.confidence, kind="stable")[: len(points) // 10]
    assert square[least].sum() >= 0.5 * square.sum()
    assert (estimate.confidence >= 0).all()
    assert (estimate.confidence <= 1).all()


def cube(count, seed=0):
    """Return points and normals of a cube of side 2, evenly at random."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (count, 3))
    axis = rng.integers(3, size=count)
    side = rng.choice([-1.0, 1.0], count)
    normals = np.zeros((count, 3))
    normals[np.arange(count), axis] = side
    points[np.arange(count), axis] = side
    return points, normals


@pytest.mark.parametrize("surface", ["cube", "bumpy", "noise"])
def test_rounding_moves_no_normal(surface):
    """A ten-millionth of the size is the rounding of single precision."""
    points = {
        "cube": lambda: cube(1000)[0],
        "bumpy": lambda: shapes.BUMPY.sample(600, 1, even=False)[0],
        "noise": lambda: noisy_sphere(2.0, 3000)[0],
    }[surface]()
    rng = np.random.default_rng(0)
    moved = points + rng.normal(0, 1e-7, points.shape)
    here, there = (estimate_normals(p, settings=AUTO) for p in (points, moved))
    off = angles(here.normals, there.normals)
    # Patches over sparse points magnify it a thousandfold.
    assert np.quantile(off, 0.99) < 0.03
    assert off.max() < 0.5


def test_points_that_one_patch_fits_keep_its_normal():
    points, _ = cube(12_000)
    fixed = Settings(method="time_scale", neighbors=16, orientation="none")
    one, auto = (estimate_normals(points, settings=s) for s in (fixed, AUTO))
    flat = one.patches(np.arange(len(points))).misfit < 0.002
    assert 0.5 < flat.mean() < 0.9
    cosine = np.abs((one.normals * auto.normals).sum(axis=1))
    np.testing.assert_allclose(cosine[flat], 1, atol=1e-12)


def test_flat_faces_are_exact_two_spacings_from_a_crease():
    points, normals = cube(12_000)
    estimate = estimate_normals(points, settings=AUTO)
    spacing = np.sqrt(24 / len(points))
    distance = np.sort(1 - np.abs(points), axis=1)[:, 1]
    far = distance > 2 * spacing
    assert angles(estimate.normals, normals)[far].max() < 1


@pytest.mark.parametrize("level", [0.0, 2.0])
def test_scale_is_a_length(level):
    """It grows with the object, and with the noise."""
    points, _, _ = noisy_sphere(level)
    small = estimate_normals(points, settings=AUTO)
    large = estimate_normals(40 * points, settings=AUTO)
    np.testing.assert_allclose(
        np.median(large.scale), 40 * np.median(small.scale), rtol=1e-3
    )
    spacing = np.sqrt(4 * np.pi / len(points))
    # Sixteen neighbors reach 2.3 spacings.
    assert np.median(small.scale) > (2 if level == 0 else 5) * spacing


@pytest.mark.parametrize("level", [0.0, 0.4, 3.0])
def test_the_number_of_threads_changes_nothing(level):
    points, _, _ = noisy_sphere(level, 5000)
    one, two = (
        estimate_normals(points, settings=Settings(orientation="none", threads=t))
        for t in (1, 2)
    )
    np.testing.assert_array_equal(one.normals, two.normals)
    np.testing.assert_array_equal(one.confidence, two.confidence)


@pytest.mark.parametrize("share", [0.01, 0.05])
def test_outliers_do_not_spoil_the_rest(share):
    """Points anywhere in the box around a sphere."""
    points, normals, _ = shapes.SPHERE.sample(10_000, 1, even=False)
    rng = np.random.default_rng(0)
    outliers = rng.uniform(-1.1, 1.1, (int(share * len(points)), 3))
    estimate = estimate_normals(np.concatenate([points, outliers]), settings=AUTO)
    error = angles(estimate.normals[: len(points)], normals)
    # Outliers lie among the neighbors of a few points only.
    assert np.median(error) < 0.5
    assert np.quantile(error, 0.9) < 5


def test_isolated_points_do_not_disturb():
    points, normals, _ = shapes.SPHERE.sample(5000, 1, even=False)
    alone = np.array([[50.0, 0, 0], [0, -80, 0], [0, 0, 300]])
    estimate = estimate_normals(np.concatenate([points, alone]), settings=AUTO)
    assert np.isfinite(estimate.normals).all()
    assert rms(angles(estimate.normals[:5000], normals)) < 0.5


@pytest.mark.parametrize("level", [0.0, 1.0])
def test_density_that_jumps_a_hundredfold(level):
    """Half a sphere has a hundred times the points of the other."""
    points, normals, _ = noisy_sphere(level, 40_000)
    rng = np.random.default_rng(0)
    kept = (points[:, 2] > 0) | (rng.random(len(points)) < 0.01)
    points, normals = points[kept], normals[kept]
    estimate = estimate_normals(points, settings=AUTO)
    sparse = points[:, 2] < -0.3
    # 200 points are left below: 16 neighbors reach 0.6 radians there.
    assert estimate.valid.all()
    assert np.median(angles(estimate.normals[sparse], normals[sparse])) < 12
    dense = points[:, 2] > 0.3
    assert rms(angles(estimate.normals[dense], normals[dense])) < 6


@pytest.mark.parametrize("level", [0.0, 1.0])
def test_duplicates_count_once(level):
    points, _, _ = noisy_sphere(level, 3000)
    twice = np.concatenate([points, points[:1500]])
    once = estimate_normals(points, settings=AUTO)
    both = estimate_normals(twice, settings=AUTO)
    # The center of the points moves, and with it the rounding of single precision.
    assert angles(both.normals[:3000], once.normals).max() < 0.1
    np.testing.assert_array_equal(both.normals[3000:], both.normals[:1500])
    np.testing.assert_array_equal(both.confidence[3000:], both.confidence[:1500])


def test_normals_turn_with_points():
    """Exactly where points are; under noise blocks are cut anew along the axes."""
    for level, close in ((0.0, 0.01), (2.0, 3.0)):
        points, _, _ = noisy_sphere(level, 5000)
        turn = turned(2)
        plain = estimate_normals(points, settings=AUTO).normals
        after = estimate_normals(points @ turn.T, settings=AUTO).normals
        assert rms(angles(plain @ turn.T, after)) < close


def test_comparison_takes_an_automatic_estimate():
    points, normals, _ = noisy_sphere(1.0, 3000)
    estimate = estimate_normals(points, settings=AUTO)
    summary = compare_normals(estimate, normals).summary()
    assert summary["angle_deviation_rms"] < 8
