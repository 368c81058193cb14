# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes: where patches speak, and where faces do."""

import numpy as np

from .faces import bump_correlation, fan_width, mean_edge, vertex_normals

# A mesh is noisy when its vertices stray from patches by this share of an edge, which
# clean and decimated ones do half as much, and neighbors do not bulge to one side, as
# they do on a coarse mesh. Then patches reach over three rings.
_NOISY, _ALIKE = 0.15, 0.2
WIDER = {"neighbors": 30, "patch": "biquadratic"}

# Of a mesh's patch, see `with_faces`.
_WELL_FITTED, _WIDE_FAN, _BESIDE = 0.1, 0.5, 2.0


def with_faces(points, faces, fitted, settings):
    """Let the faces speak where a patch has too little to say.

    Vertices without a valid patch take the mean of their faces' normals, weighted by
    angle. Method "auto" also takes it where the patch is not clearly better founded:
    where it misses the vertices by more than a tenth of what the faces turn, or leaves
    them by more than twice as much, as between a few rows of vertices that leave it
    room, or where the faces turn by more than half a radian, as at creases and on
    coarse meshes. Under noise the faces are no guide, and patches stand.
    """
    guide = vertex_normals(points, faces, weights="angle")
    has_face = (guide != 0).any(axis=1)
    doubtful = ~fitted.valid
    if settings.method == "auto" and not is_noisy(points, faces, fitted):
        width = fan_width(points, faces, guide)
        doubtful |= (fitted.misfit > _WELL_FITTED * width) | (width > _WIDE_FAN)
        away = np.linalg.norm(np.cross(fitted.normals, guide), axis=1)
        doubtful |= away > _BESIDE * width
    replaced = doubtful & has_face
    normals = np.where(replaced[:, None], guide, fitted.normals)
    return normals, fitted.valid | replaced, int(replaced.sum())


def wants_wider(points, faces, fitted, asked):
    """Whether a noisy mesh was fitted with neighbors that nobody asked for."""
    automatic = asked.method == "auto" and asked.neighbors is None
    return faces is not None and automatic and is_noisy(points, faces, fitted)


def is_noisy(points, faces, fitted):
    """Whether the vertices stray far from smooth patches, each on its own account."""
    return (
        fitted.noise > _NOISY * mean_edge(points, faces)
        and bump_correlation(points, faces) < _ALIKE
    )
