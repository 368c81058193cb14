# SPDX-License-Identifier: GPL-3.0-or-later
"""Many files through the command line: what is done, said, left and refused."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from addon import cli, files
from addon.files.shape import Polygons, Shape
from core import shapes

ROOT = Path(__file__).resolve().parents[2]


def save_sphere(path: Path, count: int = 300, seed: int = 0) -> None:
    points, normals, _ = shapes.SPHERE.sample(count, seed=seed)
    files.write(path, Shape(points, None, normals))


@pytest.fixture
def scans(tmp_path):
    """A folder with three spheres and a broken file."""
    folder = tmp_path / "scans"
    folder.mkdir()
    for number in range(3):
        save_sphere(folder / f"scan{number}.ply", seed=number)
    (folder / "broken.ply").write_bytes(b"ply\nnonsense\nend_header\n")
    (folder / "notes.md").write_text("not ours", "utf-8")
    return folder


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_broken_file_is_one_line_and_the_others_are_done(scans, tmp_path, capsys):
    out = tmp_path / "new" / "out"
    assert cli.main(["estimate", str(scans), "-o", f"{out}/"]) == 1
    said, told = capsys.readouterr()
    assert told.count("\n") == 1
    assert told.startswith(f"{scans}/broken.ply: expected a header of PLY")
    assert [line.split(":")[0] for line in said.splitlines()] == [
        str(scans / f"scan{number}.ply") for number in range(3)
    ]
    assert names(out) == [f"scan{number}.ply" for number in range(3)]
    shape = files.read(out / "scan1.ply")
    # A unit sphere: the normal is the place.
    assert (np.einsum("ij,ij->i", shape.normals, shape.points) > 0.99).all()


def test_patterns_and_quiet(scans, tmp_path, capsys):
    out = tmp_path / "out"
    pattern = str(scans / "scan[02].ply")
    assert cli.main(["estimate", pattern, "--quiet", "-o", str(out)]) == 0
    assert capsys.readouterr() == ("", "")
    assert names(out) == ["scan0.ply", "scan2.ply"]


def test_several_processes_write_the_same_bytes(scans, tmp_path, capsys):
    for jobs in "13":
        command = ["estimate", str(scans), "-o", str(tmp_path / jobs), "--jobs", jobs]
        assert cli.main(command) == 1
    said, told = capsys.readouterr()
    assert len(said.splitlines()) == 6
    assert len(set(told.splitlines())) == 1
    for path in (tmp_path / "1").iterdir():
        assert path.read_bytes() == (tmp_path / "3" / path.name).read_bytes()


def test_what_is_there_is_kept_replaced_or_skipped(scans, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    (out / "scan0.ply").write_text("mine", "utf-8")
    command = ["estimate", str(scans / "scan*.ply"), "-o", str(out)]
    assert cli.main(command) == 1
    told = capsys.readouterr().err
    assert "scan0.ply is there already: give --overwrite" in told
    assert told.count("\n") == 1
    assert cli.main([*command, "--skip-existing"]) == 0
    assert "skipped" in capsys.readouterr().out
    assert (out / "scan0.ply").read_text("utf-8") == "mine"
    assert cli.main([*command, "--overwrite"]) == 0
    assert files.read(out / "scan0.ply").normals is not None


def test_a_dry_run_touches_nothing(scans, tmp_path, capsys):
    out = tmp_path / "out"
    command = ["estimate", str(scans), "-o", str(out), "--dry-run"]
    assert cli.main([*command, "--report", str(tmp_path / "r.json")]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[-1] == f"{scans}/scan2.ply -> {out}/scan2.ply"
    assert names(tmp_path) == ["scans"]


@pytest.mark.parametrize(
    "more",
    [
        ["--neighbors", "3"],
        ["--neighbors", "many"],
        ["--method", "best"],
        ["--jobs", "0"],
        ["--viewpoint", "1", "2"],
    ],
)
def test_settings_are_checked_before_anything_is_read(more, tmp_path, capsys):
    command = ["estimate", str(tmp_path / "none.ply"), "-o", str(tmp_path / "a.ply")]
    assert cli.main([*command, *more]) == 2
    assert "expected" in capsys.readouterr().err or "invalid choice"


def test_two_files_that_would_become_one(scans, tmp_path, capsys):
    other = tmp_path / "other"
    other.mkdir()
    save_sphere(other / "scan0.ply")
    command = ["estimate", str(scans), str(other), "-o", str(tmp_path / "out")]
    assert cli.main(command) == 2
    assert "would both become" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_options_are_the_settings(tmp_path):
    save_sphere(tmp_path / "a.ply")
    command = ["estimate", str(tmp_path / "a.ply"), "-o", str(tmp_path / "b.npz")]
    command += ["--neighbors", "20", "--no-sheets", "--orientation", "viewpoint"]
    command += ["--viewpoint", "0", "0", "0", "--report", str(tmp_path / "r.json")]
    assert cli.main(command) == 0
    report = json.loads((tmp_path / "r.json").read_text("utf-8"))
    assert report["settings"] == {
        "neighbors": 20,
        "sheets": False,
        "orientation": "viewpoint",
        "viewpoint": [0.0, 0.0, 0.0],
    }
    shape = files.read(tmp_path / "b.npz")
    assert (np.einsum("ij,ij->i", shape.normals, shape.points) < 0).all()


def test_the_report_has_a_row_for_each_file(scans, tmp_path):
    path = tmp_path / "r.json"
    command = ["estimate", str(scans), "-o", str(tmp_path / "out"), "--quiet"]
    assert cli.main([*command, "--report", str(path)]) == 1
    report = json.loads(path.read_text("utf-8"))
    assert report["schema"] == "timescale_normals.report/1"
    assert report["counts"] == {"done": 3, "skipped": 0, "failed": 1}
    assert report["exit_code"] == 1
    broken, first, *_ = report["files"]
    assert broken["status"] == "failed"
    assert "header" in broken["error"]
    assert (first["points"], first["valid"], first["invalid"]) == (300, 300, 0)
    assert first["output"].endswith("out/scan0.ply")


def test_pictures_are_png(scans, tmp_path):
    command = ["estimate", str(scans / "scan*.ply"), "-o", str(tmp_path / "out")]
    assert cli.main([*command, "--image", str(tmp_path / "png"), "--quiet"]) == 0
    assert names(tmp_path / "png") == [f"scan{number}.ply.png" for number in range(3)]
    assert (tmp_path / "png" / "scan0.ply.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_points_without_coordinates_keep_their_place(tmp_path):
    points, _, _ = shapes.SPHERE.sample(200, seed=0)
    points[[3, 70]] = np.nan
    np.save(tmp_path / "a.npy", points)
    command = ["estimate", str(tmp_path / "a.npy"), "-o", str(tmp_path / "b.npy")]
    assert cli.main(command) == 0
    found = np.load(tmp_path / "b.npy")
    assert np.array_equal(found[:, :3], points, equal_nan=True)
    assert np.flatnonzero((found[:, 3:] == 0).all(axis=1)).tolist() == [3, 70]


def test_stl_becomes_ply_in_a_folder_and_is_refused_as_output(tmp_path, capsys):
    save_tetrahedron(tmp_path / "a.stl")
    command = ["estimate", str(tmp_path / "a.stl"), "-o"]
    assert cli.main([*command, f"{tmp_path}/out/"]) == 0
    assert names(tmp_path / "out") == ["a.ply"]
    assert cli.main([*command, str(tmp_path / "b.stl")]) == 1
    assert "choose another output" in capsys.readouterr().err


CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
OUTWARD = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def save_tetrahedron(path: Path, *turned: int) -> None:
    faces = OUTWARD.copy()
    faces[list(turned)] = faces[list(turned), ::-1]
    files.write(path, Shape(CORNERS, Polygons.of_rows(faces), CORNERS))


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".off", ".stl", ".npz"])
def test_repair_winds_faces_outward(suffix, tmp_path):
    save_tetrahedron(tmp_path / f"a{suffix}", 1, 3)
    target = tmp_path / f"b{suffix}"
    report = tmp_path / "r.json"
    command = ["repair", str(tmp_path / f"a{suffix}"), "-o", str(target)]
    assert cli.main([*command, "--report", str(report)]) == 0
    row = json.loads(report.read_text("utf-8"))["files"][0]
    assert row["flipped_faces"] == 2
    assert row["inconsistent_edges"] == 4
    shape = files.read(target)
    a, b, c = (shape.points[shape.faces[:, i]] for i in range(3))
    outward = (np.cross(b - a, c - a) * (a - CORNERS.mean(axis=0))).sum(axis=1)
    assert (outward > 0).all()
    if suffix != ".stl":
        away = shape.points - CORNERS.mean(axis=0)
        assert ((shape.normals * away).sum(axis=1) > 0).all()


def test_repair_wants_a_mesh(tmp_path, capsys):
    save_sphere(tmp_path / "a.ply")
    command = ["repair", str(tmp_path / "a.ply"), "-o", str(tmp_path / "b.ply")]
    assert cli.main(command) == 1
    assert "expected a mesh" in capsys.readouterr().err
    assert names(tmp_path) == ["a.ply"]


def compare(tmp_path, *more: str) -> tuple[int, dict]:
    report = tmp_path / "report.json"
    command = ["compare", str(tmp_path / "a.ply"), *more, "--report", str(report)]
    code = cli.main([*command, "--overwrite"])
    return code, json.loads(report.read_text("utf-8"))["files"][0]


def test_compare_with_the_truth(tmp_path):
    save_sphere(tmp_path / "a.ply", 500)
    save_sphere(tmp_path / "truth.ply", 500)
    code, row = compare(tmp_path, "--truth", str(tmp_path / "truth.ply"))
    assert code == 0
    assert row["matched"] == "order"
    assert row["angle_estimate_rms"] < row["angle_baseline_rms"]
    assert row["check"]["reference"] == "truth"


def test_compare_fails_above_an_angle(tmp_path, capsys):
    points, normals, _ = shapes.SPHERE.sample(400, seed=0)
    files.write(tmp_path / "truth.ply", Shape(points, None, normals))
    turned = normals.copy()
    # One normal of the asset lies across, another points inward.
    turned[7] = np.cross(normals[7], [0.6, 0.0, 0.8])
    turned[9] = -turned[9]
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    files.write(tmp_path / "a.ply", Shape(points, None, turned))
    more = ["--normals", "file", "--truth", str(tmp_path / "truth.ply")]
    code, row = compare(tmp_path, *more, "--fail-above", "5")
    assert code == 3
    assert (row["check"]["above"], row["check"]["opposite"]) == (1, 1)
    assert "1 of 400 normals are more than 5 degrees" in capsys.readouterr().err
    code, row = compare(tmp_path, *more, "--fail-above", "5", "--signed")
    assert (code, row["check"]["above"]) == (3, 2)
    code, row = compare(tmp_path, *more, "--fail-above", "91")
    assert code == 0


def test_compare_takes_normals_of_the_nearest_point(tmp_path):
    save_sphere(tmp_path / "a.ply", 400)
    save_sphere(tmp_path / "dense.ply", 5000, seed=3)
    more = ["--normals", "file", "--truth", str(tmp_path / "dense.ply")]
    code, row = compare(tmp_path, *more, "--fail-above", "6", "--signed")
    assert row["matched"] == "nearest"
    # 5000 points on a unit sphere are at most some 0.1 apart.
    assert code == 0
    assert row["check"]["max"] > 0


def test_compare_without_normals_to_compare_with(tmp_path, capsys):
    points, _, _ = shapes.SPHERE.sample(300, seed=0)
    np.save(tmp_path / "plain.npy", points)
    save_sphere(tmp_path / "a.ply")
    command = ["compare", str(tmp_path / "a.ply"), "--truth"]
    assert cli.main([*command, str(tmp_path / "plain.npy")]) == 1
    assert "plain.npy: expected normals, got none" in capsys.readouterr().err


def test_killed_midway_it_leaves_whole_files_and_goes_on(tmp_path):
    source, out = tmp_path / "in", tmp_path / "out"
    source.mkdir()
    for number in range(12):
        save_sphere(source / f"{number:02}.ply", 4000, seed=number)
    command = [sys.executable, "-m", "addon.cli", "estimate", str(source)]
    command += ["-o", str(out), "--jobs", "2", "--skip-existing", "--quiet"]
    process = subprocess.Popen(command, cwd=ROOT)
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and not list(out.glob("*.ply")):
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    done = {path: path.stat().st_mtime_ns for path in out.glob("*.ply")}
    assert done
    for path in done:
        assert len(files.read(path).normals) == 4000
    subprocess.run(command, cwd=ROOT, check=True)
    assert len(list(out.glob("*.ply"))) == 12
    assert all(path.stat().st_mtime_ns == at for path, at in done.items())


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_asked_to_end_it_cleans_up(tmp_path):
    save_sphere(tmp_path / "a.ply", 60_000)
    command = [sys.executable, "-m", "addon.cli", "estimate", str(tmp_path / "a.ply")]
    process = subprocess.Popen(
        [*command, "-o", str(tmp_path / "b.ply"), "--memory", "500M"],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    # The folder of the tiles is there for as long as the work takes.
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and not list(tmp_path.rglob(".tiles-*")):
        time.sleep(0.01)
    # Asked twice it still cleans up.
    process.send_signal(signal.SIGTERM)
    process.send_signal(signal.SIGTERM)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 1
    assert b"Traceback" not in told
    assert names(tmp_path) == ["a.ply"]


def test_a_worker_that_dies_takes_only_its_own_file(
    scans, tmp_path, capsys, monkeypatch
):
    workers = cli._part("addon.commands.workers")
    # A worker that dies at the sight of one file.
    code = (
        f"import os, sys; sys.path.insert(0, {str(ROOT)!r})\n"
        "from addon import cli\n"
        "work = cli._part('addon.commands.workers'); attempt = work.attempt\n"
        "work.attempt = lambda task, show: (\n"
        "    os._exit(9) if 'scan1' in task.source else attempt(task, show))\n"
        "cli.main(['worker'])\n"
    )
    monkeypatch.setattr(workers, "_command", lambda _: [sys.executable, "-c", code])
    command = ["estimate", str(scans / "scan*.ply"), "-o", str(tmp_path / "out")]
    assert cli.main([*command, "--jobs", "2"]) == 1
    told = capsys.readouterr().err
    assert told == f"{scans}/scan1.ply: its process ended early (exit code 9)\n"
    assert names(tmp_path / "out") == ["scan0.ply", "scan2.ply"]


def test_a_terminal_gets_a_bar_and_a_log_gets_lines():
    import io

    progress = cli._part("addon.commands.progress")

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = Terminal()
    bar = progress.Progress(2, stream=stream)
    bar.show(0.5, "a.ply")
    assert "25% 0/2 a.ply" in stream.getvalue()
    bar.close()
    assert stream.getvalue().endswith("\r")
    log = io.StringIO()
    quiet = progress.Progress(2, stream=log)
    quiet.show(0.5, "a.ply")
    assert log.getvalue() == ""
