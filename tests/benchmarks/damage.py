# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes made worse, and the true normals at their corners.

Noise, quantization, slivers and flips keep the faces of the clean mesh: the truth is
the normal of the clean vertex. Decimated, remeshed and voxel meshes have new ones: the
truth is that of the nearest place of the exact surface.
"""

from dataclasses import dataclass

import numpy as np
from cylinders import cylinder_normals
from solid import paired_sides
from solids import box_of, surface_net, voxel_grid

from core.mesh.faces import Triangles, face_vectors, split_fans, unit, vertex_normals

NOISE = (0.05, 0.1, 0.3, 0.6, 1.0)
KEPT = (50, 25, 10)
BITS = (12, 10, 8)
# Edges between faces that turn by more are sharp where the clean mesh cannot say.
SHARP_ANGLE = np.radians(30)


@dataclass(frozen=True)
class Case:
    """A mesh to repair.

    Attributes
    ----------
    points, faces : (n, 3) float64, (m, 3) int
    truth : (m, 3, 3) float64
        The true normals at the corners.
    sharp : (e, 2) int
        The edges that part the mesh, known to all methods.
    exact : (m, 3, 3) float64 or None
        The normals of cylinders that the clean mesh was sampled from, zero elsewhere.
    """

    shape: str
    damage: str
    points: np.ndarray
    faces: np.ndarray
    truth: np.ndarray
    sharp: np.ndarray
    exact: np.ndarray | None = None

    @property
    def name(self):
        return f"{self.shape}, {self.damage}"


NONE = np.empty((0, 2), dtype=np.int64)


def cases_of(solid):
    """Yield the solid's mesh, clean and made worse in each way that suits it."""
    points, faces = solid.points, solid.faces
    truth = solid.corner_truth(points, faces, solid.piece)
    sharp = solid.sharp_edges() if solid.creased else NONE

    def case(damage, p=points, f=faces, t=truth, s=sharp):
        return Case(solid.name, damage, p, f, t, s)

    yield case("clean")
    for share in NOISE:
        yield case(f"noise {share:g}", noisy(points, faces, share))
    for bits in BITS:
        yield case(f"{bits} bits", quantized(points, bits))
    thin = slivers(points, faces, sharp)
    yield case("slivers", f=thin, t=solid.corner_truth(points, thin, solid.piece))
    turned = flipped(faces)
    order = np.where(turned[:, None], [0, 2, 1], [0, 1, 2])
    yield case(
        "flips",
        f=np.take_along_axis(faces, order, axis=1),
        t=np.take_along_axis(truth, order[:, :, None], axis=1),
    )
    for percent in KEPT:
        p, f = decimated(points, faces, percent)
        yield _of_new_mesh(solid, f"{percent} %", p, f)
    if solid.field is not None:
        box, cells = box_of(solid.field), solid.cells
        yield _of_new_mesh(solid, "remesh", *surface_net(solid.field, box, cells))
        for name, count in (("coarse stairs", cells), ("fine stairs", 2 * cells)):
            mesh = staircase(solid.field, box, count)
            yield _of_new_mesh(solid, name, *mesh)


def _of_new_mesh(solid, damage, points, faces):
    piece = solid.pieces_near(points, faces)
    truth = solid.corner_truth(points, faces, piece)
    sharp = sharp_by_angle(points, faces) if solid.creased else NONE
    return Case(solid.name, damage, points, faces, truth, sharp)


def sharp_by_angle(points, faces, angle=SHARP_ANGLE):
    """Return the edges (e, 2) between faces that turn by more than an angle."""
    ends, first, second = paired_sides(faces)
    normals = unit(face_vectors(points, faces))
    return ends[(normals[first] * normals[second]).sum(axis=1) < np.cos(angle)]


def noisy(points, faces, share, seed=None):
    """Add Gaussian noise whose standard deviation is a share of the mean edge."""
    rng = np.random.default_rng(round(100 * share) if seed is None else seed)
    edge = Triangles(points, faces).mean_edge
    return points + rng.normal(0, share * edge, points.shape)


def quantized(points, bits):
    """Round coordinates to a grid of 2^bits steps along the longest side."""
    low = points.min(axis=0)
    step = np.ptp(points, axis=0).max() / (2**bits - 1)
    return low + step * np.rint((points - low) / step)


def flipped(faces, share=0.1):
    """Choose a tenth of the faces, a half of them alone and a half around a place."""
    rng = np.random.default_rng(11)
    chosen = rng.random(len(faces)) < share / 2
    chosen[: int(share / 2 * len(faces))] = True
    return chosen


