# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line.

`blender -b --command timescale_normals ...` where the extension is installed, and
`python -m addon.cli ...` in a checkout, which needs no Blender for numbers.
"""

import argparse
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from textwrap import fill
from types import ModuleType
from typing import Any

NAME = "timescale_normals"
DONE, FAILED, WRONG_USAGE, EXCEEDED = 0, 1, 2, 3

_LEAST_MEMORY = 500 << 20

# Of the help's own lines; argparse wraps the rest to the terminal.
_WIDTH = 78

_registered: list[Any] = []


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Parameters
    ----------
    argv : sequence of str, optional
        What follows the name of the command; without it, of the process.

    Returns
    -------
    int
        0 done, 1 something could not be processed, 2 wrong usage, 3 normals deviate
        by more than `compare --fail-above` allows.
    """
    _open_streams()
    with _orderly_end():
        # Not a command of its own: other runs start it.
        if (sys.argv[1:] if argv is None else list(argv)) == ["worker"]:
            return _work()
        return _run(argv)


def _run(argv: Sequence[str] | None) -> int:
    try:
        arguments = _parser().parse_args(argv)
    except SystemExit as stop:
        return int(stop.code or DONE)
    wrong: tuple[Any, ...] = (_part("addon.commands.plan").UsageError,)
    if arguments.run is _run_on_files:
        wrong += (_part("core").InputError,)
    try:
        return arguments.run(arguments)
    except wrong as error:
        _complain(error)
        return WRONG_USAGE
    except (
        _part("addon.commands.output").OutputError,
        _part("core").InputError,
    ) as error:
        _complain(error)
        return FAILED
    except KeyboardInterrupt:
        _complain("stopped")
        return FAILED


def _complain(what: object) -> None:
    _part("addon.commands.progress").say(f"{NAME}: {what}", sys.stderr)


