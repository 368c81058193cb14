# SPDX-License-Identifier: GPL-3.0-or-later
# ruff: noqa: T201 (a program: its output is the table)
"""Unoriented errors under the six conditions of the PCPNet protocol.

    python tests/benchmarks/accuracy.py CLOUD.npz [CLOUD.npz ...]

Each file holds `points` and `normals` (n, 3). The conditions (Guerrero et al. 2018) are
Gaussian noise of 0, 0.125, 0.6 and 1.2 per cent of the diagonal of the bounding box,
and two uneven densities; the truth is the normal of the point before noise. Prints the
root mean square angle in degrees of each method, as a table for docs/accuracy.md.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from core import Settings, compare_normals, estimate_normals
from core.chart import principal_axes
from core.graph import NearestNeighbors

NOISE = {"none": 0.0, "low": 0.00125, "medium": 0.006, "high": 0.012}
PLANES = (18, 112, 450)
CHUNK = 4096


def conditions(points, normals):
    """Yield name, points and true normals of each condition."""
    rng = np.random.default_rng(7)
    extent = np.ptp(points, axis=0)
    for name, share in NOISE.items():
        noise = rng.normal(0, share * np.linalg.norm(extent), points.shape)
        yield name, points + noise, normals
    axis = extent.argmax()
    along = (points[:, axis] - points[:, axis].min()) / extent[axis]
    stripes = np.where(np.sin(along * 12 * np.pi) > 0, 1.0, 0.08)
    for name, density in (("stripes", stripes), ("gradient", along**2)):
        kept = rng.random(len(points)) < np.clip(density, 0.02, 1)
        yield name, points[kept], normals[kept]


def planes(points, count):
    """Return the normals of planes through `count` nearest points, (n, 3)."""
    nearest = NearestNeighbors(points - points.mean(axis=0))
    normals = np.empty(points.shape)
    for start in range(0, len(points), CHUNK):
        rows = nearest.order[start : start + CHUNK]
        index, _ = nearest.neighbors(rows, count)
        offsets = nearest.points[index] - nearest.points[rows][:, None]
        offsets = np.ascontiguousarray(offsets.transpose(2, 1, 0))
        normals[rows] = principal_axes(offsets, np.full(len(rows), count))[2].T
    return normals


def methods():
    """Return name and function from points to normals of every method."""
    found = {"auto": lambda p: estimated(p, Settings(orientation="none"))}
    for count in (16, 112):
        settings = Settings(method="time_scale", neighbors=count, orientation="none")
        found[f"time_scale, {count}"] = lambda p, s=settings: estimated(p, s)
    for count in PLANES:
        found[f"plane, {count}"] = lambda p, k=count: planes(p, k)
    return found


def estimated(points, settings):
    return estimate_normals(points, settings=settings).normals


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("clouds", type=Path, nargs="+")
    heads = [*NOISE, "stripes", "gradient", "mean", "seconds"]
    print("| cloud | method |", " | ".join(heads), "|")
    print("|---|---|" + "---|" * len(heads))
    for path in parser.parse_args().clouds:
        data = np.load(path)
        truth = data["normals"]
        truth = truth / np.linalg.norm(truth, axis=1, keepdims=True)
        cases = list(conditions(data["points"], truth))
        for name, method in methods().items():
            start = time.perf_counter()
            errors = [
                compare_normals(method(points), normals).summary()[
                    "angle_deviation_rms"
                ]
                for _, points, normals in cases
            ]
            seconds = time.perf_counter() - start
            cells = [*errors, np.mean(errors), seconds]
            print(
                f"| {path.stem} | {name} |",
                " | ".join(f"{cell:.2f}" for cell in cells),
                "|",
                flush=True,
            )


if __name__ == "__main__":
    main()
