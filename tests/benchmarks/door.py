# SPDX-License-Identifier: GPL-3.0-or-later
"""The door to Blender's memory: time in and out next to the time of the estimate.

    door.py --zip FILE [--count 1000000] [--rounds 3] [--write]

Runs in a Blender that is a Python module, with the zip installed as a user would. In
is everything from the object to the arrays of the core, out everything from these to
attributes and custom normals. CPU seconds, so that other work on the machine counts
little; storages take turns within a round, and medians over the rounds are shown.
"""

import argparse
import importlib
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

PROFILE = tempfile.TemporaryDirectory(prefix="timescale-door-")
# Blender reads this once, when `bpy` is imported.
os.environ["BLENDER_USER_RESOURCES"] = PROFILE.name

import bpy  # noqa: E402 - not before the profile is chosen
import numpy as np  # noqa: E402
import report  # noqa: E402

MODULE = "bl_ext.user_default.timescale_normals"
DOCS = Path(__file__).resolve().parents[2] / "docs"
KINDS = {
    "mesh, free normals": ("MESH", "free"),
    "mesh, tangent space": ("MESH", "tangent_space"),
    "point cloud": ("POINTCLOUD", "free"),
}
HEAD = (
    "| | in, s | estimate, s | out, s | in and out / estimate |",
    "|---|---|---|---|---|",
)


def waves(count):
    """Make a wavy grid of about so many vertices, all of it smooth."""
    side = round(count**0.5)
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=side - 1, y_subdivisions=side - 1)
    mesh = bpy.context.object.data
    places = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.attributes["position"].data.foreach_get("vector", places)
    x, y, z = places.reshape(-1, 3).T
    z[:] = 0.2 * np.sin(4 * x) * np.cos(3 * y)
    mesh.attributes["position"].data.foreach_set("vector", places)
    mesh.polygons.foreach_set("use_smooth", np.ones(len(mesh.polygons), bool))
    mesh.update()


def points_alone():
    """Turn the active mesh into a point cloud of its vertices."""
    obj = bpy.context.object
    places = np.empty(3 * len(obj.data.vertices), np.float32)
    obj.data.attributes["position"].data.foreach_get("vector", places)
    mesh = bpy.data.meshes.new("Points")
    mesh.vertices.add(len(places) // 3)
    mesh.attributes["position"].data.foreach_set("vector", places)
    obj.data = mesh
    bpy.ops.object.convert(target="POINTCLOUD")


def measured(storage):
    """Return CPU seconds of the way in, of the estimate and of the way out."""
    jobs = importlib.import_module(f"{MODULE}.addon.operators.jobs")
    options = bpy.context.scene.timescale_normals
    options.storage = storage
    [job] = jobs.jobs_of(bpy.context)
    marks = [time.process_time()]
    for step in (jobs.read_shape, jobs.read_weight, jobs.read_split):
        step(job, options)
    marks.append(time.process_time())
    jobs.estimate(job, lambda _share: None)
    marks.append(time.process_time())
    jobs.write_estimate(job, options)
    marks.append(time.process_time())
    return np.diff(marks)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--zip", required=True)
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--write", action="store_true", help="into performance.md")
    options = parser.parse_args()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.extensions.package_install_files(
        filepath=options.zip, repo="user_default", enable_on_install=True
    )
    found = {name: [] for name in KINDS}
    for _ in range(options.rounds):
        for name, (kind, storage) in KINDS.items():
            bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
            waves(options.count)
            if kind != "MESH":
                points_alone()
            found[name].append(measured(storage))
    lines = list(HEAD)
    for name, runs in found.items():
        inward, estimate, outward = map(statistics.median, zip(*runs, strict=True))
        share = (inward + outward) / estimate
        lines.append(
            f"| {name} | {inward:.2f} | {estimate:.2f} | {outward:.2f} | {share:.1%} |"
        )
    version = f"Blender {bpy.app.version_string}, {options.count:,} points"
    table = "\n".join(
        [f"{version}; CPU seconds, medians of {options.rounds}.", "", *lines]
    )
    sys.stdout.write(table + "\n")
    if options.write:
        name = f"door {bpy.app.version[0]}.{bpy.app.version[1]}"
        report.replace_part(DOCS / "performance.md", name, table)
    bpy.ops.preferences.addon_disable(module=MODULE)


if __name__ == "__main__":
    main()
