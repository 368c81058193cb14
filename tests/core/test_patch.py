# SPDX-License-Identifier: GPL-3.0-or-later
"""Patches: exact on biquadratics, equal to the calculus on their own time scales."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core import TimeScale
from core.patches.chart import principal_axes
from core.patches.patch import (
    BIQUADRATIC,
    CUBIC,
    _normal_equations,
    fit_patches,
    jumps,
    solve_on_disk,
)


def neighborhoods(count=20, m=50, seed=0, tilt=0.3):
    """Random neighborhoods in the unit disk, as z of random Eq. (2) surfaces."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-0.7, 0.7, (2, count, m))
    a = rng.normal(0, tilt, (8, m))
    z = sum(c * x**i * y**j for c, (i, j) in zip(a, BIQUADRATIC, strict=True))
    return np.stack([x, y, z]), a


def patches_of(offsets, **options):
    return fit_patches(offsets, np.ones(offsets.shape[2]), **options)


def test_recovers_eq_2_in_the_global_chart():
    offsets, a = neighborhoods()
    patches = patches_of(offsets, terms=BIQUADRATIC, chart="global")
    np.testing.assert_allclose(patches.coefficients, a, atol=1e-10)
    np.testing.assert_allclose(patches.residuals(), 0, atol=1e-10)
    np.testing.assert_allclose(patches.misfit, 0, atol=1e-10)
    assert patches.valid.all()


@pytest.mark.parametrize("terms", [BIQUADRATIC, CUBIC])
def test_normal_equations_are_weighted_least_squares(terms):
    rng = np.random.default_rng(0)
    x, y, z = rng.uniform(-0.7, 0.7, (3, 20, 6))
    weights = rng.uniform(0.1, 1, (20, 6))
    found, left = _normal_equations(x, y, z, weights, terms)
    for i in range(6):
        root = np.sqrt(weights[:, i])
        design = np.stack([x[:, i] ** p * y[:, i] ** q for p, q in terms], axis=1)
        expected, (square,), _, _ = np.linalg.lstsq(
            design * root[:, None], z[:, i] * root, rcond=None
        )
        # The ridge, 1e-10, times the condition of the Gram matrices, some 1e4.
        np.testing.assert_allclose(found[:, i], expected, atol=1e-4)
        assert left[i] == pytest.approx(square, rel=1e-6)


@pytest.mark.parametrize("terms", [BIQUADRATIC, CUBIC])
def test_noise_of_an_even_disk(terms):
    """Slopes vary, and residuals tell the noise, as solve_on_disk says."""
    rng = np.random.default_rng(0)
    count, m, noise = 60, 20_000, 1e-3
    rank = np.arange(1, count + 1)
    radius, angle = np.sqrt(rank / count), np.pi * (3 - np.sqrt(5)) * rank
    flat = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * radius])
    offsets = np.repeat(flat[:, :, None], m, axis=2)
    # The point itself, to which the neighbors are moved, is as noisy as they are.
    offsets[2] += rng.normal(0, noise, (count, m)) - rng.normal(0, noise, m)
    patches = patches_of(offsets, terms=terms)
    slopes, square = solve_on_disk(terms, count)
    tilt = (patches.normals()[:, :2] ** 2).sum(axis=1).mean()
    # A mean of 40,000 squares is known to 1 %; the chart adds a little of its own.
    assert tilt == pytest.approx(noise**2 * slopes, rel=0.05)
    assert (patches.misfit**2).mean() == pytest.approx(noise**2 * square, rel=0.05)
    assert np.sqrt((patches.noise**2).mean()) == pytest.approx(noise, rel=0.05)


def test_eight_neighbors_interpolate():
    offsets, a = neighborhoods(count=8, m=20)
    patches = patches_of(offsets, terms=BIQUADRATIC, chart="global")
    good = patches.condition < 1e6
    assert good.sum() > 10
    np.testing.assert_allclose(patches.coefficients[:, good], a[:, good], atol=1e-7)


