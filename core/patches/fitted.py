# SPDX-License-Identifier: GPL-3.0-or-later
"""Patches of all points of a source, chunk by chunk, in threads."""

from dataclasses import dataclass

import numpy as np

from ..inputs import BoolArray, FloatArray
from ..threads import in_threads
from .patch import MEDIAN_OF


@dataclass(frozen=True)
class Fitted:
    """What the patches of all points say: see Estimate and Patches, rows (n,)."""

    normals: FloatArray
    valid: BoolArray
    misfit: FloatArray
    reach: FloatArray
    noise: float
    condition: FloatArray | None


def fit_all(source, report):
    """Return the Fitted of all points of a source; report(share) as it goes."""
    # First of all: making the neighborhoods takes memory that results take later.
    chunks = source.chunks()
    n = source.count
    normals, valid = np.zeros((n, 3)), np.zeros(n, dtype=bool)
    misfit, reach = (np.zeros(n, dtype=np.float32) for _ in range(2))
    noise: list[FloatArray] = []
    every = -(-n // MEDIAN_OF)
    condition = np.full(n, np.inf) if source.paper else None

    def work(rows):
        patches = source.fit(rows)
        normals[rows] = patches.normals(weights=source.settings.weights)
        valid[rows] = patches.valid
        misfit[rows] = patches.misfit
        reach[rows] = patches.reach
        # A copy: what is left out is not to be held.
        noise.append(patches.noise[patches.valid][::every].copy())
        if condition is not None:
            condition[rows] = patches.condition

    for done in in_threads(work, chunks, source.settings.threads):
        report(done / len(chunks))
    known = np.concatenate(noise)
    middle = float(np.median(known, overwrite_input=True)) if len(known) else 0.0
    return Fitted(normals, valid, misfit, reach, middle, condition)
