# SPDX-License-Identifier: GPL-3.0-or-later
# ruff: noqa: T201 (a program: it says how far it is)
"""Train the nets of core/auto on shapes made by training.py; write its blend.npz.

    python tests/benchmarks/train.py [--shapes 72]

Every shape is sampled clean, with uneven density, sparsely, and with noise from a
twentieth of a spacing to five. The truth is the normal before noise. The first round's
nets are trained on single points; with them the second round's. A net's weights are
chosen so that the normal they blend errs least: the loss is 2 (1 - cos) of its angle, a
cloud counting by the inverse of its root mean square error, as in the mean of these.
The same numbers come out again on the same machine, whatever the number of processes.
"""

import argparse
import os
import sys
import time
from functools import partial
from itertools import pairwise
from multiprocessing import Pool
from pathlib import Path

# Sums in several threads come out in any order; before numpy is loaded.
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import training

from core import Settings, shapes
from core.auto.blend import CHUNK, LEAST_ERROR, Exact, Noisy, first_round, is_noisy
from core.auto.coarse import noise_in_spacings
from core.auto.nets import aligned, nets, with_turns
from core.fields import base_field
from core.neighborhoods import neighborhoods
from core.neighbors.graph import NearestNeighbors
from core.patches.fitted import fit_all

ROOT = Path(__file__).resolve().parents[2]
WEIGHTS = ROOT / "core" / "auto" / "blend.npz"

# Points of a cloud, and the noise in spacings: fixed, or drawn between two values.
KINDS = {
    "none": (15_000, 0.0),
    "uneven": (25_000, 0.0),
    "sparse": ((500, 8_000), 0.0),
    "faint": (10_000, (0.05, 0.3)),
    "low": (16_000, (0.3, 0.6)),
    "any": (24_000, (0.5, 2.5)),
    "medium": (40_000, (1.5, 2.8)),
    "high": (60_000, (3.0, 5.5)),
}
SAMPLES, LEAST_SAMPLES = 2000, 20
HIDDEN, DOUBTING = (64, 64), (48, 24)
EPOCHS, BATCH, RATE, DECAY = 24, 2048, 2e-3, 1e-4

# Degrees below which a cloud's error does not make it count more.
FLOOR = 0.5

# Logarithms of squared degrees that are believed, and errors over what was expected
# beyond which they are all the same.
WITHIN, SURPRISE = (-6, 9), 30


def cloud(seed, kind):
    """Return points and true normals of a shape under a condition."""
    rng = np.random.default_rng([seed, 2, list(KINDS).index(kind)])
    count, level = KINDS[kind]
    if isinstance(count, tuple):
        count = int(np.exp(rng.uniform(*np.log(count))))
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


def prepared(points):
    """Return a cloud as the estimate sees it, Exact or Noisy."""
    source, settings = neighborhoods(points, None, Settings(threads=1))
    level, noise = noise_in_spacings(source.asked)
    if is_noisy(level, settings.neighbors):
        return Noisy(source.nearest, level, noise)
    fitted = fit_all(source, lambda _share: None)
    field, _ = base_field(source, fitted)
    return Exact(source.nearest, field, fitted.normals, fitted.misfit)


def _run(work, chunks):
    for chunk in chunks:
        work(chunk)


def sample(job, stage):
    """Return regime, weight, candidates (m, c, 3), features (m, f), truth (m, 3).

    None where patches of one size leave too few points open.
    """
    seed, kind = job
    points, truth = cloud(seed, kind)
    seen = prepared(points)
    rng = np.random.default_rng([seed, 3, stage])
    count = min(SAMPLES, len(seen.rows))
    if count < LEAST_SAMPLES:
        return None
    rows = rng.choice(seen.rows, count, replace=False)
    if stage == 0:
        look = lambda part: seen.candidates(seen.first_rows(part))[::2]  # noqa: E731
    else:
        # Also where nobody will vote: who never saw a smooth surface finds creases.
        first, _ = seen.start()
        first_round(seen, first, _run)
        look = partial(seen.votes, first)
    found = [look(part) for part in _parts(rows)]
    candidates = np.concatenate([a for a, _ in found], axis=2)
    features = np.concatenate([b for _, b in found], axis=1)
    candidates = aligned(candidates).transpose(2, 0, 1)
    truth = truth[rows].astype(np.float32)
    best = min(
        np.sqrt(squared_angle(candidates[:, i], truth).mean())
        for i in range(candidates.shape[1])
    )
    share = np.sqrt(len(seen.rows) / len(points))
    weight = np.full(count, share / max(best, FLOOR), dtype=np.float32)
    return seen.name, weight, candidates, features.T, truth


