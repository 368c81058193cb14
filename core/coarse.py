# SPDX-License-Identifier: GPL-3.0-or-later
"""How noisy a cloud is, and the means of blocks of points where it is."""

import numpy as np

from .graph import NearestNeighbors
from .halves import halved, sizes_of_halves
from .inputs import FloatArray, IntArray
from .ladder import local_noise

# Points that are asked, of a small cloud a quarter, and the neighbors over which noise
# is sought, few to many.
_SAMPLES, _EVERY = 1024, 4
_SIZES = (16, 36, 81, 182, 410, 922)

# Noise is what residuals say once it is thinner than a fifth of the reach.
_THIN = 0.2

# Below a quarter of the spacing noise is left to the patches. Above, a block has three
# points for every spacing that the noise is thick: that loses nothing that noise has
# not taken already, and there are as many fewer patches to fit.
_NOISY, _POINTS_PER_SPACING = 0.25, 3.0

# A block of three halves of a point on average is the smallest that halving reaches.
_SMALLEST = 1.5


def noise_in_spacings(nearest: NearestNeighbors) -> tuple[float, float]:
    """Return the noise of a cloud in units of its spacing, and in its own.

    A spacing is the side of the square that each point has for itself.
    """
    n = len(nearest)
    rows = nearest.order[:: max(_EVERY, n // _SAMPLES)]
    noise = spacing = 0.0
    for count in (k for k in _SIZES if k < n // 4 or k == _SIZES[0]):
        offsets, distance = nearest.offsets(rows, min(count, n - 1))
        reach = distance[:, -1]
        share = local_noise(offsets, reach)
        noise = float(np.median(share * reach))
        spacing = float(np.median(reach)) * np.sqrt(np.pi / count)
        if np.median(share) < _THIN:
            break
    return (noise / spacing if spacing > 0 else 0.0), noise


def block_means(points: FloatArray, noise: float) -> tuple[FloatArray, IntArray | None]:
    """Return the means of blocks of points, as many points each as the noise asks for.

    Parameters
    ----------
    points : (n, 3) float64
    noise : float
        In spacings: see `noise_in_spacings`.

    Returns
    -------
    means : (b, 3) float64
        The points themselves where there is little noise.
    label : (n,) int or None
        The block of each point; None where each is its own.
    """
    if noise < _NOISY:
        return points, None
    wanted = max(_SMALLEST * np.sqrt(2), noise * _POINTS_PER_SPACING)
    count = 2 ** max(0, round(np.log2(len(points) / wanted)))
    most = -(-len(points) // count)
    coordinates, order = halved(points, most)
    sizes = sizes_of_halves(len(points), most)[-1]
    starts = np.cumsum(sizes) - sizes
    means = (np.add.reduceat(coordinates, starts, axis=1) / sizes).T
    label = np.empty(len(points), dtype=np.int64)
    label[order] = np.repeat(np.arange(len(sizes)), sizes)
    return np.ascontiguousarray(means), label
