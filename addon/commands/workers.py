# SPDX-License-Identifier: GPL-3.0-or-later
"""Processes that do tasks, each one file at a time.

A worker is this program once more: a task comes as a line of JSON, its row of the
report goes back as one. A worker that dies takes only its own file with it.
"""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, BinaryIO

from .task import Task
from .work import attempt

Row = dict[str, Any]


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Do the tasks that come until there are no more: the life of a worker."""
    for line in requests:
        row = attempt(Task(**json.loads(line)), lambda _share: None)
        answers.write(json.dumps(row).encode() + b"\n")
        answers.flush()


def run_in_processes(tasks: list[Task], jobs: int, name: str) -> Iterator[Row]:
    """Yield the rows of tasks in their order, from as many workers as `jobs`.

    Parameters
    ----------
    tasks : list of Task
    jobs : int
    name : str
        Of the command in Blender.
    """
    workers: list[_Worker] = []
    local = threading.local()

    def work(task: Task) -> Row:
        if not hasattr(local, "worker"):
            local.worker = _Worker(_command(name))
            workers.append(local.worker)
        return local.worker.do(task)

    pool = ThreadPoolExecutor(min(jobs, len(tasks)))
    try:
        yield from pool.map(work, tasks)
    finally:
        # Reached early when the run is stopped: what waits is dropped, and what runs
        # leaves nothing, for a file is renamed last.
        pool.shutdown(wait=False, cancel_futures=True)
        for worker in workers:
            worker.stop()
        pool.shutdown()


def _command(name: str) -> list[str]:
    """Return what starts a worker: Blender itself where it is the program."""
    if "bpy" in sys.modules:
        binary = sys.modules["bpy"].app.binary_path
        if binary:
            return [binary, "-b", "--command", name, "worker"]
    return [sys.executable, "-P", str(Path(__file__).parents[1] / "cli.py"), "worker"]


class _Worker:
    """One process, started again when it has died."""

    def __init__(self, command: list[str]) -> None:
        self.command = command
        self.process: subprocess.Popen[bytes] | None = None
        self.busy = False

    def do(self, task: Task) -> Row:
        """Return the row of a task, also when the process dies over it."""
        if self.process is None:
            self.process = self._started()
        process = self.process
        assert process.stdin is not None
        assert process.stdout is not None
        self.busy = True
        try:
            process.stdin.write(json.dumps(task.as_dict()).encode() + b"\n")
            process.stdin.flush()
            # Blender says a line or two of its own before ours.
            for line in process.stdout:
                if line.startswith(b"{"):
                    self.busy = False
                    return json.loads(line)
        except OSError:
            pass
        with process:
            code = process.wait()
        self.process = None
        about = f"signal {-code}" if code < 0 else f"exit code {code}"
        row: Row = {"input": task.source, "output": task.target, "status": "failed"}
        return row | {"error": f"its process ended early ({about})", "seconds": 0.0}

    def _started(self) -> subprocess.Popen[bytes]:
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
        return subprocess.Popen(
            self.command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
        )

    def stop(self) -> None:
        """End the process; who waits for its answer is told so by its end."""
        process = self.process
        if process is None:
            return
        process.terminate()
        process.wait()
        if not self.busy:
            with process:
                pass
