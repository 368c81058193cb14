# SPDX-License-Identifier: GPL-3.0-or-later
"""How two sets of normals compare, with the truth or with each other (section 4).

References
----------
[1] See `timescale`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .colormaps import (
    COLORMAPS,
    DIVERGING,
    NOT_COMPARED,
    WINNERS,
    linear,
    map_colors,
    ramp_colors,
)
from .estimate import Estimate
from .inputs import BoolArray, FloatArray, InputError, IntArray, as_choice, as_normals

MEASURES = (
    "error_estimate",
    "error_baseline",
    "deviation",
    "angle_estimate",
    "angle_baseline",
    "angle_deviation",
    "log_ratio",
    "wins",
)


@dataclass(frozen=True)
class Comparison:
    """Errors of an estimate and a baseline, point by point.

    All are free of sign: of the two sides of a normal the nearer one counts. Points
    that either side could not estimate are nan.

    Attributes
    ----------
    deviation, angle_deviation : (n,) float64
        Infinity norm of the difference between estimate and baseline; the angle
        between them in degrees.
    error_estimate, error_baseline : (n,) float64 or None
        Infinity norm of the difference to the truth, as in section 4 of [1].
    angle_estimate, angle_baseline : (n,) float64 or None
        Angle to the truth, in degrees.
    """

    deviation: FloatArray
    angle_deviation: FloatArray
    error_estimate: FloatArray | None = None
    error_baseline: FloatArray | None = None
    angle_estimate: FloatArray | None = None
    angle_baseline: FloatArray | None = None

    @property
    def compared(self) -> BoolArray:
        """(n,) bool, where both sides have a normal."""
        return np.isfinite(self.deviation)

    @property
    def wins(self) -> BoolArray | None:
        """(n,) bool, where the estimate's error is the smaller; None without truth."""
        if self.error_estimate is None or self.error_baseline is None:
            return None
        return self.error_estimate < self.error_baseline

    @property
    def log_ratio(self) -> FloatArray | None:
        """(n,) log10 of baseline's error over estimate's; None without truth."""
        if self.error_estimate is None or self.error_baseline is None:
            return None
        # Errors at the level of rounding are equal, not infinitely better.
        floor = 1e-12
        return np.log10(
            np.maximum(self.error_baseline, floor)
            / np.maximum(self.error_estimate, floor)
        )

    def summary(self) -> dict[str, float | int]:
        """Return counts and statistics as a dict of plain floats and ints."""
        result: dict[str, float | int] = {
            "points": len(self.deviation),
            "compared": int(self.compared.sum()),
        }
        wins = self.wins
        if wins is not None:
            result["wins"] = int(wins.sum())
            result["wins_percent"] = _percent(wins, self.compared)
        for name in (
            "error_estimate",
            "error_baseline",
            "deviation",
            "angle_estimate",
            "angle_baseline",
            "angle_deviation",
        ):
            values = getattr(self, name)
            if values is not None:
                result.update(_statistics(name, values))
        return result

    def histogram(
        self,
        measure: str = "deviation",
        *,
        bins: int = 40,
        limit: float | None = None,
    ) -> tuple[IntArray, FloatArray]:
        """Return counts (bins,) and edges (bins + 1,) of a measure from 0 to limit.

        Values beyond the limit count in the last bin.
        """
        values = self._measure(measure)
        values = values[np.isfinite(values)]
        low, high = self.limits(measure, limit=limit)
        return np.histogram(np.clip(values, low, high), bins=bins, range=(low, high))

    def limits(
        self, measure: str = "deviation", *, limit: float | None = None
    ) -> tuple[float, float]:
        """Return the values at the two ends of the color map.

        Without a limit: the 95th percentile of the measure's magnitude, so that a
        few outliers do not darken the rest.
        """
        values = np.abs(self._measure(measure).astype(np.float64))
        values = values[np.isfinite(values)]
        if limit is None:
            limit = float(np.percentile(values, 95)) if len(values) else 1.0
        high = limit if limit > 0 else 1.0
        return (-high if measure == "log_ratio" else 0.0), high

    def colors(
        self,
        measure: str = "deviation",
        *,
        limit: float | None = None,
        colormap: str = "heat",
    ) -> FloatArray:
        """Return colors of a measure.

        Parameters
        ----------
        measure : one of MEASURES
        limit : float, optional
            The value at the end of the map; see `limits`.
        colormap : one of COLORMAPS
            Of all measures but "log_ratio" and "wins", which have two sides.

        Returns
        -------
        (n, 4) float32
            Linear sRGB with alpha 1, as Blender keeps color attributes; gray where
            there is nothing to compare.
        """
        as_choice(colormap, COLORMAPS, name="colormap")
        values = self._measure(measure).astype(np.float64)
        low, high = self.limits(measure, limit=limit)
        if measure == "wins":
            low, high = 0.0, 1.0
        share = (values - low) / (high - low)
        colors = _shown(measure, share, colormap)
        colors[~self.compared] = linear(np.array(NOT_COMPARED) / 255)
        alpha = np.ones((len(values), 1))
        return np.concatenate([colors, alpha], axis=1).astype(np.float32)

    def _measure(self, name):
        as_choice(name, MEASURES, name="measure")
        values = getattr(self, name)
        if values is None:
            raise InputError(f"expected truth for {name}, got a comparison without")
        return values


