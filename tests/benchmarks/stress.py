# SPDX-License-Identifier: GPL-3.0-or-later
"""The clouds by which sides are measured: points, true normals, and which count.

All are made here, but for four meshes: FOLDER/stanford-bunny.obj, rocker-arm.obj,
spot.obj and fandisk.obj.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from core import shapes

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


def lattice(side):
    """A cube whose points lie in rows and columns: four on every circle."""
    u, v = (a.ravel() for a in np.meshgrid(*[np.linspace(-0.98, 0.98, side)] * 2))
    sides = [
        np.stack(np.roll([s + 0 * u, u, v], k, axis=0), axis=1)
        for s in (-1.0, 1.0)
        for k in range(3)
    ]
    points = np.concatenate(sides)
    return everywhere(points, np.where(np.abs(points) == 1, points, 0))


def globe(side):
    """A sphere by latitude and longitude: all on one sphere, crowded at the ends."""
    latitude = (np.arange(side) + 0.5) * np.pi / side
    longitude = np.arange(2 * side) * np.pi / side
    t, s = (a.ravel() for a in np.meshgrid(latitude, longitude))
    normals = np.stack([np.sin(t) * np.cos(s), np.sin(t) * np.sin(s), np.cos(t)], 1)
    return everywhere(normals.copy(), normals)


def flat(side):
    """A lattice in a plane: nothing is inside."""
    u, v = (a.ravel() for a in np.meshgrid(*[np.linspace(0, 1, side)] * 2))
    points = np.stack([u, v, 0 * u], axis=1)
    return everywhere(points, np.tile([0.0, 0, 1], (len(points), 1)))


def balls(number, count):
    """Small spheres, none inside another."""
    points, normals, _ = shapes.SPHERE.sample(count, 1)
    place = 3.0 * np.stack(np.unravel_index(np.arange(number), (4, 4, number)), axis=1)
    return everywhere(
        (points + place[:, None]).reshape(-1, 3), np.tile(normals, (number, 1))
    )


def thrice(cloud):
    """Every point three times."""
    order = np.random.default_rng(2).permutation(3 * len(cloud[0]))
    return tuple(np.tile(a, (3,) + (1,) * (a.ndim - 1))[order] for a in cloud)


def far_away(cloud):
    """Where coordinates of maps are."""
    points, normals, counted = cloud
    return points + [5e5, 4.6e6, 300.0], normals, counted


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
    yield "cube lattice", 0.1, lambda: lattice(90)
    yield "globe", 0.1, lambda: globe(150)
    yield "flat lattice", -0.1, lambda: flat(200)
    yield "points thrice", 0.1, lambda: thrice(sampled(shapes.BUMPY, 20_000))
    yield "far away", 0.1, lambda: far_away(bumpy())
    yield "60 balls", 0.1, lambda: balls(60, 500)
    for name in MESHES if folder else ():
        yield name, 0.1, lambda n=name: mesh(folder, n, 50_000)
        yield f"{name} noise", 0.5, lambda n=name: noisy(mesh(folder, n, 50_000), 0.006)
    for count in (100_000, 1_000_000):
        yield f"bumpy {count:,}", 0.1, lambda n=count: sampled(shapes.BUMPY, n)
