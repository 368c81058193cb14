# SPDX-License-Identifier: GPL-3.0-or-later
"""Put what was measured into the pages of docs, each between two marks of its own."""

import math
import os
import platform
import re
import statistics
import time

PLOT = "images/performance.png"

# Errors within this power of ten share a row of labels in the plot.
_ROW = 0.35


def replace_part(path, name, body):
    """Put text into a page between `<!-- NAME -->` and `<!-- end of NAME -->`.

    Both marks stand on lines of their own and stay; the text around them is by hand.
    Raises ValueError when the page does not hold each of them once, in this order.
    """
    begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    page = path.read_text()
    if page.count(begin) != 1 or page.count(end) != 1:
        raise ValueError(f"expected {begin} and {end} once each in {path.name}")
    head, _, rest = page.partition(begin)
    _, found, tail = rest.partition(end)
    if not found:
        raise ValueError(f"expected {begin} before {end} in {path.name}")
    path.write_text(f"{head}{begin}\n{body.strip()}\n{end}{tail}")


def write(docs, tables, results, small, rounds):
    """Write the tables and the plot of docs/performance.md."""
    cores = os.cpu_count()
    parts = [
        f"{time.strftime('%Y-%m-%d')}, {platform.machine()}, {cores} cores, Python "
        f"{platform.python_version()}; medians of {rounds} rounds; load of the machine "
        f"{os.getloadavg()[2]:.1f}. {small}",
        f"![Error against time]({PLOT})",
    ]
    for cloud, table in tables.items():
        parts += [f"### {cloud}", "\n".join(table)]
    replace_part(docs / "performance.md", "measured", "\n\n".join(parts))
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
    places = {
        name: (statistics.median(run["wall"] for run in runs), runs[0]["rmse"])
        for name, runs in results[clouds[-1]].items()
        if name != "ours, Delaunay"
    }
    for name, (wall, error) in places.items():
        ours = name.startswith("ours")
        color, shape = ("C3", "o") if ours else ("C7", "s")
        axes.loglog(wall, error, shape, color=color)
    for name, place, offset in _labels(places):
        where = {"xytext": offset, "textcoords": "offset points", "va": "center"}
        line = {"arrowstyle": "-", "color": "0.7", "linewidth": 0.6}
        axes.annotate(name, place, fontsize=8, arrowprops=line, **where)
    axes.set_xlabel("seconds")
    axes.set_ylabel("root mean square angle, degrees")
    axes.set_title(f"Normals of the bumpy sphere, {clouds[-1]} points", fontsize=10)
    axes.margins(x=0.15, y=0.4)
    for which in (axes.xaxis.set_major_formatter, axes.xaxis.set_minor_formatter):
        which(ticker.StrMethodFormatter("{x:g}"))
    axes.grid(alpha=0.3, which="major")
    figure.tight_layout()
    figure.savefig(path, metadata={"Software": None})


def _labels(places):
    """Yield name, place and offset in points of each label: none covers another.

    Those with like errors stand on three lines in turn, in the order of their times.
    """
    rows = {}
    for name, (wall, error) in sorted(places.items(), key=lambda item: item[1]):
        like = next((a for a in rows if abs(math.log10(a / error)) < _ROW), error)
        rows.setdefault(like, []).append((name, (wall, error)))
    for row in rows.values():
        for level, (name, place) in enumerate(reversed(row)):
            yield name, place, (8, 9 + 11 * (level % 3))
