# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces parameterized by the product of two time scales (Definition 4 of [1]).

References
----------
[1] See `timescale`.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from .inputs import BoolArray, FloatArray, InputError, as_numbers
from .timescale import TimeScale


class GridSurface:
    """A surface patch phi: T1 x T2 -> R^3 given by its points.

    Parameters
    ----------
    T1, T2 : TimeScale or (n1,), (n2,) array_like
        Isolated time scales.
    points : (n1, n2, 3) array_like of float
        phi(t_i, s_j).

    Raises
    ------
    InputError
        When the points do not match the time scales.
    """

    def __init__(
        self, T1: TimeScale | ArrayLike, T2: TimeScale | ArrayLike, points: ArrayLike
    ) -> None:
        self.T1 = T1 if isinstance(T1, TimeScale) else TimeScale(T1)
        self.T2 = T2 if isinstance(T2, TimeScale) else TimeScale(T2)
        self.points = as_numbers(points, name="grid points")
        expected = (len(self.T1), len(self.T2), 3)
        if self.points.shape != expected or not np.isfinite(self.points).all():
            raise InputError(
                f"expected finite grid points of shape {expected}, one a pair of "
                f"the two time scales, got {self.points.shape}"
            )

    @classmethod
    def from_function(
        cls, T1: TimeScale | ArrayLike, T2: TimeScale | ArrayLike, phi: Callable
    ) -> "GridSurface":
        """Sample phi(t, s) -> (..., 3), a function of arrays, on T1 x T2."""
        T1 = T1 if isinstance(T1, TimeScale) else TimeScale(T1)
        T2 = T2 if isinstance(T2, TimeScale) else TimeScale(T2)
        return cls(T1, T2, phi(*np.meshgrid(T1.points, T2.points, indexing="ij")))

    @classmethod
    def graph(
        cls,
        T1: TimeScale | ArrayLike,
        T2: TimeScale | ArrayLike,
        heights: ArrayLike | Callable,
    ) -> "GridSurface":
        """Make the surface {(t, s, f(t, s))} of Proposition 1.

        Parameters
        ----------
        heights : callable or (n1, n2) array_like
            f as a function of arrays, or its samples.
        """
        T1 = T1 if isinstance(T1, TimeScale) else TimeScale(T1)
        T2 = T2 if isinstance(T2, TimeScale) else TimeScale(T2)
        t, s = np.meshgrid(T1.points, T2.points, indexing="ij")
        z = heights(t, s) if callable(heights) else heights
        z = as_numbers(z, name="heights")
        if z.shape != t.shape:
            raise InputError(f"expected heights of shape {t.shape}, got {z.shape}")
        return cls(T1, T2, np.stack([t, s, z], axis=-1))

    def tangents(self, *, weights: str = "paper") -> tuple[FloatArray, FloatArray]:
        """Return the partial diamond derivatives along T1 and along T2.

        Returns
        -------
        two (n1, n2, 3) float64; delta at the minimum of a time scale and nabla at
        its maximum, as after Theorem 3 of [1].
        """
        along_1 = self.T1.diamond(self.points, weights=weights)
        along_2 = self.T2.diamond(self.points, weights=weights, axis=1)
        return along_1, along_2

    def metric(self, *, weights: str = "paper") -> FloatArray:
        """Return the metric tensor, (n1, n2, 2, 2) float64."""
        frame = np.stack(self.tangents(weights=weights), axis=-2)
        return frame @ frame.swapaxes(-1, -2)

    def is_regular(self, *, weights: str = "paper") -> BoolArray:
        """Return where the tangents span a plane, (n1, n2) bool.

        Notes
        -----
        |a x b| is compared with 1e-12 |a| |b|: below that the angle between the
        tangents is rounding.
        """
        a, b = self.tangents(weights=weights)
        area = np.linalg.norm(np.cross(a, b), axis=-1)
        sides = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
        return area > 1e-12 * sides

    def normals(self, *, weights: str = "paper") -> FloatArray:
        """Return the unit normals N_TS of [1], (n1, n2, 3) float64.

        Rows where the surface is not regular are zero (see `is_regular`).
        """
        a, b = self.tangents(weights=weights)
        normals = np.cross(a, b)
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        regular = self.is_regular(weights=weights)[..., None]
        return np.divide(normals, length, out=np.zeros_like(normals), where=regular)
