# SPDX-License-Identifier: GPL-3.0-or-later
"""What goes out: files whole or not at all, and nothing of Blender's own words."""

import ctypes
import os
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path


class OutputError(Exception):
    """A file that cannot be written; the text is one sentence with the remedy."""


@contextmanager
def staged(folder: Path, names: Iterable[str], *, overwrite: bool) -> Iterator[Path]:
    """Yield an empty folder whose files go to `folder` when all went well.

    Parameters
    ----------
    folder : Path
        Made where it is not there yet.
    names : iterable of str
        Files that may be written; others in `folder` are left alone.
    overwrite : bool
        Whether files of these names may be replaced.

    Raises
    ------
    OutputError
        Before anything is computed, when one of the files is there or the folder
        cannot be written to.
    """
    taken = [name for name in names if (folder / name).exists()]
    if taken and not overwrite:
        raise OutputError(
            f"{folder / taken[0]} is there already: give --overwrite to replace it, "
            "or another folder"
        )
    with _beside(folder) as stage:
        yield stage
        for path in sorted(stage.iterdir()):
            with _explained(folder):
                path.replace(folder / path.name)


@contextmanager
def whole(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yield a path to write to; what is there becomes `path` when all went well.

    A link stays one: the file that it stands for is replaced.

    Raises
    ------
    OutputError
        When the file is there already and may not be replaced, or its folder cannot
        be written to.
    """
    path = path.resolve() if overwrite and path.is_symlink() else path
    with staged(path.parent, [path.name], overwrite=overwrite) as stage:
        yield stage / path.name


@contextmanager
def _beside(folder: Path) -> Iterator[Path]:
    """A folder to be filled, inside the one that its files are meant for."""
    with _explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
        # In the same file system, so that the last step is a change of names.
        stage = tempfile.TemporaryDirectory(dir=folder, prefix=".unfinished-")
    with stage as path:
        yield Path(path)


@contextmanager
def _explained(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"cannot write to the folder {folder}: {error.strerror}"
        ) from error


@contextmanager
def silence() -> Iterator[None]:
    """Hide what Blender itself prints, such as a line for each picture it saves."""
    sys.stdout.flush()
    kept = os.dup(1)
    with Path(os.devnull).open("w") as nowhere, redirect_stdout(nowhere):
        os.dup2(nowhere.fileno(), 1)
        try:
            yield
        finally:
            if os.name == "posix":
                # What Blender printed may wait in the buffer of its C library.
                ctypes.CDLL(None).fflush(None)
            os.dup2(kept, 1)
            os.close(kept)
