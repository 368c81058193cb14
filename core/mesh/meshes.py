# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of meshes, by what a mesh shows of itself.

Three questions, in this order: do the vertices show noise, or the steps of voxels
(`evidence`)? What would the normals be without: means of the faces around a vertex, or
a patch (`clean`)? And where there is noise, how wide should the means be (`shaken`)?
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..inputs import BoolArray, FloatArray
from ..patches.fitted import Fitted
from .averages import Averages, area_vectors
from .clean import Patched, best_clean
from .evidence import find_bumps, is_stepped, noise_of
from .faces import Triangles, unit
from .shaken import best_smoothed

# With more noise than that, in edges, patches over a few rings have nothing to say.
_TOO_NOISY = 0.1


@dataclass(frozen=True)
class MeshNormals:
    """Normals of a mesh's vertices, and where they are from.

    Attributes
    ----------
    normals : (n, 3) float64
        Unit; zero where not valid.
    valid : (n,) bool
    from_faces : int
        Vertices at which means of normals of faces count for most.
    smoothed : int
        Those among them whose mean reaches beyond the faces at the vertex.
    noise : float
        Standard deviation of the vertices' noise in object units, 0 where none shows.
    edge : float
        The mean length of the edges.
    kind : str
        "clean", "noisy" or "stepped".
    """

    normals: FloatArray
    valid: BoolArray
    from_faces: int
    smoothed: int
    noise: float
    edge: float
    kind: str


def with_faces(mesh: Triangles, fitted: Fitted) -> MeshNormals:
    """Give vertices without a valid patch the mean of their faces' normals.

    Weighted by angle.
    """
    guide = mesh.vertex_normals("angle")
    replaced = ~fitted.valid & (guide != 0).any(axis=1)
    normals = np.where(replaced[:, None], guide, fitted.normals)
    valid = fitted.valid | replaced
    count = int(replaced.sum())
    return MeshNormals(normals, valid, count, 0, fitted.noise, mesh.mean_edge, "clean")


def choose_normals(mesh: Triangles, fit: Callable[[], Fitted]) -> MeshNormals:
    """Return the normals that the evidence of a mesh speaks for, vertex by vertex.

    Parameters
    ----------
    mesh : Triangles
        Centered, faces wound alike.
    fit : callable () -> Fitted
        Fits patches over the rings of the mesh; called where they are needed.
    """
    averages = Averages(len(mesh.points), mesh.faces)
    sums = area_vectors(mesh)
    smooth = unit(averages.means(sums, 2))
    bumps = find_bumps(mesh, averages, smooth)
    stepped = not bumps.noisy and is_stepped(mesh, bumps)
    patches = None
    if not stepped and not (bumps.noisy and bumps.noise > _TOO_NOISY):
        patches = Patched.of(mesh, fit(), averages)
    noisy = bumps.noisy or (
        patches is not None and bumps.noisy_if_rough(patches.straying)
    )
    clean = best_clean(mesh, averages, patches)
    normals, from_patch = clean.normals, clean.from_patch
    smoothed, noise, kind = np.zeros(len(normals), dtype=bool), 0.0, "clean"
    if noisy or stepped:
        shake = noise_of(bumps, stepped=stepped) * mesh.mean_edge
        normals, smoothed = best_smoothed(mesh, averages, sums, clean, shake)
        noise, kind = bumps.noise * mesh.mean_edge, "stepped" if stepped else "noisy"
    # Where faces cancel out, those farther off stand in.
    missing = (normals == 0).all(axis=1)
    normals = unit(np.where(missing[:, None], smooth, normals).astype(np.float64))
    valid = (normals != 0).any(axis=1)
    from_faces = int((valid & ~(from_patch & ~smoothed)).sum())
    return MeshNormals(
        normals, valid, from_faces, int(smoothed.sum()), noise, mesh.mean_edge, kind
    )
