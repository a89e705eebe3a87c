"""Analyses of presses on a patterned skin: lines of force over gamma, loops, drift, distances, edges.

Frames of a press stand in order of time. Its loading branch ends at its greatest force.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from palpate.calibration.shear import LabelledCues
from palpate.calibration.shear.force_law import held_out
from palpate.core import Bool, Float, InputError, ndarray
from palpate.psychophysics import fit_line

Series = Float[ndarray, " n"]
Places = Float[ndarray, " k"]
Mask = Bool[ndarray, " n"]

LOOP_STEPS = 200
BRANCH_FRAMES = 3  # of a branch, to have a course


class GammaLine(NamedTuple):
    """Line F = slope gamma + offset, and how well it holds.

    Attributes:
        slope: [N].
        offset: [N].
        r2: share of the force's variance that it takes, of the frames it was fitted to.
        rms: of what is left [N].
        mae: mean absolute error on presses that were held out [N]; None with one press.
    """

    slope: float
    offset: float
    r2: float
    rms: float
    mae: float | None
    frames: int
    presses: int


class HysteresisLoop(NamedTuple):
    """Hysteresis of one press.

    Attributes:
        area: between loading and unloading, integral of F over gamma [N].
        share: of the area below the loading branch.
        width: of force at half of the greatest gamma [N].
        off_line: root mean square of all of the loop from 1 N on about its own line [N].
    """

    area: float
    share: float
    width: float
    gamma: float
    off_line: float


class TouchDrift(NamedTuple):
    """Change of a value from touch to touch.

    Attributes:
        change: of their line from the first to the last.
    """

    mean: float
    spread: float
    change: float
    error: float


def loading_frames(samples: LabelledCues) -> Mask:
    """Frames up to the greatest force of their press."""
    keep = np.zeros(len(samples.force_n), bool)
    for press in dict.fromkeys(samples.press.tolist()):
        rows = np.flatnonzero(samples.press == press)
        keep[rows[: int(samples.force_n[rows].argmax()) + 1]] = True
    return keep


def gammas(samples: LabelledCues) -> Series:
    """Published measure of every frame."""
    return np.array([cue.gamma for cue in samples.cues])


def r_squared(truth: Series, estimate: Series) -> float:
    """1 - sum (truth - estimate)^2 / sum (truth - mean)^2; below 0 where the mean does better."""
    return float(1 - ((truth - estimate) ** 2).sum() / ((truth - truth.mean()) ** 2).sum())


def force_line(gamma: Series, force_n: Series, press: ndarray) -> GammaLine:
    """Line by least squares, and its error on presses left out one after the other in folds."""
    line = fit_line(gamma, force_n)
    off = force_n - line.start - line.slope * gamma
    presses = len(np.unique(press))
    mae = None
    if presses > 1:
        estimate = held_out_line(gamma, force_n, press)
        mae = float(np.abs(estimate - force_n).mean())
    rms = math.sqrt(float((off**2).mean()))
    r2 = r_squared(force_n, force_n - off)
    return GammaLine(line.slope, line.start, r2, rms, mae, len(gamma), presses)


def held_out_line(gamma: Series, force_n: Series, press: ndarray) -> Series:
    """Force of every frame by a line through the frames of other presses [N]."""

    def fitted(kept: Mask) -> Series:
        line = fit_line(gamma[kept], force_n[kept])
        return np.asarray(line.start + line.slope * gamma)

    return held_out(fitted, press)


def hysteresis_loop(force_n: Series, gamma: Series) -> HysteresisLoop:
    """HysteresisLoop of one press, branches compared at the same gamma.

    Args:
        force_n, gamma: of its frames in order of time, from before contact until after it.
    """
    top = int(force_n.argmax())
    up, down = slice(0, top + 1), slice(top, len(force_n))
    if min(top + 1, len(force_n) - top) < BRANCH_FRAMES:
        raise InputError(f"a loop needs {BRANCH_FRAMES} frames or more each way", code="too-few-frames")
    low = max(gamma[up].min(), gamma[down].min())
    high = min(gamma[up].max(), gamma[down].max())
    at = np.linspace(low, high, LOOP_STEPS)
    loaded, unloaded = (_by_gamma(gamma[part], force_n[part], at) for part in (up, down))
    width = loaded - unloaded
    area, below = float(np.trapezoid(width, at)), float(np.trapezoid(loaded, at))
    some = force_n >= 1
    line = fit_line(gamma[some], force_n[some])
    off = force_n[some] - line.start - line.slope * gamma[some]
    half = float(np.interp((low + high) / 2, at, width))
    return HysteresisLoop(area, area / below, half, float(gamma.max()), math.sqrt(float((off**2).mean())))


def _by_gamma(gamma: Series, force_n: Series, at: Places) -> Places:
    order = np.argsort(gamma, kind="stable")
    return np.interp(at, gamma[order], force_n[order])


def gamma_at(force_n: Series, gamma: Series, at_n: Sequence[float]) -> Places:
    """Gamma of one loading branch at forces; NaN where it does not reach them."""
    order = np.argsort(force_n, kind="stable")
    return np.interp(at_n, force_n[order], gamma[order], left=np.nan, right=np.nan)


def drift_of(values: Series) -> TouchDrift:
    """TouchDrift of values, one a touch, in order."""
    if len(values) < BRANCH_FRAMES:
        raise InputError(
            f"a drift needs {BRANCH_FRAMES} touches or more; got {len(values)}", code="too-few-frames"
        )
    line = fit_line(np.arange(len(values), dtype=float), values)
    steps = len(values) - 1
    error = line.residual / math.sqrt(line.sxx) if line.sxx else math.nan
    return TouchDrift(float(values.mean()), float(values.std(ddof=1)), line.slope * steps, error * steps)


def rms(values: Series) -> float:
    """Root mean square."""
    return math.sqrt(float((values**2).mean()))


def rms_by(names: Sequence[str], distances: Series) -> dict[str, float]:
    """Root mean square of the distances of each name, in order of first use."""
    return {one: rms(distances[np.array(names) == one]) for one in dict.fromkeys(names)}


def turned_deg(one_deg: float, other_deg: float) -> float:
    """Shortest turn from the other direction to the one, -90 to 90 degrees: a line has no front."""
    return (one_deg - other_deg + 90) % 180 - 90


def shuffled_r2(gamma: Series, force_n: Series, press: ndarray, seed: int) -> float:
    """Held-out R^2 of the line where forces were dealt out anew: a control that must fail."""
    forces = np.random.default_rng(seed).permutation(force_n)
    return r_squared(forces, held_out_line(gamma, forces, press))


def branch_table(
    samples: LabelledCues, at_n: Sequence[float], keep: Mask | None = None
) -> Mapping[str, Places]:
    """Gamma of every press at forces on its loading branch."""
    loading = loading_frames(samples) if keep is None else loading_frames(samples) & keep
    gamma, found = gammas(samples), {}
    for press in dict.fromkeys(samples.press.tolist()):
        rows = loading & (samples.press == press)
        if rows.sum() >= BRANCH_FRAMES:
            found[str(press)] = gamma_at(samples.force_n[rows], gamma[rows], at_n)
    return found
