# SPDX-License-Identifier: GPL-3.0-or-later
"""What a terminal is told of a file: a row of the report as sentences."""

from collections.abc import Callable

from .progress import Progress
from .workers import Row


def say_row(row: Row, progress: Progress, command: str) -> None:
    """Say how a file went, and what is to be known of it."""
    name = row["input"]
    if row["status"] == "failed":
        progress.error(f"{name}: {row['error']}")
    elif row["status"] == "skipped":
        progress.line(f"{name}: {row['output']} is there already, skipped")
    else:
        progress.line(f"{name}: {_SENTENCES[command](row)} ({row['seconds']:.1f} s)")
        for warning in row.get("warnings", ()):
            progress.line(f"{name}: warning: {warning}")
        if row.get("lost"):
            lost = ", ".join(row["lost"])
            progress.line(f"{name}: warning: {row['output']} has no place for {lost}")
        if row.get("check", {}).get("failed"):
            progress.error(f"{name}: {_with_names(_EXCEEDED, row['check'])}")


_EXCEEDED = (
    "{above:,} of {compared:,} normals are more than {limit:g} degrees from "
    "{reference}, {max:.3g} at most"
)

# What normals are held against, as it is called in a report and in a sentence.
_AGAINST = {
    "delaunay": "Delaunay's",
    "estimate": "the estimate's",
    "truth": "the true ones",
}


def _estimate_sentence(row: Row) -> str:
    said = f"{row['valid']:,} normals"
    if row.get("cut"):
        said += f", {row['cut']:,} from cut neighborhoods"
    if row["invalid"]:
        said += f", {row['invalid']:,} points without"
    if "objects" in row:
        return f"{said}, in {len(row['objects'])} objects"
    said += f", {row['neighbors']} neighbors" if row["neighbors"] else ""
    return f"{said}, oriented by {row['orientation']}"


def _compare_sentence(row: Row) -> str:
    if "objects" in row:
        said = "{compared:,} normals at most {max:.3g} degrees from {reference}"
        return f"{len(row['objects'])} objects: {_with_names(said, row['check'])}"
    if "angle_estimate_rms" in row:
        said = (
            "RMS error {angle_estimate_rms:.3g} degrees, {baseline} "
            "{angle_baseline_rms:.3g}; nearer at {wins_percent:.1f} % of {compared:,}"
        )
    elif row["compared"]:
        said = (
            "{angle_deviation_rms:.3g} degrees (RMS) from {baseline} at "
            "{compared:,} points, {angle_deviation_max:.3g} at most"
        )
    else:
        said = "no point has normals to compare"
    return _with_names(said, row)


def _with_names(sentence: str, facts: Row) -> str:
    """Fill a sentence, and call what normals are held against by its name."""
    names = {
        key: _AGAINST[facts[key]] for key in ("baseline", "reference") if key in facts
    }
    return sentence.format_map(facts | names)


def _repair_sentence(row: Row) -> str:
    return f"{row['flipped_faces']:,} of {row['faces']:,} faces turned over, " + (
        _estimate_sentence(row)
    )


_SENTENCES: dict[str, Callable[[Row], str]] = {
    "estimate": _estimate_sentence,
    "compare": _compare_sentence,
    "repair": _repair_sentence,
}
