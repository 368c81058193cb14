# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of discrete surfaces by derivatives on time scales.

Numbers only: numpy, scipy and the standard library. The names below are the public
ones; each module says what it does in its first line. `estimate` leads through it all:
`neighbors` say who is near whom, `patches` are fitted and in `auto` blended, faces are
heard in `mesh`, sides found in `orient`.
"""

from . import shapes
from .comparison import Comparison, compare_normals
from .delaunay import delaunay_normals
from .estimate import Estimate, estimate_normals
from .inputs import InputError
from .neighbors.graph import NeighborGraph
from .orient.orientation import orient_normals
from .settings import Settings
from .surface import GridSurface
from .timescale import TimeScale

__all__ = [
    "Comparison",
    "Estimate",
    "GridSurface",
    "InputError",
    "NeighborGraph",
    "Settings",
    "TimeScale",
    "compare_normals",
    "delaunay_normals",
    "estimate_normals",
    "orient_normals",
    "shapes",
]