def slivers(points, faces, sharp, rounds=4):
    """Turn edges so that triangles become thin, over the same vertices.

    An edge turns where the two triangles beside it then have a smaller least angle and
    still face as before; sharp edges stay.

    Returns
    -------
    (m, 3) int, each on the piece of the face in its row
    """
    faces = faces.copy()
    kept = {tuple(edge) for edge in np.sort(sharp, axis=1).tolist()}
    before = unit(face_vectors(points, faces))
    for turn in range(rounds):
        ends, one, two = paired_sides(faces)
        known = {tuple(edge) for edge in ends.tolist()}
        order = np.random.default_rng(turn).permutation(len(ends))
        touched = np.zeros(len(faces), dtype=bool)
        for edge in order:
            f, g = one[edge], two[edge]
            a, b = ends[edge]
            if touched[f] or touched[g] or (a, b) in kept:
                continue
            c, d = (next(v for v in faces[h] if v not in (a, b)) for h in (f, g))
            if (min(c, d), max(c, d)) in known or c == d:
                continue
            i = list(faces[f]).index(a)
            if faces[f][(i + 1) % 3] != b:
                a, b = b, a
            new = np.array([[c, a, d], [d, b, c]])
            old_least = _least_angle(points[faces[[f, g]]])
            normals = unit(face_vectors(points, new))
            least = _least_angle(points[new])
            level = (normals @ before[[f, g]].T).min()
            if least < old_least and least > np.radians(1) and level > 0.7:
                faces[[f, g]] = new
                touched[[f, g]] = True
                known.add((min(c, d), max(c, d)))
    return faces


def _least_angle(corners):
    """Return the least angle of triangles (m, 3, 3)."""
    a, b = (np.roll(corners, -i, axis=1) - corners for i in (1, 2))
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=2), (a * b).sum(2)).min()


def decimated(points, faces, percent):
    """Collapse edges by quadric errors, as decimating modifiers do."""
    import pymeshlab

    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(points, faces))
    meshes.meshing_decimation_quadric_edge_collapse(
        targetfacenum=len(faces) * percent // 100, preservenormal=True
    )
    mesh = meshes.current_mesh()
    return mesh.vertex_matrix(), mesh.face_matrix().astype(np.int64)


def staircase(field, box, cells):
    """Return the marching cubes of full and empty cells."""
    from skimage.measure import marching_cubes

    grid, step = voxel_grid(box, cells)
    full = (field(grid.reshape(-1, 3)) < 0).reshape(grid.shape[:3])
    points, faces, _, _ = marching_cubes(full.astype(np.float32), 0.5)
    points = grid[0, 0, 0] + step * points.astype(float)
    middle = points[faces].mean(axis=1)
    center = points.mean(axis=0)
    volume = (face_vectors(points, faces) * (middle - center)).sum()
    return points, (faces if volume > 0 else faces[:, ::-1]).astype(np.int64)


def cases_of_file(name, points, faces):
    """Yield a given mesh made worse; its own normals are the truth.

    Those of the faces around each vertex, weighted by angle, on either side of edges
    that turn by more than SHARP_ANGLE where the mesh is a part with creases.
    """
    sharp = sharp_by_angle(points, faces) if name in CREASED_FILES else NONE
    fans, vertex = split_fans(len(points), faces, sharp)
    truth = vertex_normals(points[vertex], fans, weights="angle")[fans]
    exact = cylinder_normals(points[vertex], fans)[fans] if len(sharp) else None

    def case(damage, p=points, f=faces, t=truth, s=sharp, e=exact):
        return Case(name, damage, p, f, t, s, e)

    for share in NOISE:
        yield case(f"noise {share:g}", noisy(points, faces, share))
    for bits in BITS:
        yield case(f"{bits} bits", quantized(points, bits))
    turned = flipped(faces)
    order = np.where(turned[:, None], [0, 2, 1], [0, 1, 2])

    def reordered(normals):
        return np.take_along_axis(normals, order[:, :, None], axis=1)

    yield case(
        "flips",
        f=np.take_along_axis(faces, order, axis=1),
        t=reordered(truth),
        e=None if exact is None else reordered(exact),
    )
    scene = _scene(points, faces)
    for percent in KEPT:
        p, f = decimated(points, faces, percent)
        place = _places_near(scene, p, f)
        yield case(
            f"{percent} %",
            p,
            f,
            _normals_at(truth, place),
            sharp_by_angle(p, f) if len(sharp) else NONE,
            None if exact is None else _normals_at(exact, place),
        )


CREASED_FILES = ("fandisk",)


def _scene(points, faces):
    import open3d

    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(points.astype(np.float32), faces.astype(np.uint32))
    return scene


def _places_near(scene, points, faces):
    """Return the nearest places of a mesh to corners: rows of faces, shares.

    Looked for a little inside each face, so that creases are seen from its side.
    """
    corners = points[faces]
    inside = corners + 0.02 * (corners.mean(axis=1, keepdims=True) - corners)
    found = scene.compute_closest_points(inside.reshape(-1, 3).astype(np.float32))
    row = found["primitive_ids"].numpy().astype(np.int64)
    u, v = found["primitive_uvs"].numpy().astype(float).T
    return row, np.stack([1 - u - v, u, v], axis=1)


def _normals_at(normals, place):
    """Return normals (m, 3, 3) of a mesh at places, zero where a corner has none."""
    row, share = place
    known = (normals[row] != 0).any(axis=2).all(axis=1)
    found = unit((share[:, :, None] * normals[row]).sum(axis=1))
    return np.where(known[:, None], found, 0).reshape(-1, 3, 3)
