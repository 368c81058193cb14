# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of attributes: camera, page and headless render.

A picture is a page of its own scene, sixteen units wide and seen straight from above.
Objects are laid on it as copies that share their data, turned to show the view; their
attributes become colors in the material, so nothing is written to the objects.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from ...core.neighbors.graph import NearestNeighbors
from .. import bridge
from .nodes import Scale, empty_tree, geometry_tree, glow, material, ramp_material

# Any stands for scenes with Cycles, of which the stubs know nothing.

PAGE = (16.0, 9.0)
PAPER = (0.82, 0.83, 0.85)
INK = (0.015, 0.015, 0.02)
# Turning around the upright axis, then tilting toward the reader.
VIEW = (math.radians(32), math.radians(16))
SAMPLES = 16
_STAMPS: tuple[str, ...] = ("date", "time", "render_time", "memory", "hostname")
_STAMPS += ("filename", "scene", "camera", "frame")


@dataclass(frozen=True)
class Panel:
    """One object on the page: shaded by a vector attribute, colored by a float one.

    Without a value it has one color, gray unless given; without a normal it is flat.
    Points are as large as closes the surface, unless given a radius in object units.
    """

    object: bpy.types.Object
    title: str
    normal: str | None
    value: str | None = None
    color: tuple[float, float, float] | None = None
    radius: float | None = None


def render(
    path: str,
    panels: Sequence[Panel],
    *,
    heading: str,
    scale: Scale,
    view: tuple[float, float] = VIEW,
    width: int = 1600,
) -> None:
    """Write a PNG with the panels side by side, their titles and the color bar."""
    with page(width) as scene:
        write(scene, heading, (0, 4.02), 0.42)
        step = PAGE[0] / len(panels)
        for index, panel in enumerate(panels):
            x = (index + 0.5) * step - PAGE[0] / 2
            write(scene, panel.title, (x, 3.42), 0.3)
            lay(scene, [panel], (x, 0.1), (step - 1.0, 5.6), scale=scale, view=view)
        draw_bar(scene, scale, (0, -3.4), (7.0, 0.22))
        scene.render.filepath = path
        bpy.ops.render.render(write_still=True, scene=scene.name)


