# SPDX-License-Identifier: GPL-3.0-or-later
"""How noisy a cloud is, and the means of blocks of points where it is."""

import numpy as np

from ..inputs import FloatArray, IntArray
from ..neighbors.halves import halved, sizes_of_halves
from ..patches.asked import EVERY, Asked
from .ladder import local_noise

# The neighbors over which noise is sought, few to many.
_SIZES = (16, 36, 81, 182, 410, 922)

# Noise is what residuals say once it is thinner than a fifth of the reach.
_THIN = 0.2

# Below a quarter of the spacing noise is left to the patches. Above, a block has three
# points for every spacing that the noise is thick: that loses nothing that noise has
# not taken already, and there are as many fewer patches to fit.
_NOISY, _POINTS_PER_SPACING = 0.25, 3.0

# A block of three halves of a point on average is the smallest that halving reaches.
_SMALLEST = 1.5


def noise_in_spacings(asked: Asked) -> tuple[float, float]:
    """Return the noise of a cloud in units of its spacing, and in its own.

    A spacing is the side of the square that each point has for itself.
    """
    noise = spacing = 0.0
    for count in (k for k in _SIZES if k < asked.count // EVERY or k == _SIZES[0]):
        offsets, reach = asked.around(count)
        share = local_noise(offsets)
        noise = float(np.median(share * reach))
        spacing = float(np.median(reach)) * np.sqrt(np.pi / count)
        if np.median(share) < _THIN:
            break
    return (noise / spacing if spacing > 0 else 0.0), noise


def halvings(count: int, noise: float, least: float = 1.0) -> int | None:
    """Return how often a cloud is halved to blocks as large as the noise asks for.

    Parameters
    ----------
    count : int
        The points of the cloud.
    noise : float
        In spacings: see `noise_in_spacings`.
    least : float
        Points of a block at least, where there is noise.

    Returns
    -------
    int or None
        None where there is little noise, and each point is its own block.
    """
    if noise < _NOISY:
        return None
    wanted = max(_SMALLEST * np.sqrt(2), noise * _POINTS_PER_SPACING, least)
    return max(0, round(np.log2(count / wanted)))


def block_means(
    points: FloatArray, times: int, *, width: int | None = None
) -> tuple[FloatArray, IntArray]:
    """Return the means of blocks of points, halves of halves of all.

    Parameters
    ----------
    points : (n, 3) float64
    times : int
        How often they are halved.
    width : int, optional
        See `halves.halved`.

    Returns
    -------
    means : (b, 3) float64
    label : (n,) int
        The block of each point.
    """
    width = width or len(points)
    most = -(-width // 2**times)
    order = halved(points, most, width=width)
    sizes = sizes_of_halves(len(points), most, width)[-1]
    starts = np.cumsum(sizes) - sizes
    means = (np.add.reduceat(points[order].T, starts, axis=1) / sizes).T
    label = np.empty(len(points), dtype=np.int64)
    label[order] = np.repeat(np.arange(len(sizes)), sizes)
    return np.ascontiguousarray(means), label
