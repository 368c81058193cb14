# SPDX-License-Identifier: GPL-3.0-or-later
"""Color maps whose equal steps look alike, as paths through the color space Oklab.

References
----------
[1] B. Ottosson, "A perceptual color space for image processing", 2020: linear sRGB to
    cone responses, and their cube roots to lightness and two opponent axes.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np

from .inputs import FloatArray

# As sRGB bytes, dark to light and side to side; between them the maps are linear in
# Oklab.
_HEAT = (
    (24, 15, 62),
    (88, 24, 110),
    (170, 51, 106),
    (233, 106, 73),
    (252, 228, 145),
)
DIVERGING = (
    (22, 82, 140),
    (120, 170, 214),
    (232, 232, 228),
    (232, 150, 98),
    (160, 52, 20),
)
WINNERS = ((176, 176, 172), (12, 123, 131))
NOT_COMPARED = (110, 110, 110)

# Paths of our own by lightness, chroma and hue in degrees, linear in all three.
# "viridis" and "cividis" go through the hues of the maps known by these names: the
# first from violet over blue and green to yellow, the second along the one axis that
# looks the same to everyone who takes red for green. "rainbow" alone is darker at both
# ends: it tells most values apart, and says least about which is the larger.
_PATHS = {
    "viridis": ((0.28, 0.13, 300.0), (0.92, 0.13, 105.0)),
    # The hue turns where there is none.
    "cividis": (
        (0.28, 0.11, 262.0),
        (0.55, 0.0, 262.0),
        (0.55, 0.0, 95.0),
        (0.92, 0.13, 95.0),
    ),
    "rainbow": (
        (0.38, 0.14, 285.0),
        (0.60, 0.14, 235.0),
        (0.80, 0.14, 145.0),
        (0.82, 0.14, 95.0),
        (0.45, 0.14, 28.0),
    ),
    "gray": ((0.15, 0.0, 0.0), (0.95, 0.0, 0.0)),
}
COLORMAPS = ("heat", *_PATHS)

# Stops of a map that is made from a path.
_STOPS = 33

_CONES = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
_OPPONENTS = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)


def map_colors(name: str, share: FloatArray) -> FloatArray:
    """Return linear sRGB colors of a map at shares 0 to 1, (..., 3) float64.

    Parameters
    ----------
    name : one of COLORMAPS
    share : (...) float
        Clipped; nan is taken as 0.
    """
    if name == "heat":
        return ramp_colors(_HEAT, share)
    return _between(_even_path(name), share)


def ramp_colors(stops: Sequence[tuple[int, int, int]], share: FloatArray) -> FloatArray:
    """Return linear sRGB colors between stops, sRGB bytes; see `map_colors`."""
    return _between(to_oklab(linear(np.array(stops) / 255)), share)


def _between(stops, share):
    """Return linear sRGB colors between stops (m, 3) in Oklab."""
    at = np.linspace(0, 1, len(stops))
    share = np.nan_to_num(np.clip(share, 0, 1))
    mixed = np.stack([np.interp(share, at, channel) for channel in stops.T], axis=-1)
    return np.clip(from_oklab(mixed), 0, 1)


@cache
def _even_path(name):
    """Return stops of a path, as far from each other in Oklab, (m, 3)."""
    points = np.array(_PATHS[name])
    at = np.linspace(0, len(points) - 1, 1001)
    lightness, chroma, hue = (
        np.interp(at, np.arange(len(points)), values) for values in points.T
    )
    chroma = np.minimum(chroma, _most_chroma(lightness, hue))
    path = _polar(lightness, chroma, hue)
    along = np.append(0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    even = np.linspace(0, along[-1], _STOPS)
    return np.stack([np.interp(even, along, channel) for channel in path.T], axis=1)


def _most_chroma(lightness, hue):
    """Return the chroma (n,) up to which a screen has colors, less two per cent."""
    low, high = np.zeros_like(lightness), np.full_like(lightness, 0.4)
    for _ in range(30):
        middle = (low + high) / 2
        color = from_oklab(_polar(lightness, middle, hue))
        shown = ((color >= 0) & (color <= 1)).all(axis=1)
        low, high = np.where(shown, middle, low), np.where(shown, high, middle)
    return 0.98 * low


def _polar(lightness, chroma, hue):
    turn = np.radians(hue)
    return np.stack([lightness, chroma * np.cos(turn), chroma * np.sin(turn)], axis=1)


def linear(srgb: FloatArray) -> FloatArray:
    """Return linear values of sRGB ones (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def to_oklab(color: FloatArray) -> FloatArray:
    """Return linear sRGB colors (..., 3) in Oklab [1]."""
    return np.cbrt(color @ _CONES.T) @ _OPPONENTS.T


def from_oklab(lab: FloatArray) -> FloatArray:
    """Return colors of Oklab (..., 3) as linear sRGB."""
    return (lab @ np.linalg.inv(_OPPONENTS).T) ** 3 @ np.linalg.inv(_CONES).T
