# SPDX-License-Identifier: GPL-3.0-or-later
"""How normals are estimated: every choice, its default, limits and meaning."""

from dataclasses import dataclass, field, fields

from .inputs import InputError, as_choice
from .orient.orientation import MODES
from .orient.winding import NESTED
from .patches.patch import BIQUADRATIC, CUBIC, LEAST_NEIGHBORS
from .timescale import WEIGHTS

PATCHES = {"biquadratic": BIQUADRATIC, "cubic": CUBIC}
METHODS = ("auto", "time_scale", "paper")
WINDINGS = ("as_is", "repaired")
GRAPHS = ("auto", "nearest", "delaunay", "mesh")


def _setting(default, doc, *, choices=None, limits=None):
    return field(
        default=default, metadata={"doc": doc, "choices": choices, "limits": limits}
    )


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How normals are estimated. Every field has a default that works.

    Raises
    ------
    InputError
        When a value is not among the choices or outside its limits.
    """

    method: str = _setting(
        "auto",
        "auto chooses scale and weights from the data, time_scale fits a patch to a "
        "fixed number of neighbors, paper is Table 1 of the paper to the letter",
        choices=METHODS,
    )
    neighbors: int | None = _setting(
        None, "Neighbors of each point; None chooses", limits=(LEAST_NEIGHBORS, 1000)
    )
    radius: float | None = _setting(
        None, "Largest distance of a neighbor, in object units", limits=(0.0, None)
    )
    graph: str = _setting(
        "auto",
        "Who is a neighbor: the nearest points, Delaunay edges, or mesh edges",
        choices=GRAPHS,
    )
    patch: str = _setting(
        "auto",
        "Terms of a patch: biquadratic are those of the paper, cubic all up to "
        "degree three",
        choices=("auto", *PATCHES),
    )
    weights: str = _setting(
        "second_order",
        "Weights of the diamond derivative; method paper has the paper's",
        choices=WEIGHTS,
    )
    sheets: bool = _setting(
        True,
        "Tell neighbors apart where they lie on several sheets or beyond a crease; "
        "method paper does not",
        choices=(True, False),
    )
    orientation: str = _setting(
        "auto", "How the sides of the normals are found", choices=MODES
    )
    nested: str = _setting(
        "cavity",
        "Pieces inside others, under orientation poles: walls of a cavity, or bodies "
        "that face outward",
        choices=NESTED,
    )
    winding: str = _setting(
        "as_is",
        "Faces that wind against the others, or inward: left as they are, or turned "
        "over before anything else",
        choices=WINDINGS,
    )
    viewpoint: object = _setting(
        None, "Where normals should face with orientation viewpoint: (3,) or (n, 3)"
    )
    reference: object = _setting(
        None,
        "What to agree with under orientation reference: normals (n, 3), or the "
        "vertices and faces of a mesh",
    )
    sharp_angle: float | None = _setting(
        None,
        "Edges of a mesh whose faces turn by more than this angle, in radians, part "
        "its normals; None parts it at no angle",
        limits=(0.0, 3.1416),
    )
    threads: int | None = _setting(
        None, "Threads at work; None takes all cores", limits=(1, 1024)
    )

    def __post_init__(self):
        for item in fields(self):
            value = getattr(self, item.name)
            if item.metadata["choices"] is not None:
                as_choice(value, item.metadata["choices"], name=item.name)
            elif value is not None and item.metadata["limits"] is not None:
                _check_limits(item.name, value, *item.metadata["limits"])
        for name in ("neighbors", "threads"):
            value = getattr(self, name)
            if value is not None and int(value) != value:
                raise InputError(f"expected {name} to be a whole number, got {value}")


def _check_limits(name, value, low, high):
    try:
        inside = low <= value and (high is None or value <= high)
    except TypeError:
        inside = False
    if not inside or (low == 0.0 and value == 0):
        span = f"above {low:g}" if high is None else f"from {low:g} to {high:g}"
        raise InputError(f"expected {name} {span}, got {value!r}")
