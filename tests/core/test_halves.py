# SPDX-License-Identifier: GPL-3.0-or-later
"""Halves of halves: all points, in boxes that are parted by a plane each."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core import shapes
from core.neighbors.halves import halved, sizes_of_halves


@given(st.integers(1, 100_000), st.integers(2, 100))
def test_sizes(count, most):
    levels = sizes_of_halves(count, most)
    assert all(sizes.sum() == count for sizes in levels)
    assert all(np.ptp(sizes) <= 1 for sizes in levels)
    assert all((sizes[::2] == sizes[0]).all() for sizes in levels)
    assert levels[-1].max() <= most
    assert all(sizes.max() > most for sizes in levels[:-1])


def clouds():
    rng = np.random.default_rng(3)
    # More points than are halved in one go.
    yield "surface", shapes.BUMPY.sample(140_000, 1, even=False)[0]
    yield "volume", rng.normal(size=(5001, 3))
    yield "far away", rng.normal(size=(999, 3)) + 1e6
    yield "few", rng.normal(size=(5, 3))


CLOUDS = dict(clouds())


@pytest.mark.parametrize("name", CLOUDS)
def test_every_box_is_parted_by_a_plane(name):
    points = CLOUDS[name]
    order = halved(points, 22)
    np.testing.assert_array_equal(np.sort(order), np.arange(len(points)))
    coordinates = points[order].T
    for sizes in sizes_of_halves(len(points), 22)[1:]:
        starts = np.cumsum(sizes) - sizes
        low = np.minimum.reduceat(coordinates, starts, axis=1)
        high = np.maximum.reduceat(coordinates, starts, axis=1)
        # The place of a point takes the last bits of its coordinate: a thousandth of
        # a millionth of the box, at 2^17 points.
        slack = 1e-9 * (high - low).max()
        assert ((high[:, ::2] - low[:, 1::2]).min(axis=0) <= slack).all()


def test_a_grid_is_parted_into_compact_boxes():
    """Equal coordinates are told apart, and each box stays about as wide as long."""
    x, y = np.meshgrid(np.arange(64.0), np.arange(64.0))
    grid = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
    grid = np.random.default_rng(0).permutation(grid)
    boxes = grid[halved(grid, 22)].T.reshape(3, -1, 16)
    extent = boxes.max(axis=2) - boxes.min(axis=2)
    assert (extent <= [[3], [3], [0]]).all()


def test_threads_do_not_matter():
    points = CLOUDS["surface"]
    one, two = (halved(points, 22, threads=threads) for threads in (1, 2))
    np.testing.assert_array_equal(one, two)


def test_a_center_is_taken_off():
    points = CLOUDS["volume"]
    center = np.array([1.0, 2, 3])
    order = halved(points, 22, center=center)
    np.testing.assert_array_equal(order, halved(points - center, 22))
