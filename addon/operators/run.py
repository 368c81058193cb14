# SPDX-License-Identifier: GPL-3.0-or-later
"""Running jobs: straight through for scripts, beside the window for people.

In the window a thread computes while a timer looks after it, so that the view can be
turned and Esc ends the run. The thread knows nothing of Blender; reading and writing
happen in the operator, before and after it.
"""

import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import bpy
from bpy.types import Context, Event, Operator

from ...core.progress import Progress
from .. import bridge
from ..settings.scene import Returned
from .jobs import Job, check_same, jobs_of

# How often the timer looks, in seconds.
_STEP = 0.1
# A run that is over by then needs neither timer nor progress bar.
_SHORT = 0.15


class Stopped(Exception):  # noqa: N818 - it is no error
    """Raised inside a computation that nobody waits for any longer."""


class Worker:
    """A thread that computes jobs.

    Attributes
    ----------
    share : float
        How much of the whole is done, 0 to 1.
    """

    def __init__(self, jobs: Sequence[Job], compute: Callable[..., None]) -> None:
        self.jobs = jobs
        self.share = 0.0
        self._begun = time.monotonic()
        self._compute = compute
        self._failure: BaseException | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    @property
    def stopped(self) -> bool:
        """Whether someone asked for the end."""
        return self._stop.is_set()

    @property
    def seconds(self) -> int:
        """How long it has been at work: some stages take long without a word."""
        return int(time.monotonic() - self._begun)

    def stop(self) -> None:
        """Ask for the end: the computation leaves at its next word of progress."""
        self._stop.set()

    def finished(self, seconds: float = 0) -> bool:
        """Whether all is computed, or was within so many seconds.

        Raises
        ------
        BaseException
            What ended the thread, where that was no bad input.
        """
        self._thread.join(seconds)
        if self._failure is not None:
            raise self._failure
        return not self._thread.is_alive()

    def _work(self) -> None:
        try:
            for index, job in enumerate(self.jobs):
                job.attempt(self._compute, partial(self._show, index))
        except Stopped:
            pass
        except BaseException as failure:  # noqa: BLE001 - raised again in `finished`
            self._failure = failure

    def _show(self, done: int, share: float) -> None:
        if self.stopped:
            raise Stopped
        self.share = (done + share) / len(self.jobs)


class Beside:
    """What runs beside the window: one at a time, two would fight for the same cores.

    The timer is kept here and not in an operator, so that it is gone when the
    extension is: Blender 4.5 hangs at its exit when one is left.
    """

    worker: Worker | None = None
    timer: Any = None

    def open(self, context: Context, worker: Worker) -> None:
        """Start to look after a worker."""
        manager = context.window_manager
        self.worker = worker
        self.timer = manager.event_timer_add(_STEP, window=context.window)
        manager.progress_begin(0, 1)

    def close(self, context: Context) -> None:
        """End the run, if there is one."""
        if self.worker is None:
            return
        self.worker.stop()
        manager = context.window_manager
        manager.event_timer_remove(self.timer)
        manager.progress_end()
        self.worker = self.timer = None
        _show(context, None)


_beside = Beside()


def share_done() -> float | None:
    """Return how much of the run beside the window is done; None without one."""
    return None if _beside.worker is None else _beside.worker.share


