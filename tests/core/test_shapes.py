# SPDX-License-Identifier: GPL-3.0-or-later
"""Analytic surfaces: exact normals, samples even and uniform by area."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from core import InputError, shapes


@pytest.mark.parametrize("shape", shapes.ALL.values(), ids=lambda shape: shape.name)
def test_normals_are_those_of_difference_quotients(shape):
    rng = np.random.default_rng(0)
    (t0, t1), (s0, s1) = shape.domain
    # Inside by 2 %, where central quotients stay in the domain.
    t = t0 + (t1 - t0) * rng.uniform(0.02, 0.98, 200)
    s = s0 + (s1 - s0) * rng.uniform(0.02, 0.98, 200)
    h = 1e-5
    cross = shape.side * np.cross(
        shape.point(t + h, s) - shape.point(t - h, s),
        shape.point(t, s + h) - shape.point(t, s - h),
    )
    cross /= np.linalg.norm(cross, axis=1, keepdims=True)
    # Truncation h^2 f''' / 6 and rounding 1e-16 / h: both below 1e-8 here, times
    # the worst ratio of the two tangents' lengths.
    np.testing.assert_allclose(shape.normal(t, s), cross, atol=1e-6)


@pytest.mark.parametrize("name", ["sphere", "torus", "bumpy"])
def test_closed_surfaces_have_outward_normals(name):
    points, normals, _ = shapes.ALL[name].sample(400)
    core = points if name != "torus" else points - unit(points * [1, 1, 0])
    assert ((core * normals).sum(axis=1) > 0).all()


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize("even", [True, False])
def test_samples(even):
    points, normals, parameters = shapes.PHI1.sample(500, 3, even=even)
    assert points.shape == normals.shape == (500, 3)
    np.testing.assert_array_equal(points, shapes.PHI1.point(*parameters.T))
    np.testing.assert_array_equal(normals, shapes.PHI1.normal(*parameters.T))
    again = shapes.PHI1.sample(500, 3, even=even)[0]
    np.testing.assert_array_equal(points, again)
    assert (shapes.PHI1.sample(500, 4, even=even)[0] != points).any()


def test_even_samples_keep_their_distance():
    """Blue noise: the closest pair is near the hexagonal packing's spacing."""
    points, _, _ = shapes.TORUS.sample(2000, 1)
    area = 4 * np.pi**2 * 1.0 * 0.35
    widest = np.sqrt(2 * area / (np.sqrt(3) * 2000))
    spacing = cKDTree(points).query(points, k=2)[0][:, 1] / widest
    assert spacing.min() > 0.45
    assert spacing.mean() > 0.7
    # Independent points: the closest pair is a hundred times closer than that.
    loose, _, _ = shapes.TORUS.sample(2000, 1, even=False)
    assert cKDTree(loose).query(loose, k=2)[0][:, 1].min() / widest < 0.1


@pytest.mark.parametrize("even", [True, False])
def test_samples_are_uniform_by_area(even):
    """Archimedes: equal slices of a sphere hold equal shares."""
    points, _, _ = shapes.SPHERE.sample(4000, 0, even=even)
    counts, _ = np.histogram(points[:, 2], bins=8, range=(-1, 1))
    # Five standard deviations of independent points; even ones vary less.
    np.testing.assert_allclose(counts, 500, atol=5 * np.sqrt(500))


def test_noise_has_the_size_asked_for():
    points = np.zeros((10_000, 3))
    points[0], points[1] = [0, 0, 0], [3, 4, 0]
    noise = shapes.add_noise(points, 0.01, seed=1) - points
    # Diagonal 5: standard deviation 0.05, known to 1/sqrt(60000).
    assert noise.std() == pytest.approx(0.05, rel=0.02)


def test_phi1_and_phi2_are_the_paper_s():
    np.testing.assert_allclose(shapes.PHI1.point(0.3, -0.4), [0.048, -0.036, 0.5])
    e = 1.16**2.0
    np.testing.assert_allclose(
        shapes.PHI2.point(0.0, 2.0), [2 * e * np.cos(2), -2 * e * np.sin(2), -2 * e]
    )


def test_no_samples():
    with pytest.raises(InputError, match="at least 1"):
        shapes.SPHERE.sample(0)
