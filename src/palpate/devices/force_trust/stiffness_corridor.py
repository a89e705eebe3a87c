"""Corridor of stiffness: how steeply force may rise with depth, learnt from the presses of this run.

What is learnt is stiffness at a force, not at a depth: where the surface lies, how far the threshold is below
first touch and what dent an earlier press has left shift a depth, and leave this as it is. Each factor of two
of the force has a stiffness of its own, the median over presses with one tool. Below and above all that was
felt it goes on as a ball's on a half-space would at most and a spring's at least (Hertz: dF/dz over F^(1/3)).
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import defaultdict, deque
from dataclasses import dataclass
from itertools import pairwise
from statistics import median_high, median_low

from palpate.core import RangeError

WIDE_LOW = 2.5  # by which stiffness may lie below the median of earlier presses
WIDE_HIGH = 4.0  # and above
KEPT = 32  # presses that are remembered
FELT = 0.4  # of a factor of two in force that a press has to go through, to tell a stiffness
FELT_NOISES = 4.0  # and rise of force
FELT_WAY_M = 20e-6  # and way of the stage, whose own slack is as long
GROWTH = 1.0  # greatest exponent of stiffness over force, beyond what was felt: force exponential in depth
SHRINK = 0.5  # and of its fall below what was felt: stiffness over F^(1/2), as under a cone
UNKNOWN_N_M = 1e6  # nothing is known: stiffer than any skin


@dataclass(frozen=True, slots=True)
class StiffnessRange:
    """Stated range of stiffness over force, for one indenter on one skin: a check from the first press on.

    Between the stated forces it is linear. Below the least of them nothing is stated; above the greatest the
    least stiffness stays, and there is no greatest.

    Attributes:
        force_n: normal forces, increasing [N].
        least_n_m, greatest_n_m: least and greatest rise of force per depth at each of them [N/m].

    Raises:
        RangeError: lengths that differ, forces that do not increase, or a range that is empty.
    """

    force_n: tuple[float, ...]
    least_n_m: tuple[float, ...]
    greatest_n_m: tuple[float, ...]

    def __post_init__(self) -> None:
        counts = {len(self.force_n), len(self.least_n_m), len(self.greatest_n_m)}
        if len(counts) != 1 or not self.force_n:
            raise RangeError(f"a stiffness range with {sorted(counts)} numbers; give each force one of both")
        values = (*self.force_n, *self.least_n_m, *self.greatest_n_m)
        increase = all(a < b for a, b in pairwise((0.0, *self.force_n)))
        ranges = all(0 < a < b for a, b in zip(self.least_n_m, self.greatest_n_m, strict=True))
        if not (all(map(math.isfinite, values)) and increase and ranges):
            raise RangeError(
                "a stiffness range whose forces do not increase from above 0, or whose least is not below "
                "its greatest; give positive finite numbers"
            )

    def at(self, force_n: float) -> tuple[float, float]:
        """Return the least and the greatest stiffness at a force [N/m]."""
        force, least, greatest = self.force_n, self.least_n_m, self.greatest_n_m
        if force_n < force[0]:
            return 0.0, UNKNOWN_N_M
        if force_n > force[-1]:
            return least[-1], UNKNOWN_N_M
        i = max(bisect_left(force, force_n), 1)
        if i == len(force):
            return least[0], greatest[0]
        share = (force_n - force[i - 1]) / (force[i] - force[i - 1])
        low, high = (one[i - 1] + share * (one[i] - one[i - 1]) for one in (least, greatest))
        return low, high


class StiffnessCorridor:
    """Least and greatest stiffness at a force, for one tool on one skin.

    Args:
        stated: range that the rig states for them; None where it states none.
    """

    def __init__(self, stated: StiffnessRange | None = None) -> None:
        self._stated = stated
        self._felt: dict[int, deque[float]] = defaultdict(lambda: deque(maxlen=KEPT))
        self._median: dict[int, float] = {}  # the lower of the two in the middle, of an even number
        self._median_high: dict[int, float] = {}
        self._rise: dict[int, list[float]] = {}

    def feel(self, force_n: float, rise_n: float, way_m: float) -> None:
        """Take in one step of a press on its way down: a rise of force over a way, at a force [N, N, m]."""
        if force_n > 0:
            sums = self._rise.setdefault(math.frexp(force_n)[1], [0.0, 0.0])
            sums[0] += rise_n
            sums[1] += way_m

    def forget(self) -> None:
        """Forget the press that is going on: it is not to be learnt from."""
        self._rise.clear()

    def learn(self, noise_n: float) -> None:
        """Take what was felt in a press that went well among what is known; under such a noise [N]."""
        for bin_, (rise_n, way_m) in self._rise.items():
            if way_m >= FELT_WAY_M and rise_n >= max(FELT * 2.0 ** (bin_ - 1), FELT_NOISES * noise_n):
                self._felt[bin_].append(rise_n / way_m)
                self._median[bin_] = median_low(self._felt[bin_])
                self._median_high[bin_] = median_high(self._felt[bin_])
        self._rise.clear()

    def least_n_m(self, force_n: float) -> float:
        """Stiffness that a force rises by at least on the way down; 0 where nothing is known [N/m]."""
        if not self._median or force_n <= 0:
            return 0.0
        bin_ = self._nearest(math.frexp(force_n)[1])
        below = min(force_n / 2.0 ** (bin_ - 1), 1.0)
        return self._median[bin_] / WIDE_LOW * below**SHRINK

    def least_between_n_m(self, from_n: float, to_n: float) -> float:
        """Stiffness that a force rises by at least, wherever it is between two forces [N/m]."""
        low, high = sorted((from_n, to_n))
        exponents = range(math.frexp(low)[1], math.frexp(high)[1])
        return min(self.least_n_m(one) for one in (low, high, *(2.0**k for k in exponents)) if one > 0)

    def greatest_n_m(self, force_n: float) -> float:
        """Stiffness that it rises by at most [N/m]."""
        if not self._median:
            return UNKNOWN_N_M
        bin_ = self._nearest(math.frexp(max(force_n, 1e-9))[1])
        above = max(force_n / 2.0 ** (bin_ - 1), 1.0)
        return self._median_high[bin_] * WIDE_HIGH * above**GROWTH

    def stated_n_m(self, force_n: float) -> tuple[float, float]:
        """Return the stated least and greatest stiffness; 0 and `UNKNOWN_N_M` without a range [N/m]."""
        return (0.0, UNKNOWN_N_M) if self._stated is None else self._stated.at(force_n)

    def _nearest(self, bin_: int) -> int:
        if bin_ in self._median:
            return bin_
        return min(self._median, key=lambda known: abs(known - bin_))


class ForceClimb:
    """Greatest rise of a force within one move, from any sample to a later one, for the move's whole length.

    Nobody need know when in the move the stage went. A skin that relaxes before or after takes nothing off
    the climb, which serves where the call that sent the stage was blocked, and no sample can be given a way
    of its own. On the way back the force is taken with its sign turned.

    Attributes:
        from_n: the force that it began at; None before the first [N].
        rise_n: the most by which a force lay above an earlier one [N].
    """

    def __init__(self) -> None:
        self.from_n: float | None = None
        self.rise_n = 0.0
        self._least_n = 0.0

    def take(self, force_n: float) -> None:
        """Take in the next force [N]."""
        if self.from_n is None:
            self.from_n = self._least_n = force_n
        self._least_n = min(self._least_n, force_n)
        self.rise_n = max(self.rise_n, force_n - self._least_n)
