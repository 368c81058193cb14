# SPDX-License-Identifier: GPL-3.0-or-later
"""Making colors visible: a modifier with a material, and the shading of viewports.

The modifier leaves materials and points of the object alone, so that hiding the
colors is removing it.
"""

import json
from collections.abc import Iterable, Iterator
from typing import Any

import bpy
from bpy.types import Context, Object, Operator

from . import bridge
from .settings import Returned, settings_of

NAME = bridge.DRESS


def show(context: Context, objects: Iterable[Object]) -> None:
    """Dress objects in their colors and set the viewports up for them."""
    for obj in objects:
        _dress(obj)
    faces = all(not bridge.is_cloud(obj) for obj in _dressed(context))
    settings = settings_of(context)
    views = dict(_views())
    if not settings.views_before:
        before = {key: [s.type, s.color_type] for key, s in views.items()}
        settings.views_before = json.dumps(before)
    for shading in views.values():
        # Solid shading has the colors of meshes only, and needs no shader compiled.
        shading.color_type = "VERTEX"
        if shading.type in {"WIREFRAME", "SOLID", "MATERIAL"}:
            shading.type = "SOLID" if faces else "MATERIAL"


def hide(context: Context, objects: Iterable[Object]) -> None:
    """Undress objects, and with the last one set the viewports back."""
    for obj in objects:
        modifier: Any = obj.modifiers.get(NAME)
        if modifier is not None:
            _undress(obj, modifier)
    settings = settings_of(context)
    if settings.views_before and not any(_dressed(context)):
        before = json.loads(settings.views_before)
        for key, shading in _views():
            if key in before:
                shading.type, shading.color_type = before[key]
        settings.views_before = ""


def is_dressed(obj: Object | None) -> bool:
    """Whether an object shows its colors."""
    return obj is not None and obj.type in bridge.TYPES and NAME in obj.modifiers


def _dressed(context: Context) -> Iterator[Object]:
    return filter(is_dressed, context.scene.objects)


def _views() -> Iterator[tuple[str, Any]]:
    """Yield a name and the shading of every 3D viewport."""
    for screen in bpy.data.screens:
        for index, area in enumerate(screen.areas):
            for space in area.spaces:
                if isinstance(space, bpy.types.SpaceView3D):
                    yield f"{screen.name}/{index}", space.shading


def _dress(obj: Object) -> None:
    if is_dressed(obj):
        return
    tree: Any = bpy.data.node_groups.new(NAME, "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket(
            "Geometry", in_out=direction, socket_type="NodeSocketGeometry"
        )
    nodes, links = tree.nodes, tree.links
    last = nodes.new("NodeGroupInput").outputs[0]
    if bridge.is_cloud(obj):
        kind = "SetPointRadius" if obj.type == "POINTCLOUD" else "MeshToPoints"
        size = nodes.new(f"GeometryNode{kind}")
        size.inputs["Radius"].default_value = bridge.point_radius(
            bridge.read_points(obj)
        )
        links.new(last, size.inputs[0])
        last = size.outputs[0]
    cover = nodes.new("GeometryNodeSetMaterial")
    cover.inputs["Material"].default_value = _material()
    links.new(last, cover.inputs["Geometry"])
    links.new(cover.outputs["Geometry"], nodes.new("NodeGroupOutput").inputs[0])
    for place, node in enumerate(nodes):
        node.location.x = 200 * place
    modifier: Any = obj.modifiers.new(NAME, "NODES")
    modifier.node_group = tree
    modifier.show_expanded = False


def _undress(obj: Object, modifier: Any) -> None:
    tree = modifier.node_group
    obj.modifiers.remove(modifier)
    if tree is not None and not tree.users:
        bpy.data.node_groups.remove(tree)
    made: Any = bpy.data.materials.get(NAME)
    if made is not None and not made.users:
        bpy.data.materials.remove(made)


def _material() -> bpy.types.Material:
    """The color attribute as light, darker toward the rim so that shape shows."""
    found: Any = bpy.data.materials.get(NAME)
    if found is not None:
        return found
    made = bpy.data.materials.new(NAME)
    # 5.x makes the tree at once and 6.0 drops the switch; 4.5 needs it.
    if bpy.app.version < (5, 0, 0):
        made.use_nodes = True
    tree: Any = made.node_tree
    nodes, links = tree.nodes, tree.links
    nodes.clear()
    color = nodes.new("ShaderNodeAttribute")
    color.attribute_name = bridge.COLOR
    rim = nodes.new("ShaderNodeLayerWeight")
    rim.inputs["Blend"].default_value = 0.3
    shade = nodes.new("ShaderNodeMapRange")
    shade.inputs["To Min"].default_value = 1.0
    shade.inputs["To Max"].default_value = 0.35
    light = nodes.new("ShaderNodeEmission")
    output = nodes.new("ShaderNodeOutputMaterial")
    links.new(color.outputs["Color"], light.inputs["Color"])
    links.new(rim.outputs["Facing"], shade.inputs["Value"])
    links.new(shade.outputs["Result"], light.inputs["Strength"])
    links.new(light.outputs["Emission"], output.inputs["Surface"])
    for place, node in enumerate(nodes):
        node.location.x = 200 * place
    return made


class _OnColors(Operator):
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Ask for colors."""
        if any(bridge.has_comparison(obj) for obj in bridge.chosen(context)):
            return True
        cls.poll_message_set("Compare with Delaunay first")
        return False


class TIMESCALE_OT_show_colors(_OnColors):
    """Colors in every viewport and in renders."""

    bl_idname = "timescale.show_colors"
    bl_label = "Show Colors"
    bl_description = (
        "Let viewports and renders show the comparison, by a modifier that leaves "
        "materials alone"
    )

    def execute(self, context: Context) -> Returned:
        """Dress the selected objects that were compared."""
        show(context, filter(bridge.has_comparison, bridge.targets(context)))
        return {"FINISHED"}


class TIMESCALE_OT_hide_colors(_OnColors):
    """The way back from Show Colors."""

    bl_idname = "timescale.hide_colors"
    bl_label = "Hide Colors"
    bl_description = "Bring back materials and the shading that viewports had"

    def execute(self, context: Context) -> Returned:
        """Undress the selected objects."""
        hide(context, bridge.targets(context))
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory(
    (TIMESCALE_OT_show_colors, TIMESCALE_OT_hide_colors)
)