def _parts(rows):
    return [rows[at : at + CHUNK] for at in range(0, len(rows), CHUNK)]


def squared_angle(a, b):
    """Return squared angles in degrees between directions, whatever their side."""
    cosine = np.abs((a * b).sum(axis=-1)).clip(0, 1)
    return np.degrees(np.arccos(cosine)) ** 2


def train(features, candidates, truth, weight, seed, report):
    """Return the arrays of a Net: its choice, then its doubts about that."""
    choice, blended = _choice(features, candidates, truth, weight, seed, report)
    turned = with_turns(features.T, candidates.transpose(1, 2, 0), blended.T).T
    doubt = _doubt(turned, squared_angle(blended, truth) + LEAST_ERROR, seed, report)
    return {f"choice {name}": a for name, a in choice.items()} | {
        f"doubt {name}": a for name, a in doubt.items()
    }


def _choice(features, candidates, truth, weight, seed, report):
    """Return the arrays of a perceptron that weighs candidates, and what it blends."""
    mean, scale = _spread(features)
    x = (features - mean) / scale
    layers = _layers((x.shape[1], *HIDDEN, candidates.shape[1]), seed)
    weight = weight / weight.mean()

    def slopes(outputs, rows):
        return _slopes_of_blend(outputs, candidates[rows], truth[rows], weight[rows])

    _descend(layers, x, slopes, seed, report)
    return _arrays(mean, scale, layers), _blend(layers, x, candidates)


def _doubt(features, square, seed, report):
    """Return the arrays of a perceptron that finds the mean of squared errors.

    By maximum likelihood, as if they were exponential variables: the least of
    square / E + log E.
    """
    mean, scale = _spread(features)
    layers = _layers((features.shape[1], *DOUBTING, 1), seed)
    layers[-1][1][:] = np.log(square.mean())

    def slopes(outputs, rows):
        found = outputs[:, 0]
        ratio = square[rows] * np.exp(-found.clip(*WITHIN))
        loss = float((ratio + found).mean())
        # Beyond so many times what is expected an error pulls no harder.
        return loss, (1 - np.minimum(ratio, SURPRISE))[:, None] / np.float32(len(rows))

    _descend(layers, (features - mean) / scale, slopes, seed, report)
    return _arrays(mean, scale, layers)


def _spread(features):
    return features.mean(axis=0), features.std(axis=0) + np.float32(1e-3)


def _layers(sizes, seed):
    """Return matrices and offsets to start from; the last hardly matter yet."""
    rng = np.random.default_rng([seed, 4])
    layers = [
        [
            rng.normal(0, np.sqrt(2 / a), (a, b)).astype(np.float32),
            np.zeros(b, np.float32),
        ]
        for a, b in pairwise(sizes)
    ]
    layers[-1][0] *= np.float32(0.1)
    return layers


def _arrays(mean, scale, layers):
    return {
        "mean": mean.astype(np.float32),
        "scale": scale.astype(np.float32),
        **{f"matrix{i}": m.astype(np.float16) for i, (m, _) in enumerate(layers)},
        **{f"offset{i}": o.astype(np.float16) for i, (_, o) in enumerate(layers)},
    }


