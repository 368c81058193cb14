# SPDX-License-Identifier: GPL-3.0-or-later
"""The zip that is shipped, and what installing and removing it leaves behind."""

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import bpy
import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = Path(os.environ["TIMESCALE_ZIP"])
MODULE = "bl_ext.user_default.timescale_normals"


@pytest.fixture(scope="module")
def names() -> list[str]:
    with zipfile.ZipFile(PACKAGE) as package:
        return package.namelist()


@pytest.fixture(scope="module")
def manifest() -> dict:
    with zipfile.ZipFile(PACKAGE) as package:
        return tomllib.loads(package.read("blender_manifest.toml").decode())


def tracked_files() -> list[Path]:
    """Return all files of the checkout but the generated ones."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return [path for name in run.stdout.split("\0") if (path := ROOT / name).is_file()]


def test_holds_what_a_user_needs_and_nothing_else(names):
    root_files = {"blender_manifest.toml", "__init__.py", "LICENSE", "README.md"}
    folders = {"addon", "core", "wheels"}
    assert root_files == {name for name in names if "/" not in name}
    assert folders == {name.partition("/")[0] for name in names if "/" in name}
    assert not [name for name in names if "__pycache__" in name or "/." in name]


def test_holds_every_shipped_source(names):
    sources = [p.relative_to(ROOT).as_posix() for p in tracked_files()]
    shipped = {s for s in sources if s.startswith(("addon/", "core/"))}
    assert shipped == {name for name in names if name.startswith(("addon/", "core/"))}


def test_bundles_scipy_for_each_python_laspy_and_no_numpy(names):
    wheels = [Path(n).name.split("-") for n in names if n.startswith("wheels/")]
    found = sorted((wheel[0], wheel[2]) for wheel in wheels)
    scipy = [("scipy", python) for python in ("cp311", "cp313", "cp314")]
    assert found == [("laspy", "py3"), *scipy]


def test_blender_finds_the_zip_valid():
    scripts = Path(bpy.utils.system_resource("SCRIPTS"))
    tags = scripts / "modules/_bpy_internal/extensions/tags.py"
    script = scripts / "addons_core/bl_pkg/cli/blender_ext.py"
    command = [sys.executable, script, "validate", PACKAGE, f"--valid-tags={tags}"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr


def test_manifest_lists_three_wheels_for_each_platform():
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text("utf-8"))
    names = [Path(wheel).name for wheel in manifest["wheels"]]
    names = [name for name in names if name.startswith("scipy-")]
    assert len(set(names)) == len(names) == 3 * len(manifest["platforms"])
    assert len({name.split("-")[1] for name in names}) == 1


def test_version_is_the_newest_changelog_entry(manifest):
    changelog = (ROOT / "CHANGELOG.md").read_text("utf-8")
    assert re.search(r"^## (\S+)", changelog, re.M)[1] == manifest["version"]


def registered() -> dict[str, set[str]]:
    """Return everything an add-on can leave in Blender, by kind."""
    lists = [getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers)]
    handlers = [h for group in lists if isinstance(group, list) for h in group]
    menus = {n: getattr(bpy.types, n) for n in dir(bpy.types) if "_MT_" in n}
    draws = [
        f"{name}.{getattr(draw, '__name__', draw)}"
        for name, menu in menus.items()
        for draw in getattr(getattr(menu, "draw", None), "_draw_funcs", ())
    ]
    return {
        "classes": {name for name in dir(bpy.types) if not name.startswith("__")},
        "operators": set(dir(bpy.ops.timescale)),
        "properties": {
            f"{owner.__name__}.{found.identifier}"
            for owner in (bpy.types.Scene, bpy.types.Mesh, bpy.types.PointCloud)
            for found in owner.bl_rna.properties
        },
        "handlers": {repr(handler) for handler in handlers},
        "menu entries": set(draws),
    }


def ours(name: str) -> bool:
    return "timescale" in name.lower()


def test_enabling_twice_and_disabling_leaves_nothing():
    enabled = registered()
    assert "Scene.timescale_normals" in enabled["properties"]
    assert enabled["operators"]
    bpy.ops.preferences.addon_disable(module=MODULE)
    disabled = registered()
    for _ in range(2):
        bpy.ops.preferences.addon_enable(module=MODULE)
        assert registered() == enabled
        bpy.ops.preferences.addon_disable(module=MODULE)
        assert registered() == disabled
    bpy.ops.preferences.addon_enable(module=MODULE)
    assert not [name for group in disabled.values() for name in group if ours(name)]


# In a process of its own: what is tested here must stay installed for the others.
UNINSTALL = """
import sys
from pathlib import Path
import bpy
bpy.ops.extensions.package_install_files(
    filepath=sys.argv[-1], repo="user_default", enable_on_install=True
)
bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=3)
assert bpy.ops.timescale.compare_delaunay(show_colors=True) == {"FINISHED"}
bpy.ops.timescale.clear_results()
modules = [repo.module for repo in bpy.context.preferences.extensions.repos]
bpy.ops.extensions.package_uninstall(
    repo_index=modules.index("user_default"), pkg_id="timescale_normals"
)
assert not hasattr(bpy.types.Scene, "timescale_normals")
assert not dir(bpy.ops.timescale)
folder = Path(bpy.utils.user_resource("EXTENSIONS"))
print("left:", [str(p.relative_to(folder)) for p in folder.rglob("*.py")], flush=True)
"""


def test_uninstalling_leaves_nothing(tmp_path):
    run = subprocess.run(
        [sys.executable, "-P", "-c", UNINSTALL, str(PACKAGE)],
        env=os.environ | {"BLENDER_USER_RESOURCES": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert run.returncode == 0, run.stderr
    assert "left: []" in run.stdout, run.stdout


def test_no_file_names_a_registry_or_a_path_of_this_machine():
    # Put together here, so that this file does not hold what it looks for.
    hosts = "|".join(("debian", "py" + "pi", "pythonhosted", "npm" + "js"))
    home = "|".join(map(re.escape, (f"{Path.home()}/", f"{ROOT.parent}/")))
    pattern = re.compile(rf"https?://[a-z0-9.-]*(?:{hosts})\.|{home}")
    found = []
    for path in tracked_files():
        text = path.read_bytes().decode("utf-8", errors="ignore")
        found += [f"{path.relative_to(ROOT)}: {m[0]}" for m in pattern.finditer(text)]
    assert not found
