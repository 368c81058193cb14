# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of attributes: camera, light, material and headless render.

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
from mathutils import Matrix, Vector

from ...core import Comparison
from ...core.neighbors.graph import NearestNeighbors
from .. import bridge

PAGE = (16.0, 9.0)
PAPER = (0.82, 0.83, 0.85)
INK = (0.015, 0.015, 0.02)
GRAY = (0.72, 0.72, 0.72)
# From the upper left, as a reader expects; surfaces are lit from both sides because
# normals without an orientation are fine.
LIGHT = Vector((-0.35, 0.45, 0.82)).normalized()
# Turning around the upright axis, then tilting toward the reader.
VIEW = (math.radians(32), math.radians(16))
SAMPLES = 16
_STAMPS: tuple[str, ...] = ("date", "time", "render_time", "memory", "hostname")
_STAMPS += ("filename", "scene", "camera", "frame")


@dataclass(frozen=True)
class Scale:
    """What the colors mean: values from `low` to `high`, spread over powers of ten."""

    low: float
    high: float
    label: str


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


def material(
    name: str,
    scale: Scale | None,
    *,
    normal: str | None,
    value: str | None,
    color: tuple[float, float, float] | None = None,
) -> bpy.types.Material:
    """Return a new material that shows a float attribute in the colors of the scale.

    Without a value it has one color or is gray. The lights of the scene do not count:
    the color is shaded by the angle between the vector attribute `normal` and one
    direction; without a normal it is not shaded.
    """
    made, emission = glow(name)
    tree: Any = made.node_tree
    if scale is None or value is None:
        emission.inputs["Color"].default_value = (*(color or GRAY), 1)
    else:
        _link_color(tree, scale, value, emission.inputs["Color"])
    if normal is not None:
        # Colors have to stay those of the bar.
        dark = 0.5 if value or color else 0.15
        _link_shade(tree, normal, emission.inputs["Strength"], dark=dark)
    return made


# Any stands for nodes, their sockets and trees, and for scenes with Cycles: the stubs
# know only what all kinds of them have.


def glow(name: str) -> tuple[bpy.types.Material, Any]:
    """A new material of light alone, and the node that gives its color."""
    made = bpy.data.materials.new(name)
    tree = _empty_tree(made)
    emission = tree.nodes.new("ShaderNodeEmission")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(emission.outputs["Emission"], output.inputs["Surface"])
    return made, emission


def _empty_tree(owner: bpy.types.Material | bpy.types.World) -> Any:
    # 5.x makes the tree at once and 6.0 drops the switch; 4.5 needs it.
    if bpy.app.version < (5, 0, 0):
        owner.use_nodes = True
    owner.node_tree.nodes.clear()
    return owner.node_tree


def _link_color(tree: Any, scale: Scale, value: str, socket: Any) -> None:
    """Feed the socket: attribute, its logarithm, place in the scale, color.

    Where the attribute is nan the color is that of the core for nothing to compare.
    """
    attribute = tree.nodes.new("ShaderNodeAttribute")
    attribute.attribute_name = value
    # Cycles takes the logarithm of zero for zero, the color of an error of one.
    bounded = tree.nodes.new("ShaderNodeMath")
    bounded.operation = "MAXIMUM"
    bounded.inputs[1].default_value = scale.low
    power = tree.nodes.new("ShaderNodeMath")
    power.operation = "LOGARITHM"
    power.inputs[1].default_value = 10
    place = tree.nodes.new("ShaderNodeMapRange")
    place.inputs["From Min"].default_value = math.log10(scale.low)
    place.inputs["From Max"].default_value = math.log10(scale.high)
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    _fill_ramp(ramp.color_ramp)
    tree.links.new(attribute.outputs["Fac"], bounded.inputs[0])
    tree.links.new(bounded.outputs["Value"], power.inputs[0])
    tree.links.new(power.outputs["Value"], place.inputs["Value"])
    tree.links.new(place.outputs["Result"], ramp.inputs["Fac"])
    # The difference of a number to itself is not within any bound for nan.
    there = tree.nodes.new("ShaderNodeMath")
    there.operation = "COMPARE"
    mix = tree.nodes.new("ShaderNodeMix")
    mix.data_type = "RGBA"
    factor, absent, present = (mix.inputs[index] for index in (0, 6, 7))
    absent.default_value = _core_colors([math.nan])[0]
    for index in (0, 1):
        tree.links.new(attribute.outputs["Fac"], there.inputs[index])
    tree.links.new(there.outputs["Value"], factor)
    tree.links.new(ramp.outputs["Color"], present)
    tree.links.new(mix.outputs[2], socket)


