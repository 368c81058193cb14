# SPDX-License-Identifier: GPL-3.0-or-later
"""The experiment in Blender: numbers, figures, and no trace in the file."""

import json
import struct

import bpy
import numpy as np
import pytest
from bl_ext.user_default.timescale_normals.addon import cli
from bl_ext.user_default.timescale_normals.addon.paper import figures
from bl_ext.user_default.timescale_normals.addon.paper.results import FIGURES, FILES

KINDS = ("scenes", "objects", "meshes", "curves", "cameras", "worlds", "materials")
KINDS += ("node_groups", "fonts")


def everything():
    return {kind: sorted(getattr(bpy.data, kind).keys()) for kind in KINDS}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What the command leaves, with figures too small to take long."""
    path = tmp_path_factory.mktemp("reproduce")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    before = everything()
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(figures.draw.__kwdefaults__, "width", 480)
        command = ["reproduce", "--seeds", "1", "--quiet", "-o", str(path)]
        assert cli.main(command) == 0
    assert everything() == before
    return path


def chunks(path):
    """Types of the parts of a PNG, and its width and height."""
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    kinds, at = [], 8
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        kinds.append(kind)
        at += 12 + length
    return kinds, struct.unpack(">II", data[16:24])


def pixels(path):
    image = bpy.data.images.load(str(path))
    values = np.empty(4 * image.size[0] * image.size[1], np.float32)
    image.pixels.foreach_get(values)
    shape = image.size[1], image.size[0], 4
    bpy.data.images.remove(image)
    return values.reshape(shape)[::-1, :, :3]


def test_results_say_which_blender(folder):
    results = json.loads((folder / "results.json").read_text("utf-8"))
    assert results["versions"]["blender"] == bpy.app.version_string
    assert {path.name for path in folder.iterdir()} == set(FILES)


@pytest.mark.parametrize("name", FIGURES)
def test_figures_are_whole_and_framed(name, folder):
    kinds, size = chunks(folder / name)
    assert size == (480, 270)
    assert kinds[-1] == b"IEND"
    # No dates and no paths: the same numbers make the same picture.
    assert b"tEXt" not in kinds
    drawn = np.abs(pixels(folder / name) - pixels(folder / name)[0, 0]).max(2) > 0.1
    assert drawn.mean() > 0.02
    rows, columns = np.nonzero(drawn)
    assert rows.min() > 2
    assert columns.min() > 2
    assert rows.max() < size[1] - 3
    assert columns.max() < size[0] - 3


def test_errors_of_both_methods_are_seen(folder):
    """Our panel is the darker one: low errors are dark."""
    for name in ("figure-5-errors-phi1.png", "figure-6-errors-phi2.png"):
        picture = pixels(folder / name)[50:215]
        # Colors of the surface: paper and ink are close to gray.
        colored = np.ptp(picture, axis=2) > 0.1
        light = [
            picture[:, 160 * k : 160 * (k + 1)][colored[:, 160 * k : 160 * (k + 1)]]
            for k in range(3)
        ]
        paper, auto, delaunay = (values.mean() for values in light)
        assert auto < paper
        assert auto < delaunay


def test_winning_points_are_the_ones_counted(folder):
    results = json.loads((folder / "results.json").read_text("utf-8"))
    sample = figures.Sample("phi2")
    for method, comparison in sample.comparisons.items():
        (row,) = (
            row
            for row in results["trials"]
            if (row["surface"], row["sampling"], row["method"], row["baseline"])
            == ("phi2", "area", method, "parameters")
        )
        assert comparison.wins.sum() == row["wins"]
