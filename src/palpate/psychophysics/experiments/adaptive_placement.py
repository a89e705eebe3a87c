"""Transformed and weighted up-down staircases over an ordered set of stimuli, and where they settle.

After `right` right answers in a row the comparison comes nearer to the standard, after `wrong` wrong ones in
a row it goes away. A staircase settles where both are balanced: where one step nearer, times its chance, is
as far as a step away times its own. With p the chance of a right answer, the chance that a run of n right
ones comes before one of m wrong ones is

    P(p) = p^(n-1) (1 - q^m) / (p^(n-1) + q^(m-1) - p^(n-1) q^(m-1)),   q = 1 - p

and p follows from P(p) = u / (1 + u), where a step away is u times one nearer. One wrong answer, m = 1, gives
p^n = u / (1 + u): 0.5, 0.707, 0.794, 0.841 for n = 1 to 4 with steps of one size.

References: Levitt, J. Acoust. Soc. Am. 49 (1971) 467, doi:10.1121/1.1912375; Kaernbach, Percept. Psychophys.
49 (1991) 227, doi:10.3758/BF03214307; the chance of runs: Feller, An Introduction to Probability Theory, 1,
XIII.8.

Comparisons placed for the greatest expected information on a psychometric function.

    P(x) = l/2 + (1 - l) Φ((x - m) / s)

over a grid of (m, s, l), uniform at first; the next comparison minimizes the expected entropy.

References: Kontsevich and Tyler, Vision Res. 39 (1999) 2729, doi:10.1016/S0042-6989(98)00285-5; Watson, J.
Vision 17(3):10 (2017), doi:10.1167/17.3.10.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, xlogy

from palpate.core import Float, InputError, ndarray


@dataclass(frozen=True, slots=True)
class StaircaseRule:
    """Rule of a staircase.

    Attributes:
        right, wrong: consecutive answers for a step nearer to the standard, and away from it.
        steps: step sizes [positions]; the next one after each reversal.
        up_ratio: size of a step away over that of one nearer.
        reversals, max_trials: whichever comes first ends the track.
    """

    right: int = 2
    wrong: int = 1
    steps: tuple[int, ...] = (2, 1)
    up_ratio: int = 1
    reversals: int = 8
    max_trials: int = 60

    def __post_init__(self) -> None:
        counts = (self.right, self.wrong, self.up_ratio, self.max_trials, *self.steps)
        if not self.steps or min(counts) < 1 or self.reversals < 2:
            raise InputError(
                f"{self}: counts and steps are 1 or more, and reversals 2 or more; give such numbers",
                code="staircase-rule",
            )

    @property
    def converges_to(self) -> float:
        """Share of right answers where it settles, of small steps and no end of the set; 0 to 1."""
        balance = self.up_ratio / (1 + self.up_ratio)
        tiny = 1e-12
        return float(brentq(lambda p: self.nearer_chance(p) - balance, tiny, 1 - tiny, xtol=1e-14))

    def nearer_chance(self, p: float) -> float:
        """Chance that the next step is nearer, where an answer is right with the chance `p`."""
        runs, breaks = p ** (self.right - 1), (1 - p) ** (self.wrong - 1)
        return runs * (1 - (1 - p) ** self.wrong) / (runs + breaks - runs * breaks)


@dataclass(frozen=True, slots=True)
class StaircaseState:
    """State of a track.

    Attributes:
        place: position of the next comparison; 0 is nearest to the standard.
        way: direction of the last step, -1 nearer, +1 away, 0 before the first.
        in_row: consecutive equal answers; correct ones count up, wrong ones down.
    """

    place: int
    trials: int = 0
    reversals: tuple[int, ...] = ()
    way: int = 0
    in_row: int = 0
    ended: bool = False

    @property
    def threshold(self) -> float:
        """Mean position of an even number of reversals without the first (Levitt); NaN if too few."""
        kept = self.reversals[1:]
        kept = kept[len(kept) % 2 :]
        return math.nan if not kept else sum(kept) / len(kept)


def begin_staircase(places: int) -> StaircaseState:
    """The beginning of a track, at the comparison farthest from the standard."""
    if places < 1:
        raise InputError(
            "a staircase without a comparison; put a stimulus on that side of the standard",
            code="staircase-comparison",
        )
    return StaircaseState(places - 1)


def step_staircase(rule: StaircaseRule, places: int, state: StaircaseState, right: bool) -> StaircaseState:
    """How a track stands after one more answer. At an end of the set it stays there, which is no reversal."""
    if state.ended:
        raise InputError(
            f"an answer beyond the end of a staircase, at trial {state.trials + 1}; leave it out",
            code="staircase-ended",
        )
    in_row = max(state.in_row, 0) + 1 if right else min(state.in_row, 0) - 1
    place, way, reversals = state.place, state.way, state.reversals
    if in_row in (rule.right, -rule.wrong):
        turned = -1 if right else 1
        if way == -turned:
            reversals = (*reversals, place)
        way, in_row = turned, 0
        size = rule.steps[min(len(reversals), len(rule.steps) - 1)] * (1 if right else rule.up_ratio)
        place = min(max(place + way * size, 0), places - 1)
    trials = state.trials + 1
    ended = len(reversals) >= rule.reversals or trials >= rule.max_trials
    return StaircaseState(place, trials, reversals, way, in_row, ended)


EQUALITIES, SPREADS = 21, 16  # grid points of m and s
LAPSES = (0.0, 0.02, 0.06)
DIGITS = 9  # entropies are compared to so many [nat], so that rounding decides nothing


@dataclass(frozen=True, slots=True)
class Placement:
    """Posterior of a participant over a flat grid of m, s, and l, for presentable softness
    differences `x`.
    """

    x: Float[ndarray, " k"]
    equality: Float[ndarray, " n"]
    spread: Float[ndarray, " n"]
    lapse: Float[ndarray, " n"]
    weight: Float[ndarray, " n"]

    @classmethod
    def of_differences(cls, x: Sequence[float]) -> Placement:
        """Return the uniform start: m spans half the range of `x`; s a quarter of the least to twice the
        range.
        """
        differences = np.asarray(x, float)
        if len(differences) < 2 or not np.all(differences):
            raise InputError("two comparisons or more are needed, each of another level than the standard")
        span = float(np.ptp(np.append(differences, 0.0)))
        least = float(np.abs(differences).min())
        grid = np.meshgrid(
            np.linspace(-span / 4, span / 4, EQUALITIES), np.geomspace(least / 4, 2 * span, SPREADS), LAPSES,
            indexing="ij",
        )  # fmt: skip
        equality, spread, lapse = (one.ravel() for one in grid)
        return cls(differences, equality, spread, lapse, np.full(len(lapse), 1 / len(lapse)))

    def chance(self) -> Float[ndarray, "k n"]:
        """Chance of "softer" at each difference, by each grid point."""
        core = ndtr((self.x[:, None] - self.equality) / self.spread)
        return self.lapse / 2 + (1 - self.lapse) * core

    def expected_entropy(self) -> Float[ndarray, " k"]:
        """Expected entropy of the grid after an answer at each difference [nat]."""
        yes = self.chance()
        total = np.zeros(len(self.x))
        for chance in (yes, 1 - yes):
            joint = chance * self.weight
            marginal = joint.sum(1)
            total += xlogy(marginal, marginal) - xlogy(joint, joint).sum(1)
        return total

    @property
    def next(self) -> int:
        """Index of the difference to present; of equals the first."""
        return int(np.argmin(np.round(self.expected_entropy(), DIGITS)))

    def after(self, index: int, softer: bool) -> Placement:
        """What is known after an answer at a difference."""
        chance = self.chance()[index]
        weight = self.weight * (chance if softer else 1 - chance)
        return Placement(self.x, self.equality, self.spread, self.lapse, weight / weight.sum())

    @property
    def mean(self) -> tuple[float, float]:
        """Posterior mean of m, and of s by its logarithm [unit of the level]."""
        m = float(self.weight @ self.equality)
        return m, float(np.exp(self.weight @ np.log(self.spread)))
