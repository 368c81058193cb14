# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line.

`blender -b --command timescale_normals ...` where the extension is installed, and
`python -m addon.cli ...` in a checkout, which needs no Blender for numbers.
"""

import argparse
import contextlib
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

NAME = "timescale_normals"
DONE, FAILED, WRONG_USAGE = 0, 1, 2

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
        0 done, 1 something could not be processed, 2 wrong usage.
    """
    try:
        arguments = _parser().parse_args(argv)
    except SystemExit as stop:
        return int(stop.code or DONE)
    expected = (_part("addon.output").OutputError, _part("core").InputError)
    try:
        return arguments.run(arguments)
    except expected as error:
        print(f"{NAME}: {error}", file=sys.stderr)
        return FAILED


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
        epilog="Exit codes: 0 done, 1 something could not be processed, 2 wrong usage.",
    )
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for add in (_add_reproduce,):
        add(commands)
    return parser


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
    reproduction = _part("addon.reproduction")
    figures = _part("addon.figures") if find_spec("bpy") else None
    show = _progress_line(quiet=arguments.quiet)
    with _part("addon.output").staged(
        arguments.folder, reproduction.FILES, overwrite=arguments.overwrite
    ) as stage:
        results = reproduction.run(range(arguments.seeds), progress=show)
        reproduction.write(results, stage)
        if figures is not None:
            with _silent_blender():
                figures.draw(stage, results["convergence"], progress=show)
    show(1.0, "")
    if not arguments.quiet:
        made = "all numbers, tables and figures."
        if figures is None:
            made = "all numbers and tables. Figures need Blender, or a Python with bpy."
        _say(f"{reproduction.wins_table(results)}\n\nMade {arguments.folder}: {made}")
    return DONE


def _say(text: str) -> None:
    """Print what may have letters that the terminal's encoding does not."""
    encoding = sys.stdout.encoding or "utf-8"
    print(text.encode(encoding, "replace").decode(encoding))


def _at_least_one(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number from 1, got {text}")
    return int(text)


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
        print(f"\r{line:60}\r", end="", file=sys.stderr, flush=True)

    def hide(_share: float, _what: str) -> None:
        pass

    return hide if quiet or not sys.stderr.isatty() else show


@contextlib.contextmanager
def _silent_blender() -> Iterator[None]:
    """Hide what Blender itself prints, such as a line for each picture it saves."""
    sys.stdout.flush()
    kept = os.dup(1)
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
    finally:
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)


if __name__ == "__main__":
    sys.exit(main())