def test_condition_is_that_of_the_matrix_of_eq_3():
    offsets, _ = neighborhoods(m=5)
    patches = patches_of(offsets, terms=BIQUADRATIC, chart="global")
    for i in range(5):
        x, y = offsets[0, :, i], offsets[1, :, i]
        design = np.stack([x**p * y**q for p, q in BIQUADRATIC], axis=1)
        assert patches.condition[i] == pytest.approx(np.linalg.cond(design))


def test_paper_slopes_are_the_symmetric_quotient_of_the_patch():
    offsets, a = neighborhoods()
    patches = patches_of(offsets, terms=BIQUADRATIC, chart="global")
    sigma, rho = jumps(offsets[0])
    expected = ((a[0] * sigma + a[2] * sigma**2) - (a[0] * rho + a[2] * rho**2)) / (
        sigma - rho
    )
    slope, _ = patches.slopes(weights="paper")
    np.testing.assert_allclose(slope, expected, atol=1e-9)


@settings(deadline=None, max_examples=30)
@given(
    st.integers(0, 10**6),
    st.sampled_from(["principal", "global"]),
    st.sampled_from([BIQUADRATIC, CUBIC]),
)
def test_closed_form_is_grid_surface_on_the_bundle(seed, chart, terms):
    """The normal in closed form is that of the bundle's grid at the point itself."""
    offsets, _ = neighborhoods(count=12, m=3, seed=seed)
    patches = patches_of(offsets, terms=terms, chart=chart)
    for column in range(3):
        bundle = patches.bundle(column, origin=(1.0, 2.0, 3.0))
        here = tuple(
            int(np.flatnonzero(T.points == 0)[0]) for T in (bundle.T1, bundle.T2)
        )
        np.testing.assert_allclose(bundle.points[here], [1, 2, 3], atol=1e-12)
        ends = any(
            i in (0, len(T) - 1)
            for i, T in zip(here, (bundle.T1, bundle.T2), strict=True)
        )
        # Over three members the second-order difference is exact on quadratics only.
        exact = terms == BIQUADRATIC and not ends
        for weights in ("paper", "second_order") if exact else ("paper",):
            closed = patches.normals(weights=weights)[column]
            grid = bundle.normals(weights=weights)[here]
            # Quotients over the smallest jump, some 1e-3, of rounding 1e-16.
            np.testing.assert_allclose(closed, grid, atol=1e-9)


def test_one_sided_ends_use_the_jump_that_exists():
    x = np.array([[0.5], [1.0], [0.25], [0.75]])
    sigma, rho = jumps(x)
    assert (sigma, rho) == (0.25, 0)
    sigma, rho = jumps(-x)
    assert (sigma, rho) == (0, -0.25)


def test_bundle_is_a_grid_over_the_neighbors():
    offsets, _ = neighborhoods(count=9, m=1)
    bundle = patches_of(offsets, terms=BIQUADRATIC, chart="global").bundle()
    assert isinstance(bundle.T1, TimeScale)
    assert bundle.points.shape == (10, 10, 3)
    np.testing.assert_array_equal(
        bundle.T1.points, np.sort(np.append(offsets[0, :, 0], 0))
    )


def test_a_line_and_a_single_place_span_nothing():
    line = np.zeros((3, 10, 2))
    line[:, :, 0] = np.array([1, 2, 3])[:, None] * np.linspace(-1, 1, 10)
    *axes, spans = principal_axes(line, np.array([10, 0]))
    assert not spans.any()
    assert np.isfinite(axes).all()
    assert not patches_of(line).valid.any()
    np.testing.assert_array_equal(patches_of(line).normals(), 0)


def test_seven_neighbors_are_too_few():
    offsets, _ = neighborhoods(count=9, m=2)
    offsets[:, 7:, 1] = 0
    np.testing.assert_array_equal(patches_of(offsets).valid, [True, False])
