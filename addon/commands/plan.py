# SPDX-License-Identifier: GPL-3.0-or-later
"""Which files a command is to work on, and what each of them becomes."""

import glob
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from .. import files


class UsageError(Exception):
    """A command line that makes no sense; the text is one sentence."""


@dataclass(frozen=True)
class Pair:
    """A file and what it becomes; `target` is None where nothing is written."""

    source: Path
    target: Path | None = None


def found_files(inputs: Sequence[str]) -> list[Path]:
    """Return the files that arguments stand for, in a fixed order, each once.

    A folder stands for all files in it of known formats, a pattern for what it
    matches; where there are none it stays, for the one who tries to read it to say so.

    Raises
    ------
    UsageError
        When a name is empty.
    """
    paths: dict[str, Path] = {}
    for text in inputs:
        for path in _expanded(text):
            paths.setdefault(same_file(path), path)
    return list(paths.values())


def same_file(path: str | Path) -> str:
    """Return what all spellings of a path have in common; links are others."""
    # Path.resolve would follow links, which are files of their own here.
    return os.path.normcase(os.path.abspath(path))  # noqa: PTH100


def _expanded(text: str) -> Iterable[Path]:
    if not text:
        raise UsageError("expected a file, a folder or a pattern, got an empty name")
    path = Path(text)
    if path.is_dir():
        return _known(path.iterdir()) or [path]
    if not path.exists() and glob.has_magic(text):
        # Path.glob knows no absolute patterns.
        return _known(map(Path, glob.iglob(text, recursive=True))) or [path]  # noqa: PTH207
    return [path]


def _known(paths: Iterable[Path]) -> list[Path]:
    return sorted(
        path
        for path in paths
        if path.suffix.lower() in files.FORMATS
        and not path.name.startswith(".")
        and path.is_file()
    )


def pairs(
    inputs: Sequence[str],
    output: str | None,
    *,
    suffix: str | None = None,
    needs_normals: bool = True,
) -> list[Pair]:
    """Return what is read and what is written.

    Parameters
    ----------
    inputs : sequence of str
        Files, folders, patterns.
    output : str or None
        A file for one input; a folder for several, for a folder or a pattern, or
        where it is one or ends with a slash.
    suffix : str, optional
        Format of the files in a folder; by default each keeps its own, or becomes
        .ply where its own holds no normals.
    needs_normals : bool
        Whether a format without normals will not do.

    Raises
    ------
    UsageError
        When two inputs would become one file, or a file would become itself.
    """
    sources = found_files(inputs)
    if output is None:
        return [Pair(source) for source in sources]
    if not output:
        raise UsageError("expected a file or a folder as output, got an empty name")
    one = len(inputs) == 1 and sources == [Path(inputs[0])]
    if one and not is_folder(output):
        return [Pair(sources[0], Path(output))]
    made = [
        Pair(source, Path(output) / _name(source, suffix, needs_normals))
        for source in sources
    ]
    return list(_apart(made))


def is_folder(output: str) -> bool:
    """Whether an argument stands for a folder, which may not be there yet."""
    return output.endswith(("/", "\\")) or Path(output).is_dir()


def _name(source: Path, suffix: str | None, needs_normals: bool) -> str:
    stem, own = source.stem, source.suffix
    # An octree cannot be written: what was COPC becomes plain LAZ.
    if own.lower() == ".laz" and stem.lower().endswith(".copc"):
        stem = stem[: -len(".copc")]
    known = files.FORMATS.get(own.lower())
    if suffix is None and known and needs_normals and not known.holds_normals:
        suffix = ".ply"
    return stem + (suffix or own)


def _apart(made: list[Pair]) -> Iterator[Pair]:
    taken: dict[str, Path] = {}
    for pair in made:
        assert pair.target is not None
        other = taken.setdefault(same_file(pair.target), pair.source)
        if other != pair.source:
            raise UsageError(
                f"{other} and {pair.source} would both become "
                f"{pair.target}: give them one by one, with an output for each"
            )
        yield pair