def _core_colors(values: Sequence[float] | np.ndarray) -> np.ndarray:
    """The colors that the core gives to errors from 0 to 1, (n, 4)."""
    errors = np.array(values)
    return Comparison(errors, errors).colors(limit=1.0)


def _fill_ramp(ramp: bpy.types.ColorRamp) -> None:
    values = np.linspace(0, 1, 17)
    while len(ramp.elements) < len(values):
        ramp.elements.new(1.0)
    colors = _core_colors(values)
    for element, value, color in zip(ramp.elements, values, colors, strict=True):
        element.position = value
        element.color = color


def _link_shade(tree: Any, normal: str, socket: Any, *, dark: float) -> None:
    """Feed the socket: dark where the normal is across the light, 1 along it."""
    attribute = tree.nodes.new("ShaderNodeAttribute")
    attribute.attribute_name = normal
    turn = tree.nodes.new("ShaderNodeVectorTransform")
    turn.vector_type = "NORMAL"
    turn.convert_from, turn.convert_to = "OBJECT", "WORLD"
    dot = tree.nodes.new("ShaderNodeVectorMath")
    dot.operation = "DOT_PRODUCT"
    dot.inputs[1].default_value = LIGHT
    size = tree.nodes.new("ShaderNodeMath")
    size.operation = "ABSOLUTE"
    shade = tree.nodes.new("ShaderNodeMapRange")
    shade.inputs["To Min"].default_value = dark
    tree.links.new(attribute.outputs["Vector"], turn.inputs["Vector"])
    tree.links.new(turn.outputs["Vector"], dot.inputs[0])
    tree.links.new(dot.outputs["Value"], size.inputs[0])
    tree.links.new(size.outputs["Value"], shade.inputs["Value"])
    tree.links.new(shade.outputs["Result"], socket)


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
    tree = _empty_tree(scene.world)
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
    tree: Any = bpy.data.node_groups.new("Picture", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket(
            "Geometry", in_out=direction, socket_type="NodeSocketGeometry"
        )
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
    bar.materials.append(_bar_material())
    shown = add(scene, bar)
    shown.location = (x - width / 2, y, 50)
    shown.scale = (width, height, 1)
    low, high = round(math.log10(scale.low)), round(math.log10(scale.high))
    for power in range(low, high + 1):
        along = x + width * ((power - low) / (high - low) - 0.5)
        write(scene, f"{10.0**power:g}", (along, y - 0.3), 0.24)
    write(scene, scale.label, (x, y - 0.75), 0.26)


def _bar_material() -> bpy.types.Material:
    """The colors of every scale, from the left of an object to its right."""
    made, emission = glow("Picture")
    tree: Any = made.node_tree
    along = tree.nodes.new("ShaderNodeTexCoord")
    split = tree.nodes.new("ShaderNodeSeparateXYZ")
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    _fill_ramp(ramp.color_ramp)
    tree.links.new(along.outputs["Generated"], split.inputs["Vector"])
    tree.links.new(split.outputs["X"], ramp.inputs["Fac"])
    tree.links.new(ramp.outputs["Color"], emission.inputs["Color"])
    return made
