# SPDX-License-Identifier: GPL-3.0-or-later
"""What results say: sentences and tables, in Markdown."""

import json
import math
from pathlib import Path
from typing import Any

from .results import MEASURES, WEIGHTS, Results

# What surfaces and choices are called.
LABELS = {"phi1": "φ1", "phi2": "φ2"}
SAMPLINGS = {"area": "over the surface", "parameters": "over the parameters"}
BASELINES = {
    "parameters": "Delaunay of the parameters",
    "projection": "of x and y",
    "complex": "in space",
    "points": "of each star",
}


def write(results: Results, folder: Path) -> None:
    """Write results.json and results.md."""
    text = json.dumps(results, indent=1, ensure_ascii=False, allow_nan=False)
    (folder / "results.json").write_text(text + "\n", "utf-8")
    parts = [f"## {title}\n\n{text}" for title, text in sections(results).items()]
    page = "\n\n".join(["# The paper's experiment, repeated", *parts])
    (folder / "results.md").write_text(page + "\n", "utf-8")


def sections(results: Results) -> dict[str, str]:
    """Return the tables and what they say, title to Markdown."""
    return {
        "In short": findings(results),
        "Winning points": wins_table(results),
        "Errors": errors_table(results),
        "Orders": orders_table(results),
        "Made with": made_with(results),
    }


def findings(results: Results) -> str:
    """Say in sentences what the tables say about each surface."""
    lines = []
    for surface, published in results["published"].items():
        lines.append(_paper_again(results["summary"], surface, published))
        lines.append(_ours(results["summary"], surface))
        lines.append(_least(results["summary"], surface, published))
    return "\n".join(f"- {line}" for line in lines)


def _paper_again(summary, surface, published):
    rows = [r for r in summary if r["surface"] == surface and r["method"] == "paper"]
    low = min(rows, key=lambda row: row["wins_min"])
    high = max(rows, key=lambda row: row["wins_max"])
    inside = low["wins_min"] <= published["wins"] <= high["wins_max"]
    return (
        f"**{LABELS[surface]}, the paper's method**: nearer to the true normal than "
        f"N_D at {low['wins_min']:,} to {high['wins_max']:,} of {low['points']:,} "
        f"points, by how the open choices are read. The fewest are with "
        f"{_reading(low)}, the most with {_reading(high)}. The paper counts "
        f"{published['wins']}, which is {'within' if inside else 'outside'} that range."
    )


def _reading(row):
    return (
        f"samples spread {SAMPLINGS[row['sampling']]} and the triangulation "
        f"{_how(row['baseline'])}"
    )


def _how(baseline):
    return BASELINES[baseline].removeprefix("Delaunay ")


def _ours(summary, surface):
    parts = []
    for sampling, where in SAMPLINGS.items():
        found = {"surface": surface, "sampling": sampling, "baseline": "parameters"}
        row = _one(summary, **found, method="auto")
        shares = [
            f"{measure} {_number(row[f'estimate_{measure}'])} against "
            f"{_number(row[f'baseline_{measure}'])}"
            for measure in ("median", "mean")
        ]
        parts.append(
            f"spread {where} at {row['wins_percent']:.0f} % of them (error: "
            f"{', '.join(shares)})"
        )
    return (
        f"**{LABELS[surface]}, `auto`**, from the points alone, against N_D that is "
        f"told their parameters: nearer on samples {', and '.join(parts)}."
    )


def _least(summary, surface, published):
    rows = [r for r in summary if r["surface"] == surface and r["method"] == "paper"]
    parts = []
    for side, name in (("estimate", "of the paper's method"), ("baseline", "of N_D")):
        found = [row[f"{side}_min"] for row in rows]
        low, high = _number(min(found)), _number(max(found))
        told = _number(published[f"{side}_min"])
        parts.append(f"{name} {low} to {high}, where the paper has {told}")
    return f"**{LABELS[surface]}, least errors**: {'; '.join(parts)}."


