# SPDX-License-Identifier: GPL-3.0-or-later
# ruff: noqa: T201 (a program: its output is the table)
"""Wrong sides, seconds and memory over the cases that orientation is measured by.

    python tests/benchmarks/orientation.py [CASE ...] [--meshes FOLDER] [--peers]

Prints a table: share of normals on the wrong side in per cent (signed: closed pieces
face outward, no flip forgiven; `free` forgives one flip of the whole cloud), seconds of
the estimate and of the orientation, and the most memory the process took so far. Every
cloud is generated here, but for the meshes (`--meshes`: a folder with
stanford-bunny.obj, rocker-arm.obj, spot.obj, fandisk.obj). Peers get the same points
and estimate normals on their own.
"""

import argparse
import importlib.util
import resource
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from core import Settings, estimate_normals, shapes
from core.graph import NearestNeighbors
from core.orientation import find_orientation

MESHES = ("stanford-bunny", "rocker-arm", "spot", "fandisk")

# Points, true normals, and which of them count.
Cloud = tuple[np.ndarray, np.ndarray, np.ndarray]


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def everywhere(points, normals):
    return points, normals, np.ones(len(points), dtype=bool)


def sampled(shape, count, *, even=False):
    return everywhere(*shape.sample(count, 1, even=even)[:2])


def linked(count):
    points, normals, _ = shapes.TORUS.sample(count // 2, 1, even=False)
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    return everywhere(
        np.concatenate([points, points @ turn.T + [1, 0, 0]]),
        np.concatenate([normals, normals @ turn.T]),
    )


def box(count, half):
    rng = np.random.default_rng(3)
    half = np.asarray(half, dtype=float)
    area = np.repeat(half.prod() / half, 2)
    face = rng.choice(6, count, p=area / area.sum())
    axis, side, row = face // 2, np.where(face % 2, 1.0, -1.0), np.arange(count)
    points = rng.uniform(-1, 1, (count, 3)) * half
    points[row, axis] = side * half[axis]
    normals = np.zeros((count, 3))
    normals[row, axis] = side
    # Two spacings away from the rim, where a thin plate's narrow sides begin.
    inner = (np.abs(points[:, :2]) < 1 - 2 * np.sqrt(8 * area.sum() / count)).all(
        axis=1
    )
    return points, normals, inner | (half.min() > 0.1)


def bowl(count, spacings):
    """Two half spheres closed by a ring; spacings between them."""
    rng = np.random.default_rng(3)
    spacing = np.sqrt(4 * np.pi / count)
    inner = 1 - spacings * spacing
    area = np.array([2, 2 * inner**2, 1 - inner**2])
    part = rng.choice(3, count, p=area / area.sum())
    normals = unit(rng.normal(size=(count, 3)))
    normals[:, 2] = -np.abs(normals[:, 2])
    points = normals.copy()
    points[part == 1] *= inner
    normals[part == 1] *= -1
    rim = part == 2
    angle = rng.uniform(0, 2 * np.pi, rim.sum())
    radius = np.sqrt(rng.uniform(inner**2, 1, rim.sum()))
    points[rim] = np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), 0 * radius], axis=1
    )
    normals[rim] = [0, 0, 1]
    return points, normals, points[:, 2] < -2 * spacing


def uneven(shape, count, kind):
    points, normals, _ = shape.sample(8 * count, 1, even=False)
    along = (points[:, 0] - points[:, 0].min()) / np.ptp(points[:, 0])
    stripe = np.where(np.floor(along * 16) % 2 == 0, 1.0, 0.06)
    chance = stripe if kind == "stripe" else along**2 * 0.95 + 0.02
    kept = np.flatnonzero(np.random.default_rng(5).uniform(size=len(points)) < chance)
    kept = np.random.default_rng(6).permutation(kept)[:count]
    return everywhere(points[kept], normals[kept])


def wave(count):
    x, y = np.random.default_rng(0).uniform(-1, 1, (2, count))
    z = 0.2 * np.sin(4 * x) * np.cos(3 * y) + 0.1 * np.sin(9 * x + 1)
    slope_x = 0.8 * np.cos(4 * x) * np.cos(3 * y) + 0.9 * np.cos(9 * x + 1)
    slope_y = -0.6 * np.sin(4 * x) * np.sin(3 * y)
    return everywhere(
        np.stack([x, y, z], axis=1),
        unit(np.stack([-slope_x, -slope_y, np.ones(count)], axis=1)),
    )


