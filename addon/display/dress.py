# SPDX-License-Identifier: GPL-3.0-or-later
"""Making colors visible: a modifier with a material, in viewports that show them.

The modifier leaves materials and points of the object alone, so that hiding the
colors is removing it.
"""

from collections.abc import Iterable
from typing import Any

import bpy
import numpy as np
from bpy.app.handlers import persistent
from bpy.types import Context, Object
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Vector

from .. import bridge
from ..bridge import making
from ..settings.scene import Returned, settings_of
from . import coloring, picture, views
from .nodes import empty_tree, geometry_tree

NAME = bridge.DRESS

# The shape at each point of a cloud, and the attribute that carries the colors to it.
_DISC = "Time-Scale Disc"
_CARRIED = ".ts_carried_color"

# From an object to the copy beside it, in widths of the object.
_GAP = 1.15


def show(context: Context, objects: Iterable[Object]) -> None:
    """Dress objects in their colors and set the viewports up for them."""
    for obj in objects:
        _dress(obj)
    follow(context)


def hide(context: Context, objects: Iterable[Object]) -> None:
    """Undress objects, and with the last one set the viewports back."""
    for obj in objects:
        hide_beside(obj)
        modifier: Any = obj.modifiers.get(NAME)
        if modifier is not None:
            _undress(obj, modifier)
    follow(context)


def follow(context: Context) -> None:
    """Let viewports show colors where there are some, and else what they did."""
    if any(map(is_dressed, context.scene.objects)):
        views.show_colors()
    else:
        views.hide_colors()


def is_dressed(obj: Object | None) -> bool:
    """Whether an object shows its colors."""
    return obj is not None and obj.type in bridge.TYPES and NAME in obj.modifiers


def show_beside(context: Context, obj: Object) -> None:
    """Dress an object and a copy beside it, which wears the baseline's colors."""
    show(context, [obj])
    view = context.region_data
    # To the right of who looks, as far as the object is wide from there.
    right = np.array((1.0, 0.0, 0.0))
    if isinstance(view, bpy.types.RegionView3D):
        right = np.array(view.view_rotation @ Vector((1.0, 0.0, 0.0)))
    width = float(np.ptp(bridge.bounds(obj) @ right))
    made = bridge.add_beside(obj, _GAP * width * right)
    modifier: Any = made.modifiers.get(NAME)
    made.modifiers.remove(modifier)
    _dress(made, color=bridge.COLOR_BESIDE)
    if isinstance(view, bpy.types.RegionView3D):
        _bring_into_view(context, view, made)


def _bring_into_view(context: Context, view: Any, made: Object) -> None:
    """Step back to see a copy that would be out of sight."""
    regions: Any = {region.type: region for region in context.area.regions}
    place = bridge.bounds(made).mean(axis=0)
    found = location_3d_to_region_2d(regions["WINDOW"], view, Vector(place))
    room = regions["WINDOW"].width - regions["UI"].width
    if found is None or not 0 < found.x < 0.8 * room:
        # Past the middle, because the sidebar covers the right.
        view.view_location = view.view_location.lerp(Vector(place), 0.7)
        view.view_distance *= 2.0


def hide_beside(obj: Object) -> None:
    """Remove the copy beside an object, and the colors that it wears."""
    other = bridge.object_beside(obj)
    if other is None:
        return
    modifier: Any = other.modifiers.get(NAME)
    if modifier is not None:
        _undress(other, modifier)
    bridge.remove_beside(obj)


def _dress(obj: Object, *, color: str = bridge.COLOR) -> None:
    if is_dressed(obj):
        return
    tree = geometry_tree(NAME)
    nodes, links = tree.nodes, tree.links
    last = nodes.new("NodeGroupInput").outputs[0]
    if bridge.is_cloud(obj):
        last = _store(tree, last, color, _CARRIED)
        last = _discs(tree, last, picture.point_radius(obj))
        # Not before: the disc has colors of its own.
        last = _store(tree, last, _CARRIED, bridge.COLOR)
    elif color != bridge.COLOR:
        # Solid shading and the material know the colors by one name.
        last = _store(tree, last, color, bridge.COLOR)
    cover = nodes.new("GeometryNodeSetMaterial")
    cover.inputs["Material"].default_value = _material()
    links.new(last, cover.inputs["Geometry"])
    links.new(cover.outputs["Geometry"], nodes.new("NodeGroupOutput").inputs[0])
    for place, node in enumerate(nodes):
        node.location.x = 200 * place
    modifier: Any = obj.modifiers.new(NAME, "NODES")
    modifier.node_group = tree
    modifier.show_expanded = False


def _store(tree: Any, last: Any, source: str, target: str) -> Any:
    """Add nodes that keep a color attribute under another name."""
    read = tree.nodes.new("GeometryNodeInputNamedAttribute")
    read.data_type = "FLOAT_COLOR"
    read.inputs["Name"].default_value = source
    store = tree.nodes.new("GeometryNodeStoreNamedAttribute")
    store.data_type, store.domain = "FLOAT_COLOR", "POINT"
    store.inputs["Name"].default_value = target
    tree.links.new(last, store.inputs["Geometry"])
    tree.links.new(read.outputs["Attribute"], store.inputs["Value"])
    return store.outputs["Geometry"]


