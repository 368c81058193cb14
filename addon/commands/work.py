# SPDX-License-Identifier: GPL-3.0-or-later
"""One file on its way through a command, and its row of the report at the end."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ... import core
from ...core.progress import Progress
from .. import files
from .compare import compare
from .estimate import estimate, repair
from .output import OutputError
from .task import Task

# What may go wrong with one file; the others are done all the same.
EXPECTED = (files.FileError, OutputError, core.InputError, OSError, MemoryError)

_COMMANDS: dict[str, Callable[[Task, Progress], dict[str, Any]]] = {
    "estimate": estimate,
    "compare": compare,
    "repair": repair,
}


def attempt(task: Task, progress: Progress) -> dict[str, Any]:
    """Do a task and return its row of the report, whatever happens to the file."""
    start = time.perf_counter()
    row: dict[str, Any] = {"input": task.source, "output": task.target}
    try:
        files.check_is_file(Path(task.source))
        row |= {"status": "done"} | _COMMANDS[task.command](task, progress)
    except EXPECTED as error:
        # Somebody else, such as the rest of a run before, was faster.
        there = task.target is not None and Path(task.target).exists()
        if isinstance(error, OutputError) and task.skip_existing and there:
            return row | {"status": "skipped"}
        row |= {"status": "failed", "error": _sentence(error)}
    return row | {"seconds": round(time.perf_counter() - start, 3)}


def _sentence(error: BaseException) -> str:
    if isinstance(error, MemoryError):
        return "needs more memory than there is"
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return " ".join(str(error).split())
