# SPDX-License-Identifier: GPL-3.0-or-later
"""Show the extension at work: `make demo`, or `make demo INPUT=file.ply`.

Installs the built zip into a throw-away Blender profile, estimates normals, compares
them with those of a Delaunay triangulation, and writes pictures and a .blend file
into `out/`. Without a file of yours it does so on the two surfaces of the paper and on
Suzanne, where the true normals are known.
"""

import argparse
import contextlib
import importlib
import math
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np

PROFILE = tempfile.TemporaryDirectory(prefix="timescale-demo-")
# Blender reads this once, when `bpy` is imported.
os.environ["BLENDER_USER_RESOURCES"] = PROFILE.name

import bpy  # noqa: E402 - not before the profile is chosen

MODULE = "bl_ext.user_default.timescale_normals"
TRUTH = "true_normal"
SUFFIXES = (".ply", ".obj", ".stl", ".xyz")
# Title, normals, errors, and the median of these in the summary.
METHODS = (
    ("Time-Scale", "ts_normal", "ts_error", "error_estimate_median"),
    ("Delaunay", "delaunay_normal", "delaunay_error", "error_baseline_median"),
)
STATISTICS = ("median", "rms", "max")
HEAD = ("", "points", "valid", "TS median", "RMS", "max")
HEAD += ("Delaunay median", "RMS", "max", "TS nearer", "seconds")
HEAD_WITHOUT_TRUTH = ("", "points", "valid", "TS to Delaunay: median", "RMS", "max")
HEAD_WITHOUT_TRUTH += ("seconds",)
# Subdivisions of Suzanne that are shown, and those her true normals are taken from:
# 64 times as many vertices, whose normals err by about a 64th.
SHOWN, TRUE = 2, 5


class RefusedError(Exception):
    """An input that cannot be shown; the text is the whole message."""


def plain(error: Exception) -> str:
    """The words of an error without Blender's own around them."""
    return str(error).removeprefix("Error: ").strip()


def part(name: str) -> ModuleType:
    """A module of the installed extension."""
    return importlib.import_module(f"{MODULE}.{name}")


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Hide what Blender prints about installing, importing and rendering."""
    sys.stdout.flush()
    kept = os.dup(1)
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
    finally:
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)


def install(package: Path) -> None:
    """Install the zip as a user would, in an empty file."""
    bpy.context.preferences.filepaths.save_version = 0
    with quiet():
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        bpy.ops.extensions.package_install_files(
            filepath=str(package), repo="user_default", enable_on_install=True
        )


# Objects


def paper_surface(name: str, count: int) -> bpy.types.Object:
    """One of the paper's surfaces, as a cloud of evenly spread points."""
    shape = getattr(part("core").shapes, name.upper())
    points, normals, _ = shape.sample(count)
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], [])
    add_truth(mesh, normals)
    bpy.context.collection.objects.link(bpy.data.objects.new(name, mesh))
    return to_cloud(bpy.data.objects[name])


def to_cloud(obj: bpy.types.Object) -> bpy.types.Object:
    """Turn a mesh of vertices alone into a point cloud."""
    select(obj)
    bpy.ops.object.convert(target="POINTCLOUD")
    return bpy.context.view_layer.objects.active


def suzanne() -> bpy.types.Object:
    """Blender's monkey on her limit surface, with the normals that it has there."""
    bpy.ops.mesh.primitive_monkey_add()
    obj = bpy.context.view_layer.objects.active
    shown, fine = (subdivided(obj, levels) for levels in (SHOWN, TRUE))
    obj.modifiers.clear()
    obj.data = fine
    places, normals = part("addon.bridge").read_points(obj), vertex_normals(fine)
    obj.data = shown
    bpy.data.meshes.remove(fine)
    points = part("addon.bridge").read_points(obj)
    add_truth(shown, normals[nearest(places, points)])
    return obj


def subdivided(obj: bpy.types.Object, levels: int) -> bpy.types.Mesh:
    """The object's mesh subdivided, its vertices on the limit surface."""
    obj.modifiers.clear()
    obj.modifiers.new("Subdivision", "SUBSURF").levels = levels
    graph = bpy.context.evaluated_depsgraph_get()
    return bpy.data.meshes.new_from_object(obj.evaluated_get(graph))


def vertex_normals(mesh: bpy.types.Mesh) -> np.ndarray:
    """Blender's own normals of the vertices, (n, 3)."""
    normals = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertex_normals.foreach_get("vector", normals)
    return normals.reshape(-1, 3)


