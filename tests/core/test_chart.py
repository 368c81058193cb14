# SPDX-License-Identifier: GPL-3.0-or-later
"""Axes of neighborhoods are those of their covariance."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.patches.chart import principal_axes, tangent_axes


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_axes_lie_between_the_eigenvectors(dtype):
    rng = np.random.default_rng(1)
    offsets = rng.normal(size=(3, 30, 100)) * np.array([1, 0.5, 0.1])[:, None, None]
    offsets = np.einsum(
        "ij,jkm->ikm", np.linalg.qr(rng.normal(size=(3, 3)))[0], offsets
    )
    u, v, n, spans = principal_axes(offsets.astype(dtype), np.full(100, 30))
    everyone = np.concatenate([offsets, np.zeros((3, 1, 100))], axis=1)
    for i in range(100):
        expected = np.linalg.eigh(np.cov(everyone[:, :, i]))[1]
        rounding = 10 * float(np.finfo(dtype).eps)
        assert abs(expected[:, 0] @ n[:, i]) == pytest.approx(1, abs=rounding)
        # Between the other two: the diagonal.
        assert abs(expected[:, 1] @ u[:, i]) == pytest.approx(0.5**0.5, abs=rounding)
        assert abs(expected[:, 2] @ v[:, i]) == pytest.approx(0.5**0.5, abs=rounding)
    np.testing.assert_allclose(np.cross(u, v, axis=0), n, atol=1e-6)
    assert spans.all()


@given(st.integers(0, 10**6))
def test_tangent_axes_complete_a_right_handed_frame(seed):
    n = np.random.default_rng(seed).normal(size=(3, 20))
    n[:, 0] = [0, 0, -1]
    n[:, 1] = [0, 0, 1]
    n /= np.linalg.norm(n, axis=0)
    u, v = tangent_axes(n)
    np.testing.assert_allclose(np.cross(u, v, axis=0), n, atol=1e-12)
    np.testing.assert_allclose((u * v).sum(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose((u * u).sum(axis=0), 1, atol=1e-12)
