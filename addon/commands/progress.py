# SPDX-License-Identifier: GPL-3.0-or-later
"""What a command says while it works: a bar on a terminal, plain lines in a log."""

import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TextIO

_WIDTH = 24


class Progress:
    """Tells on standard error how far a run is, and each result in a line.

    Parameters
    ----------
    total : int
        The number of files.
    quiet : bool
        Say nothing but errors.
    """

    def __init__(
        self, total: int, *, quiet: bool = False, stream: TextIO | None = None
    ) -> None:
        self.total, self.quiet = total, quiet
        self.stream = stream or sys.stderr
        self.done = 0
        self._bar = not quiet and self.stream.isatty()

    def show(self, share: float, name: str = "") -> None:
        """Draw the bar: so many files, and a share of the next."""
        if not self._bar:
            return
        whole = (self.done + min(share, 1.0)) / max(self.total, 1)
        filled = "#" * int(_WIDTH * whole)
        count = f"{self.done}/{self.total} " if self.total > 1 else ""
        line = f"[{filled:{_WIDTH}}] {whole:4.0%} {count}{name}"
        put(f"\r{line:78.78}\r", self.stream)

    def line(self, text: str) -> None:
        """Say how a file went."""
        if not self.quiet:
            self._clear()
            say(_on_one_line(text))

    def error(self, text: str) -> None:
        """Say what went wrong, however quiet."""
        self._clear()
        say(_on_one_line(text), self.stream)

    def step(self) -> None:
        """Count a file as done."""
        self.done += 1
        self.show(0.0)

    def close(self) -> None:
        """Take the bar away."""
        self._clear()

    def _clear(self) -> None:
        if self._bar:
            put(f"\r{'':78}\r", self.stream)


def share_line(*, quiet: bool) -> Callable[[float, str], None]:
    """Return a function that shows the share done and what is next on a terminal."""

    def show(share: float, what: str) -> None:
        line = f"{share:4.0%}  {what}" if share < 1 else ""
        # Blender's own standard error may be something else than a terminal.
        put(f"\r{line:60}\r", sys.stderr)

    def hide(_share: float, _what: str) -> None:
        pass

    return hide if quiet or not sys.stderr.isatty() else show


def _on_one_line(text: str) -> str:
    """Return text without what breaks lines, as names of files may."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def say(text: str, stream: TextIO | None = None) -> None:
    """Print a line, whatever the stream."""
    put(text + "\n", stream or sys.stdout)


def put(text: str, stream: TextIO) -> None:
    """Write to a stream that may lack letters, have nobody who reads it, or be full.

    Work does not end because nobody listens.
    """
    encoding = stream.encoding or "utf-8"
    try:
        stream.write(text.encode(encoding, "replace").decode(encoding))
        stream.flush()
    except OSError:
        # What is left in the buffer must not come up again at the end.
        with suppress(OSError, ValueError), Path(os.devnull).open("w") as nowhere:
            os.dup2(nowhere.fileno(), stream.fileno())
