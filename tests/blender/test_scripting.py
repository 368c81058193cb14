# SPDX-License-Identifier: GPL-3.0-or-later
"""The scripts and commands for Blender in docs/scripting.md."""

import re
import shlex
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from bl_ext.user_default.timescale_normals.addon import cli
from bl_ext.user_default.timescale_normals.addon.commands import scenes

PAGE = Path(__file__).resolve().parents[2] / "docs" / "scripting.md"
TEXT = PAGE.read_text("utf-8")
SCRIPTS = dict(re.findall(r"```python\n# (\w+\.py)\n(.*?)```", TEXT, re.DOTALL))
COMMANDS = re.findall(r"^blender -b --command timescale_normals (.*)$", TEXT, re.M)


def save_scene(path: Path) -> None:
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4)
    bpy.ops.object.shade_smooth()
    scenes.save_scene(path)


def run_script(name: str, monkeypatch, *arguments: object) -> None:
    said = [str(argument) for argument in arguments]
    monkeypatch.setattr(sys, "argv", ["blender", "-b", "--python", name, "--", *said])
    exec(compile(SCRIPTS[name], name, "exec"), {"__name__": "__main__"})


def has_normals(path: Path) -> bool:
    bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    return all("ts_normal" in obj.data.attributes for obj in bpy.data.objects)


def test_the_page_has_scripts():
    assert set(SCRIPTS) == {"repair.py", "folder.py", "numbers.py"}


def test_repair_of_a_scene(tmp_path, monkeypatch):
    save_scene(tmp_path / "a.blend")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"), load_ui=False)
    run_script("repair.py", monkeypatch, tmp_path / "b.blend")
    assert has_normals(tmp_path / "b.blend")


def test_repair_of_nothing_fails(tmp_path, monkeypatch):
    with pytest.raises((SystemExit, RuntimeError)):
        run_script("repair.py", monkeypatch, tmp_path / "b.blend")
    assert not list(tmp_path.iterdir())


def test_a_folder_of_scenes(tmp_path, monkeypatch):
    (tmp_path / "in").mkdir()
    for name in ("a", "b"):
        save_scene(tmp_path / "in" / f"{name}.blend")
    run_script("folder.py", monkeypatch, tmp_path / "in", tmp_path / "out")
    assert all(has_normals(tmp_path / "out" / f"{name}.blend") for name in "ab")


def test_numbers_alone(tmp_path, monkeypatch):
    save_scene(tmp_path / "a.blend")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"), load_ui=False)
    run_script("numbers.py", monkeypatch, tmp_path / "normals.npy")
    normals = np.load(tmp_path / "normals.npy")
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)


@pytest.mark.parametrize("line", COMMANDS)
def test_commands_on_scenes(line, tmp_path, monkeypatch):
    argv = shlex.split(line)
    save_scene(tmp_path / argv[1])
    monkeypatch.chdir(tmp_path)
    assert cli.main(argv) == 0
    assert (tmp_path / argv[argv.index("-o") + 1]).exists()
