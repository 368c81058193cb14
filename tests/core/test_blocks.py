# SPDX-License-Identifier: GPL-3.0-or-later
"""Neighborhoods shared by blocks are those of a search for every point."""

import numpy as np
import pytest

from core import shapes
from core.neighbors.blocks import LARGEST, Blocks
from core.neighbors.graph import NearestNeighbors


def clouds():
    rng = np.random.default_rng(5)
    surface, _, _ = shapes.BUMPY.sample(6000, 1, even=False)
    x, y = np.meshgrid(np.arange(70.0), np.arange(70.0))
    yield "surface", surface
    yield "uneven", surface[rng.random(6000) < np.exp(3 * surface[:, 0] - 3)]
    yield "far outlier", np.concatenate([surface, [[1e4, 0, 0]]])
    yield "volume", rng.normal(size=(6000, 3))
    yield "grid", np.stack([x, y, np.sin(x / 9) + y**2 / 99], axis=-1).reshape(-1, 3)
    yield "line", np.linspace(0, 1, 500)[:, None] * [1.0, 2, 3]
    yield "few", rng.normal(size=(30, 3))


CLOUDS = dict(clouds())


@pytest.mark.parametrize("count", [1, 16, 60])
@pytest.mark.parametrize("name", CLOUDS)
def test_runs_have_the_neighbors_of_single_searches(name, count):
    points = CLOUDS[name]
    count = min(count, len(points) - 1)
    nearest = NearestNeighbors(points)
    runs = nearest.runs(count)
    assert (np.sort(np.concatenate(runs)) == np.arange(len(points))).all()
    for rows in runs:
        expected, _ = nearest.tree.query(points[rows], k=count + 1)
        index, distance = nearest.neighbors(rows, count)
        # Squares are compared in units of the block: half of the digits remain.
        np.testing.assert_allclose(distance, expected[:, 1:], rtol=1e-6, atol=1e-12)
        offsets = points[index] - points[rows][:, None]
        np.testing.assert_allclose(
            np.linalg.norm(offsets, axis=-1), expected[:, 1:], rtol=1e-6, atol=1e-12
        )
        assert (index != rows[:, None]).all()


@pytest.mark.parametrize("name", ["surface", "uneven", "grid"])
def test_any_points_have_the_neighbors_of_single_searches(name):
    points = CLOUDS[name]
    nearest = NearestNeighbors(points)
    # More blocks than are searched in one go, in any order, one of them twice.
    rows = np.random.default_rng(0).permutation(len(points))[: len(points) // 2]
    rows = np.append(rows, rows[:1])
    expected, _ = nearest.tree.query(points[rows], k=61)
    index, distance = nearest.neighbors(rows, 60)
    np.testing.assert_allclose(distance, expected[:, 1:], rtol=1e-6, atol=1e-12)
    offsets, _ = nearest.offsets(rows, 60)
    np.testing.assert_array_equal(
        offsets.transpose(2, 1, 0), points[index] - points[rows][:, None]
    )


def test_what_is_certain_on_a_surface():
    points = CLOUDS["surface"]
    blocks = Blocks(points)
    assert blocks.sizes.max() <= LARGEST
    found = blocks.search(np.arange(len(blocks.sizes)), 17)
    assert found.certain.mean() > 0.95
    assert blocks.useful


def test_blocks_know_where_they_are_of_no_use():
    points = CLOUDS["volume"]
    assert not Blocks(points).useful
