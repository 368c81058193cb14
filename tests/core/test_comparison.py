# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors, wins and colors, from numbers worked out by hand."""

import numpy as np
import pytest

from core import InputError, compare_normals
from core.comparison import MEASURES

X, Y, Z = np.eye(3)
TILTED = np.array([0.6, 0, 0.8])


def test_errors_are_free_of_sign():
    result = compare_normals([Z, -Z, TILTED], [Z, Z, -Z], truth=[Z, Z, Z])
    np.testing.assert_allclose(result.error_estimate, [0, 0, 0.6])
    np.testing.assert_allclose(result.error_baseline, [0, 0, 0])
    np.testing.assert_allclose(result.deviation, [0, 0, 0.6])
    np.testing.assert_allclose(
        result.angle_estimate, [0, 0, np.degrees(np.arccos(0.8))]
    )
    np.testing.assert_array_equal(result.wins, [False, False, False])


def test_wins_need_the_smaller_error():
    result = compare_normals([Z, TILTED], [TILTED, Z], truth=[Z, Z])
    np.testing.assert_array_equal(result.wins, [True, False])
    summary = result.summary()
    assert summary["wins"] == 1
    assert summary["wins_percent"] == 50
    assert summary["error_estimate_max"] == pytest.approx(0.6)
    assert all(type(value) in (int, float) for value in summary.values())


def test_without_truth_there_is_the_deviation_only():
    result = compare_normals([Z, X], [Z, Y])
    np.testing.assert_allclose(result.deviation, [0, 1])
    np.testing.assert_allclose(result.angle_deviation, [0, 90])
    assert result.error_estimate is None
    assert result.wins is None
    assert "wins" not in result.summary()
    with pytest.raises(InputError, match="truth"):
        result.colors("error_estimate")


def test_points_without_a_normal_are_left_out():
    result = compare_normals([Z, [0, 0, 0]], [Z, Z], truth=[Z, Z])
    np.testing.assert_array_equal(result.compared, [True, False])
    assert np.isnan(result.error_estimate[1])
    assert result.summary()["compared"] == 1
    np.testing.assert_array_equal(result.wins, [False, False])
    colors = result.colors("error_estimate")
    # Gray: not a color of the map.
    assert colors[1, 0] == colors[1, 1] == colors[1, 2]


def test_small_angles_are_exact():
    tilt = 1e-9
    result = compare_normals([[np.sin(tilt), 0, np.cos(tilt)]], [Z])
    assert result.angle_deviation[0] == pytest.approx(np.degrees(tilt), rel=1e-9)


def test_colors_are_linear_and_ordered():
    angles = np.linspace(0, 1, 50)
    normals = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
    result = compare_normals(normals, np.tile(Z, (50, 1)))
    colors = result.colors("deviation", limit=1.0)
    assert colors.shape == (50, 4)
    assert colors.dtype == np.float32
    assert (colors[:, 3] == 1).all()
    assert ((colors >= 0) & (colors <= 1)).all()
    brightness = colors[:, :3] @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(brightness) > 0).all()


def test_every_measure_has_colors_and_limits():
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(3, 40, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    result = compare_normals(normals[0], normals[1], truth=normals[2])
    for measure in MEASURES:
        low, high = result.limits(measure)
        assert low < high
        assert np.isfinite(result.colors(measure)).all()
        counts, _ = result.histogram(measure)
        assert counts.sum() == 40


def test_log_ratio_is_neutral_where_errors_are_equal():
    result = compare_normals([TILTED, Z, TILTED], [TILTED, TILTED, Z], truth=[Z, X, X])
    colors = result.colors("log_ratio", limit=1.0)
    neutral = colors[0, :3]
    assert neutral.max() - neutral.min() < 0.05
    np.testing.assert_allclose(result.log_ratio[0], 0)


def test_histogram_counts_every_compared_point():
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(500, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals[3] = 0
    counts, edges = compare_normals(normals, np.tile(Z, (500, 1))).histogram()
    assert counts.sum() == 499
    assert len(edges) == len(counts) + 1


def test_lengths_must_agree():
    with pytest.raises(InputError, match="2 baseline normals"):
        compare_normals([Z, Z], [Z])
