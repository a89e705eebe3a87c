"""Power and sample size by simulation of the planned study, tested by `sign_flip_p`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import optimize, special

from palpate.core import RangeError
from palpate.psychophysics.analysis.condition_models import sign_flip_p
from palpate.psychophysics.analysis.proportions import wilson_interval

STUDIES = 400
MAX_PARTICIPANTS = 200
FLIPS = 999
NODES_OF_MEAN = 41


@dataclass(frozen=True, slots=True)
class PlannedStudy:
    """Planned study of two conditions.

    Attributes:
        first, second: population proportions correct, 0 to 1 exclusive.
        answers: answers of each participant in each condition.
        effect_sd: standard deviation of participants' effects [logit]; 0 underestimates the sample size.
    """

    first: float
    second: float
    answers: int
    intercept_sd: float = 0.5
    effect_sd: float = 0.0
    significance: float = 0.05

    def __post_init__(self) -> None:
        if not (0 < self.first < 1 and 0 < self.second < 1):
            raise RangeError(f"shares of {self.first:g} and {self.second:g}; above 0 and below 1 are allowed")
        if self.answers < 1 or min(self.intercept_sd, self.effect_sd) < 0 or not 0 < self.significance < 1:
            raise RangeError(
                "a study has one answer or more a condition, scatters of 0 logits or more, and a "
                "significance between 0 and 1",
                code="study-design",
            )


@dataclass(frozen=True, slots=True)
class StudyPower:
    """Power of a planned study, with the 95 % interval of the simulation."""

    participants: int
    power: float
    low: float
    high: float


def simulated_power(
    study: PlannedStudy, participants: int, rng: np.random.Generator, studies: int = STUDIES
) -> StudyPower:
    """Power with so many participants."""
    if not 2 <= participants <= MAX_PARTICIPANTS:
        raise RangeError(f"{participants} participants; 2 to {MAX_PARTICIPANTS} are allowed")
    sd = math.hypot(study.intercept_sd, study.effect_sd / 2)  # of one condition's log odds over participants
    shifts = [_conditional_logit(share, sd) for share in (study.first, study.second)]
    b = study.intercept_sd * rng.standard_normal((studies, participants))
    half = study.effect_sd / 2 * rng.standard_normal((studies, participants))
    one, other = (
        rng.binomial(study.answers, special.expit(shift + b + own))
        for shift, own in zip(shifts, (-half, half), strict=True)
    )
    p = _flipped(((other - one) / study.answers), rng)
    found = int((p < study.significance).sum())
    return StudyPower(participants, found / studies, *wilson_interval(found, studies))


def participants_needed(
    study: PlannedStudy, rng: np.random.Generator, power: float = 0.8, studies: int = STUDIES
) -> StudyPower:
    """Fewest participants that reach a power, as far as so many simulated studies tell."""
    low, high = 2, 4
    while simulated_power(study, high, rng, studies).power < power:
        low, high = high, 2 * high
        if high > MAX_PARTICIPANTS:
            raise RangeError(
                f"shares of {study.first:g} and {study.second:g} are not told apart with a power of "
                f"{power:g} by {MAX_PARTICIPANTS} participants of {study.answers} answers; plan more each",
                code="sample-size",
            )
    while high - low > 1:
        middle = (low + high) // 2
        enough = simulated_power(study, middle, rng, studies).power >= power
        low, high = (low, middle) if enough else (middle, high)
    return simulated_power(study, high, rng, studies)


def _conditional_logit(share: float, sd: float) -> float:
    """Log odds of an average participant with which the population's share is as asked."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES_OF_MEAN)
    weights = weights / weights.sum()
    return float(
        optimize.brentq(lambda a: float(weights @ special.expit(a + sd * nodes)) - share, -60.0, 60.0)
    )


def _flipped(d: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Significance of each row by its signs: all of them for few participants, else drawn."""
    n = d.shape[1]
    if n <= 10:
        return np.array([sign_flip_p(row) for row in d])
    signs = rng.choice(np.array([-1.0, 1.0]), size=(FLIPS, n))
    as_far = np.abs(d @ signs.T) >= np.abs(d.sum(axis=1))[:, None] - 1e-9
    return np.asarray((1 + as_far.sum(axis=1)) / (FLIPS + 1))
