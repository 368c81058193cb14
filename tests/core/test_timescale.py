# SPDX-License-Identifier: GPL-3.0-or-later
"""Time scales: the set, its jumps, and derivatives against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core import InputError, TimeScale

# A mixture: dense on both sides, on the left only, on the right only, isolated.
MIXED = TimeScale([-1.0, 4.0], intervals=[(0.0, 1.0), (2.0, 3.0)])


@st.composite
def scales(draw, least=3):
    """Isolated time scales whose neighbors differ by 1e-2 to 10."""
    gaps = draw(st.lists(st.floats(1e-2, 10), min_size=least - 1, max_size=12))
    return TimeScale(draw(st.floats(-10, 10)) + np.concatenate([[0], np.cumsum(gaps)]))


def test_jumps_of_isolated_points():
    scale = TimeScale([0.0, 1.0, 3.0])
    t = scale.points
    np.testing.assert_array_equal(scale.sigma(t), [1, 3, 3])
    np.testing.assert_array_equal(scale.rho(t), [0, 0, 1])
    np.testing.assert_array_equal(scale.mu(t), [1, 2, 0])
    np.testing.assert_array_equal(scale.nu(t), [0, 1, 2])
    assert scale.sigma(1.0) == 3.0
    assert isinstance(scale.sigma(1.0), float)


def test_jumps_of_a_mixture():
    t = np.array([-1.0, 0.0, 0.5, 1.0, 2.0, 3.0, 4.0])
    np.testing.assert_array_equal(MIXED.sigma(t), [0, 0, 0.5, 2, 2, 4, 4])
    np.testing.assert_array_equal(MIXED.rho(t), [-1, -1, 0.5, 1, 1, 3, 3])
    np.testing.assert_array_equal(
        MIXED.is_right_dense(t), [False, True, True, False, True, False, False]
    )
    np.testing.assert_array_equal(
        MIXED.is_left_dense(t), [False, False, True, True, False, True, False]
    )
    np.testing.assert_array_equal(
        MIXED.is_right_scattered(t), [True, False, False, True, False, True, False]
    )
    np.testing.assert_array_equal(
        MIXED.is_left_scattered(t), [False, True, False, False, True, False, True]
    )


def test_membership():
    assert 0.5 in MIXED
    assert 1.5 not in MIXED
    np.testing.assert_array_equal(
        MIXED.contains([-2, -1, 1, 1.5, 4, 5]), [False, True, True, False, True, False]
    )


def test_union_joins_parts_that_touch():
    joined = TimeScale.interval(0, 1) | TimeScale.interval(1, 2) | TimeScale([1, 5])
    assert joined == TimeScale([5.0], intervals=[(0, 2)])


def test_uniform_is_h_z_on_a_window():
    np.testing.assert_allclose(
        TimeScale.uniform(0.1, -0.2, 0.3).points, [-0.2, -0.1, 0, 0.1, 0.2, 0.3]
    )


def test_kappa_removes_scattered_ends_only():
    assert (
        TimeScale([0, 1, 2]).kappa()
        == TimeScale([0, 1, 2, 3]).kappa(lower=False).kappa()
    )
    assert MIXED.kappa() == TimeScale(intervals=[(0, 1), (2, 3)])
    assert TimeScale.interval(0, 1).kappa() == TimeScale.interval(0, 1)
    assert TimeScale([0, 1, 2]).kappa(lower=False) == TimeScale([0, 1])


def test_end_values_are_nan_where_the_derivative_does_not_exist():
    scale = TimeScale([0.0, 1.0, 3.0])
    np.testing.assert_array_equal(scale.delta([0.0, 1, 9]), [1, 4, np.nan])
    np.testing.assert_array_equal(scale.nabla([0.0, 1, 9]), [np.nan, 1, 4])
    np.testing.assert_allclose(scale.diamond([0.0, 1, 9]), [1, 3, 4])
    np.testing.assert_allclose(
        scale.diamond([0.0, 1, 9], weights="second_order"), [1, 2, 4]
    )


def test_gamma_and_its_limits():
    t = np.array([-1.0, 0.0, 0.5, 1.0, 4.0])
    # Ends; 0 is left-scattered and right-dense, 1 the other way round.
    np.testing.assert_array_equal(MIXED.gamma(t), [1, 0, 0.5, 1, 0])
    np.testing.assert_array_equal(
        MIXED.gamma(t, weights="second_order"), [1, 1, 0.5, 0, 0]
    )
    assert TimeScale([0, 1, 4]).gamma(1.0) == 0.75
    assert TimeScale([0, 1, 4]).gamma(1.0, weights="second_order") == 0.25


def test_dense_points_differentiate_by_a_limit():
    t = np.array([0.0, 0.3, 1.0, 2.0, 3.0])
    for function, derivative in ((np.sin, np.cos), (np.exp, np.exp)):
        # Extrapolation from ten halvings reaches the cube root of rounding or
        # better; one-sided quotients lose two more digits.
        delta, nabla = MIXED.delta(function, t=t), MIXED.nabla(function, t=t)
        right = MIXED.is_right_dense(t)
        left = MIXED.is_left_dense(t)
        np.testing.assert_allclose(delta[right], derivative(t[right]), rtol=1e-8)
        np.testing.assert_allclose(nabla[left], derivative(t[left]), rtol=1e-8)
    # 1 is right-scattered: delta is the quotient of the gap.
    assert MIXED.delta(np.sin, t=1.0) == pytest.approx(np.sin(2) - np.sin(1))


def test_interval_is_ordinary_calculus():
    line = TimeScale.interval(-2, 2)
    t = np.linspace(-2, 2, 9)
    expected = 3 * t**2
    for derivative in (line.delta, line.nabla, line.diamond):
        np.testing.assert_allclose(
            derivative(lambda x: x**3, t=t), expected, rtol=1e-8, atol=1e-9
        )


def test_values_may_be_vectors():
    scale = TimeScale([0.0, 1.0, 3.0])
    values = np.stack([scale.points, 2 * scale.points], axis=1)
    np.testing.assert_allclose(scale.diamond(values), [[1, 2]] * 3)


def test_values_may_run_along_any_axis():
    scale = TimeScale([0.0, 1.0, 3.0])
    values = np.random.default_rng(0).normal(size=(2, 3, 4))
    for derivative in (scale.delta, scale.nabla, scale.diamond):
        expected = np.stack([derivative(part) for part in values])
        np.testing.assert_array_equal(derivative(values, axis=1), expected)
    with pytest.raises(InputError, match="3 points"):
        scale.delta(values, axis=2)
    with pytest.raises(InputError, match="axis"):
        scale.delta(values, axis=3)
    with pytest.raises(InputError, match="axis"):
        scale.delta(1.0)


@given(scales(), st.floats(-5, 5), st.floats(-5, 5))
def test_linear(scale, a, b):
    rng = np.random.default_rng(0)
    f, g = rng.normal(size=(2, len(scale)))
    for derivative in (scale.delta, scale.nabla, scale.diamond):
        np.testing.assert_allclose(
            derivative(a * f + b * g),
            a * derivative(f) + b * derivative(g),
            # Values of order one over gaps down to 1e-2.
            atol=1e-10,
        )


@given(scales())
def test_product_rule(scale):
    """(f g)^delta = f^delta g + f(sigma) g^delta (Theorem 1.20 of Bohner, Peterson)."""
    rng = np.random.default_rng(1)
    f, g = rng.normal(size=(2, len(scale)))
    f_sigma = np.append(f[1:], np.nan)
    np.testing.assert_allclose(
        scale.delta(f * g), scale.delta(f) * g + f_sigma * scale.delta(g), atol=1e-9
    )


@given(scales(), st.sampled_from(["paper", "second_order"]))
def test_diamond_mixes_delta_and_nabla(scale, weights):
    values = np.random.default_rng(2).normal(size=len(scale))
    inner = slice(1, -1)
    gamma = scale.gamma(scale.points, weights=weights)[inner]
    expected = (
        gamma * scale.delta(values)[inner] + (1 - gamma) * scale.nabla(values)[inner]
    )
    diamond = scale.diamond(values, weights=weights)
    np.testing.assert_allclose(diamond[inner], expected, atol=1e-10)
    assert diamond[0] == scale.delta(values)[0]
    assert diamond[-1] == scale.nabla(values)[-1]


@given(scales())
def test_paper_weights_are_the_symmetric_quotient(scale):
    values = np.random.default_rng(3).normal(size=len(scale))
    t = scale.points
    expected = (values[2:] - values[:-2]) / (t[2:] - t[:-2])
    np.testing.assert_allclose(scale.diamond(values)[1:-1], expected, atol=1e-10)


@given(scales(), st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3))
def test_exactness(scale, a, b, c):
    """Paper's weights are exact on lines, second-order ones on quadratics."""
    t = scale.points
    # Cancellation: values up to 3 * 130^2 over gaps from 1e-2.
    tolerance = {"rtol": 1e-7, "atol": 1e-6}
    np.testing.assert_allclose(
        scale.diamond(a + b * t), np.full(len(t), b), **tolerance
    )
    np.testing.assert_allclose(
        scale.diamond(a + b * t + c * t**2, weights="second_order")[1:-1],
        (b + 2 * c * t)[1:-1],
        **tolerance,
    )


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([0.0, 2.0, 1.0], "strictly increasing"),
        ([0.0, 1.0, 1.0], "strictly increasing"),
        ([1.0], "two points or more"),
        ([], "two points or more"),
        ([0.0, np.nan], "finite"),
        ([[0.0, 1.0]], r"shape \(n,\)"),
        (["a", "b"], "real numbers"),
    ],
)
def test_bad_points(points, message):
    with pytest.raises(InputError, match=message):
        TimeScale(points)


def test_bad_requests():
    scale = TimeScale([0.0, 1.0, 3.0])
    with pytest.raises(InputError, match="3 points"):
        scale.delta([1.0, 2.0])
    with pytest.raises(InputError, match="members"):
        scale.sigma(0.5)
    with pytest.raises(InputError, match="weights"):
        scale.diamond([0.0, 1, 2], weights="third")
    with pytest.raises(InputError, match="isolated"):
        TimeScale.interval(0, 1).delta([1.0, 2.0])
    with pytest.raises(InputError, match="start < stop"):
        TimeScale(intervals=[(1, 0)])
    with pytest.raises(InputError, match="inner points"):
        TimeScale([0, 1]).kappa()
    with pytest.raises(InputError, match="step"):
        TimeScale.uniform(0, 0, 1)
