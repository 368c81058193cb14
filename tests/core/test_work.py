# SPDX-License-Identifier: GPL-3.0-or-later
"""How much work a point costs: counted, never timed.

Milliseconds are measured by `make bench`; what a busy machine cannot change is here.
"""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from core import Settings, delaunay_normals, estimate_normals, shapes
from core.auto import blend
from core.neighbors import blocks
from core.neighbors.blocks import Blocks
from core.neighbors.graph import NearestNeighbors

FIXED = Settings(method="time_scale", neighbors=16, orientation="none", threads=1)


@pytest.fixture
def searches(monkeypatch):
    """Count points searched for by themselves, and the neighbors asked for.

    In kd-trees ("tree"), and among the blocks around a point ("each").
    """
    counted = {"tree": 0, "each": 0, "neighbors": 0}

    class Counting(cKDTree):
        def query(self, x, k=1, **options):
            counted["tree"] += len(x)
            counted["neighbors"] += len(x) * int(np.max(k))
            return super().query(x, k=k, **options)

    def search_each(blocks, places, count, plain=Blocks.search_each):
        counted["each"] += len(places)
        counted["neighbors"] += len(places) * count
        return plain(blocks, places, count)

    monkeypatch.setattr("scipy.spatial.cKDTree", Counting)
    monkeypatch.setattr(Blocks, "search_each", search_each)
    return counted


def surface(count):
    return shapes.BUMPY.sample(count, 1, even=False)[0]


@pytest.mark.parametrize("count", [1000, 20_000])
def test_few_points_are_searched_for_one_by_one(searches, count):
    estimate_normals(surface(count), settings=replace(FIXED, sheets=False))
    assert searches["tree"] == 0
    assert searches["each"] < 0.02 * count


def test_choosing_a_scale_asks_a_thousand_points(searches):
    points = surface(20_000)
    estimate_normals(points, settings=Settings(orientation="none", threads=1))
    assert searches["tree"] == 0
    # The share of the test above, and neighbors looked up further out.
    assert searches["each"] < 0.02 * 20_000 + 4 * 1100


def test_a_small_cloud_is_not_asked_whole(searches):
    estimate_normals(surface(400), settings=Settings(orientation="none", threads=1))
    # The scale asks a quarter of them, twice, for at most a hundred; the noise all of
    # so few for sixteen; and a tenth are left over by blocks.
    asked = 100 * (65 + 101) + 400 * 17 + 0.1 * 400 * 41
    assert searches["neighbors"] < asked


def test_the_baseline_searches_as_little(searches):
    delaunay_normals(surface(20_000))
    assert searches["tree"] == 0
    assert searches["each"] < 0.02 * 20_000


def test_where_blocks_are_of_no_use_every_point_is_searched_for_once(searches):
    points = np.random.default_rng(0).normal(size=(6000, 3))
    estimate_normals(points, settings=replace(FIXED, sheets=False))
    assert searches["tree"] == 6000
    assert searches["each"] == 0


def test_memory_per_point_does_not_grow(monkeypatch):
    """Beyond a fixed working set, bytes go with the points: under 52 of them each.

    What comes back are 38: normals, validity, confidence, scale, and the sides with
    theirs. The order of the points takes 4, the boxes of their blocks 3.
    """
    # A block that is freed before the work starts would hide the rest.
    monkeypatch.setattr("core.estimate.hold_memory", lambda: None)
    peaks, kept = [], []
    # As many points in a block, and as many blocks in a run.
    for count in (200_000, 400_000):
        points = surface(count)
        tracemalloc.start()
        estimate = estimate_normals(points, settings=FIXED)
        now, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert len(estimate.normals) == count
        kept.append(now)
        peaks.append(peak)
    grown = (peaks[1] - peaks[0]) / 200_000
    assert grown < 52
    assert (kept[1] - kept[0]) / 200_000 < 40
    assert peaks[0] - 200_000 * grown < 40e6


def test_points_side_by_side_share_their_search(searches):
    points = surface(20_000)
    nearest = NearestNeighbors(points)
    rows = nearest.order[5000:6000:2]
    index, _ = nearest.neighbors(rows, 16)
    assert searches["each"] < 0.1 * len(rows)
    # One here and there is looked for by itself.
    nearest.neighbors(nearest.order[::100], 16)
    assert searches["each"] >= 200
    expected = cKDTree(points).query(points[rows], k=17)[1][:, 1:]
    assert (index == expected).mean() > 0.999


def test_arrays_of_distances_stay_small(monkeypatch):
    """None is larger than two megabytes, whatever the count."""
    sizes = []
    plain = blocks._least
    monkeypatch.setattr(
        blocks,
        "_least",
        lambda square, count: sizes.append(square.nbytes) or plain(square, count),
    )
    estimate_normals(surface(200_000), settings=FIXED)
    assert max(sizes) <= 2**21


@pytest.fixture
def voted(monkeypatch):
    """Count the points that the normals around them vote on."""
    counted = []
    plain = blend.count_votes

    def count_votes(offsets, *others):
        counted.append(offsets.shape[2])
        return plain(offsets, *others)

    monkeypatch.setattr(blend, "count_votes", count_votes)
    return counted


def test_votes_are_counted_at_creases_only(voted):
    """On a smooth surface nobody votes; a cube has one point in ten at an edge."""
    estimate_normals(surface(20_000), settings=Settings(orientation="none"))
    assert sum(voted) == 0
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (20_000, 3))
    points[np.arange(20_000), rng.integers(3, size=20_000)] = 1
    estimate_normals(points, settings=Settings(orientation="none"))
    assert 0.01 < sum(voted) / 20_000 < 0.2
