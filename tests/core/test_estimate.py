# SPDX-License-Identifier: GPL-3.0-or-later
"""The pipeline: accuracy against exact normals, invariances, and bad input."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, Delaunay

from core import InputError, Settings, compare_normals, estimate_normals, shapes
from core.mesh.faces import Triangles, vertex_normals
from core.neighborhoods import unique_points

TIME_SCALE = Settings(method="time_scale")
PAPER = Settings(method="paper")
METHODS = [
    TIME_SCALE,
    PAPER,
    Settings(),
    Settings(method="time_scale", weights="paper"),
]


def angles(estimate, truth):
    return compare_normals(estimate, truth).angle_deviation


def rotation(seed):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


@pytest.mark.parametrize("setting", METHODS, ids=lambda s: f"{s.method}-{s.weights}")
def test_a_plane_is_exact(setting):
    points, _normals, _ = shapes.PLANE.sample(300, 1)
    tilt = rotation(0) if setting.method != "paper" else rotation_about_y(0.4)
    estimate = estimate_normals(points @ tilt.T, settings=setting)
    assert estimate.valid.all()
    # A plane is a patch with two terms; what is left is rounding and the ridge.
    np.testing.assert_allclose(np.abs(estimate.normals @ tilt[:, 2]), 1, atol=1e-12)


def rotation_about_y(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


@pytest.mark.parametrize(
    ("name", "n", "bound"),
    # Twice what was measured over ten seeds, in degrees.
    [("sphere", 2000, 0.02), ("torus", 3000, 0.7), ("paraboloid", 1000, 1.0)],
)
def test_smooth_surfaces(name, n, bound):
    points, normals, _ = shapes.ALL[name].sample(n, 1)
    estimate = estimate_normals(points, settings=TIME_SCALE)
    assert estimate.valid.all()
    assert np.sqrt((angles(estimate, normals) ** 2).mean()) < bound


def test_closed_surfaces_point_outward():
    for shape in (shapes.SPHERE, shapes.TORUS, shapes.BUMPY):
        points, normals, _ = shape.sample(2000, 4)
        estimate = estimate_normals(points)
        assert ((estimate.normals * normals).sum(axis=1) > 0).all()
        assert estimate.pieces == 1


def test_refining_a_smooth_surface_has_order_two_or_more():
    """Slopes of a biquadratic patch err by h^2 of the third derivatives."""
    error = []
    for n in (1000, 4000):
        points, normals, _ = shapes.TORUS.sample(n, 0)
        found = estimate_normals(points, settings=TIME_SCALE)
        error.append(np.median(angles(found, normals)))
    # Four times the points halve the spacing: a ratio of 4 at order two.
    assert error[0] / error[1] > 3.5


def test_auto_widens_its_reach_under_noise():
    points, normals, _ = shapes.SPHERE.sample(4000, 1)
    noisy = shapes.add_noise(points, 0.005, seed=2)
    clean, rough = estimate_normals(points), estimate_normals(noisy)
    assert clean.settings.neighbors < 40 < rough.settings.neighbors
    fixed = estimate_normals(noisy, settings=TIME_SCALE)
    assert angles(rough, normals).mean() < angles(fixed, normals).mean() / 4


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 100), st.sampled_from([1e-6, 1e-3, 1.0, 1e6]))
def test_rotation_and_scale(seed, scale):
    points, _, _ = shapes.TORUS.sample(300, seed, even=False)
    turn = rotation(seed)
    here = estimate_normals(points, settings=TIME_SCALE)
    there = estimate_normals(scale * points @ turn.T, settings=TIME_SCALE)
    # Rounding, magnified by the condition of sparse random neighborhoods.
    assert angles(there, here.normals @ turn.T).max() < 1e-4


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 100))
def test_translation_by_a_million(seed):
    points, _, _ = shapes.TORUS.sample(300, seed)
    here = estimate_normals(points)
    there = estimate_normals(points + [1000000.0, -1000000.0, 1000000.0])
    # Coordinates at 1e6 are rounded to 1e-10, edges are 0.1 long; what nets are told
    # is in single precision.
    turned = angles(there, here.normals)
    assert np.quantile(turned, 0.9) < 1e-3
    assert turned.max() < 0.1
    assert ((here.normals * there.normals).sum(axis=1) > 0).all()


@pytest.mark.parametrize("setting", METHODS, ids=lambda s: f"{s.method}-{s.weights}")
def test_order_of_the_points_does_not_matter(setting):
    points, _, _ = shapes.BUMPY.sample(500, 2)
    order = np.random.default_rng(0).permutation(500)
    here = estimate_normals(points, settings=setting).normals[order]
    there = estimate_normals(points[order], settings=setting).normals
    # Sums run in another order.
    np.testing.assert_allclose(there, here, atol=1e-7)


def test_threads_and_chunks_do_not_matter(monkeypatch):
    points, _, _ = shapes.BUMPY.sample(20_000, 2, even=False)
    one, two = (
        estimate_normals(
            points, settings=Settings(method="time_scale", threads=threads)
        )
        for threads in (1, 3)
    )
    np.testing.assert_array_equal(one.normals, two.normals)
    monkeypatch.setattr("core.neighborhoods._CHUNK", 1000)
    small = estimate_normals(points, settings=TIME_SCALE)
    np.testing.assert_allclose(small.normals, one.normals, atol=1e-12)


def test_single_precision_costs_no_accuracy(monkeypatch):
    points, normals, _ = shapes.BUMPY.sample(30_000, 2, even=False)
    double = estimate_normals(points, settings=TIME_SCALE)
    monkeypatch.setattr("core.patches.patch._DOUBLE_UP_TO", 0)
    single = estimate_normals(points, settings=TIME_SCALE)
    a, b = (np.sqrt((angles(e, normals) ** 2).mean()) for e in (single, double))
    assert a < 1.05 * b


def test_float32_input_and_large_offsets():
    points, normals, _ = shapes.SPHERE.sample(3000, 0)
    assert angles(estimate_normals(points.astype(np.float32)), normals).max() < 0.2
    utm = points + [448000.0, 4630000.0, 120.0]
    assert angles(estimate_normals(utm), normals).max() < 0.1


# Meshes


def tetrahedron():
    points = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    return points, np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])


def test_a_small_mesh_takes_the_normals_of_its_faces():
    points, faces = tetrahedron()
    estimate = estimate_normals(points, faces=faces)
    assert estimate.valid.all()
    assert estimate.from_faces == 4
    np.testing.assert_allclose(estimate.normals, points / np.sqrt(3), atol=1e-12)


def test_a_mesh_is_oriented_by_its_faces():
    points, normals, parameters = shapes.PARABOLOID.sample(800, 0)
    faces = Delaunay(parameters).simplices
    a, b, c = (points[faces[:, i]] for i in range(3))
    up = np.cross(b - a, c - a)[:, 2] > 0
    faces[up] = faces[up][:, ::-1]
    estimate = estimate_normals(points, faces=faces)
    assert estimate.settings.graph == "mesh"
    assert estimate.settings.orientation == "faces"
    assert (estimate.normals[:, 2] < 0).all()
    # Twice what was measured over ten seeds.
    assert np.median(angles(estimate, normals)) < 0.3


def test_loose_vertices_and_degenerate_faces():
    points, _, parameters = shapes.PARABOLOID.sample(300, 0)
    faces = Delaunay(parameters).simplices
    faces = np.concatenate([faces, [[0, 0, 1], [5, 5, 5]]])
    loose = np.array([[9.0, 9, 9], [9, 9, 10]])
    estimate = estimate_normals(np.concatenate([points, loose]), faces=faces)
    assert estimate.valid[:300].all()
    assert not estimate.valid[300:].any()
    assert (estimate.normals[300:] == 0).all()


def test_two_sheets_of_a_mesh_do_not_mix():
    """Mesh rings stay on a sheet where nearest points jump to the other."""
    points, normals, parameters = shapes.PARABOLOID.sample(600, 0)
    faces = Delaunay(parameters).simplices
    both = np.concatenate([points, points + [0, 0, 0.02]])
    two = np.concatenate([faces, faces + 600])
    mesh = estimate_normals(both, faces=two, settings=TIME_SCALE)
    cloud = estimate_normals(both, settings=TIME_SCALE)
    truth = np.concatenate([normals, normals])
    assert np.median(angles(mesh, truth)) < np.median(angles(cloud, truth)) / 10


def bumpy_mesh(n, noise, seed=0):
    """A closed mesh over a bumpy sphere, vertices moved by a share of an edge."""
    points, normals, _ = shapes.BUMPY.sample(n, seed)
    directions = points / np.linalg.norm(points, axis=1, keepdims=True)
    faces = ConvexHull(directions).simplices.astype(np.int64)
    a, b, c = (directions[faces[:, i]] for i in range(3))
    inward = (np.cross(b - a, c - a) * (a + b + c)).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    edge = Triangles(points, faces).mean_edge
    shift = np.random.default_rng(seed).normal(0, noise * edge, points.shape)
    return points + shift, normals, faces


def rms(values):
    return np.sqrt((values**2).mean())


@pytest.mark.parametrize("n", [300, 1000, 8000])
def test_a_mesh_is_not_made_worse(n):
    """From coarse to fine, against the angle-weighted normals of the faces."""
    points, truth, faces = bumpy_mesh(n, 0)
    found = rms(angles(estimate_normals(points, faces=faces), truth))
    faces_alone = vertex_normals(points, faces, weights="angle")
    assert found <= 1.02 * rms(angles(faces_alone, truth))


@pytest.mark.parametrize("rows", [2, 3, 5])
@pytest.mark.parametrize("sides", [8, 24, 256])
def test_a_tube_of_few_rows_keeps_its_normals(rows, sides):
    """Between two circles a patch has room to turn out of the faces."""
    turn = np.arange(sides) * 2 * np.pi / sides
    circle = np.stack([np.cos(turn), np.sin(turn), np.zeros(sides)], axis=1)
    points = np.concatenate([circle + [0, 0, z] for z in np.linspace(-1, 1, rows)])
    i = np.arange(sides)
    j = (i + 1) % sides
    band = np.concatenate(
        [
            np.stack([i, j, j + sides], axis=1),
            np.stack([i, j + sides, i + sides], axis=1),
        ]
    )
    faces = np.concatenate([band + sides * row for row in range(rows - 1)])
    found = estimate_normals(points, faces=faces)
    # By symmetry the faces' mean is exact but for their diagonals, at the rims a
    # third of the angle between two sides.
    bound = 360 / sides / 3 + 0.01
    assert angles(found, points * [1, 1, 0]).max() < bound


def test_a_fine_mesh_is_made_better():
    points, truth, faces = bumpy_mesh(8000, 0)
    found = rms(angles(estimate_normals(points, faces=faces), truth))
    faces_alone = vertex_normals(points, faces, weights="angle")
    assert found < rms(angles(faces_alone, truth)) / 3


def test_a_noisy_mesh_is_made_better():
    points, truth, faces = bumpy_mesh(8000, 0.3)
    found = rms(angles(estimate_normals(points, faces=faces), truth))
    faces_alone = vertex_normals(points, faces, weights="angle")
    assert found < rms(angles(faces_alone, truth)) / 3


# Data that is not nice


def test_twins_count_once():
    points, _, _ = shapes.TORUS.sample(500, 0)
    twice = np.concatenate([points, points[::-1], points])
    single, many = estimate_normals(points), estimate_normals(twice)
    assert many.valid.all()
    np.testing.assert_allclose(many.normals[:500], single.normals, atol=1e-9)
    np.testing.assert_array_equal(many.normals[:500], many.normals[999:499:-1])


@given(st.lists(st.integers(0, 3), min_size=1, max_size=30))
def test_unique_points(values):
    points = np.array(values, dtype=float)[:, None] * [1.0, -1.0, 0.0]
    kept, inverse = unique_points(points)
    if kept is None:
        assert len(set(values)) == len(values)
        return
    np.testing.assert_array_equal(points[kept][inverse], points)
    assert len(kept) == len(set(values))
    assert (np.diff(kept) > 0).all()


def test_a_line_beside_a_surface_is_not_valid():
    points, _normals, _ = shapes.SPHERE.sample(800, 0)
    line = np.linspace(0, 1, 60)[:, None] * [0.0, 0, 1.0] + [5, 0, 0]
    estimate = estimate_normals(np.concatenate([points, line]), settings=TIME_SCALE)
    assert estimate.valid[:800].all()
    assert not estimate.valid[800:].any()
    assert estimate.summary()["invalid"] == 60


def test_radius_leaves_lonely_points_invalid():
    points, _, _ = shapes.SPHERE.sample(800, 0)
    lonely = np.array([[9.0, 0, 0]])
    setting = Settings(method="time_scale", radius=0.5)
    estimate = estimate_normals(np.concatenate([points, lonely]), settings=setting)
    assert estimate.valid[:-1].all()
    assert not estimate.valid[-1]


def test_a_noisy_plane_in_single_precision_is_valid():
    points, _, _ = shapes.PLANE.sample(500, 0)
    flat = (points @ rotation(3).T).astype(np.float32)
    estimate = estimate_normals(flat)
    assert estimate.valid.all()
    assert angles(estimate, np.tile(rotation(3)[:, 2], (500, 1))).max() < 0.01


GRID = np.stack(np.meshgrid(*[np.arange(4.0)] * 2), axis=-1).reshape(-1, 2)
FLAT = np.concatenate([GRID, np.zeros((16, 1))], axis=1)


def test_a_regular_grid():
    for setting in METHODS:
        estimate = estimate_normals(FLAT, settings=setting)
        assert estimate.valid.all()
        np.testing.assert_allclose(np.abs(estimate.normals[:, 2]), 1)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((0, 3)), "at least 1 points, got 0"),
        (np.eye(3), "at least 9 points.*got 3"),
        (np.zeros((20, 2)), r"\(n, 3\)"),
        (np.zeros(20), r"\(n, 3\)"),
        (np.where(np.eye(20, 3) > 0, np.nan, FLAT[:1]), "3 of 20 rows.*row 0"),
        (np.where(np.eye(20, 3) > 0, np.inf, 0), "finite"),
        (np.ones((20, 3)), "20 in one place"),
        (np.arange(20)[:, None] * [1.0, 2, 3] + 0.3, "on one line"),
        (
            (np.arange(20)[:, None] * [0.1, 0.2, 0.7] + 0.3).astype(np.float32),
            "on one line",
        ),
        (np.repeat(np.eye(3), 9, axis=0), "27 points in 3 places"),
        ([["a", "b", "c"]] * 9, "real numbers"),
        (np.ones((20, 3)) * 1j, "real numbers"),
    ],
)
def test_bad_points(points, message):
    with pytest.raises(InputError, match=message):
        estimate_normals(points)


def test_bad_faces():
    with pytest.raises(InputError, match="0 to 15"):
        estimate_normals(FLAT, faces=[[0, 1, 16]])
    with pytest.raises(InputError, match='graph "mesh"'):
        estimate_normals(FLAT, settings=Settings(graph="mesh"))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"method": "magic"}, "method"),
        ({"neighbors": 7}, "from 8"),
        ({"neighbors": 8.5}, "whole number"),
        ({"neighbors": "many"}, "from 8"),
        ({"radius": 0}, "above 0"),
        ({"radius": -1}, "above 0"),
        ({"radius": float("nan")}, "above 0"),
        ({"weights": "third"}, "weights"),
        ({"orientation": "up"}, "orientation"),
        ({"threads": 0}, "from 1"),
    ],
)
def test_bad_settings(values, message):
    with pytest.raises(InputError, match=message):
        Settings(**values)


def test_settings_describe_themselves():
    for item in dataclasses.fields(Settings):
        assert item.metadata["doc"]
        if item.metadata["choices"]:
            assert item.default in item.metadata["choices"]


# Progress


def creased_points(count):
    """Points at random on three faces of a cube."""
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1, (count, 3))
    points[np.arange(count), rng.integers(0, 3, count)] = 0
    return points


def torus_points(count, noise):
    points = shapes.TORUS.sample(count, 0, even=False)[0]
    return points + noise * np.random.default_rng(0).normal(size=points.shape)


@pytest.mark.parametrize("orientation", ["poles", "propagate"])
@pytest.mark.parametrize(
    "points",
    [torus_points(20_000, 0.0), torus_points(8000, 0.03), creased_points(20_000)],
    ids=["clean", "noisy", "creased"],
)
def test_progress_rises_from_zero_to_one(points, orientation):
    """Through all stages: none begins before where the one before it ended."""
    seen = []
    settings = Settings(orientation=orientation)
    estimate_normals(points, settings=settings, progress=seen.append)
    assert seen[0] == 0
    assert seen[-1] == 1
    assert seen == sorted(seen)
    fitting = [share for share in seen if share < 0.7]
    assert len(fitting) > 4
    # Not silent while the sides are found.
    assert len([share for share in seen if 0.7 < share < 1]) > 2


@pytest.mark.parametrize("orientation", ["poles", "propagate"])
def test_raising_in_progress_cancels_the_search_for_sides(orientation):
    class CancelledError(Exception):
        pass

    seen = []

    def progress(share):
        seen.append(share)
        if share > 0.7:
            raise CancelledError

    with pytest.raises(CancelledError):
        estimate_normals(
            torus_points(5000, 0.0),
            settings=Settings(orientation=orientation),
            progress=progress,
        )
    assert 0.7 < seen[-1] < 1


@pytest.mark.parametrize("threads", [1, 2])
def test_raising_in_progress_cancels(threads):
    class CancelledError(Exception):
        pass

    calls = []

    def progress(share):
        calls.append(share)
        if share > 0:
            raise CancelledError

    points, _, _ = shapes.TORUS.sample(50_000, 0, even=False)
    with pytest.raises(CancelledError):
        estimate_normals(
            points,
            settings=Settings(method="time_scale", threads=threads),
            progress=progress,
        )
    assert len(calls) == 2


# Patches again


@pytest.mark.parametrize("setting", METHODS, ids=lambda s: f"{s.method}-{s.weights}")
def test_bundle_at_a_point_has_the_normal_of_its_estimate(setting):
    points, _, _ = shapes.TORUS.sample(400, 0)
    points = np.concatenate([points, points[:7]]) + [1e3, 0, 0]
    estimate = estimate_normals(points, settings=setting)
    for i in (3, 100, 403):
        bundle = estimate.bundle(i)
        here = tuple(
            int(np.flatnonzero(T.points == 0)[0]) for T in (bundle.T1, bundle.T2)
        )
        np.testing.assert_allclose(bundle.points[here], points[i], atol=1e-9)
        weights = estimate.settings.weights
        normal = estimate.patches([i]).normals(weights=weights)[0]
        # Method "auto" blends patches of other sizes in where it sees a reason.
        close = 1e-3 if setting == Settings() else 1e-9
        assert abs(normal @ estimate.normals[i]) == pytest.approx(1, abs=close)
        if weights == "paper":
            # The three-point difference is not exact on cubic terms.
            grid = bundle.normals(weights=weights)[here]
            assert abs(grid @ normal) == pytest.approx(1, abs=1e-9)


def test_settings_come_back_as_they_were_given():
    points, _, _ = shapes.SPHERE.sample(300, 0)
    asked = Settings(orientation="viewpoint", viewpoint=(5.0, 0, 0))
    used = estimate_normals(points + [100.0, 0, 0], settings=asked).settings
    assert used.viewpoint == (5.0, 0, 0)
    assert used.neighbors == 16


# The paper's method


def test_paper_reports_condition_numbers():
    points, _, _ = shapes.PHI1.sample(500, 0)
    estimate = estimate_normals(points, settings=PAPER)
    assert estimate.condition.shape == (500,)
    assert (estimate.condition >= 1).all()
    assert estimate.settings.graph == "delaunay"
    assert estimate.settings.weights == "paper"
    assert estimate_normals(points).condition is None


def test_paper_written_out():
    """Table 1 point by point, in plain loops, for a few points."""
    from core import NeighborGraph

    points, _, _ = shapes.PHI1.sample(200, 0)
    estimate = estimate_normals(
        points, settings=Settings(method="paper", orientation="none")
    )
    graph = NeighborGraph.delaunay(points).extended(8)
    for i in range(0, 200, 20):
        x, y, z = (points[graph.row(i)] - points[i]).T
        design = np.stack(
            [x, y, x**2, x * y, x**2 * y, x * y**2, y**2, x**2 * y**2], axis=1
        )
        a = np.linalg.lstsq(design, z, rcond=1e-15)[0]
        slopes = []
        for first, second, w in ((a[0], a[2], x), (a[1], a[6], y)):
            sigma = min(w[w > 0], default=0.0)
            rho = max(w[w < 0], default=0.0)
            rise = first * (sigma - rho) + second * (sigma**2 - rho**2)
            slopes.append(rise / (sigma - rho))
        normal = np.array([-slopes[0], -slopes[1], 1])
        normal /= np.linalg.norm(normal)
        # The two solvers share all but the rounding, magnified by the condition.
        tolerance = 1e-12 * estimate.condition[i] ** 2 + 1e-9
        np.testing.assert_allclose(estimate.normals[i], normal, atol=min(tolerance, 1))
