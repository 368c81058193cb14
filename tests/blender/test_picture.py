# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures show attributes in the colors of the core, and leave no trace."""

import math

import bpy
import numpy as np
import pytest
import scenes
from bl_ext.user_default.timescale_normals import core
from bl_ext.user_default.timescale_normals.addon.display import nodes, picture

SCALE = nodes.Scale(0.001, 1.0, "Error")
VALUES = {"zero": 0.0, "low": 1e-3, "middle": 10**-1.5, "high": 5.0, "absent": math.nan}
# Their places on the scale.
SHARES = {"zero": 0.0, "low": 0.0, "middle": 0.5, "high": 1.0, "absent": math.nan}
LOOKING_DOWN = (0.0, math.pi / 2)


def grid_points():
    axis = np.linspace(-1, 1, 15)
    x, y = np.meshgrid(axis, axis)
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)


def flat(kind):
    """A square in z = 0 of one kind, with errors and normals toward the light."""
    if kind == "mesh":
        obj = scenes.plane(15)
    elif kind == "vertices":
        obj = scenes.new_mesh(grid_points())
    else:
        obj = scenes.new_cloud(grid_points())
    n = len(scenes.points_of(obj))
    scenes.put(obj, "normal_up", "FLOAT_VECTOR", np.tile(nodes.LIGHT, (n, 1)))
    for name, value in VALUES.items():
        scenes.put(obj, name, "FLOAT", np.full(n, value))
    return obj


def draw(path, panels, **options):
    """Render small and return linear colors, (height, width, 3), bottom row first."""
    picture.render(
        str(path), panels, heading="Heading", scale=SCALE, width=320, **options
    )
    image = bpy.data.images.load(str(path))
    pixels = np.empty(4 * math.prod(image.size), np.float32)
    image.pixels.foreach_get(pixels)
    encoded = pixels.reshape(image.size[1], image.size[0], 4)[..., :3]
    bpy.data.images.remove(image)
    low = encoded <= 0.04045
    return np.where(low, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def expected(error):
    """The core's color for a share of the scale."""
    values = np.array([error])
    return core.Comparison(values, values).colors(limit=1.0)[0, :3]


@pytest.mark.parametrize("kind", ["mesh", "vertices", "cloud"])
def test_panels_show_the_attribute_on_a_logarithmic_scale(kind, tmp_path):
    obj = flat(kind)
    panels = [picture.Panel(obj, name, "normal_up", name) for name in SHARES]
    colors = draw(tmp_path / "a.png", panels, view=LOOKING_DOWN)
    height, width, _ = colors.shape
    for index, share in enumerate(SHARES.values()):
        # The object is in the middle of its part of the page.
        shown = colors[height // 2, width * (2 * index + 1) // (2 * len(SHARES))]
        assert shown == pytest.approx(expected(share), abs=0.01)


def test_without_a_value_an_object_is_gray(tmp_path):
    panels = [picture.Panel(flat("mesh"), "Shaded", "normal_up")]
    colors = draw(tmp_path / "a.png", panels, view=LOOKING_DOWN)
    middle = colors[colors.shape[0] // 2, colors.shape[1] // 2]
    assert middle == pytest.approx(nodes.GRAY, abs=0.01)


def test_objects_far_away_and_long_ones_are_not_clipped(tmp_path):
    obj = scenes.sphere()
    obj.location, obj.scale = (5e3, -2e3, 70), (400, 3, 3)
    points = scenes.points_of(obj)
    scenes.put(obj, "outward", "FLOAT_VECTOR", points)
    scenes.put(obj, "error", "FLOAT", np.full(len(points), 1.0))
    bpy.context.view_layer.update()
    panels = [picture.Panel(obj, "Long", "outward", "error")]
    colors = draw(tmp_path / "a.png", panels)
    # The paper and the ink are close to gray, the color of large errors is not.
    colored = np.ptp(colors, axis=2) > 0.15
    colored[: colors.shape[0] // 5] = False  # the color bar
    rows, columns = np.nonzero(colored)
    assert columns.min() > 2
    assert columns.max() < colors.shape[1] - 3
    assert np.ptp(columns) > 0.8 * colors.shape[1]
    assert rows.max() < 0.8 * colors.shape[0]


def test_nothing_is_left_behind(tmp_path):
    obj = flat("mesh")
    scene = bpy.context.scene

    def everything():
        properties = bpy.data.bl_rna.properties
        kinds = {p.identifier for p in properties if p.type == "COLLECTION"}
        kinds -= {"all_ids"}
        return {kind: sorted(getattr(bpy.data, kind).keys()) for kind in kinds}

    before, attributes = everything(), sorted(obj.data.attributes.keys())
    draw(tmp_path / "a.png", [picture.Panel(obj, "Title", "normal_up", "low")])
    after = everything()
    # Blender keeps the last render of a session under this name.
    after["images"] = [name for name in after["images"] if name != "Render Result"]
    assert after == before
    assert sorted(obj.data.attributes.keys()) == attributes
    assert not obj.modifiers
    assert bpy.context.scene == scene


def test_modifiers_do_not_count(tmp_path):
    obj = flat("mesh")
    obj.modifiers.new("Array", "ARRAY").count = 5
    panels = [picture.Panel(obj, "Title", "normal_up", "middle")]
    colors = draw(tmp_path / "a.png", panels, view=LOOKING_DOWN)
    height, width, _ = colors.shape
    assert colors[height // 2, width // 2] == pytest.approx(expected(0.5), abs=0.01)
    assert colors[height // 2, 5] == pytest.approx(picture.PAPER, abs=0.01)
