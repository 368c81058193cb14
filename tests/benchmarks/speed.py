# SPDX-License-Identifier: GPL-3.0-or-later
"""Time, memory and error of ours against every peer that is installed.

    speed.py [--rounds 3] [--large] [--only METHOD ...] [--on CLOUD ...] [--write]

Every run is a process of its own, and methods take turns within a round, so that a
busy machine slows all of them alike; medians over the rounds are compared. Ratios
carry over to other machines, seconds do not.
"""

import argparse
import importlib.util
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import clouds
import numpy as np
import peers
import report

ROOT = clouds.ROOT

NEIGHBORS = 16
SIZES = (100_000, 1_000_000)
LARGE = 10_000_000

# Beyond a million points only ours runs: that time per point and memory stay.
OWN = ("ours", "ours, auto", "ours, Delaunay")


def main():
    options = _options()
    methods = [name for name in options.only or peers.METHODS if _installed(name)]
    left_out = sorted(
        {module for module, _ in peers.METHODS.values() if not _found(module)}
    )
    if left_out:
        _say(f"not installed: {', '.join(left_out)}")
    results = {}
    with tempfile.TemporaryDirectory() as folder:
        for cloud, load in _inputs(options.large):
            if options.on and cloud not in options.on:
                continue
            path = _stored(folder, load)
            if path is None:
                _say(f"skipped {cloud}: not in {clouds.DATA}")
                continue
            chosen = [m for m in methods if m in OWN] if "10M" in cloud else methods
            _say(f"\n{cloud}, load {os.getloadavg()[0]:.1f}")
            results[cloud] = _measured(path, chosen, options.rounds)
            _say("\n".join(_table(results[cloud])))
            path.unlink()
    small = _small(options.rounds)
    _say(f"\n{small}")
    if options.write:
        tables = {cloud: _table(found) for cloud, found in results.items()}
        report.write(ROOT / "docs", tables, results, small, options.rounds)
    return 0


def _options():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--large", action="store_true", help="10M points as well")
    parser.add_argument("--only", nargs="+", choices=peers.METHODS)
    parser.add_argument("--on", nargs="+", help='some clouds: "1M random", bunny100k')
    parser.add_argument("--write", action="store_true", help="docs/performance.md")
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        _say("@" + json.dumps(_run(*options.one)))
        sys.stdout.flush()
        # Some peers crash while Python ends, after their work is done.
        os._exit(0)
    return options


def _inputs(large):
    for size in (*SIZES, *([LARGE] if large else [])):
        label = f"{size // 1_000_000}M" if size >= 1_000_000 else f"{size // 1000}k"
        yield f"{label} random", lambda size=size: clouds.bumpy(size, "random")
        if size < LARGE:
            yield f"{label} sorted", lambda size=size: clouds.bumpy(size, "sorted")
    for name in clouds.FILES:
        yield name, lambda name=name: clouds.file(name)


def _stored(folder, load):
    loaded = load()
    if loaded is None:
        return None
    points, normals = loaded
    path = Path(folder) / "cloud.npz"
    truth = {} if normals is None else {"normals": normals}
    np.savez(path, points=np.ascontiguousarray(points), **truth)
    return path


def _measured(path, methods, rounds):
    """Return the runs of each method, a dict of lists."""
    found = {name: [] for name in methods}
    for _ in range(rounds):
        for name in methods:
            command = [sys.executable, __file__, "--one", name, str(path)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            line = next((a for a in done.stdout.splitlines() if a[:1] == "@"), None)
            if line is None:
                _say(f"{name} failed: {done.stderr.strip()[-200:]}")
            else:
                found[name].append(json.loads(line[1:]))
    return {name: runs for name, runs in found.items() if runs}


def _run(name, path):
    """Run one method once and return what it took."""
    with np.load(path) as data:
        points = data["points"]
        truth = data["normals"] if "normals" in data.files else None
    prepare = peers.METHODS[name][1]
    # Imports, thread pools and the like are paid here.
    prepare(points[:2000] - points[0], NEIGHBORS)()
    run = prepare(points, NEIGHBORS)
    before = _reset_peak()
    wall, cpu = time.perf_counter(), time.process_time()
    normals = run()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    # What it takes beyond input and normals, whichever library holds these.
    extra = _status("VmHWM") - before - points.nbytes / 1e6
    normals = normals() if callable(normals) else normals
    error = None if truth is None else _rmse(normals, truth)
    return {"wall": wall, "cpu": cpu, "extra": max(extra, 0), "rmse": error}


def _rmse(normals, truth):
    """Return the root mean square angle in degrees, whatever the side."""
    normals = np.asarray(normals, dtype=float)
    cosine = np.abs(np.einsum("ij,ij->i", normals, truth))
    # The sine is exact where the cosine rounds to one.
    sine = np.linalg.norm(np.cross(normals, truth), axis=1)
    return float(np.degrees(np.sqrt(np.mean(np.arctan2(sine, cosine) ** 2))))


def _reset_peak():
    """Forget the peak of memory so far and return what is in use, in MB."""
    Path("/proc/self/clear_refs").write_text("5")
    return _status("VmRSS")


def _status(key):
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(a.split()[1]) / 1e3 for a in lines if a.startswith(key + ":"))


def _table(results):
    """Return a table in Markdown, the fastest first."""
    middle = {
        name: {
            key: statistics.median(run[key] for run in runs)
            for key in ("wall", "cpu", "extra", "rmse")
            if runs[0][key] is not None
        }
        for name, runs in results.items()
    }
    ours = middle.get("ours")
    lines = [
        "| method | wall s | CPU s | ours takes | peak MB beyond | RMSE degrees |",
        "|---|---|---|---|---|---|",
    ]
    for name, found in sorted(middle.items(), key=lambda item: item[1]["wall"]):
        ratio = f"{ours['wall'] / found['wall']:.2f}" if ours else ""
        error = f"{found['rmse']:.2g}" if "rmse" in found else ""
        lines.append(
            f"| {name} | {found['wall']:.3f} | {found['cpu']:.3f} | {ratio} "
            f"| {found['extra']:.0f} | {error} |"
        )
    return lines


def _small(rounds):
    """Return a line on what does not grow with the cloud."""
    code = """if True:
        import time
        start = time.perf_counter()
        import core
        print(time.perf_counter() - start)
        points = core.shapes.BUMPY.sample(1000, 1, even=False)[0]
        for method in ("time_scale", "auto"):
            settings = core.Settings(method=method, orientation="none")
            took = []
            for _ in range(9):
                start = time.perf_counter()
                core.estimate_normals(points, settings=settings)
                took.append(time.perf_counter() - start)
            print(sorted(took)[4])"""
    runs = []
    for _ in range(max(rounds, 3)):
        done = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=True,
            cwd=ROOT,
        )
        runs.append([float(a) * 1e3 for a in done.stdout.split()])
    start, fixed, auto = (
        statistics.median(column) for column in zip(*runs, strict=True)
    )
    return (
        f"Import of `core`: {start:.0f} ms. 1,000 points: {fixed:.1f} ms, and "
        f"{auto:.1f} ms when the scale is chosen."
    )


def _installed(name):
    return _found(peers.METHODS[name][0])


def _found(module):
    return importlib.util.find_spec(module) is not None


def _say(text):
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
