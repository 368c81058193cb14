# SPDX-License-Identifier: GPL-3.0-or-later
"""What the summaries of runs say, as rows of text beside each other."""

import textwrap
from typing import Any

import bpy

# Rows of the last result: key of the core's summary, label.
_ESTIMATE_ROWS = (
    ("points", "Points"),
    ("parted", "Normals"),
    ("invalid", "Without Normal"),
    ("from_faces", "From Faces"),
    ("smoothed", "Averaged"),
    ("neighbors", "Neighbors"),
    ("patch", "Patch"),
    ("noise_percent", "Noise"),
    ("graph", "Graph"),
    ("orientation", "Orientation"),
    ("pieces", "Pieces"),
    ("turned", "Turned Over"),
    ("uncertain_percent", "Side Uncertain"),
    ("disagreeing_percent", "Sides Disagree"),
    ("inconsistent", "Faces Disagree"),
)
_STATISTICS = (
    ("rms", "RMS"),
    ("median", "Median"),
    ("p95", "95 %"),
    ("max", "Maximum"),
)


def result_rows(summary: dict) -> list[tuple[str, ...]]:
    """Return label and value of each row about an estimate; zeros are left out."""
    shown = dict(summary)
    for key in {"uncertain", "disagreeing"} & shown.keys():
        # Less than a tenth of a per cent is as good as nothing.
        shown[f"{key}_percent"] = round(100 * shown[key], 1)
    of_faces = 2 * shown.get("from_faces", 0) > shown["points"]
    if of_faces and shown.get("mesh") != "noisy":
        # Patches that were not taken say little about the points.
        shown["noise_percent"] = None
    if shown.get("from_faces", 0) >= shown.get("normals", shown["points"]):
        shown["neighbors"] = shown["patch"] = None
    if shown.get("normals", 0) > shown["valid"]:
        shown["parted"] = shown["normals"]
    return [
        (label, _percent(shown[key]) if key.endswith("_percent") else _text(shown[key]))
        for key, label in _ESTIMATE_ROWS
        if shown.get(key)
    ]


def warning_lines(summary: dict, width: float) -> list[dict[str, Any]]:
    """Return text and icon of each line of the warnings, in a region of a width."""
    # About the width of a letter, and of the margins with the icon.
    columns = max(16, int((width / _ui_scale() - 70) / 6.5))
    lines = []
    for warning in summary.get("warnings", ()):
        sentence = warning[0].upper() + warning[1:]
        for row, text in enumerate(textwrap.wrap(sentence, columns)):
            lines.append({"text": text, "icon": "BLANK1" if row else "ERROR"})
    return lines


def _ui_scale() -> float:
    # Without a window it is zero.
    return bpy.context.preferences.system.ui_scale or 1.0


def comparison_rows(summary: dict) -> list[tuple[str, ...]]:
    """Return the rows about a comparison: labels, then one or two columns."""
    if not summary["compared"]:
        return [("Compared", "0")]
    if "wins" not in summary:
        rows: list[tuple[str, ...]] = [("", "Difference")]
        sides = ["deviation"]
    else:
        won = summary["wins_percent"]
        rows = [("", "Estimate", "Delaunay")]
        rows.append(("Nearer at", f"{won:.1f} %", f"{100 - won:.1f} %"))
        sides = ["estimate", "baseline"]
    for title, prefix, unit in (("Angle", "angle_", "°"), ("Coordinate", "error_", "")):
        rows.append((title, *[""] * len(sides)))
        for key, label in _STATISTICS:
            # What is called an error to the truth is a deviation from each other.
            names = [f"{prefix}{side}_{key}" for side in sides]
            names = [name.replace("error_deviation", "deviation") for name in names]
            rows.append((label, *(_text(summary[name]) + unit for name in names)))
    return rows


def _percent(value: float) -> str:
    return f"{value:.3g} %" if value >= 0.001 else "under 0.001 %"


def _text(value: object) -> str:
    if isinstance(value, str):
        return value.replace("_", " ").title()
    return f"{value:,}" if isinstance(value, int) else f"{value:.3g}"