def _discs(tree: Any, last: Any, radius: float) -> Any:
    """Add nodes that put a disc across the normal at each point.

    Solid shading, which needs no shader compiled, has colors for meshes only.
    """
    nodes, links = tree.nodes, tree.links
    disc = nodes.new("GeometryNodeObjectInfo")
    disc.inputs["Object"].default_value = _disc()
    normal = nodes.new("GeometryNodeInputNamedAttribute")
    normal.data_type = "FLOAT_VECTOR"
    normal.inputs["Name"].default_value = "ts_normal"
    turn = nodes.new("FunctionNodeAlignRotationToVector")
    put = nodes.new("GeometryNodeInstanceOnPoints")
    put.inputs["Scale"].default_value = (radius,) * 3
    whole = nodes.new("GeometryNodeRealizeInstances")
    links.new(last, put.inputs["Points"])
    links.new(disc.outputs["Geometry"], put.inputs["Instance"])
    links.new(normal.outputs["Attribute"], turn.inputs["Vector"])
    links.new(turn.outputs["Rotation"], put.inputs["Rotation"])
    links.new(put.outputs["Instances"], whole.inputs["Geometry"])
    return whole.outputs["Geometry"]


def _disc() -> Object:
    """The disc, in no scene; from it the mesh of discs knows its active color."""
    found: Any = bpy.data.objects.get(_DISC)
    return found or bpy.data.objects.new(_DISC, making.new_disc(_DISC))


def _undress(obj: Object, modifier: Any) -> None:
    tree = modifier.node_group
    obj.modifiers.remove(modifier)
    if tree is not None and not tree.users:
        bpy.data.node_groups.remove(tree)
    disc: Any = bpy.data.objects.get(_DISC)
    if disc is not None and not disc.users:
        bpy.data.meshes.remove(disc.data)
    made: Any = bpy.data.materials.get(NAME)
    if made is not None and not made.users:
        bpy.data.materials.remove(made)


def _material() -> bpy.types.Material:
    """The color attribute as light, darker toward the rim so that shape shows."""
    found: Any = bpy.data.materials.get(NAME)
    if found is not None:
        return found
    made = bpy.data.materials.new(NAME)
    tree = empty_tree(made)
    nodes, links = tree.nodes, tree.links
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


class TIMESCALE_OT_show_colors(coloring.OnComparison):
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


class TIMESCALE_OT_hide_colors(coloring.OnComparison):
    """The way back from Show Colors."""

    bl_idname = "timescale.hide_colors"
    bl_label = "Hide Colors"
    bl_description = "Bring back materials and the shading that viewports had"

    def execute(self, context: Context) -> Returned:
        """Undress the selected objects."""
        for obj in bridge.targets(context):
            coloring.end_beside(obj)
        hide(context, bridge.targets(context))
        return {"FINISHED"}


class TIMESCALE_OT_side_by_side(coloring.OnComparison):
    """Errors of both methods in one look."""

    bl_idname = "timescale.side_by_side"
    bl_label = "Side by Side"
    bl_description = (
        "Put a copy beside each selected object that shows the errors of Delaunay, "
        "in the same range of colors; a second time takes it away"
    )

    def execute(self, context: Context) -> Returned:
        """Show both methods, or one again where both are shown."""
        objects = list(filter(bridge.has_comparison, bridge.targets(context)))
        shown = [obj for obj in objects if bridge.object_beside(obj) is not None]
        for obj in shown or objects:
            if shown:
                hide_beside(obj)
                coloring.end_beside(obj)
            elif coloring.begin_beside(obj):
                show_beside(context, obj)
                # The menu says what is seen.
                settings_of(context).color_by = bridge.record_of(obj).color_by
            else:
                self.report({"WARNING"}, f"{obj.name}: {NO_TRUTH}")
        none = not shown and not any(map(bridge.object_beside, objects))
        return {"CANCELLED"} if none else {"FINISHED"}


NO_TRUTH = "errors need true normals; choose them and compare again"

_register_classes, _unregister_classes = bpy.utils.register_classes_factory(
    (TIMESCALE_OT_show_colors, TIMESCALE_OT_hide_colors, TIMESCALE_OT_side_by_side)
)


@persistent  # type: ignore[untyped-decorator]  # untyped in the stubs
def _follow(*_arguments: object) -> None:
    # Undo takes the colors of objects back, and leaves viewports alone.
    follow(bpy.context)


@persistent  # type: ignore[untyped-decorator]  # untyped in the stubs
def _follow_removed(*_arguments: object) -> None:
    # The last object with colors may be gone.
    if views.show_them():
        follow(bpy.context)


_HANDLERS = (
    ("undo_post", _follow),
    ("redo_post", _follow),
    ("load_post", _follow),
    ("depsgraph_update_post", _follow_removed),
)


def register() -> None:
    """Add the operators, and look after the viewports."""
    _register_classes()
    for name, handler in _HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    """Remove them, and set the viewports back."""
    for name, handler in _HANDLERS:
        handlers = getattr(bpy.app.handlers, name)
        if handler in handlers:
            handlers.remove(handler)
    views.hide_colors()
    _unregister_classes()
