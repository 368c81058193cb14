# SPDX-License-Identifier: GPL-3.0-or-later
"""Points of a noisy cloud, moved onto fits to the cloud around them."""

import numpy as np

from ..inputs import FloatArray
from ..neighbors.graph import NearestNeighbors
from ..patches.chart import tangent_axes
from ..progress import Progress, silent

# Fits reach four times the noise: less leaves bumps that look like sheets, more joins
# sheets that are apart.
_REACH = 4.0
_ROUNDS = 2

# Points that are moved in one go.
_CHUNK = 2048


def reach_of_fits(spacing: float, noise: float) -> float:
    """Return how far the fits reach that smooth a cloud of such spacing and noise."""
    return max(_REACH * noise, 2.5 * spacing)


def smooth(
    nearest: NearestNeighbors,
    place: FloatArray,
    facing: FloatArray,
    reach: float,
    *,
    workers: int = -1,
    progress: Progress = silent,
) -> tuple[FloatArray, FloatArray]:
    """Project points onto quadratic fits to the cloud around them.

    Parameters
    ----------
    place, facing : (m, 3) float64
        Points near the cloud, and about their normals.
    reach : float
        Radius of the fits in dense parts of the cloud; elsewhere more, for the number
        of neighbors is the same everywhere.

    Returns
    -------
    place, facing : (m, 3) float64
    """
    place, facing = place.copy(), facing.copy()
    tree = nearest.tree
    some = place[:: max(1, len(place) // 200)]
    inside = np.median(tree.query_ball_point(some, reach, return_length=True))
    count = min(int(np.clip(inside, 12, 800)), len(nearest.points))
    for turn in range(_ROUNDS):
        for at in range(0, len(place), _CHUNK):
            progress((turn + at / len(place)) / _ROUNDS)
            part = slice(at, at + _CHUNK)
            distance, index = tree.query(place[part], k=count, workers=workers)
            place[part], facing[part] = _project(
                nearest.points[index], distance, place[part], facing[part]
            )
    return place, facing


def _project(around, distance, place, facing):
    """Move points (m, 3) along their normals onto fits to (m, k, 3) neighbors."""
    reach = np.maximum(distance[:, -1:], 1e-300)
    axes = np.stack([*tangent_axes(facing.T), facing.T])
    local = np.einsum("mkc,acm->amk", around - place[:, None], axes) / reach
    x, y, z = local
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    weighted = design * np.exp(-((1.8 * distance / reach) ** 2))[:, None]
    matrix = weighted @ design.transpose(0, 2, 1)
    # Keeps fits finite where neighbors leave a term open.
    matrix[:, range(6), range(6)] += 1e-9 * matrix[:, :1, 0]
    found = np.linalg.solve(matrix, weighted @ z[..., None])[..., 0]
    normal = (axes[2] - found[:, 1] * axes[0] - found[:, 2] * axes[1]).T
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return place + np.clip(found[:, :1], -1, 1) * reach * facing, normal
