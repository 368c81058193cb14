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

# A patch stands where its squared misfit of the edges is below that of the means by
# this factor, and vertices stray from it by less than so much of what faces turn. Among
# slivers, of less than that quality, faces are so bad that the bars are lower.
_PATCH_BETTER, _PATCH_STRAYING = 0.5, 0.04
_PATCH_BETTER_SLIVERS, _STRAYING_SLIVERS, _SLIVERS = 0.7, 0.1, 0.6

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
    bar : (n,)
        The factor by which they have to fit the edges better; 0 where they are not
        valid or stray too far.
    straying : float
        The median share of what faces turn by which vertices stray from patches.
    """

    normals: FloatArray
    bar: FloatArray
    straying: float

    @classmethod
    def of(cls, mesh: Triangles, fitted: Fitted, averages: Averages) -> "Patched":
        """Compare what vertices stray from patches with what the faces there turn."""
        guide = mesh.vertex_normals("angle")
        turned = mesh.fan_width(guide) ** 2
        strayed = fitted.misfit.astype(np.float64) ** 2
        corners, count = mesh.faces.ravel(), len(mesh.points)
        total = np.bincount(corners, np.repeat(mesh.quality, 3), count)
        quality = total / np.maximum(np.bincount(corners, minlength=count), 1)
        gathered = averages.means(np.stack([strayed, turned, quality], axis=1), 2)
        slivers = gathered[:, 2] < _SLIVERS
        most = np.where(slivers, _STRAYING_SLIVERS, _PATCH_STRAYING)
        near = gathered[:, 0] < most**2 * gathered[:, 1]
        # What lies in a plane strays from it by rounding.
        flat = gathered[:, 0] < _FLAT**2
        bar = np.where(slivers, _PATCH_BETTER_SLIVERS, _PATCH_BETTER)
        some = averages.inner & (turned > 0)
        straying = np.sqrt(strayed[some] / turned[some])
        side = np.where(np.einsum("ij,ij->i", fitted.normals, guide) < 0, -1.0, 1.0)
        return cls(
            fitted.normals * side[:, None],
            np.where(fitted.valid & near & ~flat, bar, 0),
            float(np.median(straying)) if len(straying) else 1.0,
        )


@dataclass(frozen=True)
class Clean:
    """What the normals of n vertices are where there is no noise.

    Attributes
    ----------
    normals : (n, 3) float64
    weights : "angle" | "max"
        Of the faces, in the means, or what most of these have.
    from_patch : (n,) bool
        Who has the normal of a patch instead.
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
    weights = "angle" if share > 0.5 else "max"
    normals = unit(share * angle + (1 - share) * largest)
    # Sums gathered over the same edges compare like means.
    misfits = edge_misfit(mesh.points, averages.edges, [patches.normals, normals])
    gathered = averages.means(misfits, _GATHERED)
    chosen = gathered[:, 0] < patches.bar * gathered[:, 1]
    normals = np.where(chosen[:, None], patches.normals, normals)
    return Clean(normals, weights, chosen)


def _share_of_angle(misfits, straying):
    """Return the share of angle weights, 0 to 1, by the misfits of both kinds."""
    angle, largest = misfits
    fit = np.sqrt(angle / largest) if largest > 0 else 1.0
    better = np.interp(fit, _FIT_BETTER, (1.0, 0.0))
    return max(better, np.interp(straying, _STRAYING, (0.0, 1.0)))
