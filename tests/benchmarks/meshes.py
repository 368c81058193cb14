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
from dataclasses import dataclass
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
TRUTH = "the clean original, by angle"


def goal(case):
    """Return the largest ratio wanted on a mesh."""
    if case.damage in ("noise 0.3", "noise 0.6", "noise 1"):
        return NOISY
    return OTHERS if "stairs" in case.damage or case.damage == "slivers" else SAME


@dataclass(frozen=True)
class Result:
    """The errors in degrees by method on a mesh, and what became of the goal there.

    Attributes
    ----------
    errors : dict of str to float
    least : float
        Of Blender's and other means of faces.
    ratio : float
        Of our error to that.
    met : bool
    on_cylinders : dict of str to float
        The errors where the exact normals are known; empty where they are nowhere.
    """

    case: damage.Case
    errors: dict
    least: float
    ratio: float
    met: bool
    on_cylinders: dict


def rms(case, normals):
    """Return the root mean square angle of corner normals (m, 3, 3) in degrees.

    Over the corners where edges part the mesh, else over the vertices.
    """
    angle = angles(normals, case.truth)
    if not len(case.sharp):
        _, first = np.unique(case.faces, return_index=True)
        angle = angle.ravel()[first]
    return float(np.sqrt((angle**2).mean()))


def angles(a, b):
    """Return the angles between normals (m, 3, 3) in degrees, (m, 3)."""
    cross = np.linalg.norm(np.cross(a, b), axis=2)
    return np.degrees(np.arctan2(cross, (a * b).sum(axis=2)))


def on_cylinders(case, fields):
    """Return the errors of fields by name where the exact normals are known."""
    if case.exact is None:
        return {}
    known = (case.exact != 0).any(axis=2)
    return {
        name: float(np.sqrt((angles(normals, case.exact)[known] ** 2).mean()))
        for name, normals in fields.items()
    }


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
    """Return the Result of each case."""
    results = []
    for case, blender in zip(cases, of_blender(cases), strict=True):
        fans, vertex = split_fans(len(case.points), case.faces, case.sharp)
        points = case.points[vertex]
        fields = {name: unit(normals) for name, normals in blender.items()}
        fields |= {name: n[fans] for name, n in means_of_faces(points, fans)}
        baselines = list(fields)
        fields |= {name: n[fans] for name, n in peers(points, fans)}
        found = estimate_normals(case.points, faces=case.faces, sharp=case.sharp)
        fields[OURS] = found.corner_normals
        errors = {name: rms(case, normals) for name, normals in fields.items()}
        least = min(errors[name] for name in baselines)
        ratio = (errors[OURS] + EXACT) / (least + EXACT)
        met = ratio <= goal(case) or max(least, errors[OURS]) < EXACT
        known = on_cylinders(case, {TRUTH: case.truth, **fields})
        results.append(Result(case, errors, least, ratio, met, known))
        print(
            f"{case.name:28} {found.mesh.kind:8} least {least:7.3f} "
            f"ours {errors[OURS]:7.3f} ratio {ratio:5.2f}{'' if met else '  missed'}",
            flush=True,
        )
    return results


def ratio_table(results):
    """Return a table of ratios, shapes down and damages across, as lines."""
    shapes = list(dict.fromkeys(result.case.shape for result in results))
    damages = list(dict.fromkeys(result.case.damage for result in results))
    cells = {}
    for result in results:
        text = f"{result.ratio:.2f}" if result.met else f"**{result.ratio:.2f}**"
        cells[result.case.shape, result.case.damage] = text
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
    for name in results[0].errors:
        cells = []
        for damages in groups.values():
            some = [r.errors[name] for r in results if r.case.damage in damages]
            cells.append(f"{np.mean(some):.2f}" if some else "")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def cylinder_table(results):
    """Return a table of errors where exact normals are known, damages down."""
    known = [result for result in results if result.on_cylinders]
    names = (TRUTH, "best means of faces", OURS)
    lines = [f"| | {' | '.join(names)} |", "|---|" + "---|" * len(names)]
    for result in known:
        errors = dict(result.on_cylinders)
        others = [errors[name] for name in errors if name not in (TRUTH, OURS)]
        cells = [errors[TRUTH], min(others), errors[OURS]]
        row = " | ".join(f"{cell:.2f}" for cell in cells)
        lines.append(f"| {result.case.name} | {row} |")
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
            "Where they were sampled from cylinders, errors in degrees to the exact "
            "normals of these:",
            cylinder_table(others),
        ]
    if options.large:
        parts += ["A million triangles:", large()]
    print("\n\n".join(parts))
    if options.write:
        report.replace_part(ROOT / "docs/accuracy.md", "meshes", "\n\n".join(parts))


def summary(results):
    """Say on how many meshes the goal is met."""
    met = sum(result.met for result in results)
    same = [result for result in results if goal(result.case) == SAME]
    worst = max(same, key=lambda result: result.ratio)
    name, least = worst.case.name, worst.least
    return (
        f"{met} of {len(results)} meshes meet the goal; the largest ratio where it is "
        f"{SAME} is {worst.ratio:.2f}, on {name} ({least:.3f} degrees)."
    )


if __name__ == "__main__":
    main()
