# SPDX-License-Identifier: GPL-3.0-or-later
"""Time scales and their derivatives (section 2 of the paper).

A time scale is a nonempty closed subset of the real line. Here it is a finite union
of isolated points and closed intervals, so that the discrete and the continuous
case, and every mixture, answer to the same names.

References
----------
[1] O. Akguller, "Discrete Normal Vector Field Approximation via Time Scale
    Calculus", Applied Mathematics and Nonlinear Sciences 5 (2020),
    doi 10.2478/amns.2020.1.00033.
[2] M. Bohner, A. Peterson, "Dynamic Equations on Time Scales", Birkhauser 2001.
"""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import ArrayLike

from .inputs import BoolArray, FloatArray, InputError, as_choice, as_numbers

WEIGHTS = ("paper", "second_order")

# One-sided and central difference quotients are extrapolated to step zero from this
# many halvings; past ten, rounding costs more than extrapolation gains.
_HALVINGS = 10


class TimeScale:
    """A time scale: isolated points, closed intervals, or both.

    Parameters
    ----------
    points : (n,) array_like of float
        Strictly increasing isolated points.
    intervals : sequence of (start, stop)
        Closed intervals, start < stop, in any order. Parts that touch are joined.

    Attributes
    ----------
    starts, stops : (c,) float64
        The parts in increasing order; an isolated point starts where it stops.

    Raises
    ------
    InputError
        When points are not finite and strictly increasing, an interval is empty, or
        the whole holds a single point only (it has no derivative).

    Examples
    --------
    >>> scale = TimeScale([0.0, 1.0, 3.0])
    >>> scale.sigma(1.0), scale.mu(1.0), scale.nu(1.0)
    (3.0, 2.0, 1.0)
    >>> scale.diamond([0.0, 1.0, 9.0], weights="second_order")
    array([1., 2., 4.])
    """

    def __init__(
        self,
        points: ArrayLike = (),
        *,
        intervals: Iterable[tuple[float, float]] = (),
    ) -> None:
        points = as_numbers(points, name="time scale points")
        if points.ndim != 1 or not np.isfinite(points).all():
            raise InputError(
                f"expected time scale points of shape (n,), all finite, "
                f"got shape {points.shape}"
            )
        if (np.diff(points) <= 0).any():
            raise InputError("expected time scale points in strictly increasing order")
        spans = as_numbers(list(intervals), name="intervals").reshape(-1, 2)
        if not np.isfinite(spans).all() or (spans[:, 0] >= spans[:, 1]).any():
            raise InputError("expected intervals (start, stop) with start < stop")
        starts = np.concatenate([points, spans[:, 0]])
        stops = np.concatenate([points, spans[:, 1]])
        if len(starts) == 0 or (len(starts) == 1 and starts[0] == stops[0]):
            raise InputError(
                f"expected a time scale of two points or more, got {len(starts)}"
            )
        self.starts, self.stops = _joined(starts, stops)

    @classmethod
    def interval(cls, start: float, stop: float) -> "TimeScale":
        """Return the real interval [start, stop]."""
        return cls(intervals=[(start, stop)])

    @classmethod
    def uniform(cls, step: float, start: float, stop: float) -> "TimeScale":
        """Return the members of step * Z within [start, stop]."""
        if not step > 0:
            raise InputError(f"expected a step above 0, got {step}")
        # A window end that rounding put just beyond its multiple still counts.
        first = int(np.ceil(start / step - 1e-9))
        last = int(np.floor(stop / step + 1e-9))
        return cls(step * np.arange(first, last + 1))

    def __or__(self, other: "TimeScale") -> "TimeScale":
        """Return the union of two time scales."""
        return _scale(
            *_joined(
                np.concatenate([self.starts, other.starts]),
                np.concatenate([self.stops, other.stops]),
            )
        )

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, TimeScale)
            and np.array_equal(self.starts, other.starts)
            and np.array_equal(self.stops, other.stops)
        )

    def __hash__(self) -> int:
        return hash((self.starts.tobytes(), self.stops.tobytes()))

    def __len__(self) -> int:
        """Return the number of points of an isolated time scale."""
        return len(self.points)

    def __repr__(self) -> str:
        parts = [
            f"{a:g}" if a == b else f"[{a:g}, {b:g}]"
            for a, b in zip(self.starts[:6], self.stops[:6], strict=True)
        ]
        more = ", ..." if len(self.starts) > 6 else ""
        return f"TimeScale({{{', '.join(parts)}{more}}})"

    # The set itself

    @property
    def min(self) -> float:
        """The least member."""
        return float(self.starts[0])

    @property
    def max(self) -> float:
        """The greatest member."""
        return float(self.stops[-1])

    @property
    def is_isolated(self) -> bool:
        """Whether every member is an isolated point."""
        return bool((self.starts == self.stops).all())

    @property
    def points(self) -> FloatArray:
        """(n,) float64, the members of an isolated time scale."""
        if not self.is_isolated:
            raise InputError(
                "expected an isolated time scale, got one with intervals, whose "
                "members cannot be listed"
            )
        return self.starts

    def contains(self, t: ArrayLike) -> BoolArray | bool:
        """Return whether t, a number or an array, is a member."""
        t = np.asarray(t, dtype=np.float64)
        part = self._part(t)
        found = (part >= 0) & (t <= self.stops[part])
        return found if t.ndim else bool(found)

    __contains__ = contains

    def kappa(self, *, upper: bool = True, lower: bool = True) -> "TimeScale":
        """Return the set without its scattered ends.

        Parameters
        ----------
        upper, lower : bool
            Remove a left-scattered maximum; remove a right-scattered minimum. Both
            give the set on which the paper's Definition 1 differentiates.

        Raises
        ------
        InputError
            When nothing is left.
        """
        starts, stops = self.starts, self.stops
        if upper and starts[-1] == stops[-1]:
            starts, stops = starts[:-1], stops[:-1]
        if lower and len(starts) and starts[0] == stops[0]:
            starts, stops = starts[1:], stops[1:]
        if not len(starts):
            raise InputError(f"expected a time scale with inner points, got {self!r}")
        return _scale(starts, stops)

    # Jumps

    def sigma(self, t: ArrayLike) -> FloatArray | float:
        """Return the forward jump: the next member, or t where none is apart."""
        t, part = self._members(t)
        at_stop = (t == self.stops[part]) & (part < len(self.starts) - 1)
        after = self.starts[np.minimum(part + 1, len(self.starts) - 1)]
        return _like(t, np.where(at_stop, after, t))

    def rho(self, t: ArrayLike) -> FloatArray | float:
        """Return the backward jump: the member before, or t where none is apart."""
        t, part = self._members(t)
        at_start = (t == self.starts[part]) & (part > 0)
        return _like(t, np.where(at_start, self.stops[np.maximum(part - 1, 0)], t))

    def mu(self, t: ArrayLike) -> FloatArray | float:
        """Return the forward graininess sigma(t) - t."""
        return _like(t, np.subtract(self.sigma(t), t))

    def nu(self, t: ArrayLike) -> FloatArray | float:
        """Return the backward graininess t - rho(t)."""
        return _like(t, np.subtract(t, self.rho(t)))

    def is_right_scattered(self, t: ArrayLike) -> BoolArray | bool:
        """Return whether sigma(t) > t."""
        return self.mu(t) > 0

    def is_left_scattered(self, t: ArrayLike) -> BoolArray | bool:
        """Return whether rho(t) < t."""
        return self.nu(t) > 0

    def is_right_dense(self, t: ArrayLike) -> BoolArray | bool:
        """Return whether t < max and sigma(t) = t."""
        return (self.mu(t) == 0) & (np.asarray(t) < self.max)[()]

    def is_left_dense(self, t: ArrayLike) -> BoolArray | bool:
        """Return whether t > min and rho(t) = t."""
        return (self.nu(t) == 0) & (np.asarray(t) > self.min)[()]

    # Derivatives

    def gamma(self, t: ArrayLike, *, weights: str = "paper") -> FloatArray | float:
        """Return the share of delta in the diamond derivative (Theorem 3 of [1]).

        Notes
        -----
        "paper" is the limit of Theorem 3: mu / (mu + nu), 1/2 where t is dense on
        both sides, 1 where it is scattered on the right only, 0 on the left only.
        "second_order" exchanges the graininesses, nu / (mu + nu): the error
        (mu - nu) f''/2 of the first vanishes and mu nu f'''/6 remains.
        At the minimum only delta exists (gamma = 1), at the maximum only nabla (0).
        """
        as_choice(weights, WEIGHTS, name="weights")
        mu, nu = np.asarray(self.mu(t)), np.asarray(self.nu(t))
        over = mu if weights == "paper" else nu
        both = mu + nu
        gamma = np.full(both.shape, 0.5)
        np.divide(over, both, out=gamma, where=both > 0)
        t = np.asarray(t, dtype=np.float64)
        gamma = np.where(t == self.min, 1.0, np.where(t == self.max, 0.0, gamma))
        return _like(t, gamma)

    def delta(
        self,
        values: ArrayLike | Callable,
        *,
        t: ArrayLike | None = None,
        axis: int = 0,
    ) -> FloatArray:
        """Return the delta derivative, (f(sigma) - f) / mu or its limit.

        Parameters
        ----------
        values : (n, ...) array_like or callable
            Samples on an isolated time scale along `axis`, or a function of arrays.
        t : array_like, optional
            With a function: the members at which to differentiate; by default all of
            an isolated time scale.
        axis : int
            Of samples, the axis along which the time scale runs.

        Returns
        -------
        (n, ...) float64; nan at a left-scattered maximum, where it does not exist.
        """
        return self._one_sided(values, t, self.sigma, +1, axis)

    def nabla(
        self,
        values: ArrayLike | Callable,
        *,
        t: ArrayLike | None = None,
        axis: int = 0,
    ) -> FloatArray:
        """Return the nabla derivative, (f - f(rho)) / nu or its limit.

        As `delta`, with nan at a right-scattered minimum.
        """
        return self._one_sided(values, t, self.rho, -1, axis)

    def diamond(
        self,
        values: ArrayLike | Callable,
        weights: str = "paper",
        *,
        t: ArrayLike | None = None,
        axis: int = 0,
    ) -> FloatArray:
        """Return the symmetric derivative gamma delta + (1 - gamma) nabla.

        Parameters
        ----------
        values, t, axis
            As for `delta`.
        weights : "paper" | "second_order"
            See `gamma`.

        Returns
        -------
        (n, ...) float64; delta at the minimum and nabla at the maximum.

        Notes
        -----
        On isolated points "paper" is (f(sigma) - f(rho)) / (sigma - rho), exact on
        linear functions; "second_order" is exact on quadratics.
        """
        if not callable(values):
            values = _first(values, axis)
        delta, nabla = self.delta(values, t=t), self.nabla(values, t=t)
        at = self._default_members(values, t)
        gamma = np.asarray(self.gamma(at, weights=weights))
        gamma = gamma.reshape(gamma.shape + (1,) * (np.ndim(delta) - gamma.ndim))
        mixed = gamma * delta + (1 - gamma) * nabla
        # 0 * nan is nan: where one side has no say it must not be asked.
        result = np.where(gamma == 1, delta, np.where(gamma == 0, nabla, mixed))
        result = result if callable(values) else np.moveaxis(result, 0, axis)
        return _like(np.asarray(at), result)

    # Inside

    def _part(self, t):
        return np.searchsorted(self.starts, t, side="right") - 1

    def _members(self, t):
        t = np.asarray(t, dtype=np.float64)
        outside = ~np.asarray(self.contains(t))
        if outside.any():
            raise InputError(
                f"expected members of {self!r}, got {t[outside].flat[0]:g}"
            )
        return t, self._part(t)

    def _default_members(self, values, t):
        if callable(values):
            return self.points if t is None else np.asarray(t, dtype=np.float64)
        if t is not None:
            raise InputError("expected t only with a function, got it with samples")
        return self.points

    def _one_sided(self, values, t, jump, side, axis):
        t = self._default_members(values, t)
        if not callable(values):
            return np.moveaxis(self._sampled(_first(values, axis), side), 0, axis)
        t, _ = self._members(t)
        gap = np.asarray(jump(t)) - t
        scattered = gap != 0
        here = np.asarray(values(t), dtype=np.float64)
        gap, scattered = _columns(gap, here), _columns(scattered, here)
        there = np.asarray(values(np.asarray(jump(t))), dtype=np.float64)
        result = np.full(here.shape, np.nan)
        np.divide(there - here, gap, out=result, where=scattered)
        dense = np.asarray(self.is_left_dense(t) | self.is_right_dense(t)) & (
            np.asarray(jump(t)) == t
        )
        if dense.any():
            result[dense] = self._limit(values, t[dense])
        return _like(t, result)

    def _sampled(self, values, side):
        points = self.points
        if len(values) != len(points):
            raise InputError(
                f"expected values for the {len(points)} points of the time scale "
                f"along their axis, got {len(values)}"
            )
        slopes = np.diff(values, axis=0) / _columns(np.diff(points), values)
        end = np.full_like(values[:1], np.nan)
        parts = [slopes, end] if side > 0 else [end, slopes]
        return np.concatenate(parts)

    def _limit(self, function, t):
        """Differentiate at dense members by Richardson extrapolation.

        The steps stay inside the time scale: central where both sides are dense,
        one-sided where one is. Each column of the tableau removes one more power of
        the step, of its square where the quotient is central; of all its entries the
        one that changed least counts.
        """
        central, reach = self._steps(t)
        base = np.where(central, 4.0, 2.0)
        best = error = np.asarray(np.inf)
        previous: list[np.ndarray] = []
        for halving in range(_HALVINGS):
            step = reach * 0.5**halving
            low = np.where(central, t - step, t)
            rise = np.asarray(function(t + step)) - np.asarray(function(low))
            row = [rise / _columns(t + step - low, rise)]
            for power, before in enumerate(previous, 1):
                gain = _columns(base**power, rise)
                row.append(row[-1] + (row[-1] - before) / (gain - 1))
                change = np.maximum(np.abs(row[-1] - row[-2]), np.abs(row[-1] - before))
                best = np.where(change < error, row[-1], best)
                error = np.minimum(change, error)
            previous = row
        return best

    def _steps(self, t):
        """Return where quotients can be central, and how far steps may reach."""
        part = self._part(t)
        left, right = t - self.starts[part], self.stops[part] - t
        central = (left > 0) & (right > 0)
        one_sided = np.where(right > 0, right, -left)
        reach = np.where(central, np.minimum(left, right), one_sided)
        # No farther than a tenth of |t| or of one: the function is only known to be
        # smooth near t.
        bound = 0.1 * np.maximum(1, np.abs(t))
        return central, np.sign(reach) * np.minimum(np.abs(reach), bound)


def _scale(starts, stops):
    """Make a time scale of parts known to be good; kappa may leave a single point."""
    scale = TimeScale.__new__(TimeScale)
    scale.starts, scale.stops = starts, stops
    return scale


def _joined(starts, stops):
    """Sort parts and join those that overlap or touch."""
    order = np.argsort(starts, kind="stable")
    starts, stops = starts[order], np.maximum.accumulate(stops[order])
    opens = np.concatenate([[True], starts[1:] > stops[:-1]])
    closes = np.concatenate([opens[1:], [True]])
    return starts[opens], stops[closes]


def _first(values, axis):
    """Return samples with the axis of the time scale first."""
    values = as_numbers(values, name="values")
    if not -values.ndim <= axis < values.ndim:
        raise InputError(
            f"expected samples with an axis {axis}, got shape {values.shape}"
        )
    return np.moveaxis(values, axis, 0)


def _columns(array, like):
    """Append axes to `array` until it broadcasts against `like` along axis 0."""
    array = np.asarray(array)
    return array.reshape(array.shape + (1,) * (np.ndim(like) - array.ndim))


def _like(t, result):
    """Return a plain float where t was one."""
    return result if np.ndim(t) or np.ndim(result) else float(result)
