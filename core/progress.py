# SPDX-License-Identifier: GPL-3.0-or-later
"""Shares of stages as shares of the whole.

Whoever is told may raise, in the thread that asked for the work, which ends it.
"""

from collections.abc import Callable
from functools import partial

# Called with the share done, 0 to 1.
Progress = Callable[[float], object]


def silent(_share: float) -> None:
    """Tell nobody."""


def between(progress: Progress, start: float, end: float) -> Progress:
    """Return what tells the share of a stage as one of the whole."""
    return partial(_tell, progress, start, end)


def _tell(progress, start, end, share):
    progress(start + (end - start) * share)
