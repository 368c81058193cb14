# SPDX-License-Identifier: GPL-3.0-or-later
# ruff: noqa: T201 (a program: it says how far it is)
"""Train the nets of core/blend.py on shapes made by training.py; write core/blend.npz.

    python tests/benchmarks/train.py [--shapes 60]

Every shape is sampled clean, with uneven density, sparsely, and with noise from a
twentieth of a spacing to five. The truth is the normal before noise. The first round's
nets are trained on single points; with them the second round's. A net's weights are
chosen so that the normal they blend errs least: the loss is 2 (1 - cos) of its angle, a
cloud counting by the inverse of its root mean square error, as in the mean of these.
The same numbers come out again on the same machine, whatever the number of processes.
"""

import argparse
import sys
import time
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from multiprocessing import Pool
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import training

from core import Settings, blend, shapes
from core.asked import Asked
from core.coarse import noise_in_spacings
from core.fields import base_field
from core.fitted import fit_all
from core.graph import NearestNeighbors
from core.neighborhoods import neighborhoods

ROOT = Path(__file__).resolve().parents[2]
WEIGHTS = ROOT / "core" / "blend.npz"

# Points of a cloud, and the noise in spacings: fixed, or drawn between two values.
KINDS = {
    "none": (20_000, 0.0),
    "uneven": (40_000, 0.0),
    "sparse": (4_000, 0.0),
    "faint": (20_000, (0.05, 0.3)),
    "low": (30_000, (0.3, 0.6)),
    "any": (40_000, (0.5, 2.5)),
    "medium": (60_000, (1.5, 2.8)),
    "high": (80_000, (3.0, 5.5)),
}
SAMPLES = 1000
HIDDEN = (64, 64)
EPOCHS, BATCH, RATE, DECAY = 16, 2048, 2e-3, 1e-4

# Degrees below which a cloud's error does not make it count more.
FLOOR = 2.0


def cloud(seed, kind):
    """Return points and true normals of a shape under a condition."""
    rng = np.random.default_rng([seed, 2, list(KINDS).index(kind)])
    count, level = KINDS[kind]
    draw = training.shape(seed)
    if kind == "sparse" and seed % 2:
        points, normals = draw(5 * count, rng)
        kept = shapes.thin(points, count)
    else:
        points, normals = draw(count, rng)
        kept = np.full(count, True)
    if kind == "uneven":
        extent = np.ptp(points, axis=0)
        axis = extent.argmax()
        along = (points[:, axis] - points[:, axis].min()) / extent[axis]
        stripes = np.sin(along * 2 * np.pi * rng.uniform(2, 7)) > 0
        density = along**2 if seed % 2 else np.where(stripes, 1, 0.08)
        kept = rng.random(count) < np.clip(density, 0.02, 1)
    points, normals = points[kept], normals[kept]
    if level:
        near = NearestNeighbors(points).tree.query(points[:500], k=9)[0][:, -1]
        spacing = np.median(near) * np.sqrt(np.pi / 8)
        share = np.exp(rng.uniform(*np.log(level)))
        points = points + rng.normal(0, share * spacing, points.shape)
    return points - points.mean(axis=0), normals


@dataclass
class Case:
    """A cloud, what the first patches say of it, and where to look."""

    kind: str
    nearest: NearestNeighbors
    truth: np.ndarray
    level: float
    noise: float
    field: object = None
    misfit: np.ndarray | None = None
    rows: np.ndarray | None = None

    @property
    def exact(self):
        return bool(self.level < blend.NOISY_FROM)


def make_case(points, truth, kind):
    """Return the Case of a cloud, with the points to look at drawn."""
    nearest = NearestNeighbors(points)
    case = Case(kind, nearest, truth, *noise_in_spacings(Asked.of(nearest)))
    case.rows = np.arange(len(points))
    if case.exact:
        source, _ = neighborhoods(points, None, Settings())
        fitted = fit_all(source, lambda _share: None)
        case.field, _ = base_field(source, fitted)
        case.misfit = fitted.misfit
        case.rows = blend.unsettled(fitted.misfit, fitted.valid)
    return case


def first_round(case, rows):
    """Return candidates (c, 3, m) and features (f, m) of the first round."""
    if case.exact:
        found = blend.exact_candidates(case.nearest, case.field, case.misfit, rows)
    else:
        coarse, label = blend.coarse_cloud(case.nearest, case.level)
        own = rows if label is None else label[rows]
        found = blend.noisy_candidates(coarse, case.level, own)
    return found[0], found[2]


