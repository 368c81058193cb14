# SPDX-License-Identifier: GPL-3.0-or-later
"""The exact normals that tests/benchmarks/meshes.py finds in parts."""

import sys
from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose

sys.path.append(str(Path(__file__).resolve().parents[1] / "benchmarks"))

import cylinders
import solids

from core.mesh.faces import split_fans


def parted(name, made):
    """Return the vertices and the triangles of a solid, and its true normals."""
    solid = next(s for s in made if s.name == name)
    sharp = solid.sharp_edges() if solid.creased else np.empty((0, 2), dtype=int)
    fans, vertex = split_fans(len(solid.points), solid.faces, sharp)
    truth = np.zeros((len(vertex), 3))
    corners = solid.corner_truth(solid.points, solid.faces, solid.piece)
    truth[fans.ravel()] = corners.reshape(-1, 3)
    return solid.points[vertex], fans, truth


def test_the_side_of_a_cylinder_is_found():
    points, fans, truth = parted("cylinder", solids.creased_solids())
    found = cylinders.cylinder_normals(points, fans)
    side = np.abs(truth[:, 2]) < 0.5
    known = (found != 0).any(axis=1)
    # At rims means of faces look to one side; those too far off are left out.
    assert known[side].mean() > 0.8
    assert not known[~side].any()
    assert_allclose(found[known], truth[known], atol=1e-9)


def test_no_cylinder_in_a_bumpy_ball():
    points, fans, _ = parted("bumpy", solids.smooth_solids())
    assert (cylinders.cylinder_normals(points, fans) == 0).all()
