# SPDX-License-Identifier: GPL-3.0-or-later
"""Small perceptrons that weigh normals by facts about them, as trained."""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from io import BytesIO

import numpy as np

from ..inputs import FloatArray
from .ladder import turn

_LAYERS = 3

# Columns of a product of matrices: larger ones OpenBLAS gives to threads of its own,
# which get in the way of ours.
_COLUMNS = 32


@dataclass(frozen=True)
class Perceptron:
    """Two hidden layers between facts and what follows from them.

    Attributes
    ----------
    mean, scale : (f,) float32
        What features are centered and divided by.
    layers : list of (matrix, offset)
    """

    mean: FloatArray
    scale: FloatArray
    layers: list[tuple[FloatArray, FloatArray]]

    def __call__(self, features: FloatArray) -> FloatArray:
        """Return the outputs for features (f, m), (o, m)."""
        x = (features - self.mean[:, None]) * (1 / self.scale)[:, None]
        *hidden, last = self.layers
        for matrix, offset in hidden:
            x = _layer(matrix, offset, x)
            x = np.maximum(x, np.float32(0.01) * x)
        return _layer(*last, x)


def _layer(matrix, offset, x):
    """Return what a layer makes of its input (i, m), before it is bent, (o, m).

    In double precision, and rounded: in single precision a column hangs on which
    others are beside it.
    """
    result = np.empty((matrix.shape[1], x.shape[1]), dtype=x.dtype)
    double = matrix.T.astype(np.float64)
    for at in range(0, x.shape[1], _COLUMNS):
        part = slice(at, at + _COLUMNS)
        result[:, part] = double @ x[:, part].astype(np.float64)
    result += offset[:, None]
    return result


@dataclass(frozen=True)
class Net:
    """What weighs candidates, and what says how far their mean may be off.

    Attributes
    ----------
    choice : Perceptron
        From features to the logarithms of weights.
    doubt : Perceptron
        From features, and how the mean turns against each candidate, to the logarithm
        of the expected squared error in degrees.
    """

    choice: Perceptron
    doubt: Perceptron

    def blend(
        self, features: FloatArray, candidates: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the blend of candidates (c, 3, m), their weights, and its error.

        Returns
        -------
        normals : (3, m), unit
        weights : (c, m)
        error : (m,), the logarithm of the expected squared error in degrees
        """
        scores = self.choice(features)
        weights = np.exp(scores - scores.max(axis=0))
        weights /= weights.sum(axis=0)
        normals = np.einsum("cm,cim->im", weights, aligned(candidates))
        length = np.sqrt((normals * normals).sum(axis=0))
        normals /= np.where(length > 0, length, 1)
        error = self.doubt(with_turns(features, candidates, normals))[0]
        return normals, weights, error


def with_turns(
    features: FloatArray, candidates: FloatArray, normals: FloatArray
) -> FloatArray:
    """Return features (f, m) and how normals (3, m) turn against each candidate."""
    turns = [turn(normals, candidate) for candidate in candidates]
    return np.concatenate([features, turns])


def aligned(candidates: FloatArray) -> FloatArray:
    """Return candidates (c, 3, m) on the side of the first."""
    side = np.einsum("cim,im->cm", candidates, candidates[0])
    return candidates * np.where(side < 0, np.float32(-1), np.float32(1))[:, None]


@cache
def nets() -> dict[str, Net]:
    """Return the nets that come with the package, by name."""
    # Wherever the package is: on another machine it comes in an archive.
    stored = files(__package__).joinpath("blend.npz").read_bytes()
    with np.load(BytesIO(stored)) as file:
        return {name: _net(file, name) for name in file["names"].tolist()}


def _net(file, name):
    return Net(*(_perceptron(file, f"{name} {part}") for part in ("choice", "doubt")))


def _perceptron(file, name):
    def read(part):
        return file[f"{name} {part}"].astype(np.float32)

    layers = [(read(f"matrix{i}"), read(f"offset{i}")) for i in range(_LAYERS)]
    return Perceptron(read("mean"), read("scale"), layers)