def one_sided(count):
    """What a sensor above sees of a bumpy sphere."""
    points, normals, _ = shapes.BUMPY.sample(3 * count, 1, even=False)
    seen = (normals[:, 2] > 0.2) & (points[:, 2] > 0)
    return everywhere(points[seen][:count], normals[seen][:count])


def noisy(cloud, share):
    points, normals, counted = cloud
    return shapes.add_noise(points, share, 7), normals, counted


def with_outliers(cloud):
    points, normals, counted = cloud
    low, high = points.min(axis=0), points.max(axis=0)
    edge = 0.1 * (high - low)
    count = len(points) // 50
    stray = np.random.default_rng(4).uniform(low - edge, high + edge, (count, 3))
    none = np.zeros((count, 3))
    return (
        np.concatenate([points, stray]),
        np.concatenate([normals, none]),
        np.append(counted, np.zeros(count, dtype=bool)),
    )


def mesh(folder, name, count):
    """Sample the triangles of a closed mesh evenly by area; face normals, outward."""
    vertices, faces = [], []
    for line in (folder / f"{name}.obj").read_text("utf-8").splitlines():
        word, *rest = line.split() or [""]
        if word == "v":
            vertices.append([float(x) for x in rest[:3]])
        elif word == "f":
            corner = [int(x.split("/")[0]) - 1 for x in rest]
            faces += [
                [corner[0], corner[i], corner[i + 1]] for i in range(1, len(corner) - 1)
            ]
    triangles = np.array(vertices)[np.array(faces)]
    cross = np.cross(
        triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    )
    size = np.linalg.norm(cross, axis=1)
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(size), count, p=size / size.sum())
    cut = np.sort(rng.uniform(size=(count, 2)), axis=1)
    share = np.stack([cut[:, 0], cut[:, 1] - cut[:, 0], 1 - cut[:, 1]], axis=1)
    points = (triangles[chosen] * share[..., None]).sum(axis=1)
    outward = np.sign((triangles[:, 0] * cross).sum())
    return everywhere(points, outward * cross[chosen] / size[chosen, None])


def cases(folder: Path | None) -> Iterator[tuple[str, float, Callable[[], Cloud]]]:
    """Yield name, the most that may be wrong in per cent, and how to make the cloud.

    Open surfaces, whose outside is a choice, have a negative limit: one flip is free.
    """
    bumpy = lambda: sampled(shapes.BUMPY, 60_000)  # noqa: E731
    yield "bumpy", 0.1, bumpy
    yield "torus", 0.1, lambda: sampled(shapes.TORUS, 60_000)
    yield "linked tori", 0.1, lambda: linked(50_000)
    yield "cube", 0.1, lambda: box(50_000, (1, 1, 1))
    yield "thin plate", 0.1, lambda: box(40_000, (1, 1, 0.015))
    for spacings, most in ((1.2, 5), (1.5, 0.1), (2, 0.1), (3, 0.1)):
        yield f"bowl {spacings}", most, lambda s=spacings: bowl(30_000, s)
    for share, most in ((0.003, 0.2), (0.006, 0.2), (0.012, 0.5)):
        yield f"bumpy noise {share:.1%}", most, lambda s=share: noisy(bumpy(), s)
    for kind in ("stripe", "gradient"):
        yield kind, 0.2, lambda k=kind: uneven(shapes.BUMPY, 50_000, k)
    yield "height field", -0.1, lambda: wave(30_000)
    yield "one-sided scan", -0.1, lambda: one_sided(20_000)
    yield "phi1", -2, lambda: sampled(shapes.PHI1, 2571, even=True)
    yield "phi2", -5, lambda: sampled(shapes.PHI2, 2295, even=True)
    yield "bumpy outliers", 0.5, lambda: with_outliers(bumpy())
    yield "plate outliers", 0.5, lambda: with_outliers(box(40_000, (1, 1, 0.015)))
    for name in MESHES if folder else ():
        yield name, 0.1, lambda n=name: mesh(folder, n, 50_000)
        yield f"{name} noise", 0.5, lambda n=name: noisy(mesh(folder, n, 50_000), 0.006)
    for count in (100_000, 1_000_000):
        yield f"bumpy {count:,}", 0.1, lambda n=count: sampled(shapes.BUMPY, n)


