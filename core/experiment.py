# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's experiment repeated (section 4), and the order of its derivatives.

The paper says how many points it drew and which surfaces; it does not say how it
spread the points, in which space it made the Delaunay triangulation, nor which axes
its charts had. Each of these has a few sensible readings, and the honest repetition
is the range over all of them.

References
----------
[1] See `timescale`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .comparison import Comparison, angle, compare_normals
from .delaunay import delaunay_normals
from .estimate import estimate_normals
from .inputs import FloatArray
from .mesh.faces import face_vectors, unit
from .neighbors.graph import delaunay_simplices
from .settings import Settings
from .shapes import PHI1, PHI2, Shape
from .surface import GridSurface
from .timescale import WEIGHTS, TimeScale

# Section 4: the surfaces, how many points, and what the paper counted and measured.
SURFACES = {"phi1": (PHI1, 2571), "phi2": (PHI2, 2295)}
PUBLISHED = {
    "phi1": {"wins": 962, "estimate_min": 9.24888e-5, "baseline_min": 5.777e-2},
    "phi2": {"wins": 113, "estimate_min": 1.19273e-2, "baseline_min": 3.38129e-1},
}

# "Well distributed": evenly over the surface, or over the parameter domain.
SAMPLINGS = ("area", "parameters")

METHODS = {
    "paper": Settings(method="paper", orientation="none"),
    "time_scale": Settings(method="time_scale", orientation="none"),
    "auto": Settings(orientation="none"),
}

BASELINES = ("parameters", "projection", "complex", "points")


@dataclass(frozen=True)
class Trial:
    """One method against one baseline on one sample.

    Attributes
    ----------
    surface, sampling, method, baseline : str
    seed : int
    comparison : Comparison
    """

    surface: str
    sampling: str
    seed: int
    method: str
    baseline: str
    comparison: Comparison

    def row(self) -> dict[str, object]:
        """Return the trial as a dict of plain values."""
        summary = self.comparison.summary()
        return {
            "surface": self.surface,
            "sampling": self.sampling,
            "seed": self.seed,
            "method": self.method,
            "baseline": self.baseline,
            "points": summary["points"],
            "wins": summary["wins"],
            "wins_percent": summary["wins_percent"],
        } | {
            f"{side}_{measure}": summary[f"error_{side}_{measure}"]
            for side in ("estimate", "baseline")
            for measure in ("min", "median", "mean", "max")
        }


def repeat_experiment(
    *,
    seeds: tuple[int, ...] = (0, 1, 2),
    samplings: tuple[str, ...] = SAMPLINGS,
    progress: Callable[[float], object] | None = None,
) -> list[Trial]:
    """Run every method against every baseline on every sample.

    Parameters
    ----------
    seeds : tuple of int
    samplings : tuple of "area" | "parameters"
    progress : callable, optional
        Called with the share done.

    Returns
    -------
    list of Trial
    """
    cases = [
        (name, by, seed) for name in SURFACES for by in samplings for seed in seeds
    ]
    trials: list[Trial] = []
    for done, (name, by, seed) in enumerate(cases):
        if progress is not None:
            progress(done / len(cases))
        shape, count = SURFACES[name]
        points, truth, parameters = shape.sample(count, seed, by=by)
        found = {
            method: estimate_normals(points, settings=settings).normals
            for method, settings in METHODS.items()
        }
        for baseline in BASELINES:
            told = baseline_normals(baseline, points, parameters)
            for method, normals in found.items():
                comparison = compare_normals(normals, told, truth=truth)
                trials.append(Trial(name, by, seed, method, baseline, comparison))
    if progress is not None:
        progress(1.0)
    return trials


def baseline_normals(
    reading: str, points: FloatArray, parameters: FloatArray
) -> FloatArray:
    """Return N_D in one of the readings of section 4, (n, 3).

    Parameters
    ----------
    reading : "parameters" | "projection" | "complex" | "points"
        The Delaunay triangulation of the parameters; of x and y; of the points in
        space, with all triangles of its tetrahedra; each point's own star.
    """
    if reading == "parameters":
        return delaunay_normals(points, parameters=parameters)
    if reading == "projection":
        return delaunay_normals(points, parameters=points[:, :2])
    if reading == "points":
        return delaunay_normals(points)
    return _complex_normals(points)


