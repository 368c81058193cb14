# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's experiment as plain values, those of results.json."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict
from typing import Any

import numpy as np

from ...core import experiment, shapes
from ..commands.versions import versions

# Changes when a reader of results.json has to change.
SCHEMA = "timescale_normals.reproduce/1"

# What a whole run leaves in its folder.
FIGURES = (
    "figure-1-grid-surface.png",
    "figure-3-surfaces-and-samples.png",
    "figure-4-triangulations.png",
    "figure-5-errors-phi1.png",
    "figure-6-errors-phi2.png",
    "figure-7-winning-points.png",
    "orders.png",
)
FILES = ("results.json", "results.md", *FIGURES)

FUNCTIONS: dict[str, tuple[Callable, Callable]] = {
    "exp(t)": (np.exp, np.exp),
    "sin(3t)": (lambda t: np.sin(3 * t), lambda t: 3 * np.cos(3 * t)),
    "1/(1 + t²)": (lambda t: 1 / (1 + t**2), lambda t: -2 * t / (1 + t**2) ** 2),
}
SURFACES = ("phi1", "phi2", "sphere", "bumpy")
# The coarsest grids are as wide as the features of the surfaces: the order is that of
# the others.
COARSE = {"function": 0, "surface": 2}
WEIGHTS = ("paper", "second_order")

MEASURES = ("min", "median", "mean", "max")
GROUP = ("surface", "sampling", "method", "baseline")

Results = dict[str, Any]
Progress = Callable[[float, str], object]


def run(seeds: Iterable[int], *, progress: Progress) -> Results:
    """Run the experiment and measure the orders.

    Parameters
    ----------
    seeds : iterable of int
        One sample of each surface and each sampling for every seed.
    progress : callable
        Called with the share done and what is next.

    Returns
    -------
    dict
        Plain values, as in results.json.
    """
    seeds = tuple(seeds)
    trials = experiment.repeat_experiment(
        seeds=seeds, progress=lambda share: progress(0.6 * share, "Samples")
    )
    rows = [trial.row() for trial in trials]
    progress(0.6, "Orders")
    return {
        "schema": SCHEMA,
        "versions": versions(),
        "seeds": list(seeds),
        "settings": {name: asdict(s) for name, s in experiment.METHODS.items()},
        "published": experiment.PUBLISHED,
        "trials": rows,
        "summary": list(summarize(rows)),
        "convergence": list(measure_orders()),
    }


def summarize(rows: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield, for all seeds together, the range of wins and mean errors."""
    groups: dict[tuple, list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in GROUP), []).append(row)
    for key, group in groups.items():
        wins = [row["wins"] for row in group]
        result = dict(zip(GROUP, key, strict=True)) | {
            "points": group[0]["points"],
            "wins_min": min(wins),
            "wins_mean": float(np.mean(wins)),
            "wins_max": max(wins),
            "wins_percent": float(np.mean([row["wins_percent"] for row in group])),
        }
        for side in ("estimate", "baseline"):
            for measure in MEASURES:
                name = f"{side}_{measure}"
                result[name] = float(np.mean([row[name] for row in group]))
        yield result


def measure_orders() -> Iterator[dict[str, Any]]:
    """Yield errors and orders of both weights, of functions and of surfaces."""
    for name, (function, derivative) in FUNCTIONS.items():
        for ratio in (3.0, 1.0):
            found = experiment.convergence(function, derivative, ratio=ratio)
            yield _order_row(name, "function", ratio, found)
    for name in SURFACES:
        for ratio in (3.0, 1.0):
            found = experiment.shape_convergence(shapes.ALL[name], ratio=ratio)
            yield _order_row(name, "surface", ratio, found)


def _order_row(name, kind, ratio, found):
    fine = slice(COARSE[kind], None)
    steps = found["step"]
    row = {"name": name, "kind": kind, "ratio": ratio, "step": steps.tolist()}
    for weights in WEIGHTS:
        errors = found[weights]
        row[weights] = errors.tolist()
        row[f"order_{weights}"] = experiment.order(steps[fine], errors[fine])
    return row
