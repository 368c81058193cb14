# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture of points: seen from one side, the nearer ones in front."""

import numpy as np

from .inputs import FloatArray, IntArray

# From the front right and above, with z up.
_RIGHT = np.array([0.8, 0.6, 0.0])
_UP = np.array([-0.3, 0.4, np.sqrt(0.75)])
# A light above the viewer's left shoulder, and what all sides get of it.
_LIGHT, _AMBIENT = np.array([-0.1, -0.6, 0.8]), 0.15
_BACKGROUND = 245
_MARGIN = 0.04
# Points that stay when many are thinned: more are not told apart in a picture.
_MOST = 2_000_000


def shaded(normals: FloatArray) -> FloatArray:
    """Return the light on both sides of a surface, linear gray, (n, 3).

    Points without a normal are dark.
    """
    normals = np.nan_to_num(np.asarray(normals, dtype=np.float64))
    light = np.abs(normals @ (_LIGHT / np.linalg.norm(_LIGHT)))
    has_normal = (normals != 0).any(axis=1)
    gray = np.where(has_normal, _AMBIENT + (1 - _AMBIENT) * light, 0.02)
    return np.repeat(gray[:, None], 3, axis=1)


def picture(points: FloatArray, colors: FloatArray, *, size: int = 900) -> IntArray:
    """Draw points as squares wide enough to close the surface.

    Parameters
    ----------
    points : (n, 3) float
        Rows that are not finite are left out.
    colors : (n, 3) or (n, 4) float
        Linear sRGB.
    size : int
        Width and height of the picture in pixels.

    Returns
    -------
    (size, size, 3) uint8, sRGB
    """
    points = np.asarray(points, dtype=np.float64)
    rows = np.flatnonzero(np.isfinite(points).all(axis=1))
    rows = rows[:: max(1, -(-len(rows) // _MOST))]
    image = np.full((size * size, 3), _BACKGROUND, dtype=np.uint8)
    if not len(rows):
        return image.reshape(size, size, 3)
    points = points[rows] - points[rows].mean(axis=0)
    flat = np.stack([points @ _RIGHT, -points @ _UP], axis=1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    span = float((high - low).max()) or 1.0
    inside = size * (1 - 2 * _MARGIN)
    place = (flat - (low + high) / 2) * (inside / span) + size / 2
    # Half the side of the square that each point would fill alone.
    half = int(np.clip(0.75 * inside / np.sqrt(len(rows)), 0, 8))
    toward = np.cross(_RIGHT, _UP)
    order = np.argsort(points @ toward, kind="stable")
    column, row = np.clip(place[order].astype(np.int64), half, size - 1 - half).T
    color = _bytes(np.asarray(colors)[rows][order, :3])
    nearest = np.full(size * size, -1)
    number = np.arange(len(order))
    for down in range(-half, half + 1):
        for right in range(-half, half + 1):
            np.maximum.at(nearest, (row + down) * size + column + right, number)
    seen = nearest >= 0
    image[seen] = color[nearest[seen]]
    return image.reshape(size, size, 3)


def _bytes(linear):
    """Return sRGB bytes of linear values (IEC 61966-2-1)."""
    linear = np.clip(np.nan_to_num(linear), 0, 1)
    srgb = np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055
    )
    return (255 * srgb + 0.5).astype(np.uint8)
