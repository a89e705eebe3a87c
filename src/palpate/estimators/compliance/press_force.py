"""Force of a press or a grasp: smoothed, cut to its loading part, and its slope.

The moving average is centered and adds no delay. Grippers often repeat their last width; `fresh` selects the
samples with a new measurement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from palpate.core import Bool, Float, InputError, Int, RangeError, ndarray

TAPS = 5
CONTACT_N, MAX_N = 0.5, 5.0
SPIKE_WINDOW = 7  # samples
SPIKE_SPREADS = 6.0  # robust standard deviations from the median of its window
MIN_SPIKE_N = 0.25  # four steps of a 1/16 N sensor: less is no spike
STAYS = 3  # samples that must follow above the threshold, so that a spike is no contact
PLATEAU = 8  # equal greatest samples in a row: the sensor's range has ended

Samples = Float[ndarray, " s"]


def moving_average(force_n: Samples) -> Samples:
    """Return the centered mean of five samples, fewer at the ends [N]."""
    sums = np.concatenate([[0.0], np.cumsum(force_n)])
    i = np.arange(len(force_n))
    first = np.maximum(i - TAPS // 2, 0)
    last = np.minimum(i + TAPS // 2, len(force_n) - 1)
    return np.asarray((sums[last + 1] - sums[first]) / (last + 1 - first))


def spikes(force_n: Samples) -> Bool[ndarray, " s"]:
    """Return samples far from the median of their neighbors (Hampel's rule)."""
    middle = median_filter(force_n, SPIKE_WINDOW, mode="nearest")
    off = np.abs(force_n - middle)
    spread = 1.4826 * median_filter(off, SPIKE_WINDOW, mode="nearest")
    return off > np.maximum(SPIKE_SPREADS * spread, MIN_SPIKE_N)


def without_spikes(force_n: Samples) -> Samples:
    """Return the force with straight lines in place of spikes."""
    good = ~spikes(force_n)
    if not good.any():
        raise InputError("the force is nothing but spikes; look at the sensor's cable and its bias")
    i = np.arange(len(force_n))
    return np.interp(i, i[good], force_n[good])


def smoothed(force_n: Samples) -> Samples:
    """Return the force without spikes, averaged over five samples [N]."""
    return moving_average(without_spikes(np.asarray(force_n, np.float64)))


@dataclass(frozen=True)
class Loading:
    """Samples from contact onset to the greatest force; `saturated` if that is a plateau."""

    first: int
    last: int
    saturated: bool


def loading(force_n: Samples, contact_n: float = CONTACT_N) -> Loading:
    """Return the loading part of a smoothed force."""
    force = np.asarray(force_n, np.float64)
    if force.ndim != 1 or len(force) <= STAYS:
        raise InputError(f"{force.size} samples; a press has more than {STAYS}", code="too-few-values")
    if not np.isfinite(force).all():
        raise InputError(
            f"sample {int(np.argmin(np.isfinite(force)))} of the force is not finite", code="not-finite"
        )
    above = force >= contact_n
    stays = np.flatnonzero(np.lib.stride_tricks.sliding_window_view(above, STAYS).all(axis=1))
    if not len(stays):
        raise InputError(
            f"the force never stays above {contact_n:g} N, its maximum is {force.max():g} N",
            code="no-contact",
        )
    first, last = int(stays[0]), int(np.argmax(force))
    if last - first < STAYS:
        raise InputError(
            f"the force rises to {force[last]:g} N within {last - first} samples; its loading part is "
            "missing",
            code="not-loading",
        )
    top = np.isclose(force, force[last], rtol=0, atol=1e-12)
    run = int(np.sum(np.cumprod(top[last:])))
    return Loading(first, last, run >= PLATEAU)


def within(force_n: Samples, part: Loading, low_n: float, high_n: float) -> Int[ndarray, " k"]:
    """Return samples of the loading part with a force between two limits [N]."""
    i = np.arange(part.first, part.last + 1)
    return i[(force_n[i] >= low_n) & (force_n[i] <= high_n)]


def rising(
    force_n: Samples, values: Float[ndarray, k * n], width_n: float
) -> tuple[Samples, Float[ndarray, b * n]]:
    """Return means over bins of force, in ascending force.

    Args:
        force_n: Force of each value [N].
        values: Values, such as areas.
        width_n: Bin width [N].

    Returns:
        Mean force and mean value of every bin that is not empty.
    """
    if not width_n > 0:
        raise RangeError(f"bins of {width_n} N; above 0, 0.1 N if in doubt")
    bins = np.floor(force_n / width_n).astype(np.int64)
    kinds, where = np.unique(bins, return_inverse=True)
    count = np.bincount(where, minlength=len(kinds))
    flat = np.reshape(values, (len(force_n), -1))
    means = np.stack([np.bincount(where, column, len(kinds)) for column in flat.T], axis=1) / count[:, None]
    return np.bincount(where, force_n, len(kinds)) / count, means.reshape(len(kinds), *values.shape[1:])


MIN_SAMPLES = 3

GraspSamples = Float[ndarray, " _"]


def fresh(held: GraspSamples) -> Int[ndarray, " k"]:
    """Return samples at which a repeated measurement changes, including the first."""
    return np.flatnonzero(np.concatenate([[True], np.diff(held) != 0]))


def loading_slope(
    force_n: GraspSamples, width_m: GraspSamples, part: Loading, *, held: bool = False
) -> float:
    """Return force over closing by a straight line through the loading part [N/m].

    Args:
        force_n: Force, positive in compression [N].
        width_m: Distance between the fingers [m].
        part: Loading part.
        held: Widths repeat; only new ones and the last sample count.
    """
    force, width = np.asarray(force_n, np.float64), np.asarray(width_m, np.float64)
    if force.shape != width.shape or force.ndim != 1 or not part.last < force.size:
        raise InputError(
            f"{force.size} forces, {width.size} widths, loading to sample {part.last}", code="lengths-differ"
        )
    i = np.arange(part.first, part.last + 1)
    if held:
        i = np.union1d(np.intersect1d(i, fresh(width)), [part.last])
    if len(i) < MIN_SAMPLES or np.ptp(width[i]) == 0:
        raise InputError(f"{len(i)} widths while loading; close more slowly", code="too-few-values")
    slope = -float(np.polyfit(width[i], force[i], 1)[0])
    if not slope > 0:
        raise InputError(
            "force does not rise as the fingers close; check width and sign", code="force-constant"
        )
    return slope
