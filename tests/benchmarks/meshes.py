# SPDX-License-Identifier: GPL-3.0-or-later
# ruff: noqa: T201 (a program: its output is the table)
"""Errors of normals on meshes made worse, beside those of Blender and other peers.

    make bench-meshes
    python tests/benchmarks/meshes.py [--files FOLDER] [--write] [--large]

Prints for every mesh our error over the least one of Blender's own normals, its
Weighted Normal modifier in all modes, and means of face normals weighted by area, by
angle, by both and by N. Max's weights; `--write` puts the tables into docs/accuracy.md.
FOLDER holds OBJ files, whose clean originals are the truth; `--large` measures time and
memory on a million triangles.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import damage
import memory
import report
import solids

from core import estimate_normals
from core.mesh.faces import Triangles, corner_sums, split_fans, unit

ROOT = Path(__file__).resolve().parents[2]
# Below this many degrees normals are exact for all purposes: custom normals in tangent
# space are off by 0.004 on average.
EXACT = 0.01
# What the ratio is to be at most.
SAME, NOISY, OTHERS = 1.02, 1 / 3, 1 / 2
OURS = "Time-Scale Normals"


def goal(case):
    """Return the largest ratio wanted on a mesh."""
    if case.damage in ("noise 0.3", "noise 0.6", "noise 1"):
        return NOISY
    return OTHERS if "stairs" in case.damage or case.damage == "slivers" else SAME


def rms(case, normals):
    """Return the root mean square angle of corner normals (m, 3, 3) in degrees.

    Over the corners where edges part the mesh, else over the vertices.
    """
    cross = np.linalg.norm(np.cross(normals, case.truth), axis=2)
    angle = np.degrees(np.arctan2(cross, (normals * case.truth).sum(axis=2)))
    if not len(case.sharp):
        _, first = np.unique(case.faces, return_index=True)
        angle = angle.ravel()[first]
    return float(np.sqrt((angle**2).mean()))


def means_of_faces(points, faces):
    """Yield name and vertex normals of each kind of weights."""
    mesh = Triangles(points, faces)
    for kind in ("angle", "area", "max"):
        yield f"{kind} weights", mesh.vertex_normals(kind)
    both = mesh.weights("angle") * mesh.doubled_areas[:, None]
    sums = corner_sums(mesh.vectors, faces, len(points), both)
    yield "area and angle weights", unit(sums)


def peers(points, faces):
    """Yield name and vertex normals of the libraries that are there."""
    if pymeshlab := _imported("pymeshlab"):
        for mode in ("Simple Average", "By Angle", "By Area", "As defined by N. Max"):
            meshes = pymeshlab.MeshSet(verbose=False)
            meshes.add_mesh(pymeshlab.Mesh(points, faces))
            meshes.compute_normal_per_vertex(weightmode=mode)
            found = unit(meshes.current_mesh().vertex_normal_matrix())
            yield f"PyMeshLab, {mode}", found
    if igl := _imported("igl"):
        yield "libigl", np.nan_to_num(igl.per_vertex_normals(points, faces))
    if trimesh := _imported("trimesh"):
        mesh = trimesh.Trimesh(points, faces, process=False)
        yield "trimesh", np.asarray(mesh.vertex_normals)


def _imported(name):
    try:
        return __import__(name)
    except ImportError:
        return None


def of_blender(cases):
    """Return for each case the corner normals by name that Blender makes, if it can."""
    found = sorted((ROOT / ".venv").glob("blender-*/bin/python"))
    if not found:
        return [{} for _ in cases]
    with tempfile.TemporaryDirectory() as folder:
        for number, case in enumerate(cases):
            path = Path(folder, f"{number:04}.npz")
            np.savez(path, points=case.points, faces=case.faces, sharp=case.sharp)
        program = Path(__file__).with_name("blender_normals.py")
        done = subprocess.run(
            [found[-1], program, folder], check=False, capture_output=True, text=True
        )
        if done.returncode:
            raise SystemExit(f"Blender failed: {done.stderr[-500:]}")
        paths = [Path(folder, f"{n:04}.found.npz") for n in range(len(cases))]
        return [dict(np.load(path)) for path in paths]


def measure(cases):
    """Return for each case the errors by method; the baselines are in `baselines`."""
    results = []
    for case, blender in zip(cases, of_blender(cases), strict=True):
        fans, vertex = split_fans(len(case.points), case.faces, case.sharp)
        points = case.points[vertex]
        errors = {name: rms(case, unit(n)) for name, n in blender.items()}
        for name, normals in means_of_faces(points, fans):
            errors[name] = rms(case, normals[fans])
        baselines = list(errors)
        for name, normals in peers(points, fans):
            errors[name] = rms(case, normals[fans])
        found = estimate_normals(case.points, faces=case.faces, sharp=case.sharp)
        errors[OURS] = rms(case, found.corner_normals)
        least = min(errors[name] for name in baselines)
        ratio = (errors[OURS] + EXACT) / (least + EXACT)
        met = ratio <= goal(case) or max(least, errors[OURS]) < EXACT
        results.append((case, errors, least, ratio, met))
        print(
            f"{case.name:28} {found.mesh.kind:8} least {least:7.3f} "
            f"ours {errors[OURS]:7.3f} ratio {ratio:5.2f}{'' if met else '  missed'}",
            flush=True,
        )
    return results


def ratio_table(results):
    """Return a table of ratios, shapes down and damages across, as lines."""
    shapes = list(dict.fromkeys(case.shape for case, *_ in results))
    damages = list(dict.fromkeys(case.damage for case, *_ in results))
    cells = {}
    for case, _, _, ratio, met in results:
        cells[case.shape, case.damage] = f"{ratio:.2f}" if met else f"**{ratio:.2f}**"
    lines = [f"| | {' | '.join(shapes)} |", "|---|" + "---|" * len(shapes)]
    for name in damages:
        row = " | ".join(cells.get((shape, name), "") for shape in shapes)
        lines.append(f"| {name} | {row} |")
    return "\n".join(lines)


def method_table(results):
    """Return a table of the mean errors of methods, damages across, as lines."""
    groups = {
        "clean": ("clean",),
        "noise 0.05, 0.1": ("noise 0.05", "noise 0.1"),
        "noise 0.3 to 1": ("noise 0.3", "noise 0.6", "noise 1"),
        "8 to 12 bits": ("12 bits", "10 bits", "8 bits"),
        "slivers": ("slivers",),
        "flips": ("flips",),
        "decimated": ("50 %", "25 %", "10 %"),
        "remesh": ("remesh",),
        "stairs": ("coarse stairs", "fine stairs"),
    }
    lines = [f"| | {' | '.join(groups)} |", "|---|" + "---|" * len(groups)]
    for name in results[0][1]:
        cells = []
        for damages in groups.values():
            some = [e[name] for case, e, *_ in results if case.damage in damages]
            cells.append(f"{np.mean(some):.2f}" if some else "")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def read_obj(path):
    """Return the vertices and the triangles of a file."""
    points, faces = [], []
    for line in path.read_text().splitlines():
        word, *rest = line.split() or [""]
        if word == "v":
            points.append([float(value) for value in rest[:3]])
        elif word == "f":
            corner = [int(value.split("/")[0]) - 1 for value in rest]
            fan = range(1, len(corner) - 1)
            faces += [[corner[0], corner[i], corner[i + 1]] for i in fan]
    return np.array(points), np.array(faces)


def large(rows=1000, columns=500):
    """Print time and memory on a torus of a million triangles."""
    u, v = np.meshgrid(
        2 * np.pi * np.arange(rows) / rows,
        2 * np.pi * np.arange(columns) / columns,
        indexing="ij",
    )
    small = 0.35 + 0.02 * np.sin(9 * u) * np.cos(5 * v)
    ring = 1 + small * np.cos(v)
    points = np.stack([ring * np.cos(u), ring * np.sin(u), small * np.sin(v)], axis=-1)
    points = points.reshape(-1, 3)
    i, j = (g.ravel() for g in np.mgrid[:rows, :columns])
    a, b = i * columns + j, (i + 1) % rows * columns + j
    c, d = (i + 1) % rows * columns + (j + 1) % columns, i * columns + (j + 1) % columns
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    lines = ["| | seconds | of processor | MB beyond the mesh |", "|---|---|---|---|"]
    for share in (0.0, 0.3):
        worse = damage.noisy(points, faces, share) if share else points
        runs = []
        for _ in range(3):
            before = memory.reset_peak()
            wall, used = time.perf_counter(), time.process_time()
            estimate_normals(worse, faces=faces)
            spent = time.perf_counter() - wall, time.process_time() - used
            runs.append((*spent, memory.peak() - before))
        wall, used, most = np.median(runs, axis=0)
        name = f"noise {share:g}" if share else "clean"
        lines.append(f"| {name} | {wall:.1f} | {used:.1f} | {most:.0f} |")
    return "\n".join(lines)


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--files", type=Path)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--large", action="store_true")
    options = parser.parse_args()
    made = [*solids.smooth_solids(), *solids.creased_solids()]
    results = measure([case for solid in made for case in damage.cases_of(solid)])
    unseen = measure(
        [case for solid in solids.unseen_solids() for case in damage.cases_of(solid)]
    )
    parts = [
        summary(results),
        ratio_table(results),
        "Shapes on which no threshold was set: " + summary(unseen),
        ratio_table(unseen),
        "Mean errors in degrees over the ten shapes:",
        method_table(results),
    ]
    if options.files:
        files = [
            case
            for path in sorted(options.files.glob("*.obj"))
            for case in damage.cases_of_file(path.stem, *read_obj(path))
        ]
        others = measure(files)
        parts += [
            "Meshes of others, their clean originals as truth: " + summary(others),
            ratio_table(others),
        ]
    if options.large:
        parts += ["A million triangles:", large()]
    print("\n\n".join(parts))
    if options.write:
        report.replace_part(ROOT / "docs/accuracy.md", "meshes", "\n\n".join(parts))


def summary(results):
    """Say on how many meshes the goal is met."""
    met = sum(result[-1] for result in results)
    worst = max((r for r in results if goal(r[0]) == SAME), key=lambda r: r[3])
    return (
        f"{met} of {len(results)} meshes meet the goal; the largest ratio where it is "
        f"{SAME} is {worst[3]:.2f}, on {worst[0].name} ({worst[2]:.3f} degrees)."
    )


if __name__ == "__main__":
    main()
