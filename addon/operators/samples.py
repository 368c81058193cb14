# SPDX-License-Identifier: GPL-3.0-or-later
"""Add > Mesh > Time-Scale Samples: points on surfaces whose true normals are known."""

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty
from bpy.types import Context, Menu, Operator

from ...core import shapes
from ..bridge import making
from ..settings.scene import Returned

TRUTH = "true_normal"

_TIPS = {
    "phi1": "First surface of the paper, a sheet with a crossing",
    "phi2": "Second surface of the paper, a shell that grows as it winds",
    "plane": "Flat square, on which every method should be exact",
    "paraboloid": "Bowl, on which patches of second order are exact",
    "sphere": "Closed surface of even curvature",
    "torus": "Closed surface of both signs of curvature",
    "bumpy": "Sphere with waves, for the limits of a patch",
}


class TIMESCALE_OT_add_samples(Operator):
    """Points on an analytic surface."""

    bl_idname = "timescale.add_samples"
    bl_label = "Time-Scale Samples"
    bl_description = (
        "Add points on a surface whose true normals are known, as attribute "
        "true_normal, to compare estimates with"
    )
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender wants a plain set

    shape: EnumProperty(
        name="Surface",
        description="Where the points lie",
        items=[(name, name.title(), _TIPS[name]) for name in shapes.ALL],
        default="phi2",
    )
    count: IntProperty(
        name="Points",
        description="How many there are",
        default=4000,
        min=9,
        max=1_000_000,
        soft_max=100_000,
    )
    noise: FloatProperty(
        name="Noise",
        description="Standard deviation, in per cent of the diagonal of the whole",
        default=0.0,
        min=0.0,
        soft_max=5.0,
        max=100.0,
        subtype="PERCENTAGE",
        precision=2,
    )
    even: BoolProperty(
        name="Even",
        description="Spread the points evenly, not by chance alone",
        default=True,
    )
    seed: IntProperty(
        name="Seed", description="Another number gives other points", min=0
    )
    as_mesh: BoolProperty(
        name="As Mesh",
        description="Make vertices of a mesh, where Edit Mode can select and delete",
    )

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Ask for Object Mode."""
        if context.mode == "OBJECT":
            return True
        cls.poll_message_set("Leave Edit Mode first")
        return False

    def execute(self, context: Context) -> Returned:
        """Sample, add noise, make the object; the true normals have none."""
        surface = shapes.ALL[self.shape]
        points, normals, _ = surface.sample(self.count, self.seed, even=self.even)
        points = shapes.add_noise(points, self.noise / 100, self.seed)
        making.add_points(
            context,
            f"{self.shape.title()} Samples",
            points,
            {TRUTH: normals},
            cloud=not self.as_mesh,
        )
        return {"FINISHED"}


def _draw_menu(menu: Menu, _context: Context) -> None:
    menu.layout.separator()
    menu.layout.operator(TIMESCALE_OT_add_samples.bl_idname, icon="POINTCLOUD_DATA")


_register_classes, _unregister_classes = bpy.utils.register_classes_factory(
    (TIMESCALE_OT_add_samples,)
)


def register() -> None:
    """Add the operator and its entry in the menu."""
    _register_classes()
    # In the stubs the function that draws does not get the menu.
    bpy.types.VIEW3D_MT_mesh_add.append(_draw_menu)  # type: ignore[arg-type]


def unregister() -> None:
    """Remove them."""
    # As above.
    bpy.types.VIEW3D_MT_mesh_add.remove(_draw_menu)  # type: ignore[arg-type]
    _unregister_classes()