def _one(summary: list[dict[str, Any]], **where: str) -> dict[str, Any]:
    return next(r for r in summary if all(r[k] == v for k, v in where.items()))


def wins_table(results: Results) -> str:
    """Tell at how many points each method is nearer to the truth than each N_D."""
    head = ["surface", "samples spread", "method", *BASELINES.values(), "paper"]
    rows = []
    for surface, sampling, method in _cases(results, ("surface", "sampling", "method")):
        case = {"surface": surface, "sampling": sampling, "method": method}
        found = [_one(results["summary"], **case, baseline=b) for b in BASELINES]
        told = str(results["published"][surface]["wins"]) if method == "paper" else ""
        row = [LABELS[surface], SAMPLINGS[sampling], f"`{method}`"]
        rows.append([*row, *map(_wins, found), told])
    return _table(head, rows)


def _wins(row):
    spread = f"{row['wins_min']}–{row['wins_max']}"
    if row["wins_min"] == row["wins_max"]:
        spread = str(row["wins_min"])
    return f"{spread} ({row['wins_percent']:.0f} %)"


def errors_table(results: Results) -> str:
    """Tell the infinity norms of the errors, means over the seeds."""
    head = ["surface", "samples spread", "normals", *MEASURES, "paper's min"]
    rows = []
    for surface, sampling in _cases(results, ("surface", "sampling")):
        where = {"surface": surface, "sampling": sampling}
        published = results["published"][surface]
        methods = [method for (method,) in _cases(results, ("method",))]
        sides = [(m, "parameters", "estimate", f"`{m}`") for m in methods]
        sides += [("auto", b, "baseline", f"Delaunay {_how(b)}") for b in BASELINES]
        for method, baseline, side, title in sides:
            row = _one(results["summary"], **where, method=method, baseline=baseline)
            cells = [_number(row[f"{side}_{measure}"]) for measure in MEASURES]
            known = side == "baseline" or method == "paper"
            told = _number(published[f"{side}_min"]) if known else ""
            named = [LABELS[surface], SAMPLINGS[sampling], title]
            rows.append([*named, *cells, told])
    return _table(head, rows)


def orders_table(results: Results) -> str:
    """Tell the slopes of log error over log step, and the errors they end with."""
    head = ["", "gaps", "order, paper's weights", "order, second-order weights"]
    head += ["finest error, paper's", "finest error, second-order"]
    rows = []
    for row in results["convergence"]:
        gaps = "equal" if row["ratio"] == 1 else f"{row['ratio']:.0f} : 1"
        orders = [f"{row[f'order_{weights}']:.2f}" for weights in WEIGHTS]
        errors = [_number(row[weights][-1]) for weights in WEIGHTS]
        of = "derivative of" if row["kind"] == "function" else "normals of"
        name = LABELS.get(row["name"], row["name"])
        rows.append([f"{of} {name}", gaps, *orders, *errors])
    return _table(head, rows)


def made_with(results: Results) -> str:
    """Tell the command and the versions."""
    found = results["versions"]
    blender = f"Blender {found['blender']}" if found["blender"] else "no Blender"
    return (
        f"`timescale_normals reproduce --seeds {len(results['seeds'])}` of version "
        f"{found['timescale_normals']}, {blender}, Python {found['python']}, numpy "
        f"{found['numpy']}, scipy {found['scipy']}, {found['platform']}."
    )


def _cases(results, keys):
    """Return the values of the keys that occur, in the order of the trials."""
    return list(dict.fromkeys(tuple(r[k] for k in keys) for r in results["summary"]))


def _number(value: float) -> str:
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    if value < 1e-3:
        return f"{value:.1e}"
    return f"{value:.2g}" if value < 0.995 else f"{value:.2f}"


def _table(head: list[str], rows: list[list[str]]) -> str:
    """Write a Markdown table whose columns stand below each other."""
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    rule = ["-" * width for width in widths]
    lines = [
        " | ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True))
        for cells in (head, rule, *rows)
    ]
    return "\n".join(f"| {line} |" for line in lines)
