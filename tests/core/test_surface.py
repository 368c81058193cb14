# SPDX-License-Identifier: GPL-3.0-or-later
"""Grid surfaces: Fig. 1's five cases, and normals against closed forms."""

import numpy as np
import pytest

from core import GridSurface, InputError, TimeScale, shapes

T1 = TimeScale([0.0, 1.0, 2.5, 3.0])
T2 = TimeScale([0.0, 0.5, 2.0, 3.0])


def wavy(t, s):
    return np.stack([t, s, np.sin(t) + s * t / 4], axis=-1)


def unit_cross(a, b):
    cross = np.cross(a, b)
    return cross / np.linalg.norm(cross)


def test_the_five_normals_of_figure_1():
    """Section 2: N1 ... N5 by quotients written out, one-sided at the ends."""
    p = wavy(*np.meshgrid(T1.points, T2.points, indexing="ij"))
    t, s = T1.points, T2.points
    normals = GridSurface(T1, T2, p).normals()

    def delta_1(i, j):
        return (p[i + 1, j] - p[i, j]) / (t[i + 1] - t[i])

    def nabla_1(i, j):
        return (p[i, j] - p[i - 1, j]) / (t[i] - t[i - 1])

    def diamond_1(i, j):
        return (p[i + 1, j] - p[i - 1, j]) / (t[i + 1] - t[i - 1])

    def delta_2(i, j):
        return (p[i, j + 1] - p[i, j]) / (s[j + 1] - s[j])

    def nabla_2(i, j):
        return (p[i, j] - p[i, j - 1]) / (s[j] - s[j - 1])

    def diamond_2(i, j):
        return (p[i, j + 1] - p[i, j - 1]) / (s[j + 1] - s[j - 1])

    cases = {
        (0, 1): (delta_1, diamond_2),
        (1, 1): (diamond_1, diamond_2),
        (3, 1): (nabla_1, diamond_2),
        (2, 3): (diamond_1, nabla_2),
        (1, 0): (diamond_1, delta_2),
    }
    for at, (along_1, along_2) in cases.items():
        np.testing.assert_allclose(
            normals[at], unit_cross(along_1(*at), along_2(*at)), atol=1e-14
        )


def test_a_plane_has_its_normal_everywhere():
    surface = GridSurface.graph(T1, T2, lambda t, s: 2 * t - 3 * s + 1)
    expected = np.array([-2, 3, 1]) / np.sqrt(14)
    for weights in ("paper", "second_order"):
        np.testing.assert_allclose(
            surface.normals(weights=weights), np.broadcast_to(expected, (4, 4, 3))
        )
    assert surface.is_regular().all()


def test_second_order_weights_are_exact_on_a_quadric_inside():
    surface = GridSurface.graph(T1, T2, lambda t, s: t**2 - t * s + 3 * s**2)
    t, s = np.meshgrid(T1.points, T2.points, indexing="ij")
    expected = np.stack([-(2 * t - s), -(6 * s - t), np.ones_like(t)], axis=-1)
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    inner = np.s_[1:-1, 1:-1]
    np.testing.assert_allclose(
        surface.normals(weights="second_order")[inner], expected[inner], atol=1e-14
    )
    assert np.abs(surface.normals()[inner] - expected[inner]).max() > 1e-3


def test_metric_of_a_torus():
    """On h Z x h Z the metric tends to the smooth one, diag((R + r cos s)^2, r^2)."""
    grid = TimeScale.uniform(0.01, 0, 1)
    surface = GridSurface.from_function(grid, grid, shapes.TORUS.point)
    s = grid.points[1:-1]
    metric = surface.metric()[1:-1, 1:-1]
    # Central differences of sines at h = 0.01: relative error h^2/6 per factor.
    np.testing.assert_allclose(
        metric[..., 0, 0],
        np.broadcast_to((1 + 0.35 * np.cos(s)) ** 2, (99, 99)),
        rtol=1e-4,
    )
    np.testing.assert_allclose(metric[..., 1, 1], 0.35**2, rtol=1e-4)
    np.testing.assert_allclose(metric[..., 0, 1], 0, atol=1e-12)


def test_a_surface_folded_to_a_line_is_not_regular():
    surface = GridSurface.from_function(
        T1, T2, lambda t, s: np.stack([t + s, t + s, t + s], axis=-1)
    )
    assert not surface.is_regular().any()
    assert (surface.normals() == 0).all()


@pytest.mark.parametrize("name", ["torus", "paraboloid", "bumpy"])
def test_reparametrization_keeps_normals(name):
    """Theorem 2: an increasing change of both parameters keeps the normals.

    Up to the order of the scheme: the change of the normals falls by 4 when the step
    is halved (second-order weights), and reversing one parameter turns them.
    """
    shape = shapes.ALL[name]

    def normals(step, change):
        grid = TimeScale(np.arange(0.2, 0.6 + step / 2, step))

        def surface(a, b):
            return shape.point(change(a), change(b))

        found = GridSurface.from_function(grid, grid, surface)
        return found.normals(weights="second_order")[1:-1, 1:-1]

    def exact(step):
        t = np.arange(0.2, 0.6 + step / 2, step)[1:-1]
        t, s = np.meshgrid(t, t, indexing="ij")
        return shape.side * shape.normal(t + t**3 / 3, s + s**3 / 3)

    error = [
        np.abs(normals(h, lambda t: t + t**3 / 3) - exact(h)).max()
        for h in (0.02, 0.01)
    ]
    assert 3.5 < error[0] / error[1] < 4.5

    flipped = GridSurface.from_function(
        TimeScale([-0.6, -0.4, -0.2]),
        TimeScale([0.2, 0.4, 0.6]),
        lambda a, b: shape.point(-a, b),
    ).normals()
    straight = GridSurface.from_function(
        TimeScale([0.2, 0.4, 0.6]), TimeScale([0.2, 0.4, 0.6]), shape.point
    ).normals()
    np.testing.assert_allclose(flipped[::-1], -straight, atol=1e-14)


@pytest.mark.parametrize(
    "points", [np.zeros((4, 3, 3)), np.zeros((4, 4)), np.full((4, 4, 3), np.nan)]
)
def test_bad_points(points):
    with pytest.raises(InputError, match="grid points"):
        GridSurface(T1, T2, points)


def test_bad_heights():
    with pytest.raises(InputError, match="heights"):
        GridSurface.graph(T1, T2, np.zeros((2, 2)))