def point_radius(obj: bpy.types.Object) -> float:
    """Return a size at which evenly spread points close to a surface."""
    points = bridge.read_points(obj)
    count = min(6, len(points) - 1)
    # A few thousand are as good as all.
    rows = np.arange(0, len(points), 1 + len(points) // 5000)
    _, distance = NearestNeighbors(points).neighbors(rows, count)
    return 0.8 * float(np.median(distance[:, -1]))


@contextmanager
def page(width: int) -> Iterator[Any]:
    """A scene to draw on; it and all that was made meanwhile are removed afterwards."""
    kinds = ["scenes", "objects", "meshes", "curves", "cameras", "worlds"]
    kinds += ["fonts", "materials", "node_groups"]
    before = {kind: set(getattr(bpy.data, kind)) for kind in kinds}
    try:
        scene = bpy.data.scenes.new("Picture")
        _set_up(scene, width)
        yield scene
    finally:
        for kind in kinds:
            bpy.data.batch_remove(set(getattr(bpy.data, kind)) - before[kind])


def _set_up(scene: Any, width: int) -> None:
    """Look straight down on the page; Cycles needs no graphics card for that."""
    camera = bpy.data.cameras.new("Picture")
    camera.type = "ORTHO"
    camera.ortho_scale = PAGE[0]
    camera.clip_end = 200
    scene.camera = add(scene, camera)
    scene.camera.location.z = 100
    scene.world = bpy.data.worlds.new("Picture")
    tree = empty_tree(scene.world)
    background = tree.nodes.new("ShaderNodeBackground")
    background.inputs["Color"].default_value = (*PAPER, 1)
    output = tree.nodes.new("ShaderNodeOutputWorld")
    tree.links.new(background.outputs["Background"], output.inputs["Surface"])
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = SAMPLES
    scene.cycles.max_bounces = 0
    scene.cycles.use_denoising = False
    scene.cycles.use_adaptive_sampling = False
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x = width
    scene.render.resolution_y = round(width * PAGE[1] / PAGE[0])
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGB"
    scene.render.image_settings.compression = 90
    # Neither dates, which make equal pictures differ, nor paths of files.
    for name in _STAMPS:
        setattr(scene.render, f"use_stamp_{name}", False)
    scene.render.dither_intensity = 0


def add(scene: Any, data: bpy.types.ID) -> bpy.types.Object:
    """Put data on the page."""
    made = bpy.data.objects.new("Picture", data)
    scene.collection.objects.link(made)
    return made


def write(
    scene: Any,
    text: str,
    place: tuple[float, float],
    size: float,
    *,
    align: str = "CENTER",
) -> None:
    """Put a line of text on the page, centered on its place or with an end there."""
    curve: Any = bpy.data.curves.new("Picture", "FONT")
    curve.body = text
    curve.size = size
    curve.align_x = align
    ink, emission = glow("Picture")
    emission.inputs["Color"].default_value = (*INK, 1)
    curve.materials.append(ink)
    add(scene, curve).location = (*place, 50)


def lay(
    scene: Any,
    layers: Sequence[Panel],
    place: tuple[float, float],
    size: tuple[float, float],
    *,
    scale: Scale | None = None,
    view: tuple[float, float] = VIEW,
) -> Matrix:
    """Lay copies of objects into one frame of the page, as large as it allows.

    Returns
    -------
    Matrix
        From the world to the page.
    """
    turn, tilt = view
    tilted = Matrix.Rotation(tilt - math.pi / 2, 4, "X")
    matrix = tilted @ Matrix.Rotation(turn, 4, "Z")
    extents = [_extent(p.object, matrix @ p.object.matrix_world) for p in layers]
    low = np.min([low for low, _ in extents], axis=0)
    high = np.max([high for _, high in extents], axis=0)
    factor = min(np.array(size) / np.maximum(high - low, 1e-12)[:2])
    middle = Matrix.Translation((-(low + high) / 2).tolist())
    to_place = Matrix.Translation((*place, 0)) @ Matrix.Scale(factor, 4)
    to_page = to_place @ middle @ matrix
    for panel in layers:
        _copy(scene, panel, scale, to_page)
    return to_page


def _copy(scene: Any, panel: Panel, scale: Scale | None, to_page: Matrix) -> None:
    copy = panel.object.copy()
    copy.parent = None
    copy.animation_data_clear()
    # The attributes belong to the points as they are before any modifier.
    copy.modifiers.clear()
    scene.collection.objects.link(copy)
    copy.matrix_world = to_page @ panel.object.matrix_world
    shown = material(
        "Picture", scale, normal=panel.normal, value=panel.value, color=panel.color
    )
    _dress(copy, shown, panel.radius)


def _extent(obj: bpy.types.Object, matrix: Matrix) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest coordinates of the object's points under the matrix."""
    points = bridge.read_points(obj) @ np.array(matrix.to_3x3()).T
    points += np.array(matrix.translation)
    return points.min(axis=0), points.max(axis=0)


def _dress(
    obj: bpy.types.Object, made: bpy.types.Material, radius: float | None
) -> None:
    """Give the object a material, and points a size, without touching its data."""
    tree = geometry_tree("Picture")
    last = tree.nodes.new("NodeGroupInput").outputs["Geometry"]
    if bridge.is_cloud(obj):
        kind = "SetPointRadius" if obj.type == "POINTCLOUD" else "MeshToPoints"
        size = tree.nodes.new(f"GeometryNode{kind}")
        size.inputs["Radius"].default_value = radius or point_radius(obj)
        tree.links.new(last, size.inputs[0])
        last = size.outputs[0]
    dress = tree.nodes.new("GeometryNodeSetMaterial")
    dress.inputs["Material"].default_value = made
    output = tree.nodes.new("NodeGroupOutput")
    tree.links.new(last, dress.inputs["Geometry"])
    tree.links.new(dress.outputs["Geometry"], output.inputs["Geometry"])
    modifier: Any = obj.modifiers.new("Picture", "NODES")
    modifier.node_group = tree


def draw_bar(
    scene: Any,
    scale: Scale,
    place: tuple[float, float],
    size: tuple[float, float],
) -> None:
    """Draw the colors of the scale as a bar, its powers of ten and its label."""
    (x, y), (width, height) = place, size
    bar = bpy.data.meshes.new("Picture")
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    bar.from_pydata(corners, [], [(0, 1, 2, 3)])
    bar.materials.append(ramp_material())
    shown = add(scene, bar)
    shown.location = (x - width / 2, y, 50)
    shown.scale = (width, height, 1)
    low, high = round(math.log10(scale.low)), round(math.log10(scale.high))
    for power in range(low, high + 1):
        along = x + width * ((power - low) / (high - low) - 0.5)
        write(scene, f"{10.0**power:g}", (along, y - 0.3), 0.24)
    write(scene, scale.label, (x, y - 0.75), 0.26)
