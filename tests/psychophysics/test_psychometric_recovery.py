"""Psychometric functions come back: without bias, in intervals that hold them at their rate."""

import numpy as np
import pytest
from scipy import stats

from palpate.psychophysics.analysis import PsychometricFunction, SigmoidShape, fit_psychometric

LINEAR, RATIO = np.linspace(1.0, 5.0, 7), np.geomspace(1.0, 9.0, 7)
TRUTHS = {
    "gaussian": (PsychometricFunction(SigmoidShape.GAUSSIAN, 3.0, 0.8), LINEAR, {}),
    "logistic, off centre": (PsychometricFunction(SigmoidShape.LOGISTIC, 3.3, 0.8), LINEAR, {}),
    "weibull": (PsychometricFunction(SigmoidShape.WEIBULL, 3.0, 0.4, logarithmic=True), RATIO, {}),
    "gaussian over logarithms": (
        PsychometricFunction(SigmoidShape.GAUSSIAN, 3.0, 0.5, logarithmic=True), RATIO, {"logarithmic": True},
    ),
    "gaussian, lapses known": (
        PsychometricFunction(SigmoidShape.GAUSSIAN, 3.0, 0.8, 0.03, 0.03), LINEAR,
        {"guess": 0.03, "lapse": 0.03},
    ),
}  # fmt: skip
ANSWERS = 40  # at each of seven levels


def recovered(name: str, studies: int, seed: int) -> dict[str, float]:
    """Bias in standard errors and share of intervals that hold the truth, over simulated studies."""
    truth, levels, known = TRUTHS[name]
    rng = np.random.default_rng(seed)
    fits = [
        fit_psychometric(
            levels, rng.binomial(ANSWERS, truth(levels)), [ANSWERS] * len(levels), truth.shape,
            deviance_draws=0, **known,
        )
        for _ in range(studies)
    ]  # fmt: skip
    found = {}
    for what in ("threshold", "spread"):
        true = getattr(truth, what)
        values = np.log([getattr(fit, what).value for fit in fits])
        found[f"{what} bias"] = float((values.mean() - np.log(true)) / values.std(ddof=1))
        held = [getattr(fit, what).low <= true <= getattr(fit, what).high for fit in fits]
        found[f"{what} held"] = float(np.mean(held))
    return found


def assert_recovered(found: dict[str, float], studies: int) -> None:
    """Bias is within 0.1 standard errors but for chance; coverage within the binomial band of 95 %."""
    low, high = stats.binom.ppf([0.0005, 0.9995], studies, 0.95) / studies
    for what in ("threshold", "spread"):
        assert abs(found[f"{what} bias"]) < 0.1 + 3 / np.sqrt(studies)
        assert low <= found[f"{what} held"] <= high


@pytest.mark.parametrize("name", ["gaussian", "weibull"])
def test_known_parameters_are_recovered_in_30_studies(name: str) -> None:
    assert_recovered(recovered(name, 30, seed=3), 30)


@pytest.mark.slow
@pytest.mark.parametrize("name", TRUTHS)
def test_known_parameters_are_recovered_in_1500_studies(name: str) -> None:
    found = recovered(name, 1500, seed=4)
    print(name, {what: round(value, 3) for what, value in found.items()})
    assert_recovered(found, 1500)
