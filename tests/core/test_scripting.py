# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands in docs/scripting.md, in their order, in one folder."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from addon import cli, files
from addon.files.shape import Polygons, Shape
from core import shapes

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "scripting.md").read_text("utf-8")
COMMANDS = [
    line
    for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    for line in block.splitlines()
    if line.startswith("python -m addon.cli ")
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Files of the names that the page has."""
    path = tmp_path_factory.mktemp("scripting")
    points, normals, _ = shapes.SPHERE.sample(400, seed=0)
    ball = Shape(points, None, normals)
    for name in ("scan.ply", "reference.ply", "asset.ply", "scans/a.ply", "more/b.xyz"):
        (path / name).parent.mkdir(exist_ok=True)
        files.write(path / name, ball)
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = Polygons.of_rows([[0, 2, 1], [0, 1, 3], [0, 2, 3], [1, 2, 3]])
    files.write(path / "model.obj", Shape(corners, faces, corners))
    return path


def test_the_page_has_commands():
    assert len(COMMANDS) >= 8


@pytest.mark.parametrize("line", COMMANDS)
def test_commands_of_the_page_do_what_it_says(line, folder, monkeypatch):
    monkeypatch.chdir(folder)
    argv = shlex.split(line.removeprefix("python -m addon.cli "))
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert cli.main(argv) == 0
    for option in ("-o", "--report", "--image"):
        if option in argv:
            assert (folder / argv[argv.index(option) + 1]).exists()
    changed = {path for path, data in before.items() if path.read_bytes() != data}
    assert not changed


def test_the_check_fails_where_it_should(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    shape = files.read(folder / "asset.ply")
    normals = shape.normals.copy()
    normals[3] *= -1
    files.write(folder / "asset.ply", Shape(shape.points, None, normals))
    line = next(line for line in COMMANDS if "--signed" in line)
    assert cli.main(shlex.split(line.removeprefix("python -m addon.cli "))) == 3
    assert "1 of 400 normals are more than 5 degrees" in capsys.readouterr().err


def test_the_page_names_every_format_and_key():
    for suffix, kind in files.FORMATS.items():
        said = suffix if kind.needs_blender else kind.name
        named = said in PAGE or suffix[1:].upper() in PAGE or suffix.startswith(".usd")
        assert named, suffix
    assert cli._part("addon.commands.run").SCHEMA in PAGE
