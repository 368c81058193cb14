# SPDX-License-Identifier: GPL-3.0-or-later
"""The rule of meshes, on a few of the meshes of tests/benchmarks/meshes.py."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

sys.path.append(str(Path(__file__).resolve().parents[1] / "benchmarks"))

import damage
import solids

from core import InputError, Settings, estimate_normals
from core.mesh.averages import Averages, area_vectors, ladder
from core.mesh.clean import Patched, best_clean
from core.mesh.creases import find_sharp_edges
from core.mesh.evidence import find_bumps
from core.mesh.faces import Triangles, corner_sums, split_fans, unit, vertex_normals
from core.mesh.shaken import best_smoothed


@pytest.fixture(scope="module")
def bumpy():
    return next(s for s in solids.smooth_solids() if s.name == "bumpy")


@pytest.fixture(scope="module")
def creased():
    return {solid.name: solid for solid in solids.creased_solids()}


def rms(normals, truth):
    """Return the root mean square angle in degrees."""
    cross = np.linalg.norm(np.cross(normals, truth), axis=-1)
    angle = np.degrees(np.arctan2(cross, (normals * truth).sum(axis=-1)))
    return np.sqrt((angle**2).mean())


def best_of_faces(points, faces, truth):
    """Return the least error of face normals weighted by area, by angle and by Max."""
    fields = [
        vertex_normals(points, faces, weights=kind) for kind in ("area", "angle", "max")
    ]
    return min(rms(field[faces], truth) for field in fields)


# What becomes of a mesh in each condition


def test_a_clean_smooth_mesh_takes_patches(bumpy):
    truth = bumpy.normals[0](bumpy.points)
    found = estimate_normals(bumpy.points, faces=bumpy.faces)
    assert found.mesh.kind == "clean"
    # Patches are third order here, means of faces first: 0.05 against 0.6 degrees.
    assert rms(found.normals, truth) < 0.1
    assert found.from_faces < 0.01 * len(truth)


@pytest.mark.parametrize(("share", "gain"), [(0.05, 1.4), (0.1, 2), (0.3, 3), (1, 3)])
def test_noise_is_found_and_averaged(bumpy, share, gain):
    points = damage.noisy(bumpy.points, bumpy.faces, share)
    truth = bumpy.normals[0](bumpy.points)
    found = estimate_normals(points, faces=bumpy.faces)
    assert found.mesh.kind == "noisy"
    # A vertex moved by more than half an edge folds its faces, and the mean edge of
    # the noisy mesh is longer: then the estimate comes out low.
    edge = Triangles(bumpy.points, bumpy.faces).mean_edge
    assert 0.7 * share < found.noise / edge < 1.1 * share
    best = best_of_faces(points, bumpy.faces, truth[bumpy.faces])
    assert rms(found.normals[bumpy.faces], truth[bumpy.faces]) < best / gain


def test_slivers_over_the_same_vertices_are_seen_through(bumpy):
    faces = damage.slivers(bumpy.points, bumpy.faces, damage.NONE, rounds=2)
    truth = bumpy.normals[0](bumpy.points)[faces]
    found = estimate_normals(bumpy.points, faces=faces)
    best = best_of_faces(bumpy.points, faces, truth)
    assert rms(found.corner_normals, truth) < best / 2


def test_the_steps_of_voxels_are_averaged():
    def ball(p):
        return np.linalg.norm(p, axis=1) - 1

    # Full or empty, so that vertices are in the middle of cells' edges.
    def steps(p):
        return np.where(ball(p) < 0, -1.0, 1.0)

    points, faces = solids.surface_net(steps, solids.box_of(ball), 40)
    truth = unit(points)
    found = estimate_normals(points, faces=faces)
    assert found.mesh.kind == "stepped"
    best = best_of_faces(points, faces, truth[faces])
    assert rms(found.normals[faces], truth[faces]) < best / 2


@pytest.mark.parametrize("name", ["cube", "cam", "spool"])
@pytest.mark.parametrize("parted", [True, False])
def test_creases_are_neither_noise_nor_steps(creased, name, parted):
    solid = creased[name]
    sharp = solid.sharp_edges() if parted else None
    found = estimate_normals(solid.points, faces=solid.faces, sharp=sharp)
    assert found.mesh.kind == "clean"
    assert found.noise == 0


@pytest.mark.parametrize("name", ["cube", "L-shape"])
def test_planes_stay_exact(creased, name):
    solid = creased[name]
    truth = solid.corner_truth(solid.points, solid.faces, solid.piece)
    settings = Settings(sharp_angle=np.radians(30))
    found = estimate_normals(solid.points, faces=solid.faces, settings=settings)
    assert_allclose(found.corner_normals, truth, atol=1e-7)


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_noise_beside_creases(creased, share):
    solid = creased["cam"]
    truth = solid.corner_truth(solid.points, solid.faces, solid.piece)
    sharp = solid.sharp_edges()
    points = damage.noisy(solid.points, solid.faces, share)
    found = estimate_normals(points, faces=solid.faces, sharp=sharp)
    fans, vertex = split_fans(len(points), solid.faces, sharp)
    best = best_of_faces(points[vertex], fans, truth)
    assert rms(found.corner_normals, truth) < best / (3 if share > 0.2 else 1.5)


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_flat_pieces_are_averaged_far(creased, share):
    solid = creased["cube"]
    truth = solid.corner_truth(solid.points, solid.faces, solid.piece)
    points = damage.noisy(solid.points, solid.faces, share)
    found = estimate_normals(points, faces=solid.faces, sharp=solid.sharp_edges())
    fans, vertex = split_fans(len(points), solid.faces, solid.sharp_edges())
    best = best_of_faces(points[vertex], fans, truth)
    # A side has 289 vertices: the mean of as many normals would be 17 times better.
    assert rms(found.corner_normals, truth) < best / 10


def test_the_result_does_not_depend_on_threads_scale_and_place(bumpy):
    points = damage.noisy(bumpy.points, bumpy.faces, 0.3)
    one = estimate_normals(points, faces=bumpy.faces, settings=Settings(threads=1))
    two = estimate_normals(points, faces=bumpy.faces, settings=Settings(threads=2))
    assert_array_equal(one.normals, two.normals)
    far = estimate_normals(1e-3 * points + [5e3, 0, 1e3], faces=bumpy.faces)
    # Rounding of coordinates may tip a vertex between two candidates.
    assert rms(far.normals, one.normals) < 0.1


# Winding


def test_flipped_faces_do_not_cancel_their_neighbors(bumpy):
    turned = damage.flipped(bumpy.faces)
    faces = np.where(turned[:, None], bumpy.faces[:, ::-1], bumpy.faces)
    whole = estimate_normals(bumpy.points, faces=bumpy.faces)
    found = estimate_normals(bumpy.points, faces=faces)
    assert_allclose(found.normals, whole.normals, atol=1e-9)
    assert found.orientation.inconsistent > 0
    corners = np.where(
        turned[:, None, None], whole.corner_normals[:, ::-1], whole.corner_normals
    )
    assert_allclose(found.corner_normals, corners, atol=1e-9)


def test_a_mesh_that_winds_inward_all_over_stays_so(bumpy):
    found = estimate_normals(bumpy.points, faces=bumpy.faces[:, ::-1])
    assert ((found.normals * bumpy.points).sum(axis=1) < 0).all()


# Creases


def test_sharp_edges_by_angle(creased):
    solid = creased["cube"]
    found = find_sharp_edges(solid.points, solid.faces, np.radians(30))
    # Twelve edges of sixteen squares each.
    assert len(found) == 12 * 16
    middle = np.abs(solid.points[found].mean(axis=1))
    assert ((middle == 1).sum(axis=1) == 2).all()
    assert len(find_sharp_edges(solid.points, solid.faces, np.radians(91))) == 0


def test_edges_of_three_faces_are_sharp():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]])
    faces = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    assert_array_equal(find_sharp_edges(points, faces, 3.0), [[0, 1]])


def test_corner_normals_without_creases_are_those_of_the_vertices(bumpy):
    found = estimate_normals(bumpy.points, faces=bumpy.faces)
    assert_array_equal(found.corner_normals, found.normals[bumpy.faces])
    assert estimate_normals(bumpy.points).corner_normals is None


@pytest.mark.parametrize(
    ("sharp", "message"),
    [([[0, 1, 2]], r"shape \(e, 2\)"), ([[0, 9999]], "0 to 1537"), ([[0.5, 1]], "int")],
)
def test_bad_sharp_edges(creased, sharp, message):
    solid = creased["cube"]
    with pytest.raises(InputError, match=message):
        estimate_normals(solid.points, faces=solid.faces, sharp=sharp)


def test_bad_sharp_angle():
    with pytest.raises(InputError, match="sharp_angle"):
        Settings(sharp_angle=4.0)


# What meshes may look like


def test_loose_vertices_borders_and_faces_without_area(bumpy):
    half = bumpy.points[bumpy.faces].mean(axis=1)[:, 2] > 0
    faces = bumpy.faces[half]
    loose = ~np.isin(np.arange(len(bumpy.points)), faces)
    folded = np.array([[faces[0, 0], faces[0, 1], faces[0, 1]]])
    points = damage.noisy(bumpy.points, faces, 0.3)
    found = estimate_normals(points, faces=np.concatenate([faces, folded]))
    assert_array_equal(found.valid, ~loose)
    assert (found.normals[loose] == 0).all()
    truth = bumpy.normals[0](bumpy.points)
    assert rms(found.normals[~loose], truth[~loose]) < 7


def test_a_mesh_of_one_triangle():
    found = estimate_normals(np.eye(3), faces=[[0, 1, 2]])
    assert_allclose(found.normals, np.full((3, 3), 3**-0.5))


# The parts of it


def test_means_leave_constant_fields_and_loose_vertices_alone(bumpy):
    averages = Averages(len(bumpy.points) + 1, bumpy.faces)
    values = np.append(np.full(len(bumpy.points), 2.0), 7.0)[:, None]
    assert_allclose(averages.means(values, 5), values, rtol=1e-6)
    assert averages.degree[-1] == 0
    assert averages.inner[:-1].all()
    assert not averages.inner[-1]


def test_a_ladder_on_a_plane_stays_on_it():
    points = np.array([[x, y, 0.0] for x in range(6) for y in range(6)])
    corner = np.array([6 * x + y for x in range(5) for y in range(5)])
    faces = np.concatenate(
        [
            np.stack([corner, corner + 6, corner + 7], axis=1),
            np.stack([corner, corner + 7, corner + 1], axis=1),
        ]
    )
    mesh = Triangles(points, faces)
    averages = Averages(36, faces)
    sums = corner_sums(mesh.vectors, faces, 36).astype(np.float32)
    rounds = []
    for count, plain, sharpened in ladder(averages, sums):
        rounds.append(count)
        assert_allclose(plain, np.tile([0, 0, 1.0], (36, 1)))
        if sharpened is not None:
            assert_allclose(np.abs(sharpened[:, 2]), 1)
    assert rounds == [0, 1, 2, 4, 8, 16, 32, 64]


@pytest.fixture
def patched(bumpy):
    """A clean mesh, and patches that pass everywhere: its true normals."""
    mesh = Triangles(bumpy.points, bumpy.faces)
    count = len(mesh.points)
    return mesh, Patched(
        bumpy.normals[0](bumpy.points),
        np.full(count, 1e-6),
        np.full(count, 0.01),
        np.zeros(count, dtype=bool),
        0.01,
    )


def test_patches_count_where_most_around_pass(patched):
    mesh, patches = patched
    averages = Averages(len(mesh.points), mesh.faces)
    alone = best_clean(mesh, averages, patches)
    assert alone.from_patch.all()
    assert_allclose(alone.normals, patches.normals, atol=1e-12)
    # Every tenth alone is a pass by chance.
    few = np.where(np.arange(len(mesh.points)) % 10, np.inf, patches.share)
    chosen = best_clean(mesh, averages, replace(patches, share=few))
    assert not chosen.from_patch.any()
    means = [mesh.vertex_normals(kind) for kind in ("angle", "max")]
    # A mix of both, no patch in it: in the plane of the two.
    volume = np.einsum("ij,ij->i", chosen.normals, np.cross(*means))
    assert_allclose(volume, 0, atol=1e-12)


@pytest.mark.parametrize("share", [0.3, 0.7])
def test_patches_tell_how_to_weigh_faces(patched, share):
    mesh, patches = patched
    averages = Averages(len(mesh.points), mesh.faces)
    angle, largest = (mesh.vertex_normals(kind) for kind in ("angle", "max"))
    rng = np.random.default_rng(5)
    wrong = 1e-3 * rng.normal(size=angle.shape)
    mix = share * angle + (1 - share) * largest
    # None passes: at 0.05 of what faces turn they are too far from their vertices.
    asked = replace(
        patches,
        normals=unit(mix + wrong),
        misfit=np.zeros(len(mix)),
        share=np.full(len(mix), 0.05),
    )
    found = best_clean(mesh, averages, asked)
    # The end pieces of 0.05 are cut off, and errors of a milliradian average out.
    cut = (share - 0.05) / 0.9
    expected = unit(cut * angle + (1 - cut) * largest)
    assert_allclose(found.normals, expected, atol=2e-4)
    assert found.weights == ("angle" if share > 0.5 else "max")


def test_small_meshes_and_large_ones_are_smoothed_alike(bumpy, monkeypatch):
    """One shake, as a million triangles get, costs little where all is one piece."""
    points = damage.noisy(bumpy.points, bumpy.faces, 0.3)
    mesh = Triangles(points, bumpy.faces)
    averages = Averages(len(points), bumpy.faces)
    truth = bumpy.normals[0](bumpy.points)
    clean = best_clean(mesh, averages, None)
    errors = []
    for most in (8, 1):
        monkeypatch.setattr("core.mesh.shaken._SHAKES", most)
        shake = 0.3 * mesh.mean_edge
        normals, smooth = best_smoothed(
            mesh, averages, area_vectors(mesh), clean, shake
        )
        assert smooth.mean() > 0.99
        errors.append(rms(normals, truth))
    assert errors[0] < errors[1] < 1.1 * errors[0]


def test_bumps_of_noise_are_unlike_their_neighbors(bumpy):
    """Independent bumps have -2/6 of the variance of a vertex in common, and 2/36."""
    rng = np.random.default_rng(2)
    averages = Averages(len(bumpy.points), bumpy.faces)
    up = bumpy.normals[0](bumpy.points)
    flat = Triangles(1e-3 * rng.normal(size=(len(up), 1)) * up, bumpy.faces)
    bumps = find_bumps(flat, averages, up)
    assert bumps.alike == pytest.approx(-0.24, abs=0.08)
    assert bumps.noisy
    smooth = find_bumps(Triangles(bumpy.points, bumpy.faces), averages, up)
    assert smooth.alike > 0.9
    assert not smooth.noisy
    assert smooth.noise == 0
