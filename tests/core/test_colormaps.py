# SPDX-License-Identifier: GPL-3.0-or-later
"""Color maps: even, in order, and told apart by everyone they promise it to."""

import numpy as np
import pytest

from core import InputError
from core.colormaps import (
    COLORMAPS,
    DIVERGING,
    from_oklab,
    map_colors,
    ramp_colors,
    to_oklab,
)
from core.comparison import Comparison

SHARE = np.linspace(0, 1, 65)


def steps(colors):
    return np.linalg.norm(np.diff(to_oklab(colors), axis=0), axis=1)


def test_white_has_lightness_one_and_no_hue():
    """The one value that [1] states in words; its matrices have ten digits."""
    np.testing.assert_allclose(to_oklab(np.ones(3)), [1, 0, 0], atol=1e-7)


def test_oklab_and_back():
    colors = np.random.default_rng(0).uniform(size=(100, 3))
    np.testing.assert_allclose(from_oklab(to_oklab(colors)), colors, atol=1e-9)


@pytest.mark.parametrize("name", [name for name in COLORMAPS if name != "heat"])
def test_steps_of_a_map_look_alike(name):
    """Chords of a path that turns are shorter than the way along it, by little."""
    found = steps(map_colors(name, SHARE))
    assert found.max() / found.min() < 1.2


@pytest.mark.parametrize("name", [name for name in COLORMAPS if name != "rainbow"])
def test_lighter_is_more(name):
    lightness = to_oklab(map_colors(name, SHARE))[:, 0]
    assert (np.diff(lightness) > 0).all()
    assert lightness[-1] - lightness[0] > 0.6


def test_rainbow_tells_more_values_apart_than_the_others():
    length = {name: steps(map_colors(name, SHARE)).sum() for name in COLORMAPS}
    assert max(length, key=length.get) == "rainbow"


def test_cividis_is_without_red_and_green():
    """The axis from red to green is nearly the second of Oklab."""
    colors = to_oklab(map_colors("cividis", SHARE))
    assert np.abs(colors[:, 1]).max() < 0.02
    assert np.ptp(colors[:, 2]) > 0.15


def test_diverging_map_is_neutral_and_lightest_in_the_middle():
    colors = to_oklab(ramp_colors(DIVERGING, SHARE))
    assert colors[:, 0].argmax() == 32
    assert np.hypot(*colors[32, 1:]) < 0.01


@pytest.mark.parametrize("name", COLORMAPS)
def test_colors_of_a_comparison_are_those_of_its_map(name):
    values = np.linspace(0, 2, 5)
    found = Comparison(values, values).colors(limit=2.0, colormap=name)
    np.testing.assert_allclose(found[:, :3], map_colors(name, values / 2), atol=1e-6)


def test_sides_keep_their_colors_whatever_the_map():
    values = np.array([1.0, 2.0, 3.0])
    found = Comparison(values, values, values, values[::-1], values, values)
    for measure in ("log_ratio", "wins"):
        np.testing.assert_array_equal(
            found.colors(measure, colormap="gray"), found.colors(measure)
        )


def test_unknown_map():
    values = np.zeros(3)
    with pytest.raises(InputError, match="colormap"):
        Comparison(values, values).colors(colormap="jet")
