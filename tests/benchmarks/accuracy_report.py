# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables and pictures of docs/accuracy.md, from what accuracy.py found."""

import json
import os
import time
from pathlib import Path

import accuracy
import numpy as np
import report
import sharp

from core import Settings, estimate_normals
from core.patches.scale import CANDIDATES

DOCS = accuracy.ROOT / "docs"
ERRORS, SHARP, PICTURE = (
    f"images/accuracy-{name}.png" for name in ("conditions", "creases", "errors")
)
_PICTURED = ("bunny100k", "fandisk100k")
_SHOWN = ("none", "medium", "high")
_CAPPED = 45

PART = f"auto, at {accuracy.TRIED:,}"
BEST = f"best fixed, at {accuracy.TRIED:,}"
SHARES = {"least tenth": "least", "by place": "by place", "largest tenth": "largest"}


def write(folder):
    """Write the measured part of docs/accuracy.md and its pictures."""
    paths = sorted(Path(folder).glob("*.json"))
    found = {path.stem: json.loads(path.read_text()) for path in paths}
    found = {name: f for name, f in found.items() if set(f) == set(accuracy.NAMES)}
    sizes = sum(len(steps) for _, _, steps in CANDIDATES.values())
    parts = [
        f"{time.strftime('%Y-%m-%d')}, {os.cpu_count()} cores. Root mean square "
        f"angles in degrees; *best fixed* is the best of {sizes} sizes and kinds of "
        "patches for that very cloud, chosen with the truth at hand, at "
        f"{accuracy.TRIED:,} of the points. Shares of the squared error: *least tenth* "
        "has the tenth of the points that `auto` trusts least, *largest tenth* those "
        "that err most, *by place* those that err most on average in other draws of "
        "the same noise.",
        "\n".join(_table(found)),
        f"![Errors of each condition]({ERRORS})",
        f"![Where the errors are]({PICTURE})",
    ]
    page = DOCS / "accuracy.md"
    report.replace_part(page, "noise", "\n\n".join(parts))
    report.replace_part(page, "creases", "\n".join(sharp.table()))
    _plot(found, DOCS / ERRORS)
    _pictures(DOCS / PICTURE)


def _fixed(case):
    return {
        name: error
        for name, error in case["errors"].items()
        if name.startswith("ours, ") and name != "ours, auto"
    }


def _methods(found):
    """Return the methods of the table: ours, then the peers that all clouds have."""
    names = {"auto": lambda case: case["errors"]["ours, auto"]}
    names[PART] = lambda case: case["tried"]
    names[BEST] = lambda case: min(_fixed(case).values())
    cases = [case for cloud in found.values() for case in cloud.values()]
    for name in cases[0]["errors"]:
        if not name.startswith("ours") and all(name in c["errors"] for c in cases):
            names[name] = lambda case, name=name: case["errors"][name]
    return names


def _table(found):
    heads = [*accuracy.NAMES, "mean"]
    lines = [f"| cloud | method | {' | '.join(heads)} |", "|---|---|" + "---|" * 7]
    for cloud, cases in found.items():
        for method, error in _methods(found).items():
            errors = [error(cases[name]) for name in accuracy.NAMES]
            cells = " | ".join(f"{e:.2f}" for e in (*errors, np.mean(errors)))
            lines.append(f"| {cloud} | {method} | {cells} |")
        for label, key in SHARES.items():
            cells = [
                f"{cases[n][key]:.0%}" if key in cases[n] else "" for n in heads[:-1]
            ]
            if any(cells):
                lines.append(f"| {cloud} | {label} | {' | '.join(cells)} | |")
    return lines


def _plot(found, path):
    """Draw the mean over the clouds of every method and condition."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7.5, 4), dpi=130)
    methods = {name: error for name, error in _methods(found).items() if name != PART}
    width = 0.8 / len(methods)
    for i, (name, error) in enumerate(methods.items()):
        means = [np.mean([error(f[c]) for f in found.values()]) for c in accuracy.NAMES]
        places = np.arange(len(means)) + (i - len(methods) / 2 + 0.5) * width
        color = {"auto": "C3", BEST: "C1"}.get(name)
        shade = color or pyplot.get_cmap("Greys")(0.3 + 0.08 * i)
        axes.bar(places, means, width, label=name, color=shade)
    axes.set_xticks(range(len(accuracy.NAMES)), accuracy.NAMES)
    axes.set_ylabel("root mean square angle, degrees")
    axes.set_title(f"Mean of {len(found)} shapes", fontsize=10)
    axes.legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, metadata={"Software": None})
    pyplot.close(figure)


def _pictures(path):
    """Draw points in the colors of their errors, seen from one side."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    loaded = {name: accuracy.load(name) for name in _PICTURED}
    loaded = {name: cloud for name, cloud in loaded.items() if cloud is not None}
    figure, grid = pyplot.subplots(
        len(loaded), len(_SHOWN), figsize=(9, 3 * len(loaded)), dpi=110, squeeze=False
    )
    for row, (name, cloud) in zip(grid, loaded.items(), strict=True):
        cases = {c: (p, n) for c, p, n in accuracy.conditions(*cloud)}
        for axes, condition in zip(row, _SHOWN, strict=True):
            points, truth = cases[condition]
            normals = estimate_normals(
                points, settings=Settings(orientation="none")
            ).normals
            error = np.sqrt(accuracy.squared_angle(normals, truth))
            drawn = _draw(axes, points, error)
            rms = np.sqrt((error**2).mean())
            axes.set_title(f"{name}, {condition}: {rms:.1f}", fontsize=9)
    bar = figure.colorbar(drawn, ax=grid, shrink=0.6)
    bar.set_label("error of auto, degrees")
    figure.savefig(path, metadata={"Software": None}, bbox_inches="tight")
    pyplot.close(figure)


def _draw(axes, points, error):
    """Draw the points on the near side, the nearest last."""
    # From above and the right, y up.
    toward = np.array([0.47, 0.45, 0.76])
    right = np.cross([0, 1, 0], toward)
    turn = np.stack([right, np.cross(toward, right), toward])
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    x, y, depth = turn @ (points - points.mean(axis=0)).T
    order = np.argsort(depth)[len(depth) // 2 :]
    axes.set_aspect("equal")
    axes.axis("off")
    return axes.scatter(
        x[order], y[order], c=error[order], s=0.4, cmap="inferno", vmin=0, vmax=_CAPPED
    )
