# SPDX-License-Identifier: GPL-3.0-or-later
"""The border of the core: what may come in, and the one error that says what did."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

# Rows of a part that is worked on by itself.
_PART = 1 << 16

# Sizes of clouds whose squares, and products of these, are numbers still.
_LEAST_SIZE, _MOST_SIZE = 1e-70, 1e70

# Shapes are said in the docstrings.
FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.integer[Any]]
BoolArray = NDArray[np.bool_]


class InputError(ValueError):
    """Bad input, in one sentence: what was expected and what came."""


def as_points(points: ArrayLike, *, least: int = 1, name: str = "points") -> FloatArray:
    """Check coordinates and return them as float64.

    Parameters
    ----------
    points : (n, 3) array_like of real numbers
    least : int
        The smallest n that makes sense to the caller.

    Returns
    -------
    (n, 3) float64, contiguous; a new array only where the input was not one already.

    Raises
    ------
    InputError
        When the shape is wrong, a coordinate is nan or infinite, or n < least.
    """
    array = as_numbers(points, name=name)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"expected {name} of shape (n, 3), got {array.shape}")
    if len(array) < least:
        raise InputError(f"expected at least {least} {name}, got {len(array)}")
    with np.errstate(over="ignore", invalid="ignore"):
        total = array.sum()
    # One number tells that all are finite; a sum of finite ones may not be.
    if not np.isfinite(total) and not np.isfinite(array).all():
        bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
        raise InputError(
            f"expected finite {name}, got nan or infinite coordinates in "
            f"{len(bad)} of {len(array)} rows (the first is row {bad[0]})"
        )
    return array


def centered_parts(points: FloatArray, center: FloatArray) -> Iterator[FloatArray]:
    """Yield points (n, 3) less a center (3,), part by part: never a copy of all."""
    for at in range(0, len(points), _PART):
        yield points[at : at + _PART] - center


def snapped(center: FloatArray, size: float) -> FloatArray:
    """Return a place near the center of points that does not hang on rounding.

    A multiple of a power of two, about a thousandth of the size of the cloud: the same
    however the mean was summed, and coordinates of single precision lose nothing when
    it is subtracted.

    Parameters
    ----------
    center : (3,) float64
    size : float
        The largest extent of the cloud along an axis.
    """
    if not size > 0:
        return center
    step = 2.0 ** (np.ceil(np.log2(size)) - 10)
    return np.round(center / step) * step


@dataclass(frozen=True)
class Extent:
    """Where points are: mean, least and largest coordinates, (3,) float64 each."""

    mean: FloatArray
    low: FloatArray
    high: FloatArray

    @property
    def size(self) -> float:
        """The largest extent along an axis."""
        return float((self.high - self.low).max())

    @property
    def center(self) -> FloatArray:
        """The place that coordinates are taken from, (3,)."""
        return snapped(self.mean, self.size)


def extent_of(points: FloatArray) -> Extent:
    """Return the Extent of points (n, 3)."""
    # Axis by axis: reductions along three columns take ten times as long.
    found = []
    for at in range(0, len(points), _PART):
        part = points[at : at + _PART].T.copy()
        found.append([part.sum(axis=1), part.min(axis=1), part.max(axis=1)])
    total, low, high = np.moveaxis(np.array(found), 1, 0)
    return Extent(total.sum(axis=0) / len(points), low.min(axis=0), high.max(axis=0))


def check_size(size: float) -> None:
    """Raise InputError where the size of a cloud is beyond what can be computed."""
    if not _LEAST_SIZE < size < _MOST_SIZE:
        raise InputError(
            f"expected points that are {_LEAST_SIZE:g} to {_MOST_SIZE:g} apart, "
            f"got {size:.3g}: scale them first"
        )


def as_numbers(values: ArrayLike, *, name: str) -> FloatArray:
    """Return real numbers as a contiguous float64 array, or raise InputError."""
    try:
        array = np.asarray(values)
        if np.iscomplexobj(array):
            raise TypeError("complex numbers")
        return np.ascontiguousarray(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"expected {name} to be real numbers, got {error}") from None


def as_faces(faces: ArrayLike | None, count: int) -> IntArray | None:
    """Check triangles and return them as int64.

    Parameters
    ----------
    faces : (m, 3) array_like of int
        Vertex indices below `count`; None stands for no faces.

    Returns
    -------
    (m, 3) int64, or None where there is no face at all.
    """
    if faces is None:
        return None
    array = np.asarray(faces)
    if array.size == 0:
        return None
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iu":
        raise InputError(
            f"expected faces of shape (m, 3) holding integers, "
            f"got {array.shape} of {array.dtype}"
        )
    array = np.ascontiguousarray(array, dtype=np.int64)
    low, high = array.min(), array.max()
    if low < 0 or high >= count:
        raise InputError(
            f"expected face indices from 0 to {count - 1}, got {low} to {high}"
        )
    return array


def as_normals(normals: ArrayLike, count: int, *, name: str = "normals") -> FloatArray:
    """Check vectors, one for each of `count` points; return them as float64."""
    array = as_points(normals, least=0, name=name)
    if len(array) != count:
        raise InputError(f"expected {count} {name}, one a point, got {len(array)}")
    return array


def as_choice(value: str, choices: tuple[str, ...], *, name: str) -> str:
    """Return `value` when it is one of `choices`, else raise InputError."""
    if value not in choices:
        raise InputError(f"expected {name} to be one of {choices}, got {value!r}")
    return value
