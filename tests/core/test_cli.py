# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line without Blender: exit codes, messages, files."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from addon import cli

ROOT = Path(__file__).resolve().parents[2]
FIGURE = "figure-1-grid-surface.png"
REPRODUCE = cli._part("addon.paper.reproduce")


@pytest.fixture(autouse=True)
def _without_blender(monkeypatch):
    """Figures are tests/blender's; here they would only take time."""
    monkeypatch.setattr(REPRODUCE, "find_spec", lambda _name: None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What `python -m addon.cli reproduce` leaves in a folder that was not there."""
    path = tmp_path_factory.mktemp("reproduce") / "new" / "results"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(REPRODUCE, "find_spec", lambda _name: None)
        assert cli.main(["reproduce", "--seeds", "1", "--quiet", "-o", str(path)]) == 0
    return path


@pytest.fixture(scope="module")
def results(folder):
    return json.loads((folder / "results.json").read_text("utf-8"))


def test_it_runs_as_a_module_of_the_checkout():
    command = [sys.executable, "-m", "addon.cli", "--help"]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert ran.stderr == ""
    assert "reproduce" in ran.stdout
    assert "0 done, 1 " in ran.stdout


def test_help_of_reproduce_names_its_options(capsys):
    assert cli.main(["reproduce", "--help"]) == 0
    told = capsys.readouterr().out
    for option in ("-o DIR", "--seeds N", "--quiet", "--overwrite"):
        assert option in told


@pytest.mark.parametrize(
    "argv",
    [
        [],
        ["reprodce"],
        ["--frobnicate"],
        ["reproduce", "--seeds"],
        ["reproduce", "--seeds", "0"],
        ["reproduce", "--seeds", "-1"],
        ["reproduce", "--seeds", "many"],
        ["reproduce", "extra"],
    ],
)
def test_wrong_usage_is_2(argv, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(argv) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "usage: timescale_normals" in err
    assert not list(tmp_path.iterdir())


def test_results_are_whole(results):
    assert results["schema"] == "timescale_normals.reproduce/1"
    assert set(results["versions"]) >= {"timescale_normals", "python", "numpy", "scipy"}
    assert results["seeds"] == [0]
    methods, baselines = {"paper", "time_scale", "auto"}, 4
    assert set(results["settings"]) == methods
    assert results["settings"]["paper"]["method"] == "paper"
    assert results["published"]["phi1"]["wins"] == 962
    assert len(results["trials"]) == 2 * 2 * len(methods) * baselines
    assert len(results["summary"]) == len(results["trials"])
    for row in results["summary"]:
        assert 0 < row["wins_min"] <= row["wins_mean"] <= row["wins_max"]
        assert row["wins_max"] < row["points"]
        assert row["estimate_min"] < row["estimate_median"] < row["estimate_max"]


def test_orders_are_those_of_the_taylor_terms(results):
    rows = results["convergence"]
    assert {row["kind"] for row in rows} == {"function", "surface"}
    for row in rows:
        order = 2 if row["ratio"] == 1 else 1
        assert row["order_paper"] == pytest.approx(order, abs=0.1)
        assert row["order_second_order"] == pytest.approx(2, abs=0.1)
        assert len(row["step"]) == len(row["paper"]) == len(row["second_order"])


def test_tables_are_rectangular_and_hold_the_published_figures(folder):
    page = (folder / "results.md").read_text("utf-8")
    for section in ("In short", "Winning points", "Errors", "Orders", "Made with"):
        assert f"\n## {section}\n" in page
    tables = re.findall(r"(?:^\|.*\n)+", page, re.MULTILINE)
    assert len(tables) == 3
    for table in tables:
        assert len({line.count("|") for line in table.splitlines()}) == 1
    for published in ("962", "113", "9.2e-05", "0.058", "0.012", "0.34"):
        assert f" {published} " in page
    # The page goes into the documentation as it is.
    assert "nan" not in page
    assert os.sep + "home" not in page


def test_only_whole_files_are_left(folder):
    assert {path.name for path in folder.iterdir()} == {"results.json", "results.md"}


def test_without_blender_it_says_what_is_missing(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(REPRODUCE.results, "run", lambda *_args, **_options: None)
    monkeypatch.setattr(REPRODUCE.tables, "write", lambda *_args: None)
    monkeypatch.setattr(REPRODUCE.tables, "wins_table", lambda _results: "| table |")
    assert cli.main(["reproduce", "-o", str(tmp_path / "new")]) == 0
    out, err = capsys.readouterr()
    assert "| table |" in out
    assert "Figures need Blender" in out
    # No terminal, no progress line.
    assert err == ""


def test_a_terminal_without_greek_letters():
    code = "from addon.commands.progress import say; say('φ1 – 12 %')"
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    command = [sys.executable, "-c", code]
    ran = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, check=False
    )
    assert (ran.returncode, ran.stdout.split()) == (0, [b"?1", b"?", b"12", b"%"])


@pytest.mark.parametrize("name", ["results.json", "results.md", FIGURE])
def test_files_are_replaced_only_when_told(name, capsys, tmp_path, monkeypatch):
    def write(_results, stage):
        (stage / name).write_text("new", "utf-8")

    monkeypatch.setattr(REPRODUCE.results, "run", lambda *_args, **_options: None)
    monkeypatch.setattr(REPRODUCE.tables, "write", write)
    (tmp_path / name).write_text("old", "utf-8")
    (tmp_path / "other.txt").write_text("old", "utf-8")
    command = ["reproduce", "--quiet", "-o", str(tmp_path)]
    assert cli.main(command) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert name in err
    assert "--overwrite" in err
    assert (tmp_path / name).read_text("utf-8") == "old"
    assert cli.main([*command, "--overwrite"]) == 0
    assert (tmp_path / name).read_text("utf-8") == "new"
    assert (tmp_path / "other.txt").read_text("utf-8") == "old"
    assert len(list(tmp_path.iterdir())) == 2


def test_what_fails_halfway_leaves_nothing(tmp_path, monkeypatch):
    def write(_results, stage):
        (stage / "results.json").write_text("half", "utf-8")
        raise KeyboardInterrupt

    monkeypatch.setattr(REPRODUCE.results, "run", lambda *_args, **_options: None)
    monkeypatch.setattr(REPRODUCE.tables, "write", write)
    assert cli.main(["reproduce", "--quiet", "-o", str(tmp_path)]) == 1
    assert not list(tmp_path.iterdir())


def refused(capsys, folder):
    """The one line that is said about a folder that cannot be used."""
    assert cli.main(["reproduce", "--overwrite", "-o", str(folder)]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


@pytest.mark.parametrize("below", ["", "folder"])
def test_a_file_in_place_of_the_folder(below, capsys, tmp_path):
    (tmp_path / "taken").write_text("mine", "utf-8")
    told = refused(capsys, tmp_path / "taken" / below)
    assert "cannot write to the folder" in told
    assert (tmp_path / "taken").read_text("utf-8") == "mine"


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0,
    reason="the superuser may write to a read-only folder",
)
def test_a_read_only_folder(capsys, tmp_path):
    tmp_path.chmod(0o500)
    assert "Permission denied" in refused(capsys, tmp_path)
    assert "Permission denied" in refused(capsys, tmp_path / "new")
