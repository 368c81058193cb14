# SPDX-License-Identifier: GPL-3.0-or-later
"""What makes the nets: the shapes to train on, and the training itself."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).resolve().parents[1] / "benchmarks"))

import train
import training

from core.neighbors.graph import NearestNeighbors


@pytest.mark.parametrize("seed", [0, 2, 4])
def test_shapes_are_sampled_with_their_normals(seed):
    """One of each kind: a mesh, solids, a smooth surface."""
    draw = training.shape(seed)
    points, normals = draw(20_000, np.random.default_rng(0))
    np.testing.assert_allclose((normals**2).sum(axis=1), 1, atol=1e-9)
    rows = np.arange(0, 20_000, 10)
    index, _ = NearestNeighbors(points).neighbors(rows, 4)
    chords = points[index] - points[rows][:, None]
    chords /= np.linalg.norm(chords, axis=2, keepdims=True)
    off = np.abs(np.einsum("mki,mi->mk", chords, normals[rows]))
    # Most points have no crease within four neighbors; a chord leaves the tangent by
    # half the angle over which the surface turns.
    assert np.median(off) < 0.1


def task(count=4096):
    """Return candidates of which a feature tells the right one, and the truth."""
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(count, 3))
    truth /= np.linalg.norm(truth, axis=1, keepdims=True)
    wrong = np.roll(truth, 1, axis=1)
    first = rng.random(count) < 0.5
    candidates = np.stack([truth, wrong], axis=1)
    candidates[~first] = candidates[~first, ::-1]
    features = np.stack([np.where(first, 1, -1), rng.normal(size=count)], axis=1)
    arrays = features, candidates, truth, np.ones(count)
    return [a.astype(np.float32) for a in arrays]


def silent(_text):
    pass


def test_training_learns_whom_a_feature_points_at(monkeypatch):
    monkeypatch.setattr(train, "EPOCHS", 200)
    features, candidates, truth, weight = task()
    _, blended = train._choice(features, candidates, truth, weight, 0, silent)
    # Random ones err by 45 degrees; a softmax is never quite certain.
    assert np.sqrt(train.squared_angle(blended, truth).mean()) < 5


def test_training_again_gives_the_same_bytes():
    first, second = (train.train(*task(), 7, silent) for _ in range(2))
    assert list(first) == list(second)
    for name, array in first.items():
        assert array.tobytes() == second[name].tobytes()
