# SPDX-License-Identifier: GPL-3.0-or-later
"""What a mesh tells about itself: noise, steps, and normals that fit its edges."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..inputs import FloatArray, IntArray
from .averages import Averages
from .faces import Triangles, squares

# Vertices that are looked at, at most.
_SAMPLE = 20_000

# Correlations of independent noise: of a vertex's bump with a neighbor's, and of one
# two edges away less that. On a smooth surface bumps are about this much alike.
_NOISE_ALIKE, _SMOOTH_ALIKE = -0.24, 0.85
# What noise makes of a bump's variance: its own and the sixth part of the neighbors'.
_BUMP = 7 / 6

# Bumps that are more alike two edges away than one are those of noise.
_RISE = 0.03
# On rough surfaces likeness falls with distance as a power that noise makes smaller.
_FALL, _ROUGH = 1.3, 0.15
# Fewer vertices than that say nothing about likeness.
_FEW, _FEW_ROUGH = 60, 300

# Steps of voxels: bumps as high as that, in edges, nearly everywhere, which are not
# like their neighbors, and faces that look in few directions for their number.
# Neighboring steps depend on each other: they are as bad as noise three times as high.
_STEP_HEIGHT, _STEP_MEDIAN, _STEP_ALIKE = 0.08, 0.25, 0.6
_STEP_DIRECTIONS, _STEP_FACES = 0.15, 400
_STEP_NOISE = 3.0


@dataclass(frozen=True)
class Bumps:
    """How vertices stand out from the means of their neighbors.

    Attributes
    ----------
    height, median : float
        Root mean square and median of their absolute values, in mean edges.
    alike, alike_beyond : float
        The correlation with those of neighbors, and with those two edges away.
    count : int
        Vertices with faces all around, on which this rests.
    """

    height: float
    median: float
    alike: float
    alike_beyond: float
    count: int

    @property
    def noise(self) -> float:
        """Independent noise that explains how little alike they are, in edges."""
        share = (_SMOOTH_ALIKE - self.alike) / (_SMOOTH_ALIKE - _NOISE_ALIKE)
        return self.height * float(np.sqrt(np.clip(share, 0, 1) / _BUMP))

    @property
    def noisy(self) -> bool:
        """Whether they can only be noise: less alike near by than farther away."""
        return self.count >= _FEW and self.alike_beyond - self.alike > _RISE

    def noisy_if_rough(self, misfit: float) -> bool:
        """Whether they are noise on a surface that is rough at the size of an edge.

        Parameters
        ----------
        misfit : float
            How far vertices are from patches, as a share of what faces turn.
        """
        if self.count < _FEW_ROUGH or misfit < _ROUGH or self.alike_beyond <= 0:
            return False
        return self.alike <= 0 or (
            self.alike < 1 and self.alike_beyond > self.alike**_FALL
        )


def find_bumps(mesh: Triangles, averages: Averages, normals: FloatArray) -> Bumps:
    """Return how the vertices of a mesh stand out along smooth normals, (n, 3)."""
    points = mesh.points
    bump = np.einsum("ij,ij->i", averages.around(points) - points, normals)
    bump[~averages.inner] = 0
    rows = np.flatnonzero(averages.inner)
    count = len(rows)
    edge = mesh.mean_edge
    square = float((bump[rows] ** 2).mean()) if count else 0.0
    # Below the rounding of single precision nothing stands out.
    if square <= (1e-6 * edge) ** 2:
        return Bumps(0.0, 0.0, 1.0, 1.0, count)
    rows = rows[:: max(1, count // _SAMPLE)]
    near = averages.joined[rows]
    alike, beyond = (
        _likeness(matrix, rows, bump, averages.inner)
        for matrix in (near, _two_away(near, rows, averages))
    )
    middle = float(np.median(np.abs(bump[rows])))
    return Bumps(float(np.sqrt(square)) / edge, middle / edge, alike, beyond, count)


def _two_away(near, rows, averages):
    """Return who is two edges away from the vertices whose neighbors are in `near`."""
    from scipy import sparse

    reached = (near @ averages.joined).tocsr()
    reached.data[:] = 1
    marked = (reached + 2 * near).tocoo()
    only = (marked.data == 1) & (marked.col != rows[marked.row])
    return sparse.csr_array(
        (marked.data[only], (marked.row[only], marked.col[only])), shape=near.shape
    )


def _likeness(matrix, rows, bump, inner):
    """Return the correlation of bumps with those of the vertices in a matrix's rows."""
    own = np.repeat(rows, np.diff(matrix.indptr))
    both = inner[matrix.indices]
    a, b = bump[own[both]], bump[matrix.indices[both]]
    scale = np.sqrt(float((a * a).sum()) * float((b * b).sum()))
    return float((a * b).sum()) / scale if scale > 0 else 1.0


