"""Lag of the force behind the motion, from one touch: the delay at which force is a function of depth.

A force sensor may state current timestamps for samples that it, a filter, or a link held back. Loading and
unloading then disagree: at the speed v a lag tau shifts the force deeper by v tau on the way down and
shallower by v tau on the way up. For each lag of a grid the force is fitted as a piecewise linear function of
the depth at t - tau; the residual is least at the true lag. A viscoelastic skin and friction dissipate, which
is the opposite hysteresis: they hide a few milliseconds of a lag and never imitate one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from palpate.core import NS_PER_S, Clock, Float, Position, Wrench, ndarray
from palpate.devices import Guard

LAGS_S = np.arange(-0.05, 0.3001, 0.005)
KNOTS_M = np.array([0.8, 0.6, 0.45, 0.3, 0.2, 0.1]) * 1e-3  # above the deepest position
SIGMAS = 5.0  # half width of the interval, in standard deviations: noise alone must not show a lag
GAP_S = 0.1  # longest interval between two positions in which a motion is interpolated
MOVED_M = 1e-6
MAX_SAMPLES = 1000  # more are averaged in blocks

Series = Float[ndarray, " n"]
Positions = Float[ndarray, " p"]


@dataclass(frozen=True, slots=True)
class ForceLag:
    """Lag of the force behind the reported position.

    Attributes:
        lag_s: the most likely [s].
        least_s, greatest_s: interval of five standard deviations; wider by the longest interval without a
            position in which the stage moved, if it exceeds `GAP_S` [s].
    """

    lag_s: float
    least_s: float
    greatest_s: float


def lag_of(force_s: Series, force_n: Series, position_s: Positions, depth_m: Positions) -> ForceLag | None:
    """Estimate the lag of a force behind a motion that goes into a skin, stands, and goes back.

    Args:
        force_s, force_n: samples of the normal force, in temporal order [s, N].
        position_s, depth_m: positions of the stage along the skin's normal, in temporal order [s, m].

    Returns:
        The lag, between -50 and 300 ms; None with fewer samples than the fit needs.

    Example:
        >>> t = np.arange(0.0, 1.4, 0.005)
        >>> depth = 1e-3 * np.interp(t, [0.0, 0.5, 0.7, 1.2], [-0.5, 0.5, 0.5, -0.5])
        >>> force = 1e3 * np.maximum(np.interp(t - 0.1, t, depth), 0.0)
        >>> round(lag_of(t, force, t, depth).lag_s, 3)
        0.1
    """
    if len(position_s) < 2:
        return None
    use = force_s >= position_s[0]  # before, the stage stood there
    blocks = max(1, -(-int(use.sum()) // MAX_SAMPLES))
    t, F = (_block_means(one[use], blocks) for one in (force_s, force_n))
    knots = depth_m.max() - KNOTS_M
    columns = 1 + len(knots)
    if len(t) <= 2 * columns:
        return None
    residual = np.array([_residual(np.interp(t - lag, position_s, depth_m), F, knots) for lag in LAGS_S])
    variance = residual.min() / (len(t) - columns)
    likely = LAGS_S[residual <= residual.min() + SIGMAS**2 * variance]
    gaps_s = np.diff(position_s)[np.abs(np.diff(depth_m)) > MOVED_M]
    gap_s = max((one for one in gaps_s.tolist() if one > GAP_S), default=0.0)
    return ForceLag(float(LAGS_S[residual.argmin()]), float(likely[0]) - gap_s, float(likely[-1]) + gap_s)


def _residual(depth_m: Series, force_n: Series, knots_m: Float[ndarray, " k"]) -> float:
    """Sum of squares that a piecewise linear function of depth leaves [N^2]."""
    A = np.column_stack([np.ones_like(depth_m), *(np.maximum(depth_m - one, 0.0) * 1e3 for one in knots_m)])
    coefficients = np.linalg.lstsq(A, force_n, rcond=None)[0]
    left = force_n - A @ coefficients
    return float(left @ left)


def _block_means(values: Series, size: int) -> Float[ndarray, " m"]:
    whole = len(values) // size * size
    return values[:whole].reshape(-1, size).mean(axis=1)


class TouchRecord:
    """Normal force and position in one touch.

    Args:
        guard: that moves; its samples and positions are recorded.
        clock: that both are stamped on.
    """

    def __init__(self, guard: Guard, clock: Clock) -> None:
        self._guard, self._clock = guard, clock
        self._force: list[tuple[float, float]] = []
        self._positions: list[tuple[float, float]] = []

    @contextmanager
    def recorded(self) -> Iterator[None]:
        """Record what passes within a ``with`` block."""
        with self._guard.samples.subscribed(self._feel), self._guard.positions.subscribed(self._at):
            yield

    def stand(self) -> None:
        """Record where the stage stands now."""
        self._at(self._guard.position_m(), self._clock.now_ns())

    def lag(self) -> ForceLag | None:
        """Estimate the lag of what was recorded; None where too little was."""
        if not self._force or not self._positions:
            return None
        (force_s, force_n), (position_s, depth_m) = (
            np.array(one).T for one in (self._force, self._positions)
        )
        return lag_of(force_s, force_n, position_s, depth_m)

    def _feel(self, samples: Sequence[Wrench]) -> None:
        self._force += [
            (one.time_ns / NS_PER_S, self._guard.skin_n(one)[2]) for one in samples if not one.fault
        ]

    def _at(self, at: Position, time_ns: int) -> None:
        self._positions.append((time_ns / NS_PER_S, at[2]))
