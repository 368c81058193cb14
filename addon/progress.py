# SPDX-License-Identifier: GPL-3.0-or-later
"""What a command says while it works: a bar on a terminal, plain lines in a log."""

import sys
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
        print(f"\r{line:78.78}\r", end="", file=self.stream, flush=True)

    def line(self, text: str) -> None:
        """Say how a file went."""
        if not self.quiet:
            self._clear()
            say(text)

    def error(self, text: str) -> None:
        """Say what went wrong, however quiet."""
        self._clear()
        say(text, self.stream)

    def step(self) -> None:
        """Count a file as done."""
        self.done += 1
        self.show(0.0)

    def close(self) -> None:
        """Take the bar away."""
        self._clear()

    def _clear(self) -> None:
        if self._bar:
            print(f"\r{'':78}\r", end="", file=self.stream, flush=True)


def say(text: str, stream: TextIO | None = None) -> None:
    """Print what may have letters that the stream's encoding does not."""
    stream = stream or sys.stdout
    encoding = stream.encoding or "utf-8"
    print(text.encode(encoding, "replace").decode(encoding), file=stream, flush=True)
