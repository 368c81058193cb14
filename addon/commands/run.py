# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands that work on files: plan, run, report."""

import argparse
import json
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from . import plan
from .options import given_settings
from .output import OutputError, whole
from .progress import Progress, say
from .sentences import say_row
from .task import Task
from .versions import versions
from .work import attempt
from .workers import Row, run_in_processes

# Changes when a reader of the report has to change.
SCHEMA = "timescale_normals.report/1"

DONE, FAILED, EXCEEDED = 0, 1, 3


def run(arguments: argparse.Namespace, name: str) -> int:
    """Run `estimate`, `compare` or `repair` on all files.

    Raises
    ------
    plan.UsageError, OutputError
        Before anything is computed.
    """
    settings = given_settings(arguments)
    if arguments.jobs > 1:
        # Results do not depend on it, and the processes share the cores.
        share = max(1, (os.cpu_count() or 1) // arguments.jobs)
        settings.setdefault("threads", share)
    planned = plan.pairs(
        arguments.inputs,
        arguments.output,
        suffix=_suffix(arguments),
        needs_normals=arguments.command != "repair",
    )
    tasks = _tasks(arguments, planned, settings)
    _check_apart(tasks, arguments.report)
    if arguments.dry_run:
        return _say_plan(tasks)
    if arguments.report is not None:
        _check_report(arguments)
    progress = Progress(len(tasks), quiet=arguments.quiet)
    rows = []
    for row in _rows(tasks, arguments, progress, name):
        rows.append(row)
        say_row(row, progress, arguments.command)
        progress.step()
    progress.close()
    if arguments.report is not None:
        _write_report(arguments, rows)
    return _exit_code(rows)


def _suffix(arguments: argparse.Namespace) -> str | None:
    return f".{arguments.format.lstrip('.')}" if arguments.format else None


def _tasks(
    arguments: argparse.Namespace, planned: list[plan.Pair], settings: dict[str, Any]
) -> list[Task]:
    common = Task(
        arguments.command,
        "",
        settings=settings,
        overwrite=arguments.overwrite,
        skip_existing=arguments.skip_existing,
        **_only_of(arguments),
    )
    several = len(planned) > 1 or plan.is_folder(arguments.image or "")
    return [
        replace(
            common,
            source=str(pair.source),
            target=None if pair.target is None else str(pair.target),
            image=_image(arguments.image, pair.source, several),
        )
        for pair in planned
    ]


def _only_of(arguments: argparse.Namespace) -> dict[str, Any]:
    if arguments.command == "estimate":
        return {"memory": arguments.memory, "scheduler": arguments.scheduler}
    if arguments.command != "compare":
        return {}
    return {
        "truth": arguments.truth,
        "normals": arguments.normals,
        "fail_above": arguments.fail_above,
        "signed": arguments.signed,
    }


def _image(image: str | None, source: Path, several: bool) -> str | None:
    if image is None or not several:
        return image
    return str(Path(image) / (source.name + ".png"))


def _say_plan(tasks: list[Task]) -> int:
    missing = 0
    for task in tasks:
        known = Path(task.source).is_file()
        missing += not known
        what = "" if known else " (is not there)"
        arrow = f" -> {task.target}" if task.target else ""
        there = task.target is not None and Path(task.target).exists()
        say(f"{task.source}{what}{arrow}{' (is there already)' if there else ''}")
    return FAILED if missing else DONE


def _rows(
    tasks: list[Task], arguments: argparse.Namespace, progress: Progress, name: str
) -> Iterator[Row]:
    """Yield a row for each task, in order; files that are done are skipped."""
    skipped = [
        task.target is not None
        and arguments.skip_existing
        and Path(task.target).exists()
        for task in tasks
    ]
    todo = [task for task, skip in zip(tasks, skipped, strict=True) if not skip]
    if arguments.jobs > 1 and len(todo) > 1:
        results = run_in_processes(todo, arguments.jobs, name)
    else:
        results = _one_by_one(todo, progress)
    for task, skip in zip(tasks, skipped, strict=True):
        if skip:
            progress.step()
            yield {"input": task.source, "output": task.target, "status": "skipped"}
        else:
            yield next(results)


def _one_by_one(tasks: list[Task], progress: Progress) -> Iterator[Row]:
    for task in tasks:
        source = task.source

        def show(share: float, source: str = source) -> None:
            progress.show(share, source)

        yield attempt(task, show)


def _check_apart(tasks: list[Task], report: str | None) -> None:
    """Raise UsageError where a picture or the report would replace another file."""
    taken = [path for task in tasks for path in (task.source, task.target) if path]
    known = {plan.same_file(path) for path in taken}
    pictures = [task.image for task in tasks if task.image is not None]
    for path in pictures:
        if Path(path).suffix.lower() != ".png":
            raise plan.UsageError(f"expected a name that ends with .png, got {path}")
    for path in [*pictures, report] if report is not None else pictures:
        if plan.same_file(path) in known:
            raise plan.UsageError(
                f"expected another name for a picture or a report than {path}, "
                "which is read or written too"
            )
        known.add(plan.same_file(path))


def _check_report(arguments: argparse.Namespace) -> None:
    path = Path(arguments.report)
    # A report follows its run: one of a run that is taken up again replaces the last.
    if path.exists() and not (arguments.overwrite or arguments.skip_existing):
        raise OutputError(
            f"{path} is there already: give --overwrite to replace it, or another name"
        )
    # Where it cannot be written it is better to know before hours of work.
    with whole(path, overwrite=True):
        pass


def _write_report(arguments: argparse.Namespace, rows: list[Row]) -> None:
    counts = {
        status: sum(row["status"] == status for row in rows)
        for status in ("done", "skipped", "failed")
    }
    report = {
        "schema": SCHEMA,
        "versions": versions(),
        "command": arguments.command,
        "settings": given_settings(arguments),
        "counts": counts,
        "exit_code": _exit_code(rows),
        "files": rows,
    }
    with whole(Path(arguments.report), overwrite=True) as path:
        path.write_text(json.dumps(report, indent=2, default=float) + "\n", "utf-8")


def _exit_code(rows: list[Row]) -> int:
    if any(row["status"] == "failed" for row in rows):
        return FAILED
    if any(row.get("check", {}).get("failed") for row in rows):
        return EXCEEDED
    return DONE
