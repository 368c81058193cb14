# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports go one way: from later rooms of the house to earlier ones."""

import ast
import sys
from collections.abc import Iterator
from itertools import groupby
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
    "orient.smoothing",
    "orient.representatives",
    "orient.hearing",
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
# And so in addon, folder by folder.
ADDON_ORDER = (
    "bridge.arrays",
    "bridge.custom_normals",
    "bridge.polygons",
    "bridge.geometry",
    "bridge.objects",
    "bridge.shapes",
    "bridge.selections",
    "bridge.results",
    "bridge.normals",
    "bridge.beside",
    "bridge.making",
    "bridge",
    "files.shape",
    "files.libraries",
    "files.arrays",
    "files.obj",
    "files.off",
    "files.pcd",
    "files.ply_header",
    "files.ply_rows",
    "files.ply",
    "files.stl",
    "files.text",
    "files.laz",
    "files.las",
    "files.streams",
    "files",
    "tiles.cluster",
    "tiles.buckets",
    "tiles.survey",
    "tiles.large",
    "settings.choices",
    "settings.properties",
    "settings.scene",
    "settings.layouts",
    "settings.presets",
    "display.views",
    "display.nodes",
    "display.picture",
    "display.coloring",
    "display.dress",
    "display.lines",
    "display.legend",
    "display.summaries",
    "display.pointing",
    "display.picking",
    "display.patch_view",
    "display.overlay",
    "operators.jobs",
    "operators.run",
    "operators.estimate",
    "operators.sides",
    "operators.repair",
    "operators.samples",
    "operators.report",
    "commands.versions",
    "commands.options",
    "commands.arguments",
    "commands.output",
    "commands.progress",
    "commands.snapshot",
    "commands.plan",
    "commands.scenes",
    "commands.task",
    "commands.sources",
    "commands.estimate",
    "commands.compare",
    "commands.work",
    "commands.workers",
    "commands.sentences",
    "commands.run",
    "paper.results",
    "paper.tables",
    "paper.plots",
    "paper.figures",
    "paper.reproduce",
    "missing",
    "panel",
    "cli",
    "__init__",
)
# What reads and writes Blender's data by the array.
MEMORY = {"foreach_get", "foreach_set", "attributes"}


# New data is made by a part of the bridge of its own.
SIDE_DOORS = {"addon.bridge.making"}
# Folders of addon with an `__init__` that others import; the rest only say what they
# are for, as all folders of core do.
DOORS = {"bridge", "files"}


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """Yield level and full name of every module imported: (1, "core.surface")."""
    here = path.relative_to(ROOT).parts
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((0, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = here[: len(here) - node.level] if node.level else ()
            base += (node.module,) if node.module else ()
            for alias in node.names:
                yield node.level, module_of(".".join(base), alias.name)


def module_of(base: str, name: str) -> str:
    """Return the module that `from base import name` imports."""
    found = ROOT.joinpath(*base.split("."), name)
    inside = found.is_dir() or found.with_suffix(".py").is_file()
    return f"{base}.{name}".strip(".") if inside else base


def sources(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


def room(path: Path) -> str:
    """The name of a module as in the orders: "patches.chart", "bridge"."""
    *folders, name = path.relative_to(ROOT).with_suffix("").parts[1:]
    return ".".join(folders if folders and name == "__init__" else [*folders, name])


def says_only_what_it_is_for(path: Path) -> bool:
    return path.name == "__init__.py" and room(path) not in {"__init__", *DOORS}


def rooms(house: str) -> list[Path]:
    return [path for path in sources(house) if not says_only_what_it_is_for(path)]


@pytest.mark.parametrize(
    ("path", "order"),
    [(path, CORE_ORDER) for path in rooms("core")]
    + [(path, ADDON_ORDER) for path in rooms("addon")],
    ids=lambda value: room(value) if isinstance(value, Path) else "",
)
def test_only_earlier_rooms_are_imported(path, order):
    assert room(path) in order, "give the new module its place in the order"
    house = path.relative_to(ROOT).parts[0]
    earlier = {f"{house}.{name}" for name in order[: order.index(room(path))]}
    inside = {name for _, name in imports(path) if name.split(".")[0] == house}
    assert inside <= earlier, inside - earlier


def test_orders_name_only_what_is_there():
    assert {room(path) for path in rooms("core")} == set(CORE_ORDER)
    assert {room(path) for path in rooms("addon")} == set(ADDON_ORDER)


def test_folders_of_addon_are_layers():
    """Each stands whole before the next, so that imports go one way between them."""
    folders = [name.partition(".")[0] for name in ADDON_ORDER]
    assert [folder for folder, _ in groupby(folders)] == list(dict.fromkeys(folders))


@pytest.mark.parametrize("house", ["core", "addon"])
def test_other_folders_only_say_what_they_are_for(house):
    for path in set(sources(house)) - set(rooms(house)):
        assert not list(imports(path)), f"{path} imports"


@pytest.mark.parametrize("path", sources("core"), ids=room)
def test_core_needs_numpy_scipy_and_the_standard_library_only(path):
    allowed = {"numpy", "scipy", *sys.stdlib_module_names}
    for level, name in imports(path):
        root = name.partition(".")[0]
        assert root in ({"core"} if level else allowed), f"imports {name}"


@pytest.mark.parametrize("path", sources("addon"), ids=room)
def test_addon_reaches_core_by_relative_imports(path):
    allowed = {"numpy", *BLENDER, *sys.stdlib_module_names}
    for level, name in imports(path):
        root = name.partition(".")[0]
        assert root in ({"core", "addon"} if level else allowed), f"imports {name}"


def test_blender_is_out_of_reach_of_core_and_the_entry_point():
    for path in (*sources("core"), ROOT / "__init__.py"):
        roots = {name.partition(".")[0] for _, name in imports(path)}
        assert not roots & BLENDER, f"{path.name} imports {roots & BLENDER}"


@pytest.mark.parametrize(
    "path",
    [path for path in sources("addon") if path.parent.name != "bridge"],
    ids=room,
)
def test_blenders_memory_is_reached_by_the_bridge_alone(path):
    for _, name in imports(path):
        inside = name.startswith("addon.bridge.") and name not in SIDE_DOORS
        assert not inside, f"{name}: use the door"
    touched = {
        node.attr
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Attribute)
    }
    assert not touched & MEMORY