def ours(points):
    """Return oriented normals, seconds of the estimate and of the orientation."""
    start = time.perf_counter()
    normals = estimate_normals(points, settings=Settings(orientation="none")).normals
    middle = time.perf_counter()
    # Signs as they come out of a fit are often right by chance.
    normals *= np.random.default_rng(0).choice([-1, 1], (len(points), 1))
    found = find_orientation(points, normals, mode="auto")
    end = time.perf_counter()
    return normals * found.signs[:, None], middle - start, end - middle


def open3d(points):
    """Return what Open3D makes of 16 neighbors and its tree of tangent planes."""
    import open3d as o3d

    start = time.perf_counter()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(16))
    middle = time.perf_counter()
    cloud.orient_normals_consistent_tangent_plane(16)
    end = time.perf_counter()
    return np.asarray(cloud.normals), middle - start, end - middle


def pymeshlab(points):
    """Return what MeshLab makes of 16 neighbors."""
    import pymeshlab as ml

    start = time.perf_counter()
    meshes = ml.MeshSet()
    meshes.add_mesh(ml.Mesh(vertex_matrix=points))
    meshes.compute_normal_for_point_clouds(k=16)
    normals = meshes.current_mesh().vertex_normal_matrix()
    return normals, time.perf_counter() - start, 0.0


def meshlib(points):
    """Return what MeshLib makes of 16 neighbors."""
    from meshlib import mrmeshnumpy, mrmeshpy

    start = time.perf_counter()
    cloud = mrmeshnumpy.pointCloudFromPoints(points)
    radius = mrmeshpy.findAvgPointsRadius(cloud, 16)
    found = mrmeshpy.makeOrientedNormals(cloud, radius)
    normals = mrmeshnumpy.toNumpyArray(found)
    return normals, time.perf_counter() - start, 0.0


PEERS = {"open3d": open3d, "pymeshlab": pymeshlab, "meshlib": meshlib}


def report(name, most, cloud, method, label):
    points, truth, counted = cloud
    normals, estimate, orientation = method(points)
    share = 100 * ((normals * truth).sum(axis=1) < 0)[counted].mean()
    free = min(share, 100 - share)
    passed = (free if most < 0 else share) <= abs(most)
    # Kilobytes on Linux, bytes on macOS.
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    peak /= 1e6 if sys.platform == "darwin" else 1e3
    print(
        f"{name:22} {label:10} {len(points):9,} {share:8.3f} {free:8.3f} "
        f"{abs(most):5g} {'' if passed else 'over':5} {estimate:8.2f} "
        f"{orientation:8.2f} {peak:7.0f}",
        flush=True,
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="cases to run; all by default")
    parser.add_argument("--meshes", type=Path, help="folder of the four meshes")
    parser.add_argument("--peers", action="store_true", help="run other tools too")
    options = parser.parse_args()
    methods = {"ours": ours}
    for name in PEERS if options.peers else ():
        if importlib.util.find_spec(name) is None:
            print(f"{name} is not installed: skipped")
        else:
            methods[name] = PEERS[name]
    if options.meshes is None:
        print("no --meshes folder: the four meshes are skipped")
    print(
        f"{'case':22} {'method':10} {'points':>9} {'wrong %':>8} {'free %':>8} "
        f"{'most':>5} {'':5} {'estimate':>8} {'orient':>8} {'peak MB':>7}"
    )
    # scipy's modules and threads are loaded before anything is timed.
    NearestNeighbors(np.eye(3))
    ours(shapes.SPHERE.sample(500, 0)[0])
    for name, most, make in cases(options.meshes):
        if options.names and name not in options.names:
            continue
        cloud = make()
        for label, method in methods.items():
            report(name, most, cloud, method, label)


if __name__ == "__main__":
    main()
