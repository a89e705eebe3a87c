"""Range of stiffness of a skin, from a run whose force was right, for the rig's file.

Force is taken over depth on the way down alone, in factors of two of the force, one stiffness for each press.
The range is that of all presses, widened by a margin for other places and speeds. From then on the guard
checks the first press of every run against it, so that a gain of the force sensor that has changed is found
before the press has gone deeper than planned.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from palpate.core import Float, InputError, ndarray
from palpate.devices.force_trust import StiffnessRange
from palpate.recordings import Run
from palpate.recordings.run_reader import VOID
from palpate.rig.run_progress import fields_of

MARGIN = 1.2  # by which the range is wider than the presses
MAX_RATIO = 2.5  # of greatest to least, above which a gain of two lies inside the range
NOISES = 20.0  # of the force, below which no stiffness is taken
FELT = 0.4  # of a factor of two in force that a press has to rise by
LEVEL_M = 1e-6
PAUSE_S = 0.1  # between two positions: longer, and the stage stood in between

Series = Float[ndarray, " n"]


@dataclass(frozen=True, slots=True)
class SkinStiffness:
    """Range of stiffness that presses met.

    Attributes:
        range: over the normal force.
        presses: that it was taken from, the gentle touches among them.
        ratio: of greatest to least at its widest. A gain that changes less than this is not found.
    """

    range: StiffnessRange
    presses: int
    ratio: float


def stiffness_of(run: Run, margin: float = MARGIN) -> SkinStiffness:
    """Return the range of stiffness that a run's presses met, all with one indenter.

    Args:
        run: recorded by a plan, without rejected presses.
        margin: factor by which the range is wider than what was met.

    Raises:
        InputError: rejected presses, several indenters, or no press that is deep enough.
    """
    if fields_of(run, VOID):
        raise InputError("the run has rejected presses; record one without them to find a stiffness")
    indenters = set(run.labels["indenter"].dropna()) if "indenter" in run.labels else set()
    if len(indenters) > 1:
        raise InputError(f"the run has {len(indenters)} indenters; a stiffness is of one. Record one each")
    force, stage, events = run.force(), run.stage(), run.events()
    begun_s = events["time_s"][events["kind"] == "tare"].to_numpy()
    at_s, xyz = stage["time_s"].to_numpy(), stage[["x_m", "y_m", "z_m"]].to_numpy()
    force_n = np.interp(at_s, force["time_s"].to_numpy(), force["fz_N"].to_numpy())
    presses = list(_presses(np.searchsorted(begun_s, at_s), at_s, xyz, force_n))
    by_bin: dict[int, list[float]] = defaultdict(list)
    noise_n = max((float(one["noise_n"]) for one in fields_of(run, "tare")), default=0.0)  # type: ignore[arg-type]
    for press in presses:
        for bin_, stiffness in press.items():
            if 2.0 ** (bin_ - 1) > NOISES * noise_n:
                by_bin[bin_].append(stiffness)
    if not by_bin:
        raise InputError("no press of the run rises over a factor of two in force; press deeper")
    bins = sorted(by_bin)
    forces = tuple(0.75 * 2.0**one for one in bins)
    least = tuple(min(by_bin[one]) / margin for one in bins)
    greatest = tuple(max(by_bin[one]) * margin for one in bins)
    ratio = float(max(high / low for low, high in zip(least, greatest, strict=True)))
    return SkinStiffness(StiffnessRange(forces, least, greatest), len(presses), ratio)


def _presses(
    numbers: ndarray, at_s: Series, xyz: Float[ndarray, "n 3"], force_n: Series
) -> Iterable[dict[int, float]]:
    """Yield the stiffness of each press by the binary exponent of the force [N/m]."""
    down = np.diff(xyz[:, 2]) > LEVEL_M
    straight = (np.abs(np.diff(xyz[:, :2], axis=0)) < LEVEL_M).all(axis=1)
    moves = down & straight & (np.diff(at_s) < PAUSE_S) & (np.diff(numbers) == 0)
    middle_n, rise_n, way_m = (force_n[1:] + force_n[:-1]) / 2, np.diff(force_n), np.diff(xyz[:, 2])
    for number in np.unique(numbers):
        sums: dict[int, list[float]] = defaultdict(lambda: [0.0, 0.0])
        for i in np.flatnonzero(moves & (numbers[1:] == number) & (middle_n > 0)):
            one = sums[math.frexp(middle_n[i])[1]]
            one[0] += float(rise_n[i])
            one[1] += float(way_m[i])
        found = {
            bin_: rise / way
            for bin_, (rise, way) in sums.items()
            if way > 0 and rise >= FELT * 2.0 ** (bin_ - 1)
        }
        if found:
            yield found


def stiffness_lines(indenter: str, found: SkinStiffness, day: str) -> str:
    """Return the table for the rig's file.

    Args:
        indenter: name of the indenter, as plans give it.
        found: range.
        day: date of the measurement, ISO 8601.
    """
    one = found.range
    per_mm = ((value * 1e-3 for value in values) for values in (one.least_n_m, one.greatest_n_m))
    rows = (", ".join(f"{value:.4g}" for value in values) for values in (one.force_n, *per_mm))
    names = ("force_N", "least_N_mm", "greatest_N_mm")
    lines = [f"{name} = [{row}]" for name, row in zip(names, rows, strict=True)]
    return "\n".join(["[[stiffness]]", f'indenter = "{indenter}"', *lines, f"measured_on = {day}"])
