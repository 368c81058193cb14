# SPDX-License-Identifier: GPL-3.0-or-later
"""Normal equations of many points at once solve what each alone would."""

import numpy as np
import pytest

from core.patches.patch import BIQUADRATIC, CUBIC
from core.patches.solver import NormalEquations, cholesky_solve


def problem(count=20, m=6, seed=0):
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-1, 1, (2, count, m))
    return x, y, rng.normal(size=(3, count, m)), rng.uniform(0.1, 1, (2, count, m))


def columns(terms, x, y, which=(0, 0)):
    """The design matrix of one point, (k, terms), of the terms or of a derivative."""
    a, b = which
    return np.stack(
        [
            (i if a else 1) * (j if b else 1) * x ** max(i - a, 0) * y ** max(j - b, 0)
            for i, j in terms
        ],
        axis=-1,
    )


@pytest.mark.parametrize("terms", [CUBIC, CUBIC[:5], BIQUADRATIC])
def test_heights_and_slopes(terms):
    x, y, (z, dx, dy), (weights, of_slopes) = problem()
    equations = NormalEquations(terms, x, y, z, weights)
    equations.add_slopes(dx, dy, of_slopes)
    found = equations.solve()
    for point in range(x.shape[1]):
        at = x[:, point], y[:, point]
        design = np.concatenate(
            [columns(terms, *at, which) for which in ((0, 0), (1, 0), (0, 1))]
        )
        known = np.concatenate([a[:, point] for a in (z, dx, dy)])
        root = np.sqrt(
            np.concatenate([a[:, point] for a in (weights, of_slopes, of_slopes)])
        )
        expected = np.linalg.lstsq(root[:, None] * design, root * known)[0]
        # The condition of the normal equations is some hundreds.
        np.testing.assert_allclose(found[:, point], expected, rtol=1e-10, atol=1e-12)


def test_systems_are_solved():
    rng = np.random.default_rng(1)
    factor = rng.normal(size=(7, 30, 9))
    matrix, right = np.einsum("mki,mkj->mij", factor, factor), rng.normal(size=(7, 9))
    system = np.concatenate([matrix.transpose(1, 2, 0), right.T[None]])
    # What is above the diagonal does not count.
    system[0, 1] = np.nan
    expected = np.linalg.solve(matrix, right[..., None])[..., 0].T
    np.testing.assert_allclose(cholesky_solve(system), expected, rtol=1e-10)


def test_a_system_that_leaves_terms_open_has_a_finite_solution():
    system = np.zeros((4, 3, 2))
    system[0, 0] = system[-1, 0] = 1
    np.testing.assert_array_equal(cholesky_solve(system), [[1, 1], [0, 0], [0, 0]])
