# SPDX-License-Identifier: GPL-3.0-or-later
"""Files larger than memory: cut into tiles on disk, estimated, put together again.

1. A look at all points: how many, where, and a sample of them.
2. Points go to a file for each tile; parts of them say what the cloud asks for.
3. Each tile is estimated with its halo.
4. A thinned cloud of all tiles finds the sides, and each normal takes its own there.
5. Normals go back to the order of the points, and the file is written again.

Only the sample, a tile and a piece of the file are in memory at a time.
"""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ... import core
from ...core import tiles
from ...core.auto.coarse import block_means
from ...core.partition import Partition, depth_in_box
from ...core.patches.sheets import NO_MATTER, noise_of_counts
from ...core.progress import Progress
from ..files import streams
from .buckets import Bucket
from .cluster import Fit
from .survey import look_at

# Bytes of memory: of the program itself, of what is read at a time and of the sample,
# and for each point of a tile and its halo, well above what fifty million points took.
_BASE, _EACH = 420 << 20, 420
# Points by which space is cut, at least, and the bytes that each may take meanwhile.
_SAMPLE, _EACH_OF_SAMPLE = 1_000_000, 250
# Points of a tile: fewer are not worth one.
_FEWEST = 110_000

# Parts of the cloud that settings are chosen by.
_PARTS = 256

# Thinned points that find the sides.
_GUIDES = 120_000

# How often what a normal depends on is looked for farther out, twice as far each time.
_WIDER = 6


def estimate(
    source: Path,
    target: Path,
    settings: core.Settings,
    *,
    memory: int,
    fit: Fit,
    progress: Progress,
) -> dict[str, Any]:
    """Estimate the normals of a file in tiles and write it with them.

    Parameters
    ----------
    source, target : Path
        `target` is written in place, to be renamed by the caller.
    settings : core.Settings
    memory : int
        Bytes that may be used.
    fit : callable
        Calls functions, each in a tuple with its arguments, and yields what they
        return, in the same order: here, or on other machines.
    progress : callable

    Returns
    -------
    dict
        What there is to say, as `Estimate.summary` has it.
    """
    stream = streams.open_stream(source)
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=".tiles-") as folder:
        run = _Run(stream, settings, memory, Path(folder), progress)
        run.decide(fit)
        row = run.fit_all(fit)
        run.find_sides()
        stream.write(target, run.normals_in_order())
        return row | run.row()


