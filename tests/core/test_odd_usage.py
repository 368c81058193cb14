# SPDX-License-Identifier: GPL-3.0-or-later
"""Command lines as they are typed: odd names, odd streams, outputs in the way."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from addon import cli, files
from addon.files.shape import Shape
from core import shapes

ROOT = Path(__file__).resolve().parents[2]
posix = pytest.mark.skipif(os.name != "posix", reason="files and streams of POSIX")


@pytest.fixture(autouse=True)
def sphere(tmp_path, monkeypatch):
    """The lines of a sphere, in a.xyz of the working folder."""
    points, _, _ = shapes.SPHERE.sample(200, seed=0)
    lines = "".join("{:.6f} {:.6f} {:.6f}\n".format(*point) for point in points)
    (tmp_path / "a.xyz").write_text(lines, "utf-8")
    monkeypatch.chdir(tmp_path)
    return lines


def names(folder: str = ".") -> list[str]:
    return sorted(path.name for path in Path(folder).iterdir())


def estimate(*argv: str) -> int:
    return cli.main(["estimate", *argv])


def ran(*argv: str, **streams) -> subprocess.CompletedProcess:
    """Run the command line as a process of its own in the working folder."""
    command = [sys.executable, "-m", "addon.cli", *argv]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.run(command, env=environment, check=False, timeout=120, **streams)


@pytest.mark.parametrize(
    "name",
    [
        "my scan.xyz",
        "ünï ☃.xyz",
        "[1].xyz",
        "A.XYZ",
        "a.b.c.xyz",
        "./-dash.xyz",
        "*.xyz",
    ],
)
def test_names_are_taken_as_they_are(name, sphere):
    Path(name).write_text(sphere, "utf-8")
    assert estimate(name, "-o", "out.xyz") == 0
    assert estimate(name, "-o", f"folder/{name}") == 0
    assert Path("folder", name).read_bytes() == Path("out.xyz").read_bytes()
    assert len(Path("out.xyz").read_text("utf-8").split()) == 6 * 200


@posix
def test_a_name_that_breaks_lines_is_said_on_one(sphere, capsys):
    Path("a\nb.xyz").write_text(sphere, "utf-8")
    assert estimate("a\nb.xyz", "-o", "out.xyz") == 0
    assert capsys.readouterr().out.startswith("a?b.xyz: 200 normals")


def test_a_dash_in_front_needs_two(sphere):
    Path("-a.xyz").write_text(sphere, "utf-8")
    assert estimate("-o", "out.xyz", "--", "-a.xyz") == 0


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("none.xyz", "cannot be read: No such file"),
        ("no*.xyz", "no file matches the pattern"),
        ("empty", "expected files of .ply, "),
        ("noending", "got no ending"),
        ("pipe.xyz", "expected a file, got a pipe or a device"),
        ("loop.xyz", "cannot be read"),
        ("broken.xyz", "cannot be read: No such file"),
    ],
)
@posix
def test_what_is_no_file_is_told_in_a_line(name, told, capsys):
    Path("empty").mkdir()
    Path("noending").touch()
    os.mkfifo("pipe.xyz")
    Path("loop.xyz").symlink_to("loop.xyz")
    Path("broken.xyz").symlink_to("nowhere")
    before = names()
    assert estimate(name, "-o", "out.xyz") == 1
    said = capsys.readouterr().err
    assert said.startswith(f"{name}: {told}") or told in said
    assert said.count("\n") == 1
    assert names() == before


def test_empty_names_are_wrong_usage(capsys):
    assert estimate("", "-o", "out/") == 2
    assert estimate("a.xyz", "-o", "") == 2
    assert capsys.readouterr().err.count("got an empty name") == 2
    assert names() == ["a.xyz"]


def test_the_same_file_twice_is_done_once(tmp_path, capsys):
    again = str(tmp_path / "a.xyz")
    assert estimate("a.xyz", "./a.xyz", again, "a.xyz", "-o", "out/") == 0
    assert capsys.readouterr().out.count("normals") == 1


def test_a_file_may_become_itself(sphere):
    assert estimate("a.xyz", "-o", "a.xyz") == 1
    assert Path("a.xyz").read_text("utf-8") == sphere
    assert estimate("a.xyz", "-o", "a.xyz", "--overwrite") == 0
    rows = np.loadtxt("a.xyz")
    assert rows.shape == (200, 6)
    assert (np.einsum("ij,ij->i", rows[:, :3], rows[:, 3:]) > 0.99).all()


@posix
def test_a_link_stays_a_link():
    Path("kept").mkdir()
    Path("a.xyz").rename("kept/a.xyz")
    Path("link.xyz").symlink_to("kept/a.xyz")
    assert estimate("link.xyz", "-o", "link.xyz", "--overwrite") == 0
    assert Path("link.xyz").is_symlink()
    assert np.loadtxt("kept/a.xyz").shape == (200, 6)


@pytest.mark.parametrize(
    "more",
    [
        ["--report", "out.xyz"],
        ["--report", "./a.xyz"],
        ["--image", "p.png", "--report", "p.png"],
        ["--image", "p.jpg"],
        ["--image", "out.xyz"],
    ],
)
def test_a_report_or_picture_replaces_nothing_else(more, sphere, capsys):
    assert estimate("a.xyz", "-o", "out.xyz", *more, "--overwrite") == 2
    assert "expected" in capsys.readouterr().err
    assert Path("a.xyz").read_text("utf-8") == sphere
    assert names() == ["a.xyz"]


@posix
@pytest.mark.parametrize("closed", [(0,), (1,), (2,), (0, 1, 2)])
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_without_streams_the_work_is_done(closed, jobs, sphere):
    Path("b.xyz").write_text(sphere, "utf-8")

    def close():
        for number in closed:
            os.close(number)

    done = ran(
        "estimate", "a.xyz", "b.xyz", "-o", "out", "--jobs", jobs, preexec_fn=close
    )
    assert done.returncode == 0
    assert names("out") == ["a.xyz", "b.xyz"]
    assert np.loadtxt("out/b.xyz").shape == (200, 6)


@posix
def test_nobody_who_reads_or_no_room_for_words_ends_no_work(sphere):
    Path("b.xyz").write_text(sphere, "utf-8")
    reader, writer = os.pipe()
    os.close(reader)
    for number, stream in enumerate((writer, os.open("/dev/full", os.O_WRONLY))):
        done = ran(
            *("estimate", "a.xyz", "b.xyz", "-o", f"{number}/"),
            stdout=stream,
            stderr=subprocess.PIPE,
        )
        os.close(stream)
        assert (done.returncode, done.stderr) == (0, b"")
        assert names(str(number)) == ["a.xyz", "b.xyz"]


@posix
def test_a_folder_that_may_not_be_written_to(capsys):
    Path("locked").mkdir(mode=0o500)
    if os.access("locked", os.W_OK):
        pytest.skip("nothing is locked for this user")
    assert estimate("a.xyz", "-o", "locked/out.xyz") == 1
    assert "cannot write to the folder locked: Permission denied" in (
        capsys.readouterr().err
    )
    assert estimate("a.xyz", "-o", "out.xyz", "--report", "locked/r.json") == 1
    assert not Path("out.xyz").exists()


def test_a_full_disk_leaves_no_part_of_a_file(monkeypatch, capsys):
    def write(path, _shape):
        path.write_bytes(b"the first half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cli._part("addon.files"), "write", write)
    assert estimate("a.xyz", "-o", "out.xyz") == 1
    assert capsys.readouterr().err == "a.xyz: No space left on device\n"
    assert names() == ["a.xyz"]


def test_coordinates_whose_squares_are_no_numbers_are_told(capsys):
    points, _, _ = shapes.SPHERE.sample(200, seed=0)
    for number, scale in enumerate((1e200, 1e-200)):
        np.save(f"{number}.npy", points * scale)
        assert estimate(f"{number}.npy", "-o", "out.npy") == 1
        assert "expected points that are" in capsys.readouterr().err


def test_a_mark_of_utf_8_is_no_column(sphere):
    mark = b"\xef\xbb\xbf"
    Path("a.csv").write_bytes(mark + b"x,y,z\n" + sphere.replace(" ", ",").encode())
    Path("b.xyz").write_bytes(mark + sphere.encode())
    for name in ("a.csv", "b.xyz"):
        assert estimate(name, "-o", "out/") == 0
        assert Path("out", name).read_bytes().startswith(mark)
        assert len(files.read(Path("out", name)).points) == 200
    assert files.read(Path("out/a.csv")).normals is not None


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off"])
def test_faces_of_many_corners_stay_whole(suffix):
    turn = np.arange(8) * np.pi / 4
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros(8)], axis=1)
    points = np.concatenate([ring, ring + [0, 0, 1]])
    sides = [[i, (i + 1) % 8, 8 + (i + 1) % 8, 8 + i] for i in range(8)]
    faces = [list(range(8))[::-1], list(range(8, 16)), *sides]
    of_shape = cli._part("addon.files.shape").Polygons
    sizes = np.array([len(face) for face in faces])
    polygons = of_shape(np.concatenate(faces), sizes)
    files.write(Path(f"in{suffix}"), Shape(points, polygons, points))
    for command in ("estimate", "repair"):
        assert cli.main([command, f"in{suffix}", "-o", f"{command}{suffix}"]) == 0
        found = files.read(Path(f"{command}{suffix}"))
        assert found.polygons.sizes.tolist() == sizes.tolist()
        # Every normal of a prism points away from its middle.
        away = found.points - [0, 0, 0.5]
        assert (np.einsum("ij,ij->i", found.normals, away) > 0).all()


def test_angles_are_degrees():
    Path("cube.off").write_text(
        "OFF\n8 6 0\n"
        + "".join(f"{x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1))
        + "4 0 1 3 2\n4 4 6 7 5\n4 0 4 5 1\n4 2 3 7 6\n4 0 2 6 4\n4 1 5 7 3\n",
        "utf-8",
    )
    more = ["--sharp-angle", "30", "--report", "r.json"]
    assert estimate("cube.off", "-o", "out.ply", *more) == 0
    settings = json.loads(Path("r.json").read_text("utf-8"))["settings"]
    # As in Settings: in radians.
    assert settings["sharp_angle"] == pytest.approx(np.pi / 6)
    assert estimate("cube.off", "-o", "out.ply", "--sharp-angle", "200") == 2


@pytest.mark.parametrize("command", ["", "estimate", "compare", "repair", "reproduce"])
def test_help_fits_a_terminal(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert cli.main([*command.split(), "--help"]) == 0
    told = capsys.readouterr().out
    assert max(len(line) for line in told.splitlines()) <= 80
    # Nothing that only makes sense in Python.
    assert "None" not in told
    assert "(n, 3)" not in told