def _descend(layers, x, slopes_of, seed, report):
    """Fit layers, in place, by Adam with a rate that falls as a cosine.

    slopes_of(outputs, rows) returns the loss of some rows and its derivatives by what
    the last layer gives.
    """
    rng = np.random.default_rng([seed, 5])
    moments = [[np.zeros_like(p), np.zeros_like(p)] for pair in layers for p in pair]
    batches = len(x) // BATCH
    for epoch in range(EPOCHS):
        total = 0.0
        order = rng.permutation(len(x))
        for batch in range(batches):
            rows = order[batch * BATCH : (batch + 1) * BATCH]
            outputs = _forward(layers, x[rows])
            loss, slope = slopes_of(outputs[-1], rows)
            total += loss
            step = epoch * batches + batch + 1
            falling = (1 + np.cos(np.pi * step / (EPOCHS * batches))) / 2
            rate = RATE * min(1, step / 200) * falling
            slopes = _backward(layers, outputs, slope.astype(np.float32))
            _adam(layers, slopes, moments, step, float(rate))
    report(f"loss {total / batches:.5f}")


def _forward(layers, x):
    """Return the input and the output of every layer."""
    outputs = [x]
    for i, (matrix, offset) in enumerate(layers):
        x = x @ matrix + offset
        if i < len(layers) - 1:
            x = np.maximum(x, np.float32(0.01) * x)
        outputs.append(x)
    return outputs


def _backward(layers, outputs, slope):
    """Return derivatives by matrices and offsets from those by the last output."""
    slopes = []
    for i in range(len(layers) - 1, -1, -1):
        if i < len(layers) - 1:
            slope = np.where(outputs[i + 1] > 0, slope, np.float32(0.01) * slope)
        slopes.append([outputs[i].T @ slope, slope.sum(axis=0)])
        slope = slope @ layers[i][0].T
    return slopes[::-1]


def _softmax(scores):
    weights = np.exp(scores - scores.max(axis=1, keepdims=True))
    return weights / weights.sum(axis=1, keepdims=True)


def _blend(layers, x, candidates):
    shares = _softmax(_forward(layers, x)[-1])
    normals = np.matmul(shares[:, None], candidates)[:, 0]
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _slopes_of_blend(scores, candidates, truth, weight):
    """Return the loss of a batch, and its derivatives by the scores."""
    shares = _softmax(scores)
    blended = np.matmul(shares[:, None], candidates)[:, 0]
    length = np.linalg.norm(blended, axis=1, keepdims=True) + np.float32(1e-9)
    unit = blended / length
    cosine = (unit * truth).sum(axis=1, keepdims=True)
    side = np.sign(cosine)
    loss = float((2 * (1 - np.abs(cosine[:, 0])) * weight).mean())
    by_blend = -2 * side * (truth - cosine * unit) / length
    by_share = np.matmul(candidates, by_blend[:, :, None])[:, :, 0] * weight[:, None]
    slope = shares * (by_share - (shares * by_share).sum(axis=1, keepdims=True))
    return loss, slope / np.float32(len(scores))


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


def gather(jobs, stage, processes, report):
    """Return features, candidates, truth and weight of all jobs, by regime."""
    with Pool(processes) as pool:
        found = pool.map(partial(sample, stage=stage), jobs, chunksize=1)
    result = {}
    for name in ("exact", "noisy"):
        mine = [s for s in found if s is not None and s[0] == name]
        weight, candidates, features, truth = (
            np.concatenate([s[i] for s in mine]) for i in range(1, 5)
        )
        report(f"{name}: {len(mine)} clouds, {len(weight)} points")
        result[name] = features, candidates, truth, weight
    return result


def write(arrays):
    """Write the nets and their names."""
    names = sorted({" ".join(key.split(" ")[:2]) for key in arrays})
    np.savez_compressed(WEIGHTS, names=np.array(names), **arrays)


def main():
    """Train, round by round."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--shapes", type=int, default=72)
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
            arrays |= {f"{regime} {name} {part}": a for part, a in net.items()}
        # The second round looks at the first's normals.
        write(arrays)
        nets.cache_clear()
    report(f"{WEIGHTS.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
