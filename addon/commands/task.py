# SPDX-License-Identifier: GPL-3.0-or-later
"""What is to be done with one file: plain values, which other processes take too."""

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class Task:
    """What is to be done with a file.

    Attributes
    ----------
    command : "estimate" | "compare" | "repair"
    source : str
    target : str or None
        The file to be written.
    settings : dict
        Those that were given, see `options`.
    overwrite : bool
    skip_existing : bool
        Whether a file that has come to be there is right as it is.
    image : str or None
        A picture to be written.
    truth : str or None
        The file with the normals that count as right, of `compare`.
    normals : "estimate" | "file"
        Which normals `compare` is about.
    fail_above : float or None
        Degrees.
    signed : bool
        Whether a normal on the wrong side is off by more than 90 degrees.
    memory : int or None
        Bytes that may be used: the file is done in tiles.
    scheduler : str or None
        The address of a Dask scheduler whose workers do the tiles.
    """

    command: str
    source: str
    target: str | None = None
    settings: dict[str, Any] = field(default_factory=dict)
    overwrite: bool = False
    skip_existing: bool = False
    image: str | None = None
    truth: str | None = None
    normals: str = "estimate"
    fail_above: float | None = None
    signed: bool = False
    memory: int | None = None
    scheduler: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the task as plain values."""
        return asdict(self)
