# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line.

`blender -b --command timescale_normals ...` where the extension is installed, and
`python -m addon.cli ...` in a checkout, which needs no Blender for numbers.
"""

import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
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
        arguments = _part("addon.commands.arguments").parser(NAME).parse_args(argv)
    except SystemExit as stop:
        return int(stop.code or DONE)
    wrong: tuple[Any, ...] = (_part("addon.commands.plan").UsageError,)
    if arguments.command != "reproduce":
        wrong += (_part("core").InputError,)
    try:
        return _do(arguments)
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


def _do(arguments: Any) -> int:
    if arguments.command == "reproduce":
        _part("addon.paper.reproduce").reproduce(
            arguments.folder,
            arguments.seeds,
            overwrite=arguments.overwrite,
            quiet=arguments.quiet,
        )
        return DONE
    return _part("addon.commands.run").run(arguments, NAME)


def _work() -> int:
    """Be a worker of another run: see `commands.workers`."""
    _part("addon.commands.workers").serve(sys.stdin.buffer, sys.stdout.buffer)
    return DONE


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


if __name__ == "__main__":
    sys.exit(main())
