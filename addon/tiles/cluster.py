# SPDX-License-Identifier: GPL-3.0-or-later
"""Where tiles are computed: here, or by the workers of a Dask cluster.

The unit of work is a pure function of a tile. A tile whose worker dies is given to
another one.
"""

import tempfile
import zipfile
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ...core import tiles
from ..files.libraries import needed
from ..files.shape import FileError

Fit = Callable[[Iterator[tuple[Any, ...]]], Iterator[Any]]

# Tiles on their way for each worker: one that is computed, one that is there next.
_AHEAD = 2
# How often a tile may lose its worker.
_RETRIES = 5


@contextmanager
def tile_runner(scheduler: str | None) -> Iterator[Fit]:
    """Yield what calls functions of tiles, and gives their results in order.

    Parameters
    ----------
    scheduler : str or None
        The address of a Dask scheduler; None for this process.
    """
    if scheduler is None:
        yield _here
        return
    distributed = needed("distributed", "--scheduler")
    try:
        client = distributed.Client(scheduler, timeout=20, set_as_default=False)
    except (OSError, ValueError) as error:
        raise FileError(f"no scheduler answers at {scheduler}: {error}") from None
    config = needed("dask", "--scheduler").config
    few = {"distributed.admin.large-graph-warning-threshold": "1TB"}
    with client, tempfile.TemporaryDirectory() as folder, config.set(few):
        _send_code(client, Path(folder))
        yield lambda tasks: _there(client, tasks)


def _here(tasks: Iterator[tuple[Any, ...]]) -> Iterator[Any]:
    for function, *arguments in tasks:
        yield function(*arguments)


def _there(client: Any, tasks: Iterator[tuple[Any, ...]]) -> Iterator[Any]:
    """Keep the workers busy, and no more tiles on their way than that takes."""
    waiting: deque[Any] = deque()
    most = _AHEAD * max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
    for task in tasks:
        waiting.append(_submitted(client, task))
        if len(waiting) >= most:
            yield _result(waiting.popleft())
    while waiting:
        yield _result(waiting.popleft())


def _submitted(client, task):
    # With the task, which the scheduler keeps: what is scattered is lost with the
    # worker that has it.
    return client.submit(*task, pure=False, retries=_RETRIES)


def _result(future):
    return future.result()


def _send_code(client: Any, folder: Path) -> None:
    """Give the workers the package that tiles are computed with."""
    package = tiles.__name__.removesuffix(".core.tiles")
    root = Path(tiles.__file__).parent
    path = folder / "timescale_tiles.zip"
    with zipfile.ZipFile(path, "w") as archive:
        parts = package.split(".")
        for depth in range(1, len(parts) + 1):
            archive.writestr("/".join(parts[:depth]) + "/__init__.py", "")
        for source in sorted((*root.rglob("*.py"), *root.rglob("*.npz"))):
            name = source.relative_to(root).as_posix()
            archive.write(source, f"{'/'.join(parts)}/core/{name}")
    client.upload_file(str(path))
