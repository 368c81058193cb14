# SPDX-License-Identifier: GPL-3.0-or-later
"""Work in threads, whose results do not depend on how many there are."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

# Bytes of a block that is freed before work starts.
_HELD = 31 << 20


def in_threads(
    work: Callable[[Any], object], items: Sequence[Any], threads: int | None
) -> Iterator[int]:
    """Call work(item) for every item and yield how many are done, in this thread.

    The items say what is computed together, never the number of threads: results do
    not depend on it.
    """
    # Nobody counts cores for a single item: small clouds have many of these.
    threads = 1 if len(items) < 2 else min(threads or os.cpu_count() or 1, len(items))
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


def hold_memory() -> None:
    """Keep arrays that come and go from being fetched from the system every time.

    Notes
    -----
    glibc gives freed memory back to the system at once until a larger block has been
    freed, and then up to twice its size is kept (mallopt(3), M_MMAP_THRESHOLD). Where
    no array of the input is that large, handing pages back and forth takes up to a
    third of the time. The block is never written to, so it takes no memory.
    """
    np.empty(_HELD, dtype=np.uint8)