def second_round(case, rows):
    """Return candidates and features of the second round."""
    if case.exact:
        first = blend.Growing(case.field)
        _run(
            lambda chunk: first.put(
                chunk, *blend.fitted_exact(case.nearest, case.field, case.misfit, chunk)
            ),
            blend.chunks_of(
                case.nearest, blend.unsettled(case.misfit, case.misfit > 0)
            ),
        )
        return blend.exact_votes(case.nearest, first, rows)
    coarse, _ = blend.coarse_cloud(case.nearest, case.level)
    first = blend.Growing(count=len(coarse.points))
    _run(
        lambda chunk: first.put(chunk, *blend.fitted_noisy(coarse, case.level, chunk)),
        blend.chunks_of(coarse, coarse.order),
    )
    return blend.noisy_votes(case.nearest, coarse, first, case.level, case.noise, rows)


def _run(work, chunks):
    for chunk in chunks:
        work(chunk)


def sample(job, stage):
    """Return regime, weight, candidates (m, c, 3), features (m, f), truth (m, 3)."""
    seed, kind = job
    points, truth = cloud(seed, kind)
    case = make_case(points, truth, kind)
    rng = np.random.default_rng([seed, 3, stage])
    count = min(SAMPLES, len(case.rows))
    if count < 20:
        return None
    rows = rng.choice(case.rows, count, replace=False)
    found = [(first_round, second_round)[stage](case, part) for part in _parts(rows)]
    candidates = np.concatenate([a for a, _ in found], axis=2)
    features = np.concatenate([b for _, b in found], axis=1)
    candidates = blend.aligned(candidates).transpose(2, 0, 1)
    share = np.sqrt(len(case.rows) / len(points))
    truth = truth[rows].astype(np.float32)
    best = min(
        np.sqrt(squared_angle(candidates[:, i], truth).mean())
        for i in range(candidates.shape[1])
    )
    weight = np.full(count, share / max(best, FLOOR), dtype=np.float32)
    return case.exact, weight, candidates, features.T, truth


def _parts(rows):
    return [rows[at : at + blend.CHUNK] for at in range(0, len(rows), blend.CHUNK)]


def squared_angle(a, b):
    """Return squared angles in degrees between directions, whatever their side."""
    cosine = np.abs((a * b).sum(axis=-1)).clip(0, 1)
    return np.degrees(np.arccos(cosine)) ** 2


