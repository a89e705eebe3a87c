"""Psychometric functions: greatest likelihood as another code finds it, and honest answers at the ends."""

import math

import numpy as np
import pytest
import statsmodels.api as sm
from scipy import stats
from tests.refusals import refused

from palpate.core import InputError, RangeError
from palpate.psychophysics.analysis import PsychometricFunction, SigmoidShape, fit_psychometric

LEVELS = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
GIVEN, N = np.array([2, 7, 14, 26, 29]), np.array([30, 30, 28, 30, 30])
LINKS = {
    SigmoidShape.GAUSSIAN: (sm.families.links.Probit(), False),
    SigmoidShape.LOGISTIC: (sm.families.links.Logit(), False),
    SigmoidShape.WEIBULL: (sm.families.links.CLogLog(), True),
}


@pytest.mark.parametrize("shape", SigmoidShape)
def test_without_lapses_it_is_the_generalised_linear_model_of_statsmodels(shape: SigmoidShape) -> None:
    link, logarithmic = LINKS[shape]
    x = np.log(LEVELS) if logarithmic else LEVELS
    theirs = sm.GLM(
        np.column_stack([GIVEN, N - GIVEN]), sm.add_constant(x), sm.families.Binomial(link)
    ).fit(tol=1e-12, maxiter=200)  # fmt: skip
    fit = fit_psychometric(LEVELS, GIVEN, N, shape, logarithmic=logarithmic, deviance_draws=0)
    assert fit.deviance == pytest.approx(theirs.deviance, rel=1e-6)


@pytest.mark.parametrize("shape", SigmoidShape)
def test_a_function_is_half_at_its_threshold_and_three_quarters_a_spread_above(shape: SigmoidShape) -> None:
    logarithmic = shape is SigmoidShape.WEIBULL
    f = PsychometricFunction(shape, 3.0, 0.5, 0.1, 0.2, logarithmic)
    further = 3.0 * math.exp(0.5) if logarithmic else 3.5
    assert f([3.0, further]) == pytest.approx([0.1 + 0.7 / 2, 0.1 + 0.7 * 3 / 4])
    assert f(1e3) == pytest.approx(0.8, abs=1e-9)


@pytest.mark.parametrize("lapse", [0.0, None])
@pytest.mark.parametrize(("far", "n"), [(7.0, 40_000), (100.0, 280), (100.0, 40_000), (1000.0, 280)])
def test_neither_a_level_far_off_nor_many_answers_move_the_posterior(
    far: float, n: int, lapse: float | None
) -> None:
    x, m, slip = np.append(LEVELS, far), np.full(6, n), 0.0 if lapse is not None else 0.03
    k = np.round(n * (slip + (1 - 2 * slip) * stats.norm.cdf((x - 3.1) / 0.8 * stats.norm.ppf(0.75)))).astype(
        int
    )
    fit = fit_psychometric(x, k, m, lapse=lapse, guess_is_lapse=lapse is None, deviance_draws=0)
    b = stats.norm.ppf(0.75) / 0.8
    z = b * (x - 3.1)
    p, dp = slip + (1 - 2 * slip) * stats.norm.cdf(z), (1 - 2 * slip) * stats.norm.pdf(z)
    X = np.column_stack([np.ones(6), x])
    weight = n * dp**2 / np.maximum(p * (1 - p), 1e-300)  # a level far off weighs nothing
    covariance = np.linalg.inv(X.T @ (X * weight[:, None]))
    error = math.sqrt(np.array([1, 3.1]) @ covariance @ np.array([1, 3.1])) / b
    assert fit.threshold.value == pytest.approx(3.1, abs=0.15 * error)
    assert fit.threshold.high - fit.threshold.low == pytest.approx(2 * 1.96 * error, rel=0.03)
    error = math.sqrt(covariance[1, 1]) / b
    unknown = 1.0 if lapse is not None else 1.5  # a lapse rate to be found widens the spread's
    width = math.log(fit.spread.high / fit.spread.low) / (2 * 1.96 * error)
    assert 0.97 < width < 1.05 * unknown
    assert fit.spread.value == pytest.approx(0.8, rel=0.15 * unknown * error)
    assert all(fit.threshold.bounded + fit.spread.bounded)


@pytest.mark.parametrize(
    ("given", "code", "bounded"),
    [
        ([0] * 5, "all-equal", (True, False)),
        ([30] * 5, "all-equal", (False, True)),
        ([0, 0, 30, 30, 30], "separated", (True, True)),
        ([0, 0, 15, 30, 30], "separated", (True, True)),
        ([15] * 5, "spread-unbounded-above", (True, True)),
        ([30, 30, 0, 0, 0], "falling", (True, False)),
    ],
)
def test_answers_without_a_slope_have_wide_intervals_and_say_so(given, code, bounded) -> None:
    fit = fit_psychometric(LEVELS, given, [30] * 5)
    assert code in fit.notes
    assert fit.threshold.bounded == bounded
    for one in (fit.threshold, fit.spread):
        assert np.isfinite([one.low, one.value, one.high]).all()
        assert one.low < one.value < one.high
    if code in ("all-equal", "separated"):
        assert not fit.spread.bounded[0]


@pytest.mark.parametrize("studies", [20, pytest.param(80, marks=pytest.mark.slow)])
def test_the_deviance_is_judged_at_its_rate_and_sees_answers_that_scatter_too_much(studies: int) -> None:
    truth, rng = PsychometricFunction(SigmoidShape.GAUSSIAN, 3.0, 0.8), np.random.default_rng(2)

    def p(k) -> float:
        return fit_psychometric(LEVELS, k, [30] * 5, deviance_draws=99, rng=rng).deviance_p

    small = sum(p(rng.binomial(30, truth(LEVELS))) < 0.1 for _ in range(studies))
    low, high = stats.binom.ppf([0.001, 0.999], studies, 0.1)
    assert low <= small <= high
    assert p([12, 2, 25, 12, 30]) < 0.02


def test_a_free_lapse_rate_is_found_with_its_interval() -> None:
    truth = PsychometricFunction(SigmoidShape.GAUSSIAN, 3.0, 0.4, 0.05, 0.05)
    k = np.round(truth(LEVELS) * 400).astype(int)
    fit = fit_psychometric(LEVELS, k, [400] * 5, lapse=None, guess_is_lapse=True, deviance_draws=0)
    assert fit.lapse is not None
    assert fit.lapse.low < 0.05 < fit.lapse.high
    assert fit.lapse.value == pytest.approx(0.05, abs=0.015)
    assert fit.function.guess == fit.function.lapse


def test_bad_numbers_are_refused() -> None:
    with refused("too-few-levels", InputError):
        fit_psychometric([1, 2], [3, 0], [5, 0])
    with refused("counts", InputError):
        fit_psychometric([1, 2], [6, 0], [5, 5])
    with refused("lengths-differ", InputError):
        fit_psychometric([1, 2], [6], [5, 5])
    with refused("levels", RangeError):
        fit_psychometric([0, 2], [1, 2], [5, 5], SigmoidShape.WEIBULL)
    with refused("guess-and-lapse", RangeError):
        fit_psychometric([1, 2], [1, 2], [5, 5], guess=0.5, lapse=0.5)
    with refused("spread", RangeError):
        PsychometricFunction(SigmoidShape.GAUSSIAN, 1.0, 0.0)
