# SPDX-License-Identifier: GPL-3.0-or-later
"""Files larger than memory: cut into tiles on disk, estimated, put together again.

1. A look at all points: how many, where, and a sample of them.
2. Points go to a file for each tile; each tile is estimated with its halo.
3. A thinned cloud of all tiles finds the sides, and each normal takes its own there.
4. Normals go back to the order of the points, and the file is written again.

Only the sample, a tile and a piece of the file are in memory at a time.
"""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import core
from ..core import tiles
from ..core.inputs import snapped
from .files import streams

Progress = Callable[[float], object]
Fit = Callable[[Iterator[tuple[Any, ...]]], Iterator[tiles.Tile]]

# Bytes of memory: of the program itself, of what is read at a time and of the sample,
# and for each point of a tile and its halo, well above what fifty million points took.
_BASE, _EACH = 420 << 20, 420
_SAMPLE = 1_000_000
# Tiles of more points than are fitted in double precision.
_FEWEST = 110_000

# Parts of the cloud that settings are chosen by, and points of each.
_PARTS, _OF_PART = 12, 20_000

# Thinned points that find the sides.
_GUIDES = 120_000

# How often what a normal depends on is looked for farther out, twice as far each time.
_WIDER = 6

_RECORD = np.dtype([("row", "<i8"), ("point", "<f8", 3)])


@dataclass
class _Bucket:
    """The points of a tile, in a file, and the box around them."""

    path: Path
    count: int
    low: Any
    high: Any

    def add(self, rows: Any, points: Any) -> None:
        """Append points with their places in the file."""
        records = np.empty(len(rows), _RECORD)
        records["row"], records["point"] = rows, points
        with self.path.open("ab") as file:
            records.tofile(file)
        self.count += len(rows)
        self.low = np.minimum(self.low, points.min(axis=0))
        self.high = np.maximum(self.high, points.max(axis=0))

    def read(self) -> tuple[Any, Any]:
        """Return rows (n,) and points (n, 3)."""
        if not self.count:
            return np.empty(0, np.int64), np.empty((0, 3))
        records = np.fromfile(self.path, _RECORD)
        return records["row"].copy(), records["point"].copy()

    def inside(self, low: Any, high: Any) -> Iterator[Any]:
        """Yield the points in a box piece by piece."""
        if not self.count or (self.low > high).any() or (self.high < low).any():
            return
        with self.path.open("rb") as file:
            while len(records := np.fromfile(file, _RECORD, streams.ROWS)):
                points = records["point"]
                yield points[((points >= low) & (points <= high)).all(axis=1)]


