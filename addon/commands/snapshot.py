# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of points as PNG files, without Blender."""

import struct
import zlib
from pathlib import Path
from typing import Any

from ...core.raster import picture, shaded

__all__ = ["draw", "shaded"]


def draw(path: Path, points: Any, colors: Any) -> None:
    """Write a picture of points (n, 3) in linear colors (n, 3 or 4)."""
    path.write_bytes(png(picture(points, colors)))


def png(image: Any) -> bytes:
    """Return an (h, w, 3) uint8 image as the bytes of a PNG file."""
    height, width, _ = image.shape
    # Each line begins with the number of its filter: none.
    lines = b"".join(b"\0" + row.tobytes() for row in image)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(lines, 9)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(*part) for part in parts)


def _chunk(kind, data):
    check = struct.pack(">I", zlib.crc32(kind + data))
    return struct.pack(">I", len(data)) + kind + data + check
