# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the pictures of repaired shading in accuracy.md.

    .venv/bench/bin/python docs/shading.py

Each has a mesh four times: with Blender's own normals and with repaired ones, under a
soft light as a matcap has it, and with the stripes of a zebra, whose kinks are those of
the normals. Drawn by a few lines of numpy, so that nothing depends on a renderer.
"""

import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "benchmarks")]

import damage  # noqa: E402 - found by the line above
import solids  # noqa: E402

from core import estimate_normals  # noqa: E402
from core.mesh.faces import split_fans, unit, vertex_normals  # noqa: E402

PICTURES = ROOT / "docs" / "pictures"
SIZE, MARGIN = 300, 1.08
# Samples along each side of a pixel.
FINE = 2
CASES = (
    ("noise", "creature", "noise 0.3"),
    ("stairs", "blobs", "fine stairs"),
    ("slivers", "bumpy", "slivers"),
    ("part", "spool", "noise 0.1"),
    ("flips", "creature", "flips"),
)


def view():
    """Return the axes of the view, right, up and toward the eye, as rows."""
    toward = unit(np.array([0.55, -0.75, 0.45]))
    right = unit(np.cross([0, 0, 1.0], toward))
    return np.stack([right, np.cross(toward, right), toward])


def drawn(points, faces, normals, paint):
    """Return a picture (SIZE, SIZE, 3) of faces with normals at their corners.

    Parameters
    ----------
    normals : (m, 3, 3)
    paint : callable (p, 3) -> (p, 3)
        Color of normals in the axes of the view.
    """
    size = SIZE * FINE
    axes = view()
    places = points @ axes.T
    low, high = places.min(axis=0), places.max(axis=0)
    scale = size / (MARGIN * (high - low)[:2].max())
    places = (places - (low + high) / 2) * scale + [size / 2, size / 2, 0]
    depth = np.full((size, size), -np.inf)
    shown = np.zeros((size, size, 3))
    for corners, turned in zip(places[faces], normals @ axes.T, strict=True):
        _fill(depth, shown, corners, turned)
    seen = np.isfinite(depth)
    picture = np.ones((size, size, 3))
    picture[seen] = paint(unit(shown[seen]))
    picture = picture[::-1].reshape(SIZE, FINE, SIZE, FINE, 3).mean(axis=(1, 3))
    return np.clip(picture, 0, 1)


def _fill(depth, shown, corners, normals):
    """Draw one triangle into a picture of depths and normals."""
    low = np.maximum(np.floor(corners[:, :2].min(axis=0)).astype(int), 0)
    high = np.minimum(
        np.ceil(corners[:, :2].max(axis=0)).astype(int) + 1, depth.shape[::-1]
    )
    x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    a, b, c = corners[:, :2]
    whole = (b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]
    if whole == 0 or not x.size:
        return
    share = [
        ((q - p)[0] * (y - p[1]) - (q - p)[1] * (x - p[0])) / whole
        for p, q in ((b, c), (c, a), (a, b))
    ]
    z = sum(s * height for s, height in zip(share, corners[:, 2], strict=True))
    part = depth[low[1] : high[1], low[0] : high[0]]
    inside = (np.minimum.reduce(share) >= -1e-9) & (z > part)
    part[inside] = z[inside]
    mixed = sum(s[inside][:, None] * n for s, n in zip(share, normals, strict=True))
    shown[low[1] : high[1], low[0] : high[0]][inside] = mixed


def matcap(normals):
    """Return the colors of clay under a soft light, a lamp and a rim of sky."""
    light = np.maximum(normals @ unit(np.array([-0.5, 0.7, 0.6])), 0)
    gloss = np.maximum(normals @ unit(np.array([-0.3, 0.5, 1.0])), 0) ** 60
    rim = (1 - np.clip(normals[:, 2], 0, 1)) ** 3
    clay, sky = np.array([0.72, 0.45, 0.34]), np.array([0.35, 0.45, 0.6])
    shade = (0.18 + 0.8 * light)[:, None] * clay + 0.5 * rim[:, None] * sky
    return shade + 0.55 * gloss[:, None]


def zebra(normals):
    """Return black and white by where the eye's ray is thrown back to."""
    back = 2 * normals[:, 2:] * normals - [0, 0, 1]
    wave = np.sin(14 * np.arctan2(back[:, 1], 1.2 + back[:, 2]))
    return np.repeat(np.clip(0.5 + 4 * wave, 0.04, 0.96)[:, None], 3, axis=1)


def normals_of(case):
    """Return Blender's own corner normals, and repaired ones, (m, 3, 3) each."""
    fans, vertex = split_fans(len(case.points), case.faces, case.sharp)
    before = vertex_normals(case.points[vertex], fans, weights="angle")[fans]
    found = estimate_normals(case.points, faces=case.faces, sharp=case.sharp)
    return before, found.corner_normals


def main():
    """Write the pictures."""
    from matplotlib import image

    made = [*solids.smooth_solids(), *solids.creased_solids()]
    by_name = {solid.name: solid for solid in made}
    for name, shape, worse in CASES:
        cases = damage.cases_of(by_name[shape])
        case = next(case for case in cases if case.damage == worse)
        tiles = [
            drawn(case.points, case.faces, normals, paint)
            for normals in normals_of(case)
            for paint in (matcap, zebra)
        ]
        path = PICTURES / f"repair-{name}.png"
        picture = (255 * np.hstack(tiles)).astype(np.uint8)
        image.imsave(path, picture, metadata={"Software": None})
        print(path.name, picture.shape)


if __name__ == "__main__":
    main()