def compare_normals(
    estimate: Estimate | ArrayLike,
    baseline: Estimate | ArrayLike,
    *,
    truth: ArrayLike | None = None,
) -> Comparison:
    """Compare estimated normals with a baseline's.

    Parameters
    ----------
    estimate, baseline : Estimate or (n, 3) array_like of float
    truth : (n, 3) array_like of float, optional

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        When the arrays are not of one length.
    """
    count = len(_vectors(estimate))
    ours = as_normals(_vectors(estimate), count, name="estimated normals")
    theirs = as_normals(_vectors(baseline), count, name="baseline normals")
    pairs = {"deviation": (ours, theirs)}
    if truth is not None:
        exact = as_normals(truth, count, name="true normals")
        pairs |= {"estimate": (ours, exact), "baseline": (theirs, exact)}
    absent = ~np.logical_and.reduce(
        [(normals != 0).any(axis=1) for pair in pairs.values() for normals in pair]
    )
    measured = {}
    for name, (a, b) in pairs.items():
        prefix = "" if name == "deviation" else "error_"
        measured[prefix + name] = np.where(absent, np.nan, infinity_norm(a, b))
        measured["angle_" + name] = np.where(absent, np.nan, angle(a, b))
    return Comparison(**measured)


def _vectors(normals):
    return normals.normals if isinstance(normals, Estimate) else np.asarray(normals)


def infinity_norm(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the sign-free infinity norm of a - b for rows of unit vectors, (n,)."""
    return np.minimum(np.abs(a - b).max(axis=1), np.abs(a + b).max(axis=1))


def angle(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the sign-free angle between rows of unit vectors in degrees, (n,).

    By the arctangent of sine and cosine, which keeps small angles exact.
    """
    sine = np.linalg.norm(np.cross(a, b), axis=1)
    return np.degrees(np.arctan2(sine, np.abs((a * b).sum(axis=1))))


def _shown(measure, share, colormap):
    """Return linear sRGB of shares (n,) along the scale of a measure, (n, 3)."""
    fixed = {"log_ratio": DIVERGING, "wins": WINNERS}
    if measure in fixed:
        return ramp_colors(fixed[measure], share)
    return map_colors(colormap, share)


def _percent(part, whole):
    return 100.0 * float(part.sum()) / max(1, int(whole.sum()))


def _statistics(name, values):
    values = values[np.isfinite(values)]
    if not len(values):
        return {}
    return {
        f"{name}_rms": float(np.sqrt(np.mean(values**2))),
        f"{name}_mean": float(values.mean()),
        f"{name}_median": float(np.median(values)),
        f"{name}_p95": float(np.percentile(values, 95)),
        f"{name}_min": float(values.min()),
        f"{name}_max": float(values.max()),
    }
