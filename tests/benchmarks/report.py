# SPDX-License-Identifier: GPL-3.0-or-later
"""Put what was measured into docs/performance.md, between its two marks."""

import os
import platform
import re
import statistics
import time

BEGIN, END = "<!-- measured -->", "<!-- end of measured -->"
PLOT = "images/performance.png"


def write(docs, tables, results, small, rounds):
    """Write the tables and the plot; the text around them is written by hand."""
    path = docs / "performance.md"
    text = path.read_text()
    head, _, rest = text.partition(BEGIN)
    _, _, tail = rest.partition(END)
    cores = os.cpu_count()
    parts = [
        f"{time.strftime('%Y-%m-%d')}, {platform.machine()}, {cores} cores, Python "
        f"{platform.python_version()}; medians of {rounds} rounds; load of the machine "
        f"{os.getloadavg()[2]:.1f}. {small}",
        f"![Error against time]({PLOT})",
    ]
    for cloud, table in tables.items():
        parts += [f"### {cloud}", "\n".join(table)]
    body = "\n\n".join(parts)
    path.write_text(f"{head}{BEGIN}\n{body}\n{END}{tail}")
    plot(docs / PLOT, results)


def plot(path, results):
    """Draw error against time of every method, on the largest cloud with both."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot, ticker

    clouds = [name for name in results if re.match(r"1M random|100k random", name)]
    if not clouds:
        return
    figure, axes = pyplot.subplots(figsize=(7, 4.2), dpi=130)
    for name, runs in results[clouds[-1]].items():
        if name == "ours, Delaunay":
            continue
        wall = statistics.median(run["wall"] for run in runs)
        ours = name.startswith("ours")
        color, shape = ("C3", "o") if ours else ("C7", "s")
        axes.loglog(wall, runs[0]["rmse"], shape, color=color)
        where = {"xytext": (3, 4), "textcoords": "offset points", "rotation": 50}
        axes.annotate(name, (wall, runs[0]["rmse"]), fontsize=8, **where)
    axes.set_xlabel("seconds")
    axes.set_ylabel("root mean square angle, degrees")
    axes.set_title(f"Normals of the bumpy sphere, {clouds[-1]} points", fontsize=10)
    axes.margins(x=0.15, y=0.4)
    for which in (axes.xaxis.set_major_formatter, axes.xaxis.set_minor_formatter):
        which(ticker.StrMethodFormatter("{x:g}"))
    axes.grid(alpha=0.3, which="major")
    figure.tight_layout()
    figure.savefig(path, metadata={"Software": None})