def _complex_normals(points):
    """Return the area-weighted mean of all triangles of the Delaunay complex.

    Triangles inside a solid have no side of their own: each is turned up, as the
    graph of a function would be.
    """
    simplices = np.sort(delaunay_simplices(points), axis=1)
    corners = ([0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3])
    faces = np.unique(np.concatenate([simplices[:, c] for c in corners]), axis=0)
    vectors = face_vectors(points, faces)
    vectors[vectors[:, 2] < 0] *= -1
    total = np.zeros(points.shape)
    for corner in range(3):
        np.add.at(total, faces[:, corner], vectors)
    return unit(total)


def convergence(
    function: Callable,
    derivative: Callable,
    *,
    halvings: int = 6,
    ratio: float = 3.0,
) -> dict[str, FloatArray]:
    """Measure the error of the diamond derivative as a time scale is refined.

    Parameters
    ----------
    function, derivative : callable
        f and f' of arrays.
    halvings : int
        How often the largest gap, 0.1 at first, is halved.
    ratio : float
        Of the long gaps to the short ones: they alternate, so that mu and nu differ
        at every point however fine the scale is.

    Returns
    -------
    dict
        "step": (halvings + 1,) the largest gap; and for both weights the largest
        error at inner points, (halvings + 1,).

    Notes
    -----
    Taylor: delta = f' + mu f''/2 + mu^2 f'''/6 and nabla = f' - nu f''/2 +
    nu^2 f'''/6. With the paper's weights mu/(mu + nu) and nu/(mu + nu) the sum is
    f' + (mu - nu) f''/2 + ..., of first order unless mu = nu. Exchanged, it is
    f' + mu nu f'''/6, of second order.
    """
    steps = 0.1 * 0.5 ** np.arange(halvings + 1)
    errors: dict[str, list[float]] = {weights: [] for weights in WEIGHTS}
    for step in steps:
        pair = step * (1 + 1 / ratio)
        starts = pair * np.arange(round(1 / pair))
        scale = TimeScale(np.sort(np.concatenate([starts, starts + step])))
        t = scale.points
        for weights, found in errors.items():
            diamond = scale.diamond(function(t), weights=weights)
            found.append(np.abs(diamond - derivative(t))[1:-1].max())
    return {"step": steps} | {w: np.array(found) for w, found in errors.items()}


def order(steps: FloatArray, errors: FloatArray) -> float:
    """Return the slope of log error over log step: the order of a scheme."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def shape_convergence(
    shape: Shape, *, halvings: int = 6, ratio: float = 3.0
) -> dict[str, FloatArray]:
    """As `convergence`, for the normals of a surface over a non-uniform grid.

    The grid covers a tenth of the parameter domain, away from its middle, where the
    surfaces have their symmetries; the finest has a few hundred members a side.

    Returns
    -------
    dict
        "step", and for both weights the largest angle to the true normals, radians.
    """
    steps = 0.25 * 0.5 ** np.arange(halvings + 1)
    errors: dict[str, list[float]] = {weights: [] for weights in WEIGHTS}
    for step in steps:
        pair = step * (1 + 1 / ratio)
        starts = pair * np.arange(max(2, round(1 / pair)))
        unit_scale = np.sort(np.concatenate([starts, starts + step]))
        grids = [
            TimeScale(low + (high - low) * (0.3 + 0.1 * unit_scale))
            for low, high in shape.domain
        ]
        surface = GridSurface.from_function(grids[0], grids[1], shape.point)
        exact = shape.normal(*np.meshgrid(*(g.points for g in grids), indexing="ij"))
        for weights, found in errors.items():
            normals = surface.normals(weights=weights)[1:-1, 1:-1]
            truth = exact[1:-1, 1:-1].reshape(-1, 3)
            found.append(np.radians(angle(normals.reshape(-1, 3), truth)).max())
    return {"step": steps} | {w: np.array(found) for w, found in errors.items()}
