# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes: where patches speak, where faces do, and where many of them together.

A mesh shows by its vertices whether they are noisy (see `evidence`). Where they are
not, normals are means of the faces around a vertex, or those of patches where these fit
the edges clearly better. Where they are, means over more and more faces stand beside
these. To tell which is best, the mesh is shaken: noise as large as that found is added
to its vertices, and what a normal then moves by is its variance; what it differs from a
mean over half as many rounds by, less what noise explains, is its bias.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .averages import Averages, ladder
from .evidence import edge_misfit, find_bumps, is_stepped, mesh_misfit, noise_of
from .faces import Triangles, corner_sums, squares, unit
from .fitted import Fitted
from .inputs import BoolArray, FloatArray

# Angle weights where they fit the edges better than those of Max by this factor, or
# vertices stray from patches by so much of what faces turn: on spheres the latter are
# exact, on decimated and rough surfaces the former are better.
_FIT_BETTER, _STRAYING = 0.905, 0.15

# A patch stands where its squared misfit of the edges is below that of the means by
# this factor, and vertices stray from it by less than so much of what faces turn. Among
# slivers, of less than that quality, faces are so bad that the bars are lower.
_PATCH_BETTER, _PATCH_STRAYING = 0.5, 0.04
_PATCH_BETTER_SLIVERS, _STRAYING_SLIVERS, _SLIVERS = 0.7, 0.1, 0.6

# Patches that miss their points by less than that, as an angle, lie in a plane, which
# faces know as well.
_FLAT = 1e-7

# With more noise than that, in edges, patches over a few rings have nothing to say.
_TOO_NOISY = 0.1

# A bias is twice the difference to half as many rounds, where it grows with the square
# of the reach; noise may differ by half from what one shake shows.
_BIAS, _EXPLAINED = 2.0, 1.5

# Candidates count by this power of their risks; the best alone is right less often than
# the better ones together.
_SHARPNESS, _LEAST_RISK = 3, 1e-10

# Rounds of means over which evidence is gathered: for a choice between two patches of
# a few rings, and for variances, of which a vertex alone knows little.
_GATHERED, _GATHERED_VARIANCE = 4, 6


@dataclass(frozen=True)
class MeshNormals:
    """Normals of a mesh's vertices, and where they are from.

    Attributes
    ----------
    normals : (n, 3) float64
        Unit; zero where not valid.
    valid : (n,) bool
    from_faces : int
        Vertices that have a mean of normals of faces.
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
    sums = _area_vectors(mesh)
    smooth = unit(averages.means(sums, 2))
    bumps = find_bumps(mesh, averages, smooth)
    stepped = not bumps.noisy and is_stepped(mesh, bumps)
    patches = None
    if not stepped and not (bumps.noisy and bumps.noise > _TOO_NOISY):
        patches = _Patches.of(mesh, fit(), averages)
    base, from_patch = _best_clean(mesh, averages, patches)
    noisy = bumps.noisy or (
        patches is not None and bumps.noisy_if_rough(patches.straying)
    )
    if not (noisy or stepped):
        none = np.zeros(len(mesh.points), dtype=bool)
        return _result(mesh, base.normals, smooth, from_patch, none, 0.0, "clean")
    shake = noise_of(bumps, stepped=stepped) * mesh.mean_edge
    normals, chosen = _best_smoothed(mesh, averages, sums, base, shake)
    return _result(
        mesh,
        normals,
        smooth,
        from_patch & ~chosen,
        chosen,
        bumps.noise * mesh.mean_edge,
        "stepped" if stepped else "noisy",
    )


def _result(mesh, normals, smooth, from_patch, chosen, noise, kind):
    """Count who has what; where faces cancel out, those farther off stand in."""
    missing = (normals == 0).all(axis=1)
    normals = np.where(missing[:, None], smooth, normals).astype(np.float64)
    valid = (normals != 0).any(axis=1)
    return MeshNormals(
        unit(normals),
        valid,
        int((valid & ~from_patch).sum()),
        int(chosen.sum()),
        noise,
        mesh.mean_edge,
        kind,
    )


def _area_vectors(mesh):
    """Return the sums of area vectors at vertices in single precision, 1 at most."""
    vectors = corner_sums(mesh.vectors, mesh.faces, len(mesh.points))
    top = np.abs(vectors).max(initial=0)
    return (vectors / top if top > 0 else vectors).astype(np.float32)


@dataclass(frozen=True)
class _Patches:
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
    def of(cls, mesh, fitted, averages):
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
class _Base:
    """Normals of vertices, and the weights of faces where these made them."""

    normals: FloatArray
    weights: str


def _best_clean(mesh, averages, patches):
    """Return the _Base of a mesh without noise, and who has a patch's normal, (n,)."""
    fields = {kind: mesh.vertex_normals(kind) for kind in ("angle", "max")}
    angle, largest = mesh_misfit(mesh, list(fields.values()))
    better = angle < _FIT_BETTER**2 * largest
    rough = patches is None or patches.straying > _STRAYING
    weights = "angle" if better or rough else "max"
    normals = fields[weights]
    if patches is None:
        return _Base(normals, weights), np.zeros(len(normals), dtype=bool)
    # Sums gathered over the same edges compare like means.
    misfits = edge_misfit(mesh.points, averages.edges, [patches.normals, normals])
    gathered = averages.means(misfits, _GATHERED)
    chosen = gathered[:, 0] < patches.bar * gathered[:, 1]
    return _Base(np.where(chosen[:, None], patches.normals, normals), weights), chosen


