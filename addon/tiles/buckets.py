# SPDX-License-Identifier: GPL-3.0-or-later
"""Points of a tile in a file of their own, with their places in the whole."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..files import streams

_RECORD = np.dtype([("row", "<i8"), ("point", "<f8", 3)])


@dataclass
class Bucket:
    """The points of a tile, in a file, and the box around them."""

    path: Path
    count: int = 0
    low: Any = np.inf
    high: Any = -np.inf

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
