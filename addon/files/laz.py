# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks of compressed LAS files before a decoder believes what they say.

Decoders set memory aside by sizes in the file, and end the whole process where there
is not as much. So these sizes are held against the size of the file first.
"""

import struct
from typing import Any, BinaryIO

import numpy as np

from .shape import FileError, checked_count

# Type of an item -> its bytes (0: any number), and the layers that it is stored in
# (0: as many as bytes), for layered compression.
_ITEMS = {0: 0, 6: 20, 7: 8, 8: 6, 9: 29, 10: 30, 11: 6, 12: 8, 13: 29, 14: 0}
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1, 14: 0}
_POINTWISE, _LAYERED = 2, 3
_DAMAGED = "expected compressed points, got damaged ones"


def check(file: BinaryIO, size: int, record: bytes, data: int, each: int) -> None:
    """Check what describes compressed points; raises FileError.

    Parameters
    ----------
    file : open file
    size : int
        Bytes of the file.
    record : bytes
        The record that describes the compression.
    data : int
        Where the points begin.
    each : int
        Bytes of a point.
    """
    items = _items(record, each)
    compressor = int.from_bytes(record[:2], "little")
    layered = {kind in _LAYERS for kind, _ in items}
    if layered != {compressor == _LAYERED} or compressor not in (_POINTWISE, _LAYERED):
        raise FileError(_DAMAGED)
    table = _table(file, size, data)
    version, chunks = struct.unpack("<II", _read_at(file, table, 8))
    checked_count(chunks, each, size, "chunks of points")
    if version:
        raise FileError(_DAMAGED)
    if compressor == _LAYERED:
        _walk(file, data + 8, table, items, each)


def _items(record, each):
    """Return the (type, bytes) of the items that make up a point."""
    words: Any = np.frombuffer(record[32:], "<u2") if len(record) % 2 == 0 else []
    if len(words) < 4 or len(words) != 1 + 3 * words[0]:
        raise FileError(_DAMAGED)
    kinds, sizes = (words[1:][at::3].tolist() for at in (0, 1))
    known = all(
        kind in _ITEMS and _ITEMS[kind] in (0, size)
        for kind, size in zip(kinds, sizes, strict=True)
    )
    if not known or sum(sizes) != each or len(set(kinds)) < len(kinds):
        raise FileError(_DAMAGED)
    return list(zip(kinds, sizes, strict=True))


def _table(file, size, data):
    """Return where the table of chunks begins."""
    (table,) = struct.unpack("<q", _read_at(file, data, 8))
    if table == -1:
        # A writer that could not go back left it at the end.
        (table,) = struct.unpack("<q", _read_at(file, size - 8, 8))
    if not data + 8 <= table <= size - 8:
        raise FileError(_DAMAGED)
    return table


def _walk(file, at, end, items, each):
    """Go from chunk to chunk by the sizes of their layers."""
    layers = sum(_LAYERS[kind] or size for kind, size in items)
    while at < end:
        # The first point as it is, the number of points, the sizes of the layers.
        head = _read_at(file, at, each + 4 + 4 * layers)
        at += len(head) + int(np.frombuffer(head[each + 4 :], "<u4").sum(dtype="i8"))
    if at != end:
        raise FileError(_DAMAGED)


def _read_at(file, at, count):
    file.seek(max(0, at))
    found = file.read(count)
    if len(found) < count:
        raise FileError(_DAMAGED)
    return found
