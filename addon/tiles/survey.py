# SPDX-License-Identifier: GPL-3.0-or-later
"""A first look at all points of a file, piece by piece."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ... import core
from ...core.inputs import check_size, snapped
from ..files import streams


@dataclass(frozen=True)
class Survey:
    """What a first look at all points says.

    Attributes
    ----------
    count, finite : int
        Points, and those whose coordinates are finite.
    center : (3,) float64
    """

    count: int
    finite: int
    center: Any


def look_at(stream: streams.Stream, room: int) -> tuple[Survey, Any]:
    """Count the points, and take so many of them, or up to twice that; all of few.

    Returns
    -------
    Survey
    sample : (s, 3) float64, less the center
    """
    every = max(1, stream.count // room)
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
    size = float((high - low).max())
    check_size(size)
    center = snapped(total / finite, size)
    return Survey(count, finite, center), np.concatenate(sample) - center
