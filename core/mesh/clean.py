# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes without noise: means of the faces around each vertex, or the patch there.

First the weights of the means, one kind for the whole mesh; then, vertex by vertex,
whether the patch stands.
"""

from dataclasses import dataclass

import numpy as np

from ..inputs import BoolArray, FloatArray
from ..patches.fitted import Fitted
from .averages import Averages
from .evidence import edge_misfit, mesh_misfit
from .faces import Triangles, unit

# Angle weights where they fit the edges better than those of Max by the first factor,
# or vertices stray from patches by the last share of what faces turn; those of Max from
# the other ends on; between them the mean of both. On spheres the latter are exact, on
# decimated and rough surfaces the former are better.
_FIT_BETTER, _STRAYING = (0.88, 0.93), (0.13, 0.17)

# Patches are asked for weights too where the mesh strays from them by less than the
# first share, and not from the second on. They are taken at a vertex that strays by
# less than the third, and a mix nearer to one of its ends than that is the end.
_ASKED, _ASKED_AT, _END = (0.04, 0.08), 0.1, 0.05

# A patch passes where its squared misfit of the edges is below that of the means by
# this factor, and vertices stray from it by less than so much of what faces turn. Among
# slivers, of less than that quality, faces are so bad that the bars are lower.
_PATCH_BETTER, _PATCH_STRAYING = 0.5, 0.04
_PATCH_BETTER_SLIVERS, _STRAYING_SLIVERS, _SLIVERS = 0.8, 0.15, 0.6

# Patches count where more than the first share of those within so many rounds of means
# pass, and stand alone from the second on: a few that pass among many that do not do so
# by chance, and on the verge a wrong one does little harm.
_PASSED, _AROUND = (0.5, 0.9), 8

# Patches that miss their points by less than that, as an angle, lie in a plane, which
# faces know as well.
_FLAT = 1e-7

# Rounds of means over which a choice between two patches of a few rings is made.
_GATHERED = 4


@dataclass(frozen=True)
class Patched:
    """Patches of all vertices, beside what the faces there turn.

    Attributes
    ----------
    normals : (n, 3)
        On the side of the faces.
    misfit : (n,)
        The squared angle by which a patch misses its vertices.
    share : (n,)
        Of what the faces turn, by which vertices stray from patches; infinite where
        patches are not valid or lie in a plane.
    slivers : (n,) bool
    straying : float
        The median share of all vertices with faces around.
    """

    normals: FloatArray
    misfit: FloatArray
    share: FloatArray
    slivers: BoolArray
    straying: float

    @classmethod
    def of(cls, mesh: Triangles, fitted: Fitted, averages: Averages) -> "Patched":
        """Compare what vertices stray from patches with what the faces there turn."""
        guide = mesh.vertex_normals("angle")
        turned = mesh.fan_width(guide) ** 2
        misfit = fitted.misfit.astype(np.float64) ** 2
        corners, count = mesh.faces.ravel(), len(mesh.points)
        total = np.bincount(corners, np.repeat(mesh.quality, 3), count)
        quality = total / np.maximum(np.bincount(corners, minlength=count), 1)
        gathered = averages.means(np.stack([misfit, turned, quality], axis=1), 2)
        # What lies in a plane strays from it by rounding.
        some = fitted.valid & (gathered[:, 0] >= _FLAT**2) & (gathered[:, 1] > 0)
        share = np.full(count, np.inf, dtype=np.float32)
        share[some] = np.sqrt(gathered[some, 0] / gathered[some, 1])
        inner = averages.inner & (turned > 0)
        straying = np.sqrt(misfit[inner] / turned[inner])
        side = np.where(np.einsum("ij,ij->i", fitted.normals, guide) < 0, -1.0, 1.0)
        return cls(
            fitted.normals * side[:, None],
            misfit.astype(np.float32),
            share,
            gathered[:, 2] < _SLIVERS,
            float(np.median(straying)) if len(straying) else 1.0,
        )

    def passing(self, misfit: FloatArray, of_means: FloatArray) -> BoolArray:
        """Return which patches are clearly better than means of faces, (n,).

        Parameters
        ----------
        misfit, of_means : (n,)
            How badly either fits the edges around, see `edge_misfit`.
        """
        most = np.where(self.slivers, _STRAYING_SLIVERS, _PATCH_STRAYING)
        bar = np.where(self.slivers, _PATCH_BETTER_SLIVERS, _PATCH_BETTER)
        return (self.share < most) & (misfit < bar * of_means)


@dataclass(frozen=True)
class Clean:
    """What the normals of n vertices are where there is no noise.

    Attributes
    ----------
    normals : (n, 3) float64
    weights : "angle" | "max"
        Of the faces, in the means, or what most of these have.
    from_patch : (n,) bool
        Where a patch counts more than they do.
    """

    normals: FloatArray
    weights: str
    from_patch: BoolArray


def best_clean(mesh: Triangles, averages: Averages, patches: Patched | None) -> Clean:
    """Return the normals of a mesh as if it had no noise.

    Parameters
    ----------
    patches : Patched or None
        None where nobody asks them.
    """
    angle = mesh.vertex_normals("angle")
    if patches is None:
        return Clean(angle, "angle", np.zeros(len(angle), dtype=bool))
    largest = mesh.vertex_normals("max")
    share = _share_of_angle(mesh_misfit(mesh, [angle, largest]), patches.straying)
    share = max(share, _share_by_patches(angle, largest, patches, share))
    weights = "angle" if share > 0.5 else "max"
    normals = unit(share * angle + (1 - share) * largest)
    # Sums gathered over the same edges compare like means.
    misfits = edge_misfit(mesh.points, averages.edges, [patches.normals, normals])
    passing = patches.passing(*averages.means(misfits, _GATHERED).T)
    passed = averages.means(passing[:, None].astype(np.float32), _AROUND)[:, 0]
    weight = np.where(np.isfinite(patches.share), np.interp(passed, _PASSED, (0, 1)), 0)
    apart = patches.normals - normals
    apart *= weight[:, None]
    normals += apart
    return Clean(unit(normals), weights, weight > 0.5)


def _share_of_angle(misfits, straying):
    """Return the share of angle weights, 0 to 1, by the misfits of both kinds."""
    angle, largest = misfits
    fit = np.sqrt(angle / largest) if largest > 0 else 1.0
    better = np.interp(fit, _FIT_BETTER, (1.0, 0.0))
    return max(better, np.interp(straying, _STRAYING, (0.0, 1.0)))


def _share_by_patches(angle, largest, patches, by_edges):
    """Return the share of angle weights that brings means next to patches.

    What patches are wrong by does not depend on the weights, so that on average the
    mix next to them is next to the surface. Where they miss their vertices by more
    than the weights differ, what the edges say stays.
    """
    asked = patches.share < _ASKED_AT
    missed = float(patches.misfit[asked].sum(dtype=np.float64))
    along, total = 0.0, missed
    for axis in range(3):
        far = largest[asked, axis]
        apart = angle[asked, axis] - far
        along += (patches.normals[asked, axis] - far) @ apart
        total += apart @ apart
    share = (along + missed * by_edges) / total if total > 0 else by_edges
    trust = np.interp(patches.straying, _ASKED, (1.0, 0.0))
    return float(trust * np.interp(share, (_END, 1 - _END), (0.0, 1.0)))
