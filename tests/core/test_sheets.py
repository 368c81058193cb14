# SPDX-License-Identifier: GPL-3.0-or-later
"""Neighbors told apart: crossing sheets, close sheets, creases."""

import numpy as np
import pytest

from core import Settings, compare_normals, delaunay_normals, estimate_normals, shapes

APART = Settings(method="time_scale", orientation="none")
TOGETHER = Settings(method="time_scale", orientation="none", sheets=False)


def crossing_planes(seed=0):
    """Two planes that cross at a right angle along y."""
    points, _, _ = shapes.PLANE.sample(1500, seed)
    x, y, z = points.T
    upright = np.stack([z, y, x], axis=1)
    truth = np.repeat([[0.0, 0, 1], [1.0, 0, 0]], 1500, axis=0)
    return np.concatenate([points, upright]), truth


def errors(points, truth, settings):
    found = estimate_normals(points, settings=settings)
    return compare_normals(found, truth).angle_deviation


def test_planes_that_cross():
    points, truth = crossing_planes()
    together = errors(points, truth, TOGETHER)
    apart = errors(points, truth, APART)
    # Points nearer to the line than a third of their spacing may lie on either.
    assert (together > 1).mean() > 0.08
    assert (apart > 1).mean() < (together > 1).mean() / 3
    spacing = np.sqrt(4 / 1500)
    clear = np.maximum(np.abs(points[:, 0]), np.abs(points[:, 2])) > spacing
    assert (apart[clear] > 1).mean() < 0.01


def test_a_crease_stays_sharp():
    """Half planes that meet at a right angle."""
    points, truth = crossing_planes(3)
    roof = (points[:, 0] >= 0) & (points[:, 2] >= 0)
    points, truth = points[roof], truth[roof]
    distance = np.maximum(points[:, 0], points[:, 2])
    spacing = np.sqrt(4 / 1500)
    apart = errors(points, truth, APART)
    # Beyond two spacings from a crease, errors are under a degree.
    assert (apart[distance > 2 * spacing] < 1).all()
    assert (apart > 10).sum() < (errors(points, truth, TOGETHER) > 10).sum() / 3


@pytest.mark.parametrize("name", ["sphere", "torus", "paraboloid"])
def test_smooth_surfaces_are_left_alone(name):
    points, _, _ = shapes.ALL[name].sample(5000, 1)
    found = estimate_normals(points, settings=APART)
    assert found.separated < 100
    # At the rim of the paraboloid one-sided patches miss a little; repaired or not,
    # they are the same to a few hundredths of a degree.
    same = compare_normals(found, estimate_normals(points, settings=TOGETHER))
    assert np.nanpercentile(same.angle_deviation, 99) < 0.1


def test_paper_surfaces_against_a_baseline_that_knows_the_parameters():
    """Section 4 from the points alone: wins, and errors at the median and the mean."""
    for name, count, wins in (("phi1", 2571, 88), ("phi2", 2295, 94)):
        for seed in (11, 12):
            points, truth, parameters = shapes.ALL[name].sample(count, seed)
            told = delaunay_normals(points, parameters=parameters)
            summary = compare_normals(
                estimate_normals(points), told, truth=truth
            ).summary()
            assert summary["wins_percent"] >= wins
            medians = summary["error_baseline_median"], summary["error_estimate_median"]
            assert medians[0] > 5 * medians[1]
            assert summary["error_estimate_mean"] < summary["error_baseline_mean"]


def test_order_rotation_scale_and_threads():
    points, _, _ = shapes.PHI1.sample(1000, 4)
    found = estimate_normals(points, settings=APART).normals
    order = np.random.default_rng(0).permutation(1000)
    shuffled = estimate_normals(points[order], settings=APART).normals
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turned = estimate_normals(1e6 * points @ turn.T, settings=APART).normals
    single = Settings(method="time_scale", orientation="none", threads=1)
    np.testing.assert_array_equal(
        estimate_normals(points, settings=single).normals, found
    )
    assert compare_normals(shuffled, found[order]).angle_deviation.max() < 1e-6
    # Consensus decides between sheets: where two are equally good, rounding does.
    angle = compare_normals(turned, found @ turn.T).angle_deviation
    assert (angle > 1e-4).mean() < 0.005


def test_noise_is_not_taken_for_sheets():
    points, _, _ = shapes.TORUS.sample(4000, 0)
    noisy = shapes.add_noise(points, 0.003, seed=1)
    found = estimate_normals(noisy, settings=APART)
    assert found.separated < 0.01 * len(points)
