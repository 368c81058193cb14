# SPDX-License-Identifier: GPL-3.0-or-later
"""Clouds in tiles come out as in one piece."""

import json
import os
import signal
import threading
from pathlib import Path

import numpy as np
import pytest

from addon import cli, files
from addon.files.shape import Shape
from core import InputError, Settings, shapes
from core.auto.blend import Noisy, blend, coarse_cloud
from core.auto.coarse import block_means
from core.inputs import extent_of
from core.neighbors.graph import NearestNeighbors
from core.neighbors.halves import halved
from core.partition import Partition, depth_in_box
from core.patches.asked import Asked
from core.tiles import (
    asked_of_parts,
    facing,
    fit_noisy_tile,
    fit_tile,
    misfit_counts,
    plan_of,
    thinned,
)

LARGE = cli._part("addon.tiles.large")
CLUSTER = cli._part("addon.tiles.cluster")
# Far more than neighborhoods in single precision need, far less than a real tile.
COUNT, FEWEST = 120_000, 70_000


@pytest.fixture
def _small_tiles(monkeypatch):
    """Tiles as small as a test can be, whatever the memory."""
    monkeypatch.setattr(LARGE, "_FEWEST", FEWEST)
    monkeypatch.setattr(LARGE, "_BASE", 1 << 50)


@pytest.fixture(scope="module")
def torus():
    """Points all around, far out, in the order in which they come."""
    points, normals, _ = shapes.TORUS.sample(COUNT, seed=0)
    return points * 50 + np.array([623_000.0, 4_851_000.0, 100.0]), normals


def estimate(source: Path, target: Path, *more: str) -> dict:
    report = target.with_name("report.json")
    command = ["estimate", str(source), "-o", str(target), "--quiet", "--overwrite"]
    assert cli.main([*command, "--report", str(report), *more]) == 0
    return json.loads(report.read_text("utf-8"))["files"][0]


def planned(points, settings):
    return plan_of(Asked.of(NearestNeighbors(points)), settings)


def boxed(points, depth):
    """Return the partition of a cloud, and the points of each box in their order."""
    partition = Partition.of(points, depth)
    box = partition.box_of(points)
    return partition, [np.flatnonzero(box == b) for b in range(len(partition))]


def test_boxes_cover_space_and_hold_as_many_points_each():
    points = np.random.default_rng(0).normal(size=(4000, 3))
    partition = Partition.of(points, 3)
    box = partition.box_of(points)
    assert np.bincount(box, minlength=8).tolist() == [500] * 8
    depth = np.stack(
        [
            depth_in_box(points, *corners)
            for corners in zip(partition.low, partition.high, strict=True)
        ]
    )
    # Planes go through points, which are in both boxes' closures.
    assert (depth[box, np.arange(4000)] >= 0).all()
    assert ((depth > 0).sum(axis=0) <= 1).all()


