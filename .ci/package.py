#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Build and validate the extension's zip with Blender's own script.

    package.py PLATFORM|all

The wheels that `blender_manifest.toml` lists for the platform are fetched by pip
into `wheels/`, the files a user needs are staged in a clean folder, and the zip
appears in `dist/`.
"""

import argparse
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib

ROOT = pathlib.Path(__file__).resolve().parent.parent
WHEELS = ROOT / "wheels"
DIST = ROOT / "dist"
FILES = ("blender_manifest.toml", "__init__.py", "LICENSE", "README.md")
PACKAGES = ("addon", "core")

# Blender's platform -> how the platform tag in a wheel's name looks.
WHEEL_TAGS = {
    "linux-x64": r"manylinux.*_x86_64",
    "macos-arm64": r"macosx_.*_arm64",
    "macos-x64": r"macosx_.*_x86_64",
    "windows-arm64": r"win_arm64",
    "windows-x64": r"win_amd64",
}


def read_manifest() -> dict:
    return tomllib.loads((ROOT / "blender_manifest.toml").read_text("utf-8"))


def zip_path(manifest: dict, name: str) -> pathlib.Path:
    """Where Blender's script puts the zip of one platform."""
    suffix = name.replace("-", "_")
    return DIST / f"{manifest['id']}-{manifest['version']}-{suffix}.zip"


def wheels_of(manifest: dict, name: str) -> list[str]:
    """File names of the wheels that the manifest lists for one platform."""
    names = [pathlib.PurePosixPath(path).name for path in manifest["wheels"]]
    tag = f"(any|{WHEEL_TAGS[name]})"
    return [n for n in names if re.fullmatch(rf".*-{tag}\.whl", n)]


def fetch_wheel(wheel: str) -> None:
    """Download one wheel by what its name says, unless it is there already."""
    if (WHEELS / wheel).exists():
        return
    package, version, python, abi, tags = wheel.removesuffix(".whl").split("-")
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps"]
    command += ["--only-binary=:all:", "--retries=8", f"--dest={WHEELS}"]
    if tags != "any":
        command += [f"--python-version={python.removeprefix('cp')}", f"--abi={abi}"]
        platforms = (f"--platform={tag}" for tag in tags.split("."))
        command += ["--implementation=cp", *platforms]
    command += [f"{package}=={version}"]
    print(f"  fetching {wheel}", flush=True)
    for attempt in range(4):
        time.sleep(5 * attempt)
        if subprocess.run(command).returncode == 0 and (WHEELS / wheel).exists():
            return
    sys.exit(f"package.py: pip could not download {wheel}")


def stage(folder: pathlib.Path, platforms: list[str], manifest: dict) -> None:
    """Copy what belongs into the zip, and nothing else, into an empty folder."""
    for name in FILES:
        shutil.copy(ROOT / name, folder / name)
    for name in PACKAGES:
        hidden = shutil.ignore_patterns("__pycache__", ".*")
        shutil.copytree(ROOT / name, folder / name, ignore=hidden)
    (folder / "wheels").mkdir()
    for name in platforms:
        for wheel in wheels_of(manifest, name):
            shutil.copy(WHEELS / wheel, folder / "wheels" / wheel)
    # Blender's script splits by this list and wants every wheel of each member.
    path = folder / "blender_manifest.toml"
    listed = "platforms = [" + ", ".join(f'"{name}"' for name in platforms) + "]"
    original = path.read_text("utf-8")
    path.write_text(re.sub(r"(?ms)^platforms = \[.*?\]", listed, original), "utf-8")


def blender_script() -> pathlib.Path:
    """Blender's own build and validate script, from any environment with Blender."""
    inside = "bpy/*/scripts/addons_core/bl_pkg/cli/blender_ext.py"
    pattern = f".venv/blender-*/lib/python*/site-packages/{inside}"
    scripts = sorted(ROOT.glob(pattern), reverse=True)
    if not scripts:
        sys.exit("package.py: no Blender in .venv; run .ci/environment.py first")
    return scripts[0]


def blender_extension(*arguments: str) -> None:
    """Run Blender's script; end with its words when it refuses."""
    script = blender_script()
    # The program gives its list of tags to the script; else tags are not checked.
    tags = script.parents[3] / "modules/_bpy_internal/extensions/tags.py"
    command = [sys.executable, str(script), *arguments, f"--valid-tags={tags}"]
    run = subprocess.run(command, capture_output=True, text=True)
    if run.returncode != 0:
        sys.exit(f"package.py: {' '.join(arguments)}\n{run.stdout}{run.stderr}")


def build(platforms: list[str]) -> None:
    """Fetch, stage, build and validate the zips of these platforms."""
    manifest = read_manifest()
    for directory in (WHEELS, DIST, ROOT / "build"):
        directory.mkdir(exist_ok=True)
    for name in platforms:
        for wheel in wheels_of(manifest, name):
            fetch_wheel(wheel)
    with tempfile.TemporaryDirectory(dir=ROOT / "build", prefix="stage-") as folder:
        stage(pathlib.Path(folder), platforms, manifest)
        source, output = f"--source-dir={folder}", f"--output-dir={DIST}"
        blender_extension("build", source, output, "--split-platforms")
    for name in platforms:
        path = zip_path(manifest, name)
        blender_extension("validate", str(path))
        print(f"  {path.relative_to(ROOT)}: {path.stat().st_size / 1e6:.0f} MB, valid")


def main() -> None:
    """Read the command line and build."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("platform", choices=[*WHEEL_TAGS, "all"])
    chosen = parser.parse_args().platform
    build(list(WHEEL_TAGS) if chosen == "all" else [chosen])


if __name__ == "__main__":
    main()
