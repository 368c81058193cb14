# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `reproduce`: results, tables and figures into a folder."""

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from ..commands.output import silence, staged
from ..commands.progress import say, share_line
from . import results, tables


def reproduce(folder: Path, seeds: int, *, overwrite: bool, quiet: bool) -> None:
    """Repeat the experiment and write all files of it, or none.

    Parameters
    ----------
    folder : Path
    seeds : int
        Samples of each surface.
    overwrite : bool
        Whether files of these names may be replaced.
    quiet : bool
        Print nothing.

    Raises
    ------
    OutputError
        When files are there already, or the folder cannot be written to.
    """
    with_figures = find_spec("bpy") is not None
    show = share_line(quiet=quiet)
    with staged(folder, results.FILES, overwrite=overwrite) as stage:
        found = results.run(range(seeds), progress=show)
        tables.write(found, stage)
        if with_figures:
            figures = import_module(".figures", __package__)
            with silence():
                figures.draw(stage, found["convergence"], progress=show)
    show(1.0, "")
    if not quiet:
        made = "all numbers and tables. Figures need Blender, or a Python with bpy."
        if with_figures:
            made = "all numbers, tables and figures."
        say(f"{tables.wins_table(found)}\n\nMade {folder}: {made}")
