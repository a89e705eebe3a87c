"""Offset between the clocks of frames and force sensor, from taps that both have recorded.

The difference of a frame from the no-contact image depends on the force at its time, by an unknown law. The
offset is the shift of the force that explains the signal best. A lag of the signal (creep) adds to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import minimize_scalar
from scipy.special import stdtrit

from palpate.core import Float, InputError, RangeError, ndarray

Series = Float[ndarray, " _"]
"""Pair of any length; that two belong together is checked, and told."""
Columns = Float[ndarray, "_ _"]

STEP_S = 4e-3  # of the first, coarse search
MIN_FRAMES = 12  # frames on the flanks of taps, for four unknowns and an interval
FLANK = 0.2  # of the greatest slope of the signal, above which a frame counts as on a flank
SLOPE_S = 10e-3  # to either side, over which the slope is taken: the force's noise is no slope
SOFT = 0.02  # of the greatest force, added below the root: so near to zero there is nothing but noise
TOUCHED = 0.2  # of the greatest force, above which a tap is under way
QUIET = 10.0  # times its noise that the force must rise
MIN_EXPLAINED = 0.8  # of the signal's variance
RIVAL = 1.5  # times the residual that any other offset must leave
APART_S = 0.15  # from the best offset, for another one to be a rival
CONFIDENCE = 0.95
MAX_GAP_S = 0.05  # between samples, across which a value is believed


@dataclass(frozen=True, slots=True)
class Offset:
    """Offset to add to the time of a force sample to obtain the frames' clock.

    Attributes:
        seconds: Offset; positive if frames are stamped later than the force they show [s].
        low_s, high_s: Interval at 95 % [s].
        jitter_s: Upper bound of the standard deviation of a frame's stamp [s].
        taps: Number of detected taps.
        frames: Number of frames on the flanks of taps.
        explained: Fraction of the signal's variance explained by the force.
    """

    seconds: float
    low_s: float
    high_s: float
    jitter_s: float
    taps: int
    frames: int
    explained: float


def offset_between(
    force_t: Series,
    force: Series,
    frame_t: Series,
    change: Series,
    *,
    exposure_s: float = 0.0,
    most_s: float = 0.5,
) -> Offset:
    """Estimate the clock offset between force samples and frames.

    At each trial offset the signal is fitted by a + b sqrt(F + s) + c F + d F^2 of the mean force F over the
    exposure. The interval uses the sandwich estimator with HC3 correction and Student's t, since jitter
    scatters frames more on the flanks.

    Args:
        force_t: Times of force samples, increasing [s].
        force: Normal force, positive in compression [N].
        frame_t: Ends of the exposures, increasing [s].
        change: Difference of each frame from the no-contact image; any unit.
        most_s: Largest offset searched, in either direction [s].

    Reference:
        MacKinnon & White, J. Econometrics 29 (1985) 305, doi:10.1016/0304-4076(85)90158-7.

    Example:
        >>> t = np.arange(0, 6, 0.005)
        >>> tap = lambda t: np.clip(np.sin(3 * t), 0, None)
        >>> frames = np.arange(0.6, 5.4, 1 / 30)
        >>> found = offset_between(t, tap(t), frames, 7 * tap(frames - 0.02))
        >>> round(found.seconds, 4)
        0.02
    """
    _check_series(force_t, force, "force")
    _check_series(frame_t, change, "frame")
    if not (math.isfinite(exposure_s) and exposure_s >= 0 and math.isfinite(most_s) and most_s > 0):
        raise RangeError(f"exposure_s {exposure_s} and most_s {most_s}: give seconds, 0 or more and above 0")
    taps = _taps(force)
    signals = _TapSignals(force_t, force, frame_t, change, exposure_s, most_s)
    seconds, explained = _best(signals, most_s)
    return _with_interval(signals, seconds, explained, taps)


def mean_over_exposures(
    sample_t: Series,
    values: Series,
    frame_t: Series,
    *,
    exposure_s: float,
    offset_s: float,
    most_gap_s: float = MAX_GAP_S,
) -> Series:
    """Return the mean of a sampled quantity over each frame's exposure.

    Samples are interpolated linearly: with the sample period T the error is at most T^2/8 max|F''|, and an
    offset error e adds e max|F'|.

    Args:
        sample_t: Times of the samples, increasing [s].
        values: Samples, in any unit.
        frame_t: Ends of the exposures by the frames' stamps, increasing [s].
        offset_s: Delay of frame stamps after sample stamps, `Offset.seconds` [s].
        most_gap_s: Longest time between samples that is bridged [s].

    Example:
        >>> t = np.arange(0.0, 2.0, 0.008)  # 125 Hz
        >>> frames = 0.5 + np.arange(12) / 12  # of 20 ms, stamped 6 ms late: the middle lies 16 ms before
        >>> force = mean_over_exposures(t, 3 * t, frames, exposure_s=0.02, offset_s=0.006)
        >>> bool(np.allclose(force, 3 * (frames - 0.016)))
        True
    """
    _check_series(sample_t, values, "sample")
    if not (math.isfinite(exposure_s) and exposure_s >= 0 and math.isfinite(offset_s) and most_gap_s > 0):
        raise RangeError(
            f"exposure_s {exposure_s}, offset_s {offset_s}, most_gap_s {most_gap_s}: give seconds, 0 or "
            "more, any, and above 0"
        )
    ends = np.asarray(frame_t, dtype=float) - offset_s
    _check_covered(sample_t, ends - exposure_s, ends, most_gap_s)
    if exposure_s == 0:
        return np.interp(ends, sample_t, values)
    integral = make_interp_spline(sample_t, values, k=1).antiderivative()
    return np.asarray(integral(ends) - integral(ends - exposure_s)) / exposure_s


def _check_covered(sample_t: Series, begins: Series, ends: Series, most_gap_s: float) -> None:
    """Refuse exposures that no sample stands near."""
    if not np.isfinite(ends).all():
        raise InputError("the frames' times are not all finite")
    outside = np.count_nonzero((begins < sample_t[0]) | (ends > sample_t[-1]))
    wide = np.flatnonzero(np.diff(sample_t) > most_gap_s)
    gap = np.zeros(len(ends), dtype=bool)
    for k in wide.tolist():
        gap |= (ends > sample_t[k]) & (begins < sample_t[k + 1])
    if outside or gap.any():
        raise RangeError(
            f"{outside} of {len(ends)} frames lie outside the samples' time, {sample_t[0]:.3f} to "
            f"{sample_t[-1]:.3f} s, and {np.count_nonzero(gap)} in gaps of more than {most_gap_s:g} s; leave "
            "these frames out",
            code="frames-without-force",
        )


class _TapSignals:
    """Both series, and the fit of one by the other at any offset, of those frames that none of them loses."""

    def __init__(
        self,
        force_t: Series,
        force: Series,
        frame_t: Series,
        change: Series,
        exposure_s: float,
        most_s: float,
    ) -> None:
        inside = (frame_t - exposure_s - most_s >= force_t[0]) & (frame_t + most_s <= force_t[-1])
        if np.count_nonzero(inside) < MIN_FRAMES:
            raise RangeError(
                f"{np.count_nonzero(inside)} frames lie inside the force samples' time and {most_s:g} s from "
                f"its ends; {MIN_FRAMES} are needed: record both from before the first tap until after "
                "the last"
            )
        self.frame_t, self.change = frame_t[inside], change[inside]
        self._force_t, self._exposure_s = force_t, exposure_s
        self._force = force / force.max()
        self._integral = make_interp_spline(force_t, self._force, k=1).antiderivative()

    def force_at(self, offset_s: float) -> Series:
        """The mean over each exposure, of the greatest force."""
        ends = self.frame_t - offset_s
        if self._exposure_s == 0:
            return np.interp(ends, self._force_t, self._force)
        return np.asarray(self._integral(ends) - self._integral(ends - self._exposure_s)) / self._exposure_s

    def fit(self, offset_s: float) -> tuple[Series, Columns, Series]:
        """Residuals, columns and coefficients of the best law at an offset."""
        columns = _columns(self.force_at(offset_s))
        law, *_ = np.linalg.lstsq(columns, self.change, rcond=None)
        return np.asarray(self.change - columns @ law), columns, law

    def squares(self, offset_s: float) -> float:
        """Residual sum of squares of the best law at an offset."""
        residual, *_ = self.fit(offset_s)
        return float(residual @ residual)


def _taps(force: Series) -> int:
    """Count of times that the force rises well above its noise and falls again."""
    greatest, rest = float(force.max()), float(np.median(np.sort(force)[: max(len(force) // 5, 1)]))
    # Of neighbours' differences, so that the taps themselves do not count as noise.
    noise = float(np.median(np.abs(np.diff(force, n=2)))) / (0.6745 * math.sqrt(6))
    if greatest <= 0 or greatest - rest <= QUIET * noise:
        raise RangeError(
            f"no tap stands out: the force is {greatest:.3g} N at most, with a noise of {noise:.2g} N; "
            "tap harder",
            code="no-tap",
        )
    touched = force > rest + TOUCHED * (greatest - rest)
    # A tap has to fall back, half as far down again, before the next begins.
    free = force < rest + TOUCHED / 2 * (greatest - rest)
    taps, under_way = 0, False
    for on, off in zip(touched.tolist(), free.tolist(), strict=True):
        taps += on and not under_way
        under_way = on or (under_way and not off)
    return taps


def _best(signals: _TapSignals, most_s: float) -> tuple[float, float]:
    """The offset that leaves the least, and which share of the variance it explains."""
    offsets = np.linspace(-most_s, most_s, 2 * math.ceil(most_s / STEP_S) + 1)
    left = np.array([signals.squares(float(offset)) for offset in offsets])
    best = int(np.argmin(left))
    whole = float(np.sum((signals.change - signals.change.mean()) ** 2))
    explained = 1 - left[best] / whole if whole > 0 else 0.0
    if not explained >= MIN_EXPLAINED:
        raise RangeError(
            f"at no offset up to {most_s:g} s does the signal follow the force: {explained:.0%} of its "
            f"variance at best, {MIN_EXPLAINED:.0%} are needed; do the frames see the taps?",
            code="taps-not-seen",
        )
    if best in (0, len(offsets) - 1):
        raise RangeError(f"the offset is {most_s:g} s or more; look further, by most_s")
    others = left[np.abs(offsets - offsets[best]) > APART_S]
    if others.size and others.min() < RIVAL * left[best]:
        raise RangeError(
            "several offsets explain the frames alike; tap a few times, not evenly, and rest between"
        )
    near = (float(offsets[best - 1]), float(offsets[best + 1]))
    fine = minimize_scalar(signals.squares, bounds=near, method="bounded", options={"xatol": 1e-7})
    return float(fine.x), float(explained)


def _with_interval(signals: _TapSignals, seconds: float, explained: float, taps: int) -> Offset:
    residual, columns, law = signals.fit(seconds)
    # Of the signal, for a change of the offset.
    later, earlier = (_columns(signals.force_at(seconds + h)) @ law for h in (SLOPE_S, -SLOPE_S))
    slope = (later - earlier) / (2 * SLOPE_S)
    J = np.column_stack([slope, columns])
    bread = np.linalg.pinv(J.T @ J)
    leverage = np.clip(np.einsum("ij,jk,ik->i", J, bread, J), 0.0, 0.99)
    meat = (J * (residual / (1 - leverage))[:, None] ** 2).T @ J
    error_s = math.sqrt(max(float((bread @ meat @ bread)[0, 0]), 0.0))
    flank = np.abs(slope) > FLANK * np.abs(slope).max()
    frames = int(np.count_nonzero(flank))
    if frames < MIN_FRAMES:
        raise RangeError(
            f"{frames} frames were taken while the force rose or fell; {MIN_FRAMES} are needed: tap more "
            "often, or more slowly"
        )
    # Weighted by the slope, since a frame on a flat part tells nothing of its time.
    jitter_s = math.sqrt(float(np.sum(residual[flank] ** 2) / np.sum(slope[flank] ** 2)))
    reach = float(stdtrit(frames - J.shape[1], (1 + CONFIDENCE) / 2)) * error_s
    return Offset(seconds, seconds - reach, seconds + reach, jitter_s, taps, frames, explained)


def _columns(force: Series) -> Columns:
    F = np.clip(force, 0.0, None)
    return np.column_stack([np.ones_like(F), np.sqrt(F + SOFT), F, F**2])


def _check_series(times: Series, values: Series, what: str) -> None:
    if len(times) != len(values) or len(times) < MIN_FRAMES:
        raise InputError(
            f"{len(times)} {what} times and {len(values)} values; give as many of each, and at least "
            f"{MIN_FRAMES}",
            code="lengths-differ",
        )
    if not (np.isfinite(times).all() and np.isfinite(values).all()):
        raise InputError(f"{what} times or values are not finite; leave out what was not measured")
    if not (np.diff(times) > 0).all():
        raise InputError(
            f"{what} times do not increase; sort them, and leave out what comes twice", code="time-order"
        )