class OnSelection(Operator):
    """Works on every selected mesh and point cloud; bad ones do not stop the others."""

    # Whether the window is to stay alive meanwhile.
    takes_time = True

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Ask for something to work on, and for one run at a time."""
        if cls.takes_time and _beside.worker is not None:
            cls.poll_message_set("Another run is going on; Esc stops it")
            return False
        if bridge.has_targets(context):
            return True
        cls.poll_message_set("Select a mesh or point cloud")
        return False

    def execute(self, context: Context) -> Returned:
        """Read all, compute all, write all, report."""
        jobs = jobs_of(context)
        with bridge.object_mode(context):
            self.read_all(jobs)
            for job, progress in bridge.with_progress(context, jobs):
                job.attempt(self.compute, progress)
            return self.write_all(context, jobs)

    def invoke(self, context: Context, _event: Event) -> Returned:
        """Compute beside the window, where there is one."""
        if bpy.app.background or not self.takes_time:
            return self.execute(context)
        jobs = jobs_of(context)
        with bridge.object_mode(context):
            self.read_all(jobs)
        if all(job.error for job in jobs):
            return self.finish(jobs)
        worker = Worker(jobs, type(self).compute)
        if worker.finished(_SHORT):
            return self._write_beside(context, worker)
        _beside.open(context, worker)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Context, event: Event) -> Returned:
        """Look after the thread; all events but Esc go on to the window."""
        worker = _beside.worker
        if worker is None:
            return {"CANCELLED"}
        if event.type == "ESC" and event.value == "PRESS":
            worker.stop()
        if worker.stopped:
            self.cancel(context)
            self.report({"WARNING"}, f"{self.bl_label} stopped; nothing was changed")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            finished = worker.finished()
        except BaseException:
            self.cancel(context)
            raise
        if not finished:
            done = f"{worker.share:.0%}, {worker.seconds} s"
            _show(context, f"{self.bl_label}: {done}    Esc to stop")
            context.window_manager.progress_update(worker.share)
            return {"PASS_THROUGH"}
        self.cancel(context)
        return self._write_beside(context, worker)

    def cancel(self, context: Context) -> None:
        """Leave the window as it was; Blender calls this when a file is loaded."""
        _beside.close(context)

    def _write_beside(self, context: Context, worker: Worker) -> Returned:
        """Write to what is still there as it was read."""
        with bridge.object_mode(context):
            for job in worker.jobs:
                failed = bool(job.error)
                job.attempt(check_same)
                job.stale = bool(job.error) and not failed
            return self.write_all(context, worker.jobs)

    def read_all(self, jobs: Sequence[Job]) -> None:
        """Read every job."""
        for job in jobs:
            job.attempt(self.read)

    def write_all(self, _context: Context, jobs: Sequence[Job]) -> Returned:
        """Write every job and say how it went."""
        for job in jobs:
            job.attempt(self.write)
        return self.finish(jobs)

    def finish(self, jobs: Sequence[Job]) -> Returned:
        """Say how each job went; it is an error when none was done."""
        done = any(job.done for job in jobs)
        for job in jobs:
            if job.error:
                # Who edits meanwhile is told, and not held up by a window.
                mild = done or job.stale
                job.notes.append(("WARNING" if mild else "ERROR", job.error))
            for level, sentence in job.notes:
                self.report({level}, f"{job.name}: {sentence}")
        return {"FINISHED"} if done else {"CANCELLED"}

    def read(self, job: Job) -> None:
        """Take from Blender what the job needs; refuse what cannot be written."""
        bridge.check_writable(job.obj)

    @staticmethod
    def compute(_job: Job, _progress: Progress) -> None:
        """Do the numbers, without Blender."""

    def write(self, job: Job) -> None:
        """Give the results to Blender and note what to say."""
        raise NotImplementedError


def _show(context: Context, text: str | None) -> None:
    """Put text into the status bar, and the share done into the sidebars."""
    if context.workspace is not None:
        context.workspace.status_text_set(text)
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                for region in area.regions:
                    if region.type == "UI":
                        region.tag_redraw()


class TIMESCALE_OT_stop(Operator):
    """The button beside the progress bar."""

    bl_idname = "timescale.stop"
    bl_label = "Stop"
    bl_description = "End the run; objects stay as they were before it"
    bl_options = {"INTERNAL"}  # noqa: RUF012 - Blender wants a plain set

    @classmethod
    def poll(cls, _context: Context) -> bool:
        """Ask for a run."""
        return _beside.worker is not None

    def execute(self, _context: Context) -> Returned:
        """Ask it to end."""
        _beside.worker.stop()
        return {"FINISHED"}


register_classes, unregister_classes = bpy.utils.register_classes_factory(
    (TIMESCALE_OT_stop,)
)


def register() -> None:
    """Add the button that stops a run."""
    register_classes()


def unregister() -> None:
    """End the run and remove the button."""
    _beside.close(bpy.context)
    unregister_classes()
