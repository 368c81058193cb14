# SPDX-License-Identifier: GPL-3.0-or-later
"""Which points belong to one connected piece of surface."""

import numpy as np

from ..inputs import FloatArray, IntArray
from ..neighbors.graph import NeighborGraph
from .mending import Surface

# The line between two points on one sheet leaves their mean tangent plane by less: it
# is 1 from one sheet straight to another, and 0 along a plane or over a crease.
_ALONG = 0.4


def connected_pieces(
    points: FloatArray, normals: FloatArray, faces: IntArray | None = None
) -> IntArray:
    """Return the piece of each point, (n,) int, counted from 0.

    Parameters
    ----------
    points : (n, 3) float64
    normals : (n, 3) float64, unit or zero
        On either side. They keep sheets apart that are as close as the points.
    faces : (m, 3) int, optional
        Pieces then hang together along edges of faces, and normals do not matter.
    """
    from scipy.sparse.csgraph import connected_components

    if faces is not None:
        graph = NeighborGraph.mesh(len(points), faces)
    elif len(points) < 2:
        return np.zeros(len(points), dtype=np.int64)
    else:
        surface = Surface.through(points, normals)
        row, column = np.nonzero(surface.slope < _ALONG)
        edges = np.stack([row, surface.index[row, column]], axis=1)
        graph = NeighborGraph.from_edges(len(points), edges)
    return connected_components(graph.matrix, directed=False)[1].astype(np.int64)
