# SPDX-License-Identifier: GPL-3.0-or-later
"""Trees of nodes: materials that show attributes in colors, and those of modifiers."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from ...core import Comparison

# Any stands for nodes, their sockets and trees: the stubs know only what all kinds of
# them have.

GRAY = (0.72, 0.72, 0.72)
# From the upper left, as a reader expects; surfaces are lit from both sides because
# normals without an orientation are fine.
LIGHT = Vector((-0.35, 0.45, 0.82)).normalized()


@dataclass(frozen=True)
class Scale:
    """What the colors mean: values from `low` to `high`, spread over powers of ten."""

    low: float
    high: float
    label: str


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


def glow(name: str) -> tuple[bpy.types.Material, Any]:
    """A new material of light alone, and the node that gives its color."""
    made = bpy.data.materials.new(name)
    tree = empty_tree(made)
    emission = tree.nodes.new("ShaderNodeEmission")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(emission.outputs["Emission"], output.inputs["Surface"])
    return made, emission


def empty_tree(owner: bpy.types.Material | bpy.types.World) -> Any:
    """The tree of a material or a world, without any node."""
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


def ramp_material() -> bpy.types.Material:
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


def geometry_tree(name: str) -> Any:
    """A new tree for a modifier: a geometry comes in, another one goes out."""
    tree: Any = bpy.data.node_groups.new(name, "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket(
            "Geometry", in_out=direction, socket_type="NodeSocketGeometry"
        )
    return tree