def _open_streams() -> None:
    """Give the process the streams that it was started without, to nowhere.

    Else the first files that are opened would stand in for them.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            # Open as long as the process is.
            setattr(sys, name, Path(os.devnull).open(mode))  # noqa: SIM115


@contextmanager
def _orderly_end() -> Iterator[None]:
    """Let a request to end clean up behind itself, as Ctrl-C does.

    From the first moment on: where the system ends a process there is no cleaning up.
    """

    def stop(number: int, _frame: Any) -> None:
        # A second request must not end the cleaning up.
        signal.signal(number, signal.SIG_IGN)
        sys.exit(FAILED)

    try:
        before = signal.signal(signal.SIGTERM, stop)
    except ValueError:
        # Signals are the main thread's.
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def register() -> None:
    """Let Blender know the command."""
    import bpy

    _registered.append(bpy.utils.register_cli_command(NAME, main))


def unregister() -> None:
    """Take the command out again; Blender 4.5 hangs at exit where it stays."""
    import bpy

    bpy.utils.unregister_cli_command(_registered.pop())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=NAME,
        description="Normals of meshes and point clouds by calculus on time scales.",
        epilog="Exit codes: 0 done, 1 something could not be processed, 2 wrong usage, "
        "3 normals deviate by more than compare --fail-above allows.",
    )
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for add in (_add_estimate, _add_compare, _add_repair, _add_reproduce):
        add(commands)
    return parser


def _add_estimate(commands: Any) -> None:
    parser = _add_on_files(
        commands,
        "estimate",
        "estimate normals and write the files with them",
        "Estimate the normals of point clouds and meshes. Files keep their points, "
        "colors and everything else, and get normals.",
        example="estimate scans/*.ply -o normals/ --report report.json",
    )
    large = parser.add_argument_group("clouds larger than memory (PLY, NPY, LAS, LAZ)")
    large.add_argument(
        "--memory",
        metavar="SIZE",
        type=_size,
        help="work in tiles and use about so much memory, such as 800M or 4G",
    )
    large.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="let the workers of a Dask scheduler do the tiles, such as "
        "tcp://10.0.0.1:8786",
    )
    _part("addon.commands.options").add_settings(parser)


def _add_repair(commands: Any) -> None:
    parser = _add_on_files(
        commands,
        "repair",
        "wind the faces of meshes alike and outward, and estimate their normals",
        "Turn over the faces of meshes that wind against the others or look inward, "
        "and estimate the normals of the vertices.",
        example="repair model.obj -o repaired.obj",
    )
    _part("addon.commands.options").add_settings(parser)


def _add_compare(commands: Any) -> None:
    parser = _add_on_files(
        commands,
        "compare",
        "compare normals with Delaunay's and with those that count as right",
        "Compare normals with those of a Delaunay triangulation and, where --truth "
        "has them, with true ones. Nothing but a report and a picture is written.",
        example="compare scan.ply --truth reference.ply --fail-above 5",
        writes=False,
    )
    parser.add_argument(
        "--truth",
        metavar="FILE",
        help="a file with the normals that count as right: over the same points in "
        "the same order, or else of the nearest point",
    )
    parser.add_argument(
        "--normals",
        choices=("estimate", "file"),
        default="estimate",
        help="which normals are compared: the estimate's, or those in the file "
        "(%(default)s)",
    )
    parser.add_argument(
        "--fail-above",
        metavar="DEG",
        type=_part("addon.commands.options").degrees,
        help="exit with 3 when a normal is more degrees from the truth, or without "
        "--truth from what it is compared with",
    )
    parser.add_argument(
        "--signed",
        action="store_true",
        help="count a normal on the wrong side as more than 90 degrees off",
    )
    parser.set_defaults(output=None, format=None, skip_existing=False)
    _part("addon.commands.options").add_settings(parser)


def _add_on_files(
    commands: Any,
    name: str,
    text: str,
    description: str,
    *,
    example: str,
    writes: bool = True,
) -> Any:
    """Add a command with the options that all commands on files share."""
    known = " ".join(_part("addon.files").FORMATS)
    output = " -o OUTPUT" if writes else ""
    parser = commands.add_parser(
        name,
        help=text,
        description=fill(description, _WIDTH),
        usage=f"{NAME} {name} INPUT...{output} [options]",
        epilog=f"example:\n  {NAME} {example}\n\n{fill(f'Files: {known}', _WIDTH)}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "inputs",
        metavar="INPUT",
        nargs="+",
        help="files, folders, or patterns such as 'scans/*.ply'",
    )
    if writes:
        _add_output(parser)
    parser.add_argument(
        "--report", metavar="FILE.json", help="write what was found, and what failed"
    )
    parser.add_argument(
        "--image",
        metavar="FILE.png",
        help="write a picture; with several files the name of a folder",
    )
    parser.add_argument(
        "--jobs",
        metavar="N",
        type=_at_least_one,
        default=1,
        help="files at a time, each in a process of its own (%(default)s)",
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="replace files that are there already"
    )
    parser.add_argument("--quiet", action="store_true", help="print errors alone")
    parser.add_argument(
        "--dry-run", action="store_true", help="say what would be done, and do nothing"
    )
    parser.set_defaults(run=_run_on_files, command=name)
    return parser


def _add_output(parser: Any) -> None:
    parser.add_argument(
        "-o",
        "--output",
        metavar="OUTPUT",
        required=True,
        help="the file to write; a folder for several files",
    )
    parser.add_argument(
        "--format",
        metavar="EXT",
        help="format of the files in a folder, such as ply; by default each keeps its "
        "own",
    )
    parser.add_argument(
        "--skip-existing",
        action="store_true",
        help="leave out files whose output is there already",
    )


def _run_on_files(arguments: argparse.Namespace) -> int:
    return _part("addon.commands.run").run(arguments, NAME)


def _work() -> int:
    """Be a worker of another run: see `workers`."""
    _part("addon.commands.workers").serve(sys.stdin.buffer, sys.stdout.buffer)
    return DONE


def _add_reproduce(commands: Any) -> None:
    text = "repeat the paper's experiment: tables, numbers and, in Blender, figures"
    parser = commands.add_parser("reproduce", help=text, description=text)
    parser.add_argument(
        "-o",
        dest="folder",
        metavar="DIR",
        type=Path,
        default=Path("out", "reproduce"),
        help="folder for results.json, results.md and the figures (%(default)s)",
    )
    parser.add_argument(
        "--seeds",
        metavar="N",
        type=_at_least_one,
        default=3,
        help="number of samples drawn of each surface (%(default)s)",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace files in DIR")
    parser.add_argument("--quiet", action="store_true", help="print errors alone")
    parser.set_defaults(run=_reproduce)


def _reproduce(arguments: argparse.Namespace) -> int:
    reproduction = _part("addon.paper.reproduction")
    figures = _part("addon.paper.figures") if find_spec("bpy") else None
    show = _progress_line(quiet=arguments.quiet)
    with _part("addon.commands.output").staged(
        arguments.folder, reproduction.FILES, overwrite=arguments.overwrite
    ) as stage:
        results = reproduction.run(range(arguments.seeds), progress=show)
        reproduction.write(results, stage)
        if figures is not None:
            with _part("addon.commands.output").silence():
                figures.draw(stage, results["convergence"], progress=show)
    show(1.0, "")
    if not arguments.quiet:
        made = "all numbers, tables and figures."
        if figures is None:
            made = "all numbers and tables. Figures need Blender, or a Python with bpy."
        table = reproduction.wins_table(results)
        _part("addon.commands.progress").say(
            f"{table}\n\nMade {arguments.folder}: {made}"
        )
    return DONE


def _at_least_one(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number from 1, got {text}")
    return int(text)


def _size(text: str) -> int:
    unit = {"M": 20, "G": 30, "T": 40}.get(text[-1:].upper())
    number = text[:-1] if unit else text
    try:
        size = int(float(number) * (1 << (unit or 0)))
    except ValueError:
        size = 0
    if size < _LEAST_MEMORY:
        raise argparse.ArgumentTypeError(f"expected 500M or more, got {text}")
    return size


def _part(name: str) -> ModuleType:
    """A module of the extension, which is a package of any name when installed."""
    package = (__package__ or "").rpartition(".")[0]
    return import_module(f"{package or _checkout()}.{name}")


def _checkout() -> str:
    """Make the checkout the package that it is when installed; return its name.

    Run as `python -m addon.cli`, `addon` has no parent that it could share with
    `core`, and the folder of a checkout may have any name.
    """
    if NAME not in sys.modules:
        root = Path(__file__).parents[1]
        spec = spec_from_file_location(
            NAME, root / "__init__.py", submodule_search_locations=[str(root)]
        )
        assert spec is not None
        assert spec.loader is not None
        sys.modules[NAME] = module_from_spec(spec)
        spec.loader.exec_module(sys.modules[NAME])
    return NAME


def _progress_line(*, quiet: bool) -> Callable[[float, str], None]:
    """Return a function that shows the share done and what is next on a terminal."""

    def show(share: float, what: str) -> None:
        line = f"{share:4.0%}  {what}" if share < 1 else ""
        # Blender's own standard error may be something else than a terminal.
        _part("addon.commands.progress").put(f"\r{line:60}\r", sys.stderr)

    def hide(_share: float, _what: str) -> None:
        pass

    return hide if quiet or not sys.stderr.isatty() else show


if __name__ == "__main__":
    sys.exit(main())
