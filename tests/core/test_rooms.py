# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports go one way: from later rooms of the house to earlier ones."""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BLENDER = {"bpy", "bpy_extras", "bl_operators", "bl_ui", "bmesh", "gpu", "gpu_extras"}
BLENDER |= {"mathutils", "blf"}

# A module of core imports only modules that stand before it here.
CORE_ORDER = (
    "inputs",
    "progress",
    "timescale",
    "surface",
    "mesh.faces",
    "mesh.creases",
    "mesh.averages",
    "mesh.evidence",
    "threads",
    "neighbors.halves",
    "neighbors.blocks",
    "neighbors.graph",
    "patches.chart",
    "patches.solver",
    "patches.patch",
    "patches.asked",
    "patches.scale",
    "auto.ladder",
    "auto.coarse",
    "auto.votes",
    "auto.nets",
    "auto.blend",
    "patches.sheets",
    "orient.guides",
    "orient.tree",
    "orient.nesting",
    "orient.winding",
    "orient.poles",
    "orient.mending",
    "orient.pieces",
    "orient.sides",
    "orient.orientation",
    "settings",
    "neighborhoods",
    "patches.fitted",
    "mesh.clean",
    "mesh.shaken",
    "mesh.meshes",
    "fields",
    "estimate",
    "delaunay",
    "colormaps",
    "comparison",
    "shapes",
    "experiment",
    "raster",
    "partition",
    "tiles",
    "__init__",
)
# And so in the bridge, whose door is `__init__`.
BRIDGE_ORDER = (
    "arrays",
    "custom_normals",
    "polygons",
    "geometry",
    "objects",
    "shapes",
    "selections",
    "results",
    "normals",
    "beside",
    "making",
    "__init__",
)
# What reads and writes Blender's data by the array.
MEMORY = {"foreach_get", "foreach_set", "attributes"}


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """Yield (level, dotted name) of every import; `from . import a` gives (1, "a")."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((0, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.level, node.module
        elif isinstance(node, ast.ImportFrom):
            yield from ((node.level, alias.name) for alias in node.names)


def sources(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


def room(path: Path) -> str:
    """The name of a module of core, as in CORE_ORDER: "patches.chart"."""
    return ".".join(path.relative_to(ROOT / "core").with_suffix("").parts)


# The folders' own __init__ files say what the folder is for and import nothing.
ROOMS = [path for path in sources("core") if not room(path).endswith(".__init__")]


@pytest.mark.parametrize("path", ROOMS, ids=room)
def test_core_imports_only_earlier_rooms(path):
    assert room(path) in CORE_ORDER, "give the new module its place in CORE_ORDER"
    earlier = CORE_ORDER[: CORE_ORDER.index(room(path))]
    folder = path.relative_to(ROOT / "core").parts[:-1]
    for level, name in imports(path):
        assert level <= len(folder) + 1, f"{room(path)} imports from outside: {name}"
        if level:
            parts = folder[: len(folder) + 1 - level]
            assert ".".join((*parts, name)) in earlier, f"{room(path)} imports {name}"


def test_folders_of_core_only_say_what_they_are_for():
    for path in set(sources("core")) - set(ROOMS):
        assert not list(imports(path)), f"{path} imports"


@pytest.mark.parametrize("path", sources("core"), ids=lambda path: path.stem)
def test_core_needs_numpy_scipy_and_the_standard_library_only(path):
    allowed = {"numpy", "scipy", *sys.stdlib_module_names}
    roots = {name.partition(".")[0] for level, name in imports(path) if level == 0}
    assert roots <= allowed


@pytest.mark.parametrize("path", sources("addon"), ids=lambda path: path.stem)
def test_addon_reaches_core_by_relative_imports(path):
    allowed = {"numpy", *BLENDER, *sys.stdlib_module_names}
    roots = {name.partition(".")[0] for level, name in imports(path) if level == 0}
    assert roots <= allowed, "core and addon are imported relatively"
    # From a folder inside `addon` the way out is one step longer.
    out = len(path.relative_to(ROOT / "addon").parts) + 1
    outside = {name.partition(".")[0] for level, name in imports(path) if level >= out}
    assert outside <= {"core"}


def test_blender_is_out_of_reach_of_core_and_the_entry_point():
    for path in (*sources("core"), ROOT / "__init__.py"):
        roots = {name.partition(".")[0] for level, name in imports(path) if level == 0}
        assert not roots & BLENDER, f"{path.name} imports {roots & BLENDER}"


@pytest.mark.parametrize("path", sources("addon/bridge"), ids=lambda path: path.stem)
def test_bridge_imports_only_its_earlier_rooms_and_the_core(path):
    assert path.stem in BRIDGE_ORDER, "give the new module its place in BRIDGE_ORDER"
    earlier = BRIDGE_ORDER[: BRIDGE_ORDER.index(path.stem)]
    for level, name in imports(path):
        assert level != 2, f"{path.name} imports {name}, which is on this side"
        if level == 1:
            assert name.partition(".")[0] in earlier, f"{path.name} imports {name}"


@pytest.mark.parametrize(
    "path",
    [path for path in sources("addon") if path.parent.name != "bridge"],
    ids=lambda path: path.stem,
)
def test_blenders_memory_is_reached_by_the_bridge_alone(path):
    for level, name in imports(path):
        assert level == 0 or not name.startswith("bridge."), f"{name}: use the door"
    touched = {
        node.attr
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Attribute)
    }
    assert not touched & MEMORY
