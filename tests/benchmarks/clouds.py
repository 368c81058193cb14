# SPDX-License-Identifier: GPL-3.0-or-later
"""Points to measure on: a surface with known normals, and real files when there."""

import os
from pathlib import Path

import numpy as np

from core import shapes

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("TIMESCALE_DATA", ROOT.parent / "shared" / "data"))

FILES = {
    "bunny100k": "pcpnet/bunny100k.npz",
    "fandisk100k": "pcpnet/fandisk100k.npz",
    "autzen": "scan/autzen_trim.las",
}


def bumpy(count, order):
    """Return points and normals of the bumpy sphere, random or sorted in space."""
    points, normals, _ = shapes.BUMPY.sample(count, 1, even=False)
    if order == "sorted":
        along = np.argsort(_morton(points), kind="stable")
        points, normals = points[along], normals[along]
    return points, normals


def file(name):
    """Return points and normals (or None) of a real file; None when it is absent."""
    path = DATA / FILES[name]
    if not path.exists():
        return None
    if path.suffix == ".las":
        return _las(path), None
    with np.load(path) as data:
        normals = data["normals"].astype(float) if "normals" in data.files else None
        return data["points"].astype(float), normals


def _morton(points):
    """Return the places of points along a Z curve of 2^21 cells a side."""
    low, high = points.min(axis=0), points.max(axis=0)
    cells = ((points - low) / (high - low).max() * (2**21 - 1)).astype(np.uint64)
    key = np.zeros(len(points), dtype=np.uint64)
    for bit in range(21):
        for axis in range(3):
            here = (cells[:, axis] >> np.uint64(bit)) & np.uint64(1)
            key |= here << np.uint64(3 * bit + axis)
    return key


def _las(path):
    """Return the coordinates of a LAS file, versions 1.0 to 1.3."""
    raw = path.read_bytes()
    start = int.from_bytes(raw[96:100], "little")
    size = int.from_bytes(raw[105:107], "little")
    count = int.from_bytes(raw[107:111], "little")
    scale, offset = np.frombuffer(raw[131:179], "<f8").reshape(2, 3)
    record = np.dtype({"names": ["xyz"], "formats": ["(3,)<i4"], "itemsize": size})
    steps = np.frombuffer(raw, record, count, start)["xyz"]
    return steps * scale + offset


def mesh(name, count):
    """Return points drawn from a mesh evenly by area, and the normals of its faces.

    None when the file is absent.
    """
    import training

    found = vertices_and_faces(name)
    if found is None:
        return None
    return training.sample_mesh(*found, count, np.random.default_rng(3))


def vertices_and_faces(name):
    """Return the vertices and triangles of an OBJ file; None when it is absent."""
    path = DATA / "mesh" / f"{name}.obj"
    if not path.exists():
        return None
    rows = [line.split() for line in path.read_text().splitlines()]
    vertices = np.array([row[1:4] for row in rows if row[:1] == ["v"]], dtype=float)
    faces = []
    for row in rows:
        if row[:1] == ["f"]:
            corners = [int(corner.split("/")[0]) - 1 for corner in row[1:]]
            fans = range(1, len(corners) - 1)
            faces += [[corners[0], corners[i], corners[i + 1]] for i in fans]
    return vertices, np.array(faces)