@pytest.mark.parametrize("count", [4000, 4001, 4099])
def test_boxes_are_halves_of_halves(count):
    """Boxes hold the points, and their blocks are the blocks, of the whole cloud."""
    points = np.random.default_rng(0).normal(size=(count, 3))
    partition, rows = boxed(points, 3)
    order = halved(points, -(-count // 8))
    ends = np.cumsum([len(part) for part in rows])[:-1]
    for own, part in zip(rows, np.split(order, ends), strict=True):
        assert np.array_equal(own, np.sort(part))
    whole = block_means(points, 9)[0]
    parts = [
        block_means(points[own], 6, width=partition.width(count, len(own)))[0]
        for own in rows
    ]
    # Points are added up in another order.
    np.testing.assert_allclose(np.concatenate(parts), whole, rtol=0, atol=1e-14)


def test_one_box_is_all_of_space():
    partition = Partition.of(np.eye(3), 0)
    assert len(partition) == 1
    assert partition.box_of(np.eye(3)).tolist() == [0, 0, 0]
    assert np.isinf(depth_in_box(np.eye(3), partition.low[0], partition.high[0])).all()


def test_what_is_not_known_is_not_exact():
    points, _, _ = shapes.SPHERE.sample(3000, seed=0)
    plan = planned(points, Settings(neighbors=16))
    inside = points[:, 0] < 0.2
    known = points[inside]
    depth = np.where(inside, 0.2 - points[:, 0], 0)[inside]
    tile = fit_tile(known, len(known), depth, plan)
    whole = fit_tile(points, len(points), np.full(3000, np.inf), plan)
    assert whole.exact.all()
    # Some of the points near the edge are cut, those a margin away from it are not.
    assert (~tile.exact).sum() > 0
    assert tile.exact[depth > plan.margin].all()
    # In double precision the last bits hang on the order of sums.
    close = np.abs(tile.normals - whole.normals[inside]).max(axis=1) < 1e-9
    assert close[tile.exact].all()
    assert not close[~tile.exact].all()


def test_few_points_are_no_neighborhood():
    plan = planned(shapes.SPHERE.sample(100, seed=0)[0], Settings(neighbors=8))
    tile = fit_tile(np.eye(3), 3, np.full(3, 1.0), plan)
    assert not tile.valid.any()
    assert not tile.exact.any()
    assert fit_tile(np.eye(3), 3, np.full(3, np.inf), plan).exact.all()


def test_thinned_points_are_one_a_cell():
    points = np.random.default_rng(0).uniform(-5, 5, (3000, 3))
    rows = thinned(points, 2.5)
    assert len(rows) == 64
    assert len(np.unique(np.floor(points[rows] / 2.5), axis=0)) == 64


def test_normals_take_the_side_of_their_guides():
    points, normals, _ = shapes.SPHERE.sample(2000, seed=0)
    guides = (points[::10], normals[::10], np.ones(200))
    found = facing(points, -normals, Settings(), guides)
    assert np.array_equal(found, normals)


@pytest.mark.parametrize(
    "settings",
    [
        Settings(method="paper"),
        Settings(graph="delaunay"),
        Settings(orientation="reference"),
    ],
)
def test_what_needs_the_whole_cloud_is_refused(settings):
    with pytest.raises(InputError, match="for a cloud in tiles"):
        planned(shapes.SPHERE.sample(100, seed=0)[0], settings)


def test_the_center_does_not_hang_on_rounding(torus):
    points, _ = torus
    center = extent_of(points).center
    assert np.array_equal(extent_of(points[::-1]).center, center)
    assert np.abs(center - points.mean(axis=0)).max() < 0.3


@pytest.mark.usefixtures("_small_tiles")
@pytest.mark.parametrize("suffix", [".ply", ".npy"])
def test_tiles_give_the_same_bits(suffix, tmp_path, torus):
    points, normals = torus
    columns = {"label": np.arange(COUNT, dtype=np.int32)}
    source = tmp_path / f"a{suffix}"
    files.write(source, Shape(points, None, normals, columns))
    row = estimate(source, tmp_path / f"tiles{suffix}", "--memory", "500M")
    assert row["tiles"] == 2
    assert row["cut"] == 0
    whole = estimate(source, tmp_path / f"whole{suffix}")
    assert (row["neighbors"], row["patch"]) == (whole["neighbors"], whole["patch"])
    assert (tmp_path / f"tiles{suffix}").read_bytes() == (
        tmp_path / f"whole{suffix}"
    ).read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_dir()) == []


def creased(count, noise):
    """Return points of a cube, dense enough for creases to show, with noise."""
    rng = np.random.default_rng(5)
    points = rng.uniform(-1, 1, (count, 3))
    face = rng.integers(0, 3, count)
    points[np.arange(count), face] = rng.choice([-1.0, 1.0], count)
    return points + rng.normal(0, noise, (count, 3))


@pytest.mark.usefixtures("_small_tiles")
@pytest.mark.parametrize("noise", [0.0, 2e-4])
def test_tiles_blend_at_creases_as_one_piece_does(noise, tmp_path):
    np.save(tmp_path / "a.npy", creased(COUNT, noise))
    row = estimate(tmp_path / "a.npy", tmp_path / "b.npy", "--memory", "500M")
    assert (row["tiles"], row["cut"]) == (2, 0)
    estimate(tmp_path / "a.npy", tmp_path / "c.npy")
    tiles, whole = (np.load(tmp_path / f"{name}.npy")[:, 3:] for name in "bc")
    # Bits but for a few points that hang on the last ones of a sum.
    # On the very edge of a cube a side may be either one's, too.
    off = np.minimum(np.abs(tiles - whole), np.abs(tiles + whole)).max(axis=1)
    assert off.max() < 1e-5
    assert (tiles == whole).all(axis=1).mean() > 0.999


@pytest.mark.parametrize("level", [0.15, 1.0])
def test_noisy_tiles_are_the_same_bits_under_one_plan(level):
    """Where every point is its own block, and where blocks have three."""
    count = 60_000
    spacing = np.sqrt(24 / count)
    points = creased(count, level * spacing)
    plan = planned(points, Settings())
    assert plan.level > 0
    nearest = NearestNeighbors(points)

    def run(work, chunks):
        for chunk in chunks:
            work(chunk)

    whole = blend(Noisy(nearest, plan.level, plan.noise, least=plan.block), run)
    coarse, _ = coarse_cloud(nearest, plan.level, plan.block)
    assert (len(coarse) == count) == (plan.halvings is None) == (level < 0.25)
    partition, rows = boxed(points, 2)
    for number, own in enumerate(rows):
        low = partition.low[number] - plan.margin
        high = partition.high[number] + plan.margin
        inside = depth_in_box(coarse.points, low, high) >= 0
        blocks = coarse.points[inside]
        assert len(blocks) < len(coarse)
        depth, around = (depth_in_box(p, low, high) for p in (points[own], blocks))
        tile = fit_noisy_tile(points[own], depth, blocks, around, plan)
        assert tile.exact.mean() > 0.99
        assert np.array_equal(tile.normals[tile.exact], whole.normals[own][tile.exact])


@pytest.mark.usefixtures("_small_tiles")
def test_tiles_take_the_decisions_of_one_piece_under_noise(tmp_path):
    points = creased(COUNT, 0.01)
    np.save(tmp_path / "a.npy", points)
    row = estimate(tmp_path / "a.npy", tmp_path / "b.npy", "--memory", "500M")
    assert (row["tiles"], row["cut"]) == (2, 0)
    estimate(tmp_path / "a.npy", tmp_path / "c.npy")
    tiles, whole = (np.load(tmp_path / f"{name}.npy")[:, 3:] for name in "bc")
    cosine = (tiles * whole).sum(axis=1)
    # Sides are found by other points: a few at the creases may differ.
    assert (cosine < 0).sum() < 10
    # So is the noise measured. The errors are of nine degrees here.
    angle = np.degrees(np.arccos(np.clip(np.abs(cosine), 0, 1)))
    assert np.sqrt((angle**2).mean()) < 0.3


def test_the_misfits_of_tiles_are_those_of_the_cloud():
    points = creased(20_000, 1e-3)
    plan = planned(points, Settings(neighbors=16))
    partition, rows = boxed(points, 2)
    whole = misfit_counts(points, len(points), np.full(len(points), np.inf), plan)
    total = 0
    for number, own in enumerate(rows):
        low = partition.low[number] - plan.margin
        high = partition.high[number] + plan.margin
        halo = np.flatnonzero(depth_in_box(points, low, high) >= 0)
        halo = np.setdiff1d(halo, own)
        known = points[np.concatenate([own, halo])]
        depth = depth_in_box(known, low, high)
        total = total + misfit_counts(known, len(own), depth, plan)
    assert np.array_equal(total, whole)


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_points_are_asked_from_parts_that_are_whole(noise):
    points = creased(30_000, noise)
    nearest = NearestNeighbors(points)
    rows = np.arange(0, len(points), 500)
    parts = [points[np.r_[row, nearest.neighbors([row], 1200)[0][0]]] for row in rows]
    parts = asked_of_parts(parts, len(points))
    offsets, reach = parts.around(122)
    assert offsets.shape == (3, 122, 4 * len(rows))
    far = nearest.neighbors(rows, 122)[1][:, -1]
    np.testing.assert_allclose(reach[::4], far, rtol=1e-9)
    one, other = plan_of(parts, Settings()), planned(points, Settings())
    # Several points of a part are asked: they know less than as many from all over.
    assert one.level == pytest.approx(other.level, rel=0.2)
    assert (one.level > 0) == (noise > 0)
    assert one.margin == pytest.approx(other.margin, rel=0.2)
    if not noise:
        assert one.settings == other.settings


@pytest.mark.usefixtures("_small_tiles")
@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_tiles_of_las(suffix, tmp_path, torus):
    points, normals = torus
    source = tmp_path / f"a{suffix}"
    columns = {"intensity": np.arange(COUNT, dtype=np.uint16)}
    files.write(source, Shape(points, None, normals, columns))
    row = estimate(source, tmp_path / f"b{suffix}", "--memory", "500M")
    assert row["cut"] == 0
    before, after = files.read(source), files.read(tmp_path / f"b{suffix}")
    assert np.array_equal(before.points, after.points)
    assert np.array_equal(before.columns["intensity"], after.columns["intensity"])
    # Nearly those of the torus, all outward.
    assert np.abs(after.normals - normals).max() < 0.01


@pytest.mark.usefixtures("_small_tiles")
def test_lone_points_are_looked_for_far_away(tmp_path, torus):
    points = np.concatenate([torus[0], torus[0][:3] + [5e3, 0, 0], [[np.nan] * 3]])
    np.save(tmp_path / "a.npy", points)
    row = estimate(tmp_path / "a.npy", tmp_path / "b.npy", "--memory", "500M")
    assert row["invalid"] >= 1
    found = np.load(tmp_path / "b.npy")
    assert np.array_equal(found[:, :3], points, equal_nan=True)
    assert (found[-1, 3:] == 0).all()


def test_tiles_are_for_formats_that_can_be_read_in_pieces(tmp_path, capsys):
    (tmp_path / "a.xyz").write_text("0 0 0\n", "utf-8")
    command = ["estimate", str(tmp_path / "a.xyz"), "-o", str(tmp_path / "b.xyz")]
    assert cli.main([*command, "--memory", "1G"]) == 1
    assert "for work in tiles" in capsys.readouterr().err
    assert cli.main([*command, "--memory", "lots"]) == 2


def test_nobody_at_the_address_of_a_scheduler(tmp_path, capsys, monkeypatch):
    distributed = pytest.importorskip("distributed")
    real = distributed.Client

    def soon(address, *, timeout, set_as_default):
        return real(address, timeout=timeout / 20, set_as_default=set_as_default)

    monkeypatch.setattr(distributed, "Client", soon)
    np.save(tmp_path / "a.npy", np.zeros((9, 3)))
    command = ["estimate", str(tmp_path / "a.npy"), "-o", str(tmp_path / "b.npy")]
    assert cli.main([*command, "--scheduler", "tcp://127.0.0.1:1"]) == 1
    told = capsys.readouterr().err
    assert "no scheduler answers at tcp://127.0.0.1:1" in told


@pytest.mark.usefixtures("_small_tiles")
@pytest.mark.filterwarnings("ignore")
def test_a_worker_that_is_killed_changes_nothing(tmp_path, torus, monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(LARGE, "_FEWEST", 16_000)
    np.save(tmp_path / "a.npy", torus[0])
    more = ("--memory", "500M", "--threads", "1")
    row = estimate(tmp_path / "a.npy", tmp_path / "here.npy", *more)
    assert row["tiles"] == 8
    killed = []

    def kill_one(cluster):
        """Kill a worker process once tiles have come back."""
        client = distributed.Client(cluster, set_as_default=False)
        first.wait(60)
        pid = next(iter(client.run(os.getpid).values()))
        os.kill(pid, signal.SIGKILL)
        killed.append(pid)
        client.close()

    first, result = threading.Event(), CLUSTER._result

    def tell(future):
        found = result(future)
        first.set()
        return found

    monkeypatch.setattr(CLUSTER, "_result", tell)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        thread = threading.Thread(target=kill_one, args=(cluster,))
        thread.start()
        address = ("--scheduler", cluster.scheduler_address)
        estimate(tmp_path / "a.npy", tmp_path / "there.npy", *more, *address)
        thread.join(60)
    assert len(killed) == 1
    here, there = (tmp_path / name for name in ("here.npy", "there.npy"))
    assert here.read_bytes() == there.read_bytes()
