# SPDX-License-Identifier: GPL-3.0-or-later
"""What `orientation` found, in docs/accuracy.md: two tables and a picture.

One table has the sides, one seconds and memory; the picture shows where normals are
wrong.
"""

import os
import platform
import time

import numpy as np
import orienters
import stress
from report import replace_part

# Shown in the picture: slices across the second axis, this thick.
PICTURED = {"thin plate": 0.02, "bowl 2": 0.04, "bumpy noise 1.2%": 0.04, "phi1": 0.5}
PLOT = "images/orientation.png"
# Of whose seconds and memory there is a table.
TIMED = (
    "bumpy",
    "torus",
    "cube",
    "thin plate",
    "bumpy noise 1.2%",
    "stanford-bunny",
    "bumpy 100,000",
    "bumpy 1,000,000",
)


def write(docs, found, store, limit):
    """Write the part "sides" of docs/accuracy.md and its picture."""
    ran = {method for case in found.values() for method in case["runs"]}
    methods = [method for method in orienters.METHODS if method in ran]
    # Meshes are named here, not read.
    order = [name for name, _, _ in stress.cases(docs)]
    found = {name: found[name] for name in order if name in found}
    about = (
        f"{time.strftime('%Y-%m-%d')}, {platform.machine()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}. A run is stopped after {limit} seconds "
        "of CPU time."
    )
    plot(docs / PLOT, methods, store)
    parts = [about, _sides(methods, found), f"![Wrong sides in red]({PLOT})"]
    parts += [_costs(methods, found)]
    replace_part(docs / "accuracy.md", "sides", "\n\n".join(parts))


def _table(head, rows):
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _sides(methods, found):
    """Return the table of wrong sides."""
    rows = []
    for name, case in found.items():
        row = [name, f"{case['points']:,}", f"{abs(case['most']):g}"]
        for method in methods:
            run = case["runs"].get(method, {"failed": ""})
            row.append(run.get("failed") or _share(run["wrong"], case["most"] < 0))
        rows.append(row)
    return _table(["case", "points", "goal", *methods], rows)


def _share(wrong, is_open):
    """Return per cents: signed, and with a flip forgiven where that differs."""
    free = min(wrong, 100 - wrong)
    if is_open:
        return f"{free:.2f}"
    return f"{wrong:.2f}" if free == wrong else f"{wrong:.2f} ({free:.2f})"


def _costs(methods, found):
    """Return the table of seconds and memory."""
    rows = []
    for name, case in found.items():
        if name not in TIMED:
            continue
        row = [name, f"{case['points']:,}"]
        for method in methods:
            run = case["runs"].get(method, {"failed": ""})
            row.append(run.get("failed") or f"{run['cpu']:.1f} / {run['peak']:.0f}")
        rows.append(row)
    head = ["CPU s / peak MB beyond", "points", *methods]
    return _table(head, rows)


def plot(path, methods, store):
    """Draw a slice of each pictured cloud under each method."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    shape = len(PICTURED), len(methods)
    figure, axes = pyplot.subplots(*shape, figsize=(11, 7), dpi=120, squeeze=False)
    for line, (name, thick) in zip(axes, PICTURED.items(), strict=True):
        with np.load(store / f"{name} cloud.npz") as data:
            points = data["points"]
        near = np.abs(points[:, 1]) < thick
        for cell, method in zip(line, methods, strict=True):
            cell.set_xticks([])
            cell.set_yticks([])
            if name != "thin plate":
                cell.set_aspect("equal")
            _draw(cell, points, near, store / f"{name} {method}.npy")
        line[0].set_ylabel(name, fontsize=9)
    for cell, method in zip(axes[0], methods, strict=True):
        cell.set_title(method, fontsize=9)
    figure.tight_layout()
    figure.savefig(path, metadata={"Software": None})


def _draw(cell, points, near, path):
    """Draw the points of a slice, wrong ones in red; nothing where there is no run."""
    if not path.exists():
        cell.text(0.5, 0.5, "no result", ha="center", transform=cell.transAxes)
        return
    wrong = np.load(path)
    if wrong.mean() > 0.5:
        # The flip of all is forgiven here: what is left are the borders.
        wrong = ~wrong
    for some, color in ((near & ~wrong, "C0"), (near & wrong, "C3")):
        cell.scatter(points[some, 0], points[some, 2], s=1, color=color, linewidths=0)
