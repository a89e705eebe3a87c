"""Discriminability of objects at each stage of a transmission.

An observer perceives the logarithm of each cue's chord with Gaussian noise and weights the cues by 1 /
variance. A cue of Weber fraction w has sigma = ln(1 + w) / 0.954 (75 % of pairs). Draws of different objects
are independent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from palpate.core import InputError, RangeError
from palpate.psychophysics.rank_observer import RankObserver
from palpate.softness.transmission.transmitted_cues import CUES, Transmission

STAGES = {
    "true": "objects themselves",
    "touched": "as touched",
    "felt": "as felt",
    "drawn": "as felt, readings' intervals carried",
}
JUDGED_DRAWS = 100
JND_SD = math.sqrt(2) * 0.6744897501960817  # d' of a pair that is told right in 75 %


@dataclass(frozen=True, slots=True)
class StageJudgement:
    """Probability of naming the softer of each pair, and expected fraction of correct
    positions in a ranking.
    """

    pairs: Mapping[tuple[str, str], float]
    total: float


@dataclass(frozen=True, slots=True)
class CueNoise:
    """Weber fraction of each cue (75 % of pairs correct); infinite for a cue that is not perceived."""

    displacement: float
    area: float

    def __post_init__(self) -> None:
        if not (self.displacement > 0 and self.area > 0 and min(self.displacement, self.area) < math.inf):
            raise RangeError(
                f"Weber fractions of {self.displacement:g} and {self.area:g}; both have to be above 0, and "
                "one finite, such as 0.15"
            )

    def place(self, chords: Mapping[str, float]) -> float:
        """Place of an object, rising with softness [standard deviations of the percept]."""
        total = place = 0.0
        for cue, chord in chords.items():
            reliability = (JND_SD / math.log1p(getattr(self, cue))) ** 2
            total += reliability
            place -= reliability * math.log(chord)
        return place / math.sqrt(total)


def judged(transmissions: Sequence[Transmission], noise: CueNoise) -> dict[str, StageJudgement]:
    """Judge two or more objects at each stage; ``true`` is omitted if an object is unknown."""
    known = all(one.true_flat_pa is not None for one in transmissions)
    transmissions = sorted(
        transmissions,
        key=lambda one: -(one.true_flat_pa if known and one.true_flat_pa else one.touched.flat_pa),
    )
    names = [one.name for one in transmissions]
    if len(names) < 2 or len(set(names)) < len(names):
        raise InputError(f"objects {', '.join(names)}; two or more of different names can be told apart")
    stages = {}
    for stage in ("true", "touched", "felt"):
        chords = [{cue: getattr(one.cues[cue], stage) for cue in CUES} for one in transmissions]
        if all(None not in each.values() for each in chords):
            stages[stage] = _mean(names, [[noise.place(each) for each in chords]])
    count = min(JUDGED_DRAWS, *(len(one.cues[CUES[0]].drawn) for one in transmissions))
    places = [
        [noise.place({cue: float(one.cues[cue].drawn[k]) for cue in CUES}) for one in transmissions]
        for k in range(count)
    ]
    return stages | {"drawn": _mean(names, places)}


def _mean(names: Sequence[str], places: Sequence[Sequence[float]]) -> StageJudgement:
    observers = [RankObserver(tuple(one)) for one in places]
    pairs = {
        (names[i], names[j]): float(np.mean([one.pair_accuracy(i, j) for one in observers]))
        for i, j in combinations(range(len(names)), 2)
    }
    return StageJudgement(pairs, float(np.mean([one.total_accuracy() for one in observers])))