def nearest(places: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The number of the place that is nearest to each point."""
    from scipy.spatial import cKDTree  # the wheel of the installed extension

    return cKDTree(places).query(points)[1]


def add_truth(mesh: bpy.types.Mesh, normals: np.ndarray) -> None:
    """Keep the true normals on the mesh, for the comparison to find."""
    attribute = mesh.attributes.new(TRUTH, "FLOAT_VECTOR", "POINT")
    attribute.data.foreach_set("vector", normals.astype(np.float32).ravel())


def load(path: Path) -> bpy.types.Object:
    """The object in a file; its parts joined if there are several."""
    try:
        with quiet():
            read_file(path)
    except (RuntimeError, ValueError) as error:
        raise RefusedError(f"{path} could not be read: {plain(error)}") from error
    found = [obj for obj in bpy.context.scene.objects if obj.type == "MESH"]
    if not any(len(obj.data.vertices) for obj in found):
        raise RefusedError(f"{path} holds no points")
    select(*found)
    if len(found) > 1:
        bpy.ops.object.join()
    obj = bpy.context.view_layer.objects.active
    obj.name = path.stem
    return obj if obj.data.polygons else to_cloud(obj)


def read_file(path: Path) -> None:
    """Bring the contents of a file into the scene."""
    if path.suffix.lower() == ".xyz":
        points = np.loadtxt(path, ndmin=2)[:, :3]
        if points.shape[1] < 3:
            raise ValueError("expected three numbers or more in a line")
        mesh = bpy.data.meshes.new(path.stem)
        mesh.from_pydata(points, [], [])
        bpy.context.collection.objects.link(bpy.data.objects.new(path.stem, mesh))
    else:
        importer = getattr(bpy.ops.wm, path.suffix.lower()[1:] + "_import")
        importer(filepath=str(path))


def select(*objects: bpy.types.Object) -> None:
    """Make these the selected objects, the first of them active."""
    for obj in bpy.context.selected_objects:
        obj.select_set(False)
    for obj in objects:
        obj.select_set(True)
    bpy.context.view_layer.objects.active = objects[0]


# Normals, numbers, pictures


def run(obj: bpy.types.Object) -> float:
    """Estimate and compare with the extension's operators; return the seconds."""
    select(obj)
    start = time.perf_counter()
    try:
        with quiet():
            bpy.ops.timescale.estimate_normals()
            bpy.ops.timescale.compare_delaunay(truth=TRUTH if has_truth(obj) else "")
    except RuntimeError as error:
        raise RefusedError(plain(error)) from error
    return time.perf_counter() - start


def has_truth(obj: bpy.types.Object) -> bool:
    """Whether the true normals of the object are known."""
    return TRUTH in obj.data.attributes


def summary(obj: bpy.types.Object) -> dict:
    """What the panel shows about the object, in one dict."""
    found = part("addon.bridge").read_summary(obj)
    return found["estimate"] | found["comparison"]


def row(obj: bpy.types.Object, seconds: float) -> tuple[str, ...]:
    """A line of the table, under HEAD or under HEAD_WITHOUT_TRUTH."""
    found = summary(obj)
    measures = ("error_estimate", "error_baseline")
    measures = measures if has_truth(obj) else ("deviation",)
    cells = [obj.name, f"{found['points']:,}", f"{found['valid']:,}"]
    for measure in measures:
        cells += [f"{found[f'{measure}_{kind}']:.4f}" for kind in STATISTICS]
    if has_truth(obj):
        cells.append(f"{found['wins']:,} ({found['wins_percent']:.0f} %)")
    return (*cells, f"{seconds:.2f}")


def print_table(rows: list[tuple[str, ...]]) -> None:
    """Print rows of cells in columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for cells in rows:
        first, *rest = (c.rjust(w) for c, w in zip(cells, widths, strict=True))
        print("  ", cells[0].ljust(len(first)), *rest, sep="  ")


def draw(obj: bpy.types.Object, path: Path) -> None:
    """Render the errors of both methods, or both normals and how far apart they are."""
    picture, found = part("addon.display.picture"), summary(obj)
    nodes = part("addon.display.nodes")
    if has_truth(obj):
        what = "Error: largest coordinate of the difference from the true normal"
        panels = [
            picture.Panel(obj, f"{method}: median {found[key]:.2g}", normal, value)
            for method, normal, value, key in METHODS
        ]
    else:
        what = "Largest coordinate of the difference between the two normals"
        panels = [
            picture.Panel(obj, f"Shaded by {method}", normal)
            for method, normal, *_ in METHODS
        ]
        title = f"Difference: median {found['deviation_median']:.2g}"
        panels.append(picture.Panel(obj, title, "ts_normal", "ts_error"))
    scale = nodes.Scale(*decades(obj), what)
    heading = f"{obj.name}, {found['points']:,} points"
    with quiet():
        picture.render(str(path), panels, heading=heading, scale=scale)


def decades(obj: bpy.types.Object) -> tuple[float, float]:
    """The powers of ten around all but the extreme errors, four of them at most."""
    read = part("addon.bridge").read_attribute
    names = [name for *_, name, _ in METHODS if name in obj.data.attributes]
    values = np.concatenate([read(obj, name, "FLOAT") for name in names])
    low, high = np.nanpercentile(np.maximum(values, 1e-7), [2, 98])
    last = math.ceil(math.log10(high))
    first = min(last - 1, max(last - 4, math.floor(math.log10(low))))
    return 10.0**first, 10.0**last


def save(objects: list[bpy.types.Object], path: Path) -> None:
    """Save the objects side by side, colored by the error of the estimate."""
    picture, nodes = part("addon.display.picture"), part("addon.display.nodes")
    for index, obj in enumerate(objects):
        # Each two units wide, with the middle of its box on the grid.
        obj.scale *= 2 / max(obj.dimensions)
        middle = np.mean(obj.bound_box, axis=0) * obj.scale
        obj.location = (2.5 * index, 0, 0) - middle
        scale = nodes.Scale(*decades(obj), "")
        show = nodes.material(obj.name, scale, normal="ts_normal", value="ts_error")
        obj.data.materials.append(show)
        if obj.type == "POINTCLOUD":
            set_radius(obj, picture.point_radius(obj))
    for screen in bpy.data.screens:
        for area in screen.areas:
            if area.type == "VIEW_3D":
                area.spaces.active.shading.type = "MATERIAL"
    with quiet():
        bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, compress=True)


def set_radius(cloud: bpy.types.Object, radius: float) -> None:
    """Give all points of a cloud one size."""
    attribute = cloud.data.attributes.new("radius", "FLOAT", "POINT")
    values = np.full(len(attribute.data), radius, np.float32)
    attribute.data.foreach_set("value", values)


# The command


def check(path: Path) -> None:
    """Refuse what is no file of points or faces, before anything takes time."""
    if not path.is_file():
        raise RefusedError(f"there is no file {path}")
    if path.suffix.lower() not in SUFFIXES:
        raise RefusedError(f"{path} is not one of {', '.join(SUFFIXES)}")
    if not path.stat().st_size:
        raise RefusedError(f"{path} is empty")


def demonstrate(arguments: argparse.Namespace) -> None:
    """Do all of it."""
    if arguments.input:
        check(arguments.input)
    install(arguments.zip)
    print(f"Blender {bpy.app.version_string} with {arguments.zip.name}")
    if arguments.input:
        name, objects = arguments.input.stem, [load(arguments.input)]
    else:
        name = "demo"
        objects = [paper_surface("phi1", 2571), paper_surface("phi2", 2295), suzanne()]
    rows = [row(obj, run(obj)) for obj in objects]
    print_table([HEAD if has_truth(objects[0]) else HEAD_WITHOUT_TRUTH, *rows])
    arguments.out.mkdir(exist_ok=True)
    for obj in objects:
        draw(obj, arguments.out / f"{obj.name}.png")
    save(objects, arguments.out / f"{name}.blend")
    told = "errors of both" if has_truth(objects[0]) else "both and their difference"
    print("Made:")
    for obj in objects:
        print(f"  {arguments.out}/{obj.name}.png: {told} in color")
    names = ", ".join(obj.name for obj in objects)
    print(
        f"  {arguments.out}/{name}.blend: {names} with normals, attributes and colors"
    )


def main() -> int:
    """Run as a command; 1 when the input cannot be shown."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--zip", type=Path, required=True, help="the built extension")
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("input", type=Path, nargs="?", help=" ".join(SUFFIXES))
    try:
        demonstrate(parser.parse_args())
    except RefusedError as error:
        print(f"demo: {error}", file=sys.stderr)
        return 1
    finally:
        # Blender 4.5 hangs at exit where something stays registered.
        if MODULE in bpy.context.preferences.addons:
            bpy.ops.preferences.addon_disable(module=MODULE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
