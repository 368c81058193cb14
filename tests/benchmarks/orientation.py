# SPDX-License-Identifier: GPL-3.0-or-later
"""Wrong sides, seconds and memory, ours beside the peers'.

    make bench-orientation OPTIONS="[CASE ...] [--meshes FOLDER]"

Every method gets every cloud of `stress` once, in a process of its own that is stopped
after `--limit` seconds of CPU time. What came out is kept in build/orientation, case by
case, so that a part can be run again; `--write` puts all of it into docs/accuracy.md.
"""

import argparse
import importlib.util
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import memory
import numpy as np
import orientation_report
import orienters
import stress

ROOT = Path(__file__).resolve().parents[2]
STORE = ROOT / "build" / "orientation"
# Of the limit in wall time, for who waits without working.
_PATIENCE = 5


def main():
    options = _options()
    if options.one:
        return _one(*options.one)
    methods = options.only or list(orienters.METHODS)
    missing = [name for name in methods if not _installed(name)]
    if missing:
        _say(f"not installed: {', '.join(missing)}")
    methods = [name for name in methods if name not in missing]
    STORE.mkdir(parents=True, exist_ok=True)
    store = STORE / "found.json"
    found = json.loads(store.read_text()) if store.exists() else {}
    for name, most, make in stress.cases(options.meshes):
        if options.names and name not in options.names:
            continue
        case = found.setdefault(name, {"runs": {}})
        _measure(name, make, methods, case, options.limit)
        case["most"] = most
        store.write_text(json.dumps(found))
    if options.write:
        orientation_report.write(ROOT / "docs", found, STORE, options.limit)
    return 0


def _measure(name, make, methods, case, limit):
    """Run the methods on one cloud and put what came out into the case."""
    points, truth, counted = make()
    case["points"] = len(points)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cloud.npz"
        np.savez(path, points=points, truth=truth, counted=counted)
        for method in methods:
            case["runs"][method] = run = _run(method, path, limit)
            _say(f"{name:20} {method:14} {run}")
        if name in orientation_report.PICTURED:
            for each in Path(folder).iterdir():
                shutil.copy(each, STORE / f"{name} {each.name}")


def _options():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", help="cases to run; all by default")
    parser.add_argument("--meshes", type=Path, help="folder of the four meshes")
    parser.add_argument("--only", nargs="+", choices=orienters.METHODS)
    parser.add_argument("--limit", type=int, default=120, help="CPU s of a run")
    parser.add_argument("--write", action="store_true", help="docs/accuracy.md")
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    return parser.parse_args()


def _installed(name):
    return importlib.util.find_spec(orienters.METHODS[name][0]) is not None


def _run(method, path, limit):
    """Return what a method made of a cloud, or why there is nothing."""
    command = [sys.executable, __file__, "--one", method, str(path)]
    # At the second bound a process is killed as one that took all memory is.
    bounds = (limit, limit + 10)
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            check=False,
            timeout=_PATIENCE * limit,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, bounds),
        )
    except subprocess.TimeoutExpired:
        return {"failed": f"over {limit} s"}
    if done.returncode == -signal.SIGXCPU:
        return {"failed": f"over {limit} s"}
    line = next((a for a in done.stdout.splitlines() if a[:1] == "@"), None)
    if line is None:
        # Killed by the system: that is what happens when memory is used up.
        return {"failed": "killed" if done.returncode == -signal.SIGKILL else "crashed"}
    return json.loads(line[1:])


def _one(name, path):
    """Run one method once and say what it took."""
    with np.load(path) as data:
        points, truth, counted = data["points"], data["truth"], data["counted"]
    method = orienters.METHODS[name][1]
    # Imports, thread pools and the like are paid here.
    method(stress.sampled(stress.shapes.BUMPY, 2000)[0], lambda: None)
    before = memory.reset_peak()
    marks = []
    normals = method(
        points, lambda: marks.append((time.perf_counter(), time.process_time()))
    )
    peak = memory.peak() - before
    wrong = (np.asarray(normals) * truth).sum(axis=1) < 0
    np.save(Path(path).with_name(f"{name}.npy"), wrong)
    share = 100 * wrong[counted].mean()
    (wall, cpu), (wall_end, cpu_end) = marks
    run = {"wrong": share, "wall": wall_end - wall, "cpu": cpu_end - cpu, "peak": peak}
    _say("@" + json.dumps({key: float(value) for key, value in run.items()}))
    sys.stdout.flush()
    # Some peers crash while Python ends, after their work is done.
    os._exit(0)


def _say(text):
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