def train(features, candidates, truth, weight, seed, report):
    """Return the arrays of a Net.

    Adam with a rate that falls as a cosine; then the error, linear in the last hidden
    layer, by maximum likelihood of exponential squared errors.
    """
    rng = np.random.default_rng([seed, 4])
    mean = features.mean(axis=0)
    scale = features.std(axis=0) + np.float32(1e-3)
    x = (features - mean) / scale
    sizes = (x.shape[1], *HIDDEN, candidates.shape[1])
    layers = [
        [
            rng.normal(0, np.sqrt(2 / a), (a, b)).astype(np.float32),
            np.zeros(b, np.float32),
        ]
        for a, b in pairwise(sizes)
    ]
    layers[-1][0] *= np.float32(0.1)
    weight = weight / weight.mean()
    moments = [[np.zeros_like(p), np.zeros_like(p)] for pair in layers for p in pair]
    steps, step = EPOCHS * (len(x) // BATCH), 0
    for epoch in range(EPOCHS):
        total = 0.0
        order = rng.permutation(len(x))
        for at in range(0, len(x) - BATCH + 1, BATCH):
            rows = order[at : at + BATCH]
            loss, slopes = _slopes(
                layers, x[rows], candidates[rows], truth[rows], weight[rows]
            )
            total += loss
            step += 1
            rate = RATE * min(1, step / 200) * (1 + np.cos(np.pi * step / steps)) / 2
            _adam(layers, slopes, moments, step, float(rate))
        if epoch % 4 == 3:
            report(f"epoch {epoch + 1}: {total / (len(x) // BATCH):.5f}")
    hidden = _forward(layers, x)[-2]
    blended = _blend(layers, x, candidates)
    error = _error_head(hidden, squared_angle(blended, truth) + blend.LEAST_ERROR)
    return {
        "mean": mean.astype(np.float32),
        "scale": scale.astype(np.float32),
        **{f"matrix{i}": m.astype(np.float16) for i, (m, _) in enumerate(layers)},
        **{f"offset{i}": o.astype(np.float16) for i, (_, o) in enumerate(layers)},
        "error": error.astype(np.float32),
    }


def _forward(layers, x):
    """Return the input and the output of every layer."""
    outputs = [x]
    for i, (matrix, offset) in enumerate(layers):
        x = x @ matrix + offset
        if i < len(layers) - 1:
            x = np.maximum(x, np.float32(0.01) * x)
        outputs.append(x)
    return outputs


def _softmax(scores):
    weights = np.exp(scores - scores.max(axis=1, keepdims=True))
    return weights / weights.sum(axis=1, keepdims=True)


def _blend(layers, x, candidates):
    shares = _softmax(_forward(layers, x)[-1])
    normals = np.matmul(shares[:, None], candidates)[:, 0]
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _slopes(layers, x, candidates, truth, weight):
    """Return the loss of a batch, and its derivatives by matrices and offsets."""
    outputs = _forward(layers, x)
    shares = _softmax(outputs[-1])
    blended = np.matmul(shares[:, None], candidates)[:, 0]
    length = np.linalg.norm(blended, axis=1, keepdims=True) + np.float32(1e-9)
    unit = blended / length
    cosine = (unit * truth).sum(axis=1, keepdims=True)
    side = np.sign(cosine)
    loss = float((2 * (1 - np.abs(cosine[:, 0])) * weight).mean())
    by_blend = -2 * side * (truth - cosine * unit) / length
    by_share = np.matmul(candidates, by_blend[:, :, None])[:, :, 0] * weight[:, None]
    slope = shares * (by_share - (shares * by_share).sum(axis=1, keepdims=True))
    slope /= np.float32(len(x))
    slopes = []
    for i in range(len(layers) - 1, -1, -1):
        if i < len(layers) - 1:
            slope = np.where(outputs[i + 1] > 0, slope, np.float32(0.01) * slope)
        slopes.append([outputs[i].T @ slope, slope.sum(axis=0)])
        slope = slope @ layers[i][0].T
    return loss, slopes[::-1]


def _adam(layers, slopes, moments, step, rate):
    """Take one step; matrices also decay."""
    for i, (pair, by) in enumerate(zip(layers, slopes, strict=True)):
        for j in range(2):
            first, second = moments[2 * i + j]
            first += np.float32(0.1) * (by[j] - first)
            second += np.float32(0.001) * (by[j] ** 2 - second)
            size = np.sqrt(second / np.float32(1 - 0.999**step)) + np.float32(1e-8)
            move = first / np.float32(1 - 0.9**step) / size
            if j == 0:
                move = move + np.float32(DECAY) * pair[0]
            pair[j] -= np.float32(rate) * move


def _error_head(hidden, square):
    """Return the coefficients of log E, E the mean of exponential variables.

    Newton's method on sum(square / E + log E), which is convex in the coefficients.
    """
    design = np.concatenate([hidden, np.ones((len(hidden), 1))], axis=1).astype(float)
    found = np.zeros(design.shape[1])
    found[-1] = np.log(square.mean())
    ridge = 1e-3 * len(design) * np.eye(len(found))
    ridge[-1, -1] = 0
    for _ in range(30):
        ratio = np.exp(np.clip(np.log(square) - design @ found, -20, 8))
        # The expected curvature: one for each point, whatever its error.
        slope = design.T @ (1 - ratio) + ridge @ found
        curvature = design.T @ (design * np.maximum(ratio, 0.3)[:, None]) + ridge
        found -= np.linalg.solve(curvature, slope)
    return found


def gather(jobs, stage, processes, report):
    """Return features, candidates, truth and weight of all jobs, by regime."""
    with Pool(processes) as pool:
        found = pool.map(partial(sample, stage=stage), jobs, chunksize=1)
    result = {}
    for exact, name in ((True, "exact"), (False, "noisy")):
        mine = [s for s in found if s is not None and s[0] is exact]
        weight, candidates, features, truth = (
            np.concatenate([s[i] for s in mine]) for i in range(1, 5)
        )
        report(f"{name}: {len(mine)} clouds, {len(weight)} points")
        result[name] = features, candidates, truth, weight
    return result


def write(arrays):
    """Write the nets and their names."""
    names = sorted({key.rsplit("_", 1)[0] for key in arrays})
    np.savez_compressed(WEIGHTS, names=np.array(names), **arrays)


def main():
    """Train, round by round."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--shapes", type=int, default=60)
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    start = time.perf_counter()

    def report(text):
        print(f"{time.perf_counter() - start:6.0f} s  {text}", flush=True)

    jobs = [(seed, kind) for seed in range(options.shapes) for kind in KINDS]
    arrays = {}
    for stage, name in enumerate(("fit", "vote")):
        found = gather(jobs, stage, options.processes, report)
        for i, (regime, data) in enumerate(found.items()):
            net = train(*data, 2 * stage + i, report)
            arrays |= {f"{regime} {name}_{part}": a for part, a in net.items()}
        # The second round looks at the first's normals.
        write(arrays)
        blend.nets.cache_clear()
    report(f"{WEIGHTS.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