class _Run:
    """The steps over one file."""

    def __init__(
        self,
        stream: streams.Stream,
        settings: core.Settings,
        memory: int,
        folder: Path,
        progress: Progress,
    ) -> None:
        self.stream, self.folder, self.progress = stream, folder, progress
        room = max(_SAMPLE, (memory - _BASE) // _EACH_OF_SAMPLE)
        self.survey, sample = look_at(stream, room)
        if self.survey.finite <= 8:
            raise core.InputError(
                f"expected at least 9 points, got {self.survey.finite}"
            )
        viewpoint = settings.viewpoint
        if viewpoint is not None:
            place = np.asarray(viewpoint) - self.survey.center
            settings = replace(settings, viewpoint=place)
        self.depth = _depth(self.survey.finite, memory)
        self.partition = Partition.of(sample, self.depth)
        self.cell = _cell_of(sample[:: max(1, len(sample) // _SAMPLE)])
        del sample
        self.buckets = self._scattered()
        progress(0.1)
        asked = tiles.asked_of_parts(self._parts(), self.survey.finite)
        self.plan = tiles.plan_of(asked, settings)
        self.blocks = self.buckets
        self.valid = self.cut = 0
        self.guides: Any = None
        self.warnings: tuple[str, ...] = ()
        self.orientation = settings.orientation

    def _scattered(self) -> list[Bucket]:
        """Write every point into the file of its tile."""
        made = [
            Bucket(self.folder / f"{number}.points")
            for number in range(len(self.partition))
        ]
        start = 0
        for chunk in self.stream.chunks():
            rows = start + np.flatnonzero(np.isfinite(chunk).all(axis=1))
            points = chunk[rows - start] - self.survey.center
            start += len(chunk)
            box = self.partition.box_of(points)
            order = np.argsort(box, kind="stable")
            cuts = np.searchsorted(box[order], np.arange(len(made) + 1))
            for number, bucket in enumerate(made):
                part = order[cuts[number] : cuts[number + 1]]
                if len(part):
                    bucket.add(rows[part], points[part])
        return made

    def _parts(self) -> list[Any]:
        """Return parts of the cloud from all over it, each whole: see `core.tiles`."""
        filled = self._filled()
        chosen = filled[:: max(1, len(filled) // _PARTS)]
        whole: list[Any] = []
        cut: list[Any] = []
        for number in chosen:
            points = self.buckets[number].read()[1]
            low, high = self.partition.low[number], self.partition.high[number]
            rows = np.linspace(0, len(points) - 1, max(1, _PARTS // len(chosen)))
            for row in np.unique(rows.astype(np.int64)):
                part, reach = _nearest_part(points, row)
                inside = reach <= depth_in_box(part[:1], low, high)[0]
                (whole if inside else cut).append(part)
        return whole or cut

    def decide(self, fit: Fit) -> None:
        """Complete the plan by what only all points say."""
        plan = self.plan
        if plan.level and plan.halvings is not None:
            self.blocks = [self._of_blocks(n) for n in range(len(self.buckets))]
        elif not plan.level and plan.settings.sheets and plan.misfit > NO_MATTER:
            tasks = (
                (tiles.misfit_counts, *self._task(number)) for number in self._filled()
            )
            self.plan = replace(
                plan, misfit=noise_of_counts(np.sum(list(fit(tasks)), axis=0))
            )
        self.progress(0.2)

    def _of_blocks(self, number: int) -> Bucket:
        """Write the means of a tile's blocks into a file of their own."""
        bucket = self.buckets[number]
        made = Bucket(self.folder / f"{number}.blocks")
        if bucket.count:
            width = self.partition.width(self.survey.finite, bucket.count)
            times = max(0, (self.plan.halvings or 0) - self.depth)
            means = block_means(bucket.read()[1], times, width=width)[0]
            made.add(np.zeros(len(means), dtype=np.int64), means)
        return made

    def _filled(self) -> list[int]:
        return [number for number, bucket in enumerate(self.buckets) if bucket.count]

    def fit_all(self, fit: Fit) -> dict[str, Any]:
        """Estimate tile by tile; normals and guides are kept."""
        numbers = self._filled()
        results = fit((self._work, *self._task(number)) for number in numbers)
        found = []
        for done, (number, first) in enumerate(zip(numbers, results, strict=True), 1):
            points = self.buckets[number].read()[1]
            tile = self._widened(points, first, fit)
            self.valid += int(tile.valid.sum())
            self.cut += int((~tile.exact).sum())
            normals = np.where(tile.valid[:, None], tile.normals, 0.0)
            normals.tofile(self.folder / f"{number}.normals")
            rows = np.flatnonzero(tile.valid)
            rows = rows[tiles.thinned(points[rows], self.cell)]
            found.append((points[rows], normals[rows]))
            self.progress(0.2 + 0.5 * done / len(numbers))
        self.guides = [np.concatenate(column) for column in zip(*found, strict=True)]
        return {"tiles": len(numbers)}

    @property
    def _work(self) -> Callable[..., tiles.Tile]:
        return tiles.fit_noisy_tile if self.plan.level else tiles.fit_tile

    def _task(self, number: int) -> tuple[Any, ...]:
        """Return what is known of a tile and its halo, as `_work` takes it."""
        low, high = self.partition.low[number], self.partition.high[number]
        low, high = low - self.plan.margin, high + self.plan.margin
        own = self.buckets[number].read()[1]
        inner = own
        if self.blocks is not self.buckets:
            inner = self.blocks[number].read()[1]
        known = np.concatenate([inner, *self._around(low, high, number)])
        around = depth_in_box(known, low, high)
        if not self.plan.level:
            return known, len(own), around, self.plan
        return own, depth_in_box(own, low, high), known, around, self.plan

    def _around(self, low: Any, high: Any, number: int | None) -> list[Any]:
        """Return the points, or the blocks, of other tiles in a box."""
        return [
            points
            for other, bucket in enumerate(self.blocks)
            if other != number
            for points in bucket.inside(low, high)
        ]

    def _widened(self, points: Any, tile: tiles.Tile, fit: Fit) -> tiles.Tile:
        """Return a tile whose inexact normals were made again from farther around."""
        normals, valid, exact = tile.normals, tile.valid, tile.exact
        reach = self.plan.margin
        for _ in range(_WIDER):
            rows = np.flatnonzero(~exact)
            if not len(rows):
                break
            reach *= 2
            task = self._wider_task(points[rows], reach)
            (again,) = fit(iter([(self._work, *task)]))
            normals[rows], valid[rows] = again.normals, again.valid
            exact[rows] = again.exact
        return tiles.Tile(normals, valid, exact)

    def _wider_task(self, own: Any, reach: float) -> tuple[Any, ...]:
        """Return all that is within a reach of some points, as `_work` takes it."""
        low, high = own.min(axis=0) - reach, own.max(axis=0) + reach
        known, known_away = [], []
        for points in self._around(low, high, None):
            away = tiles.distance_to(points, own)
            # A point at no distance is one of them.
            near = away <= reach if self.plan.level else (away > 0) & (away <= reach)
            known.append(points[near])
            known_away.append(away[near])
        halo, around = np.concatenate(known), reach - np.concatenate(known_away)
        depth = np.full(len(own), reach)
        total = sum(bucket.count for bucket in self.blocks)
        if len(halo) + (0 if self.plan.level else len(own)) >= total:
            depth[:] = around[:] = np.inf
        if self.plan.level:
            return own, depth, halo, around, self.plan
        depth = np.concatenate([depth, around])
        return np.concatenate([own, halo]), len(own), depth, self.plan

    def find_sides(self) -> None:
        """Find the sides of the guides."""
        if self.plan.settings.orientation in ("viewpoint", "none"):
            self.guides = None
            return
        place, normals = self.guides
        outward, found = tiles.orient_guides(place, normals, self.plan.settings)
        self.guides = (place, outward, found.confidence)
        self.orientation, self.warnings = found.mode, found.warnings
        self.progress(0.8)

    def normals_in_order(self) -> Iterator[Any]:
        """Yield the normals in the order of the file, piece by piece."""
        record = np.dtype([("row", "<i8"), ("normal", self.stream.dtype, 3)])
        blocks = -(-self.survey.count // streams.ROWS)
        names = [self.folder / f"{number}.block" for number in range(blocks)]
        for number, bucket in enumerate(self.buckets):
            if not bucket.count:
                continue
            rows, points = bucket.read()
            path = self.folder / f"{number}.normals"
            normals = np.fromfile(path).reshape(-1, 3)
            bucket.path.unlink()
            path.unlink()
            found = np.empty(len(rows), record)
            found["row"] = rows
            found["normal"] = tiles.facing(
                points, normals, self.plan.settings, self.guides
            )
            order = np.argsort(rows, kind="stable")
            cuts = np.searchsorted(
                rows[order], streams.ROWS * np.arange(len(names) + 1)
            )
            for block in np.flatnonzero(np.diff(cuts)):
                with names[block].open("ab") as file:
                    found[order[cuts[block] : cuts[block + 1]]].tofile(file)
        self.progress(0.95)
        for number, name in enumerate(names):
            start = number * streams.ROWS
            normals = np.zeros((min(streams.ROWS, self.survey.count - start), 3))
            if name.exists():
                found = np.fromfile(name, record)
                normals[found["row"] - start] = found["normal"]
                name.unlink()
            yield normals

    def row(self) -> dict[str, Any]:
        """Return what the report says."""
        settings = self.plan.settings
        return {
            "points": self.survey.count,
            "valid": self.valid,
            "invalid": self.survey.count - self.valid,
            "cut": self.cut,
            "method": settings.method,
            "neighbors": settings.neighbors,
            "patch": settings.patch,
            "orientation": self.orientation,
            "warnings": list(self.warnings),
        }


def _nearest_part(points: Any, row: int) -> tuple[Any, float]:
    """Return the points nearest to one of them, that first, and how far they reach."""
    away = np.square(points - points[row]).sum(axis=1)
    size = min(tiles.PART, len(points))
    near = np.argpartition(away, size - 1)[:size]
    near = near[np.argsort(away[near], kind="stable")]
    return points[near], float(np.sqrt(away[near[-1]]))


def _depth(count: int, memory: int) -> int:
    """Return how often space is halved so that a tile and its halo fit into memory."""
    # Halos are a third of a tile, or less.
    most = max(_FEWEST, int((memory - _BASE) / (1.35 * _EACH)))
    return max(0, int(np.ceil(np.log2(count / most))))


def _cell_of(sample: Any) -> float:
    """Return the side of cells of which about as many are filled as guides may be."""
    size = float(np.ptp(sample, axis=0).max()) or 1.0
    low, high = size / 4096, size
    for _ in range(12):
        middle = np.sqrt(low * high)
        if len(tiles.thinned(sample, middle)) > _GUIDES:
            low = middle
        else:
            high = middle
    return float(high)
