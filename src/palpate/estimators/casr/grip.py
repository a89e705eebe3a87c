"""A grasp's loading part: how stiff it is, and what was seen at a force.

Grippers are often asked for their width more slowly than the camera runs: the table then repeats a width for
several frames and jumps. A repeated width is no measurement; `fresh` tells those that are.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from palpate.core.errors import InputError, RangeError
from palpate.core.shapes import Float, Int
from palpate.estimators.casr.force import Loading

LEAST_SAMPLES = 3

Samples = Float[ndarray, " _"]


def fresh(held: Samples) -> Int[ndarray, " k"]:
    """Samples at which a held reading is new: the first, and every one that differs from that before it."""
    return np.flatnonzero(np.concatenate([[True], np.diff(held) != 0]))


def loading_slope(force_n: Samples, width_m: Samples, part: Loading, *, held: bool = False) -> float:
    """Force over closing, by a straight line through the loading part [N/m].

    Args:
        force_n: positive in compression [N].
        width_m: between the fingers, falling as they close [m].
        part: of the loading.
        held: the width repeats; only new readings count, and the last sample, where the gripper rests.

    Raises:
        InputError: shapes that do not fit, too few samples, or force that does not rise as fingers close.
    """
    force, width = np.asarray(force_n, np.float64), np.asarray(width_m, np.float64)
    if force.shape != width.shape or force.ndim != 1 or not part.last < force.size:
        raise InputError(
            f"{force.size} forces, {width.size} widths, loading to sample {part.last}; one of each"
        )
    i = np.arange(part.first, part.last + 1)
    if held:
        i = np.union1d(np.intersect1d(i, fresh(width)), [part.last])
    if len(i) < LEAST_SAMPLES or np.ptp(width[i]) == 0:
        raise InputError(f"{len(i)} readings of the width while loading, or all one; close more slowly")
    slope = -float(np.polyfit(width[i], force[i], 1)[0])
    if not slope > 0:
        raise InputError(
            "force does not rise as the fingers close; is the width an opening, and the force signed?"
        )
    return slope


def at_force(force_n: Samples, values: Samples, part: Loading, level_n: float) -> float:
    """The value at which force first reaches a level while loading, between samples by a straight line.

    Args:
        force_n: of every sample [N].
        values: of every sample.
        part: of the loading; the sample before it may be the lower one.
        level_n: force [N].

    Raises:
        InputError: as many values as forces are needed.
        RangeError: the loading part begins above the level or never reaches it.
    """
    if np.shape(force_n) != np.shape(values):
        raise InputError(f"{np.size(force_n)} forces and {np.size(values)} values; one of each")
    first = max(part.first - 1, 0)
    force = np.asarray(force_n, np.float64)[first : part.last + 1]
    if not force[0] <= level_n <= force.max():
        raise RangeError(
            f"{level_n:g} N is asked for, and loading goes from {force[0]:.3g} to {force.max():.3g} N"
        )
    after = int(np.argmax(force >= level_n))
    if after == 0:
        return float(values[first])
    low, high = force[after - 1], force[after]
    k = (level_n - low) / (high - low)
    return float((1 - k) * values[first + after - 1] + k * values[first + after])
