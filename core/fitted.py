# SPDX-License-Identifier: GPL-3.0-or-later
"""Patches of all points of a source, chunk by chunk, in threads."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from .inputs import BoolArray, FloatArray


@dataclass(frozen=True)
class Fitted:
    """What the patches of all points say: see Estimate and Patches, rows (n,)."""

    normals: FloatArray
    valid: BoolArray
    misfit: FloatArray
    noise: float
    condition: FloatArray | None


def fit_all(source, report):
    """Return the Fitted of all points of a source; report(share) as it goes."""
    n = len(source.points)
    normals, valid = np.zeros((n, 3)), np.zeros(n, dtype=bool)
    misfit, noise = np.zeros((2, n), dtype=np.float32)
    condition = np.full(n, np.inf) if source.paper else None

    def work(rows):
        patches = source.fit(rows)
        normals[rows] = patches.normals(weights=source.settings.weights)
        valid[rows] = patches.valid
        misfit[rows] = patches.misfit
        noise[rows] = patches.noise
        if condition is not None:
            condition[rows] = patches.condition

    chunks = source.chunks()
    for done in in_threads(work, chunks, source.settings.threads):
        report(done / len(chunks))
    middle = float(np.median(noise[valid])) if valid.any() else 0.0
    return Fitted(normals, valid, misfit, middle, condition)


def in_threads(work, items, threads):
    """Call work(item) for every item and yield how many are done, in this thread.

    The items say what is computed together, never the number of threads: results do
    not depend on it.
    """
    threads = min(threads or os.cpu_count() or 1, len(items))
    if threads == 1:
        for done, item in enumerate(items, 1):
            work(item)
            yield done
        return
    pool = ThreadPoolExecutor(threads)
    try:
        futures = [pool.submit(work, item) for item in items]
        for done, future in enumerate(futures, 1):
            future.result()
            yield done
    finally:
        # Reached with work left when the caller was cancelled: drop what waits.
        pool.shutdown(cancel_futures=True)
