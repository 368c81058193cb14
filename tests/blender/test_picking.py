# SPDX-License-Identifier: GPL-3.0-or-later
"""The values at a picked point: those of the attributes, in words."""

import bmesh
import bpy
import numpy as np
import pytest
import scenes
from bl_ext.user_default.timescale_normals.addon.display import picking

pick = bpy.ops.timescale.pick_point


@pytest.fixture
def compared():
    """Samples of a torus, with the errors of both methods."""
    bpy.ops.timescale.add_samples(shape="torus", count=2000, noise=0.2)
    bpy.ops.timescale.compare_delaunay(truth="true_normal")
    return bpy.context.object


def rows(obj):
    _, values = picking.values_of(obj)
    return dict(picking.rows_of(values))


def test_rows_are_the_attributes_at_the_point(compared):
    assert pick(index=1234) == {"FINISHED"}
    found = rows(compared)
    for label, name in (
        ("Angle of Estimate", "ts_angle"),
        ("Angle of Delaunay", "delaunay_angle"),
    ):
        # Three digits are shown.
        angle, error = found[label].rstrip(")").split("° (")
        assert float(angle) == pytest.approx(scenes.get(compared, name)[1234], rel=5e-3)
        kept = scenes.get(compared, name.replace("angle", "error"))
        assert float(error) == pytest.approx(kept[1234], rel=5e-3)
    sure = scenes.get(compared, "ts_confidence")[1234]
    assert float(found["Confidence"]) == pytest.approx(sure, abs=0.005)
    normal = [float(part) for part in found["Normal"].split(",")]
    np.testing.assert_allclose(
        normal, scenes.get(compared, "ts_normal")[1234], atol=5e-4
    )


def test_estimate_alone_has_no_errors():
    scenes.sphere()
    bpy.ops.timescale.estimate_normals()
    pick(index=5)
    found = rows(bpy.context.object)
    assert not [label for label in found if "Angle" in label]
    assert "Confidence" in found


def test_without_truth_the_angle_between_is_said():
    obj = scenes.sphere()
    bpy.ops.timescale.compare_delaunay()
    pick(index=5)
    value = float(rows(obj)["Angle Between"].partition("°")[0])
    assert value == pytest.approx(scenes.get(obj, "ts_angle")[5], rel=5e-3)


def test_point_without_a_normal_says_so():
    obj = scenes.new_cloud(scenes.ball())
    bpy.ops.timescale.estimate_normals(radius=1e-4)
    pick(index=0)
    assert rows(obj) == {"Normal": "none"}


def test_active_vertex_is_looked_at_in_edit_mode():
    obj = scenes.sphere()
    bpy.ops.timescale.compare_delaunay()
    expected = scenes.get(obj, "ts_angle")[7]
    bpy.ops.object.mode_set(mode="EDIT")
    assert picking.values_of(obj) is None
    edited = bmesh.from_edit_mesh(obj.data)
    edited.verts.ensure_lookup_table()
    edited.select_history.clear()
    edited.select_history.add(edited.verts[7])
    row, values = picking.values_of(obj)
    assert row == 7
    assert values["ts_angle"] == pytest.approx(expected)
    assert dict(picking.rows_of(values))["Angle Between"].startswith(f"{expected:.3g}°")


def test_no_point_after_clearing_or_when_none_is_wanted(compared):
    pick(index=3)
    pick(index=-1)
    assert picking.values_of(compared) is None
    pick(index=3)
    bpy.ops.timescale.clear_results()
    assert picking.values_of(compared) is None


@pytest.mark.usefixtures("compared")
def test_point_that_is_not_there():
    with pytest.raises(RuntimeError, match="below 2,000, got 2,000"):
        pick(index=2000)


def test_results_are_asked_for():
    scenes.sphere()
    with pytest.raises(RuntimeError, match="Estimate or compare normals first"):
        pick(index=0)


def test_lengths_are_in_the_units_of_the_scene(compared):
    pick(index=0)
    units = bpy.context.scene.unit_settings
    units.system, units.scale_length = "METRIC", 0.001
    assert rows(compared)["Reach of Patch"].endswith("mm")
    units.system = "NONE"
    assert float(rows(compared)["Reach of Patch"]) == pytest.approx(
        scenes.get(compared, "ts_scale")[0], rel=0.05
    )