def _best_smoothed(mesh, averages, sums, base, shake):
    """Return the normals of a noisy mesh, and at which vertices they are smooth ones.

    Parameters
    ----------
    sums : (n, 3) float32
        Area vectors of the faces at the vertices.
    base : _Base
    shake : float
        Standard deviation of the noise, in object units.
    """
    at_vertex, by_area = _shaken(mesh, sums, base.weights, shake)
    still = squares(at_vertex[:, 3:] - at_vertex[:, :3])
    # What noise does to patches in the base is much the same as to its means.
    blend = _Blend(
        base.normals, averages.means(still[:, None], _GATHERED_VARIANCE)[:, 0]
    )
    unbent = _Run(averages, 1.0)
    unbent.risk(at_vertex)
    plain, sharpened = _Run(averages, _BIAS**2), _Run(averages, _BIAS**2)
    for rounds, means, sharper in ladder(averages, by_area):
        if rounds == 0:
            blend.add(means, unbent.risk(means), smooth=False)
        blend.add(means, plain.risk(means), smooth=True)
        if sharper is not None:
            blend.add(sharper, sharpened.risk(sharper), smooth=True)
    return blend.normals, blend.smooth


def _shaken(mesh, sums, weights, shake):
    """Return fields of a mesh beside the same with more noise, (n, 6) float32 each.

    Returns
    -------
    at_vertex : normals, means of those of the faces by `weights`
    by_area : sums of area vectors, as in `sums`
    """
    rng = np.random.default_rng(0)
    moved = mesh.points + rng.normal(0, shake, mesh.points.shape)
    other = Triangles(moved, mesh.faces)
    normals = [each.vertex_normals(weights) for each in (mesh, other)]
    return (
        np.concatenate(normals, axis=1, dtype=np.float32),
        np.concatenate([sums, _area_vectors(other)], axis=1),
    )


class _Blend:
    """The mean of fields of normals, those of less risk counting more."""

    def __init__(self, normals, risk):
        weight = _weight(risk)
        self._total = weight[:, None] * normals
        self._weight = weight
        self._smooth = np.zeros(len(normals))

    def add(self, pair, risk, *, smooth):
        """Take the first field of a pair in, with its risk, (n,) or None."""
        if risk is None:
            return
        weight = _weight(risk)
        self._total += weight[:, None] * pair[:, :3]
        self._weight += weight
        if smooth:
            self._smooth += weight

    @property
    def normals(self):
        return unit(self._total)

    @property
    def smooth(self):
        """(n,) bool, where means that reach beyond a vertex count for most."""
        return 2 * self._smooth > self._weight


def _weight(risk):
    # Rounding of single precision is no evidence that there is no risk.
    return np.maximum(risk, _LEAST_RISK).astype(np.float64) ** -_SHARPNESS


class _Run:
    """Fields of normals in the order of their reach, each with that of a shaken mesh.

    Parameters
    ----------
    factor : float
        The squared bias of a field over its squared difference to the one before.
    """

    def __init__(self, averages, factor):
        self._averages = averages
        self._factor = factor
        self._before = None
        self._bias = 0.0

    def risk(self, pair):
        """Return the risk of the next pair, bias² plus variance; not of the first."""
        before, self._before = self._before, pair
        if before is None:
            return None
        step = pair - before
        parts = [step[:, :3], step[:, 3:] - step[:, :3], pair[:, 3:] - pair[:, :3]]
        turned, by_noise, variance = self._averages.means(
            np.stack([squares(part) for part in parts], axis=1), _GATHERED_VARIANCE
        ).T
        left = np.maximum(turned - _EXPLAINED * by_noise, 0)
        # Where everything is rounded off, differences become small again.
        self._bias = np.maximum(self._bias, self._factor * left)
        return self._bias + variance
