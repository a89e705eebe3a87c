"""Area and spread rate: the resolved equations, and what the printed ones do."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core.errors import InputError, RangeError
from palpate.estimators.compliance.spread_rate import (
    area_m2,
    paper_spread,
    spread,
    summed_slopes,
)


def test_accumulated_divergence_gives_back_the_area_that_made_it() -> None:
    """A = A_0 exp(0.05 F): 128.4 at 5 N, where equation (11) says 349."""
    force = np.linspace(0, 5, 101)
    area = 100 * np.exp(0.05 * force)
    steps = np.diff(np.log(area))
    found = area_m2(100.0, steps)
    assert_allclose(found, area[1:], rtol=1e-12)
    assert_allclose(found[-1], 128.4, atol=0.03)
    assert_allclose(100 * np.exp(np.cumsum(steps)[-1] * 5), 349.0, atol=0.1)


@pytest.mark.parametrize("way", ["regression", "secant"])
def test_the_spread_rate_of_a_straight_area_is_its_slope(rng, way) -> None:
    force = np.linspace(0.5, 5, 300) + 0.02 * rng.standard_normal(300)
    assert_allclose(spread(force, 4 + 10 * force, way).rate_m2_n, 10, rtol=1e-6)


@pytest.mark.parametrize("way", ["regression", "secant"])
def test_the_spread_rate_does_not_depend_on_frames_or_speed(way) -> None:
    def rate(frames: int) -> float:
        force = np.linspace(0.5, 5, frames)
        return spread(force, 100 * force**0.7, way).rate_m2_n

    assert_allclose([rate(50), rate(100), rate(400)], rate(4000), rtol=0.05)


@pytest.mark.parametrize(("frames", "sum_"), [(2, 20), (18, 180)])
def test_equation_12_counts_frames(frames, sum_) -> None:
    """Three specimens with the same A(F) of slope 10, at 38, 15.5 and 5.5 N/s and 20 frames a second."""
    force = np.linspace(0.5, 5, frames + 1)
    assert_allclose(summed_slopes(force, 4 + 10 * force), sum_)


def test_paper_mode_doubles_at_half_the_speed_and_says_so() -> None:
    def paper(frames: int) -> float:
        force = np.linspace(0.5, 5, frames)
        return paper_spread(force, np.full(frames, 0.2 / frames), 7e-4).rate_m2_n

    assert_allclose(paper(80) / paper(40), 2, rtol=0.05)
    steps_without_force = np.array([0.5, 0.5, 1.0, 1.0])
    assert np.isfinite(paper_spread(steps_without_force, np.full(4, 0.01), 7e-4).rate_m2_n)


def test_what_has_no_spread_rate_is_refused() -> None:
    with refused("lengths-differ", InputError, match="2 areas"):
        spread(np.ones(3), np.ones(2))
    with refused("too-few-forces", InputError):
        spread(np.full(9, 1.0), np.ones(9))
    with refused("not-finite", InputError):
        spread(np.linspace(1, 5, 9), np.full(9, np.nan))
    with refused("divergence-range", RangeError):
        area_m2(1e-4, np.full(100, 90.0))
    with refused("area", RangeError):
        area_m2(0.0, np.ones(3))
