# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line with Blender at hand: scenes, and plain files as without it."""

import json
from pathlib import Path

import bpy
import numpy as np
import pytest
from bl_ext.user_default.timescale_normals.addon import cli, files
from bl_ext.user_default.timescale_normals.addon.commands import scenes
from bl_ext.user_default.timescale_normals.addon.files.shape import Shape
from bl_ext.user_default.timescale_normals.core import shapes

SUFFIXES = [".blend", ".glb", ".gltf", ".usd", ".usda", ".usdc", ".usdz"]


def save_scene(path: Path) -> None:
    """A ball, and one beside it of another size."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    for name, radius, x in (("Ball", 1.0, 0.0), ("Boulder", 2.0, 5.0)):
        bpy.ops.mesh.primitive_ico_sphere_add(
            subdivisions=4, radius=radius, location=(x, 0, 0)
        )
        bpy.context.object.name = bpy.context.object.data.name = name
        # Shaded flat, every face of a glTF file has vertices of its own.
        bpy.ops.object.shade_smooth()
    scenes.save_scene(path)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_objects_of_a_scene_get_normals(suffix, tmp_path, capfd):
    save_scene(tmp_path / f"a{suffix}")
    capfd.readouterr()
    report = tmp_path / "r.json"
    command = ["estimate", str(tmp_path / f"a{suffix}"), "--report", str(report)]
    assert cli.main([*command, "-o", str(tmp_path / "out" / f"b{suffix}")]) == 0
    out, _ = capfd.readouterr()
    # What Blender says of its own is not our report.
    assert len(out.splitlines()) == 1
    assert "normals, in 2 objects" in out
    row = json.loads(report.read_text("utf-8"))["files"][0]
    names = [item["name"].split(".")[0] for item in row["objects"]]
    assert names == ["Ball", "Boulder"]
    found = scenes.read_shapes(tmp_path / "out" / f"b{suffix}")
    assert len(found) == 2
    for shape in found.values():
        middle = shape.points.mean(axis=0)
        outward = shape.points - middle
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        # Normals of an icosphere's vertices are exact in its symmetric corners and
        # a tenth of a degree off elsewhere.
        assert (np.einsum("ij,ij->i", outward, shape.normals) > 0.9999).all()


@pytest.mark.parametrize("suffix", [".blend", ".glb", ".usdc"])
def test_faces_of_a_scene_are_wound_outward(suffix, tmp_path):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    for name, x in (("Sound", 0.0), ("Turned", 5.0)):
        bpy.ops.mesh.primitive_uv_sphere_add(location=(x, 0, 0))
        bpy.context.object.name = bpy.context.object.data.name = name
        bpy.ops.object.shade_smooth()
    mesh = bpy.data.meshes["Turned"]
    for face in list(mesh.polygons)[::3]:
        face.flip()
    scenes.save_scene(tmp_path / f"a{suffix}")
    report = tmp_path / "r.json"
    command = ["repair", str(tmp_path / f"a{suffix}"), "--report", str(report)]
    assert cli.main([*command, "-o", str(tmp_path / f"b{suffix}")]) == 0
    row = json.loads(report.read_text("utf-8"))["files"][0]
    flipped = {item["name"]: item["flipped_faces"] for item in row["objects"]}
    assert flipped["Sound"] == 0
    assert flipped["Turned"] > 150
    found = scenes.read_shapes(tmp_path / f"b{suffix}")
    assert len(found) == 2
    for shape in found.values():
        middle = shape.points.mean(axis=0)
        corners = shape.points[shape.faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert (np.einsum("ij,ij->i", across, corners[:, 0] - middle) > 0).all()
        assert ((shape.normals * (shape.points - middle)).sum(axis=1) > 0).all()


def test_a_blend_file_holds_the_attributes(tmp_path):
    save_scene(tmp_path / "a.blend")
    command = ["estimate", str(tmp_path / "a.blend"), "-o", str(tmp_path / "b.blend")]
    assert cli.main(command) == 0
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "b.blend"))
    for obj in bpy.data.objects:
        assert {"ts_normal", "ts_valid"} <= set(obj.data.attributes.keys())


def test_compare_object_by_object(tmp_path, capsys):
    save_scene(tmp_path / "a.glb")
    command = ["compare", str(tmp_path / "a.glb"), "--normals", "file"]
    assert cli.main([*command, "--truth", str(tmp_path / "a.glb")]) == 0
    assert "0 degrees from the true ones" in capsys.readouterr().out
    # Shaded smooth it has the means of faces, which the estimate is not quite.
    assert cli.main([*command, "--fail-above", "1e-9"]) == 3
    assert cli.main([*command, "--fail-above", "5"]) == 0


@pytest.mark.parametrize("suffix", [".blend", ".glb", ".usdc"])
def test_a_broken_scene_is_one_line(suffix, tmp_path, capfd):
    (tmp_path / f"a{suffix}").write_bytes(b"nothing of the kind")
    command = ["estimate", str(tmp_path / f"a{suffix}"), "-o", str(tmp_path / "out/")]
    assert cli.main([*command[:-1], f"{tmp_path}/out/"]) == 1
    out, told = capfd.readouterr()
    lines = [line for line in told.splitlines() if line.startswith(str(tmp_path))]
    assert len(lines) == 1
    assert "Traceback" not in told + out
    assert not list((tmp_path / "out").iterdir())


def test_an_empty_scene_says_so(tmp_path, capsys):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    command = ["estimate", str(tmp_path / "a.blend"), "-o", str(tmp_path / "b.blend")]
    assert cli.main(command) == 1
    assert "expected meshes or point clouds" in capsys.readouterr().err


def test_plain_files_go_as_without_blender(tmp_path):
    points, normals, _ = shapes.SPHERE.sample(400, seed=0)
    for suffix in (".ply", ".pcd", ".npz", ".xyz"):
        files.write(tmp_path / f"a{suffix}", Shape(points, None, normals))
        command = ["estimate", str(tmp_path / f"a{suffix}"), "--quiet", "-o"]
        assert cli.main([*command, str(tmp_path / f"b{suffix}")]) == 0
        found = files.read(tmp_path / f"b{suffix}")
        assert (np.einsum("ij,ij->i", found.normals, points) > 0.99).all()


def test_las_is_there_and_laz_says_how_to_get_it(tmp_path, capsys):
    points, normals, _ = shapes.SPHERE.sample(400, seed=0)
    files.write(tmp_path / "a.las", Shape(points, None, normals))
    command = ["estimate", str(tmp_path / "a.las"), "--quiet", "-o"]
    assert cli.main([*command, str(tmp_path / "b.las")]) == 0
    found = files.read(tmp_path / "b.las").normals
    assert (np.einsum("ij,ij->i", found, points) > 0.99).all()
    assert cli.main([*command, str(tmp_path / "b.laz")]) == 1
    assert '-m pip install "lazrs"' in capsys.readouterr().err


def test_several_processes(tmp_path):
    for number in range(3):
        points, normals, _ = shapes.SPHERE.sample(400, seed=number)
        files.write(tmp_path / f"{number}.ply", Shape(points, None, normals))
    command = ["estimate", str(tmp_path / "*.ply"), "--jobs", "2", "--quiet"]
    assert cli.main([*command, "-o", str(tmp_path / "out")]) == 0
    assert len(list((tmp_path / "out").iterdir())) == 3