def is_stepped(mesh: Triangles, bumps: Bumps) -> bool:
    """Whether a mesh is made of the steps of voxels.

    Its vertices stand out far, and not as their neighbors do, while nearly all of its
    faces look in a few directions.
    """
    if (
        len(mesh.faces) < _STEP_FACES
        or bumps.height < _STEP_HEIGHT
        or bumps.median < _STEP_MEDIAN * bumps.height
        or bumps.alike > _STEP_ALIKE
    ):
        return False
    grid = np.rint(50 * mesh.normals).astype(np.int64) + 50
    key = np.bincount(grid @ np.array([101 * 101, 101, 1]))
    share = np.cumsum(np.sort(key)[::-1]) / len(mesh.faces)
    return bool(np.searchsorted(share, 0.98) < _STEP_DIRECTIONS * len(mesh.faces))


def noise_of(bumps: Bumps, *, stepped: bool) -> float:
    """Return the independent noise, in edges, that does as much harm as there is."""
    return (_STEP_NOISE if stepped else 1.0) * bumps.noise


def edge_misfit(
    points: FloatArray, edges: tuple[IntArray, IntArray], fields: Sequence[FloatArray]
) -> FloatArray:
    """Return how badly fields of normals fit the edges at each vertex.

    On spheres, and on all surfaces up to third order, an edge is at right angles to
    the sum of the normals at its ends.

    Parameters
    ----------
    edges : two (e,) int
    fields : f of (n, 3)

    Returns
    -------
    (n, f) float64, the sum over a vertex's edges of the squared sines by which the
    mean of the normals at both ends leans along the edge.
    """
    i, j = edges
    square = squares(points[j] - points[i])
    leans = _leans(points, edges, fields)
    leans *= leans
    np.divide(leans, 4 * square, out=leans, where=square > 0)
    count = len(points)
    at_ends = [np.bincount(i, a, count) + np.bincount(j, a, count) for a in leans]
    return np.stack(at_ends, axis=1)


def mesh_misfit(mesh: Triangles, fields: Sequence[FloatArray]) -> list[float]:
    """Return how badly fields of normals (n, 3) fit the edges of a whole mesh.

    The sums of the squared leans of `edge_misfit` times the squared length and the
    cotangent of the angle across, so that edges which cut a flat quadrilateral in two
    do not count: where they run is chance.
    """
    total = [0.0] * len(fields)
    points, faces, sides = mesh.points, mesh.faces, mesh.sides
    whole, half = mesh.doubled_areas > 0, sides.sum(axis=1) / 2
    for corner in range(3):
        here, after = faces[:, (corner + 1) % 3], faces[:, (corner + 2) % 3]
        # The cosine and the sine, both times the sides beside the corner.
        share = np.maximum(half - sides[:, corner], 0)
        np.divide(share, mesh.doubled_areas, out=share, where=whole)
        share[~whole] = 0
        leans = _leans(points, (here, after), fields)
        for row, lean in enumerate(leans):
            total[row] += float(np.einsum("i,i,i->", share, lean, lean))
    return total


def _leans(points, edges, fields):
    """Return how the sums of normals at both ends lean along edges, (f, e)."""
    i, j = edges
    result = np.zeros((len(fields), len(i)))
    # Axis by axis: arrays of vectors would be three times as large.
    for axis in range(3):
        along = points[j, axis] - points[i, axis]
        for row, normals in enumerate(fields):
            result[row] += (normals[i, axis] + normals[j, axis]) * along
    return result