@dataclass(frozen=True)
class _Survey:
    """What a first look at all points says.

    Attributes
    ----------
    count, finite : int
        Points, and those whose coordinates are finite.
    center : (3,) float64
    sample : (s, 3) float64, less the center
    """

    count: int
    finite: int
    center: Any
    sample: Any


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
        Turns the arguments of `tiles.fit_tile`, one tuple a tile, into its results, in
        the same order: here, or on other machines.
    progress : callable

    Returns
    -------
    dict
        What there is to say, as `Estimate.summary` has it.
    """
    stream = streams.open_stream(source)
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=".tiles-") as folder:
        run = _Run(stream, settings, memory, Path(folder), progress)
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
        self.survey = _look_at(stream)
        if self.survey.finite <= 8:
            raise core.InputError(
                f"expected at least 9 points, got {self.survey.finite}"
            )
        viewpoint = settings.viewpoint
        if viewpoint is not None:
            place = np.asarray(viewpoint) - self.survey.center
            settings = replace(settings, viewpoint=place)
        self.partition = tiles.Partition.of(
            self.survey.sample, _depth(self.survey.finite, memory)
        )
        self.buckets = self._scattered()
        progress(0.1)
        self.settings, self.noise, self.margin = tiles.resolve(self._parts(), settings)
        self.cell = _cell_of(self.survey.sample)
        self.valid = self.cut = 0
        self.guides: Any = None
        self.warnings: tuple[str, ...] = ()

    def _scattered(self) -> list[_Bucket]:
        """Write every point into the file of its tile."""
        none = np.full(3, np.inf)
        made = [
            _Bucket(self.folder / f"{number}.points", 0, none, -none)
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

    def _parts(self) -> Any:
        """Return parts of the cloud, each whole: around points of some tiles."""
        filled = [bucket for bucket in self.buckets if bucket.count]
        every = max(1, len(filled) // _PARTS)
        parts = []
        chosen = filled[::every]
        size = _OF_PART * max(1, _PARTS // len(chosen))
        for bucket in chosen:
            points = bucket.read()[1]
            if len(points) > size:
                away = ((points - points[len(points) // 2]) ** 2).sum(axis=1)
                points = points[np.argpartition(away, size)[:size]]
            parts.append(points)
        return np.concatenate(parts)

    def fit_all(self, fit: Fit) -> dict[str, Any]:
        """Estimate tile by tile; normals and guides are kept."""
        numbers = [n for n, bucket in enumerate(self.buckets) if bucket.count]
        results = fit(self._task(number) for number in numbers)
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
            self.progress(0.1 + 0.6 * done / len(numbers))
        self.guides = [np.concatenate(column) for column in zip(*found, strict=True)]
        return {"tiles": len(numbers)}

    def _task(self, number: int) -> tuple[Any, ...]:
        """Return the arguments of `fit_tile` for a tile and its halo."""
        low, high = self.partition.low[number], self.partition.high[number]
        own = self.buckets[number].read()[1]
        low, high = low - self.margin, high + self.margin
        halo = self._around(low, high, number)
        points = np.concatenate([own, *halo])
        depth = tiles.depth_in_box(points, low, high)
        return points, len(own), depth, self.settings, self.noise

    def _around(self, low: Any, high: Any, number: int | None) -> list[Any]:
        """Return the points of other tiles in a box."""
        return [
            points
            for other, bucket in enumerate(self.buckets)
            if other != number
            for points in bucket.inside(low, high)
        ]

    def _widened(self, points: Any, tile: tiles.Tile, fit: Fit) -> tiles.Tile:
        """Return a tile whose inexact normals were made again from farther around."""
        normals, valid, exact = tile.normals, tile.valid, tile.exact
        reach = self.margin
        for _ in range(_WIDER):
            rows = np.flatnonzero(~exact)
            if not len(rows):
                break
            reach *= 2
            (again,) = fit(iter([self._wider_task(points[rows], reach)]))
            normals[rows], valid[rows] = again.normals, again.valid
            exact[rows] = again.exact
        return tiles.Tile(normals, valid, exact)

    def _wider_task(self, own: Any, reach: float) -> tuple[Any, ...]:
        """Return the arguments of `fit_tile` for points and all within a reach."""
        low, high = own.min(axis=0) - reach, own.max(axis=0) + reach
        around = []
        for points in self._around(low, high, None):
            away = tiles.distance_to(points, own)
            # A point at no distance is one of them.
            near = (away > 0) & (away <= reach)
            around.append((points[near], away[near]))
        halo = np.concatenate([part[0] for part in around])
        away = np.concatenate([part[1] for part in around])
        everything = len(own) + len(halo) >= self.survey.finite
        depth = np.concatenate([np.full(len(own), reach), reach - away])
        if everything:
            depth[:] = np.inf
        points = np.concatenate([own, halo])
        return points, len(own), depth, self.settings, self.noise

    def find_sides(self) -> None:
        """Find the sides of the guides."""
        if self.settings.orientation in ("viewpoint", "none"):
            self.guides = None
            return
        place, normals = self.guides
        outward, sure, self.warnings = tiles.orient_guides(
            place, normals, self.settings
        )
        self.guides = (place, outward, sure)
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
            found["normal"] = tiles.facing(points, normals, self.settings, self.guides)
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
        settings = self.settings
        return {
            "points": self.survey.count,
            "valid": self.valid,
            "invalid": self.survey.count - self.valid,
            "cut": self.cut,
            "method": settings.method,
            "neighbors": settings.neighbors,
            "patch": settings.patch,
            "orientation": settings.orientation,
            "warnings": list(self.warnings),
        }


def _look_at(stream: streams.Stream) -> _Survey:
    """Count the points, and take every so many of them."""
    every = max(1, stream.count // _SAMPLE)
    total, low, high = np.zeros(3), np.full(3, np.inf), np.full(3, -np.inf)
    count = finite = 0
    sample = []
    for chunk in stream.chunks():
        first = -count % every
        count += len(chunk)
        good = np.isfinite(chunk).all(axis=1)
        sample.append(chunk[first::every][good[first::every]])
        points = chunk if good.all() else chunk[good]
        finite += len(points)
        if len(points):
            total += points.sum(axis=0)
            low = np.minimum(low, points.min(axis=0))
            high = np.maximum(high, points.max(axis=0))
    if not finite:
        raise core.InputError("expected finite points, got none")
    center = snapped(total / finite, float((high - low).max()))
    return _Survey(count, finite, center, np.concatenate(sample) - center)


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
