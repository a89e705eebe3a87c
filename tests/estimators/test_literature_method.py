"""The report's route on whole presses: what it gives, and what it counts beside contact."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core.errors import InputError
from palpate.estimators.compliance.spread_rate import AsReported, as_reported, circle_through_pins
from palpate.estimators.pins import find_pins
from palpate.sensors.tactip import tactip
from palpate.workflows.tactip_trials import record_press


@pytest.fixture(scope="module")
def press():
    made = record_press(replace(tactip(), speed_m_s=5e-3), "S1=7.6", seed=21)
    return made, list(made.frames())


@pytest.fixture(scope="module")
def usual(press) -> AsReported:
    made, frames = press
    circle = circle_through_pins(find_pins(frames[0]).xy_px, *frames[0].shape)
    return as_reported(frames, made.raw_n, made.frame_sample, region=circle)


def test_the_whole_route_runs_on_frames(usual) -> None:
    assert len(usual.force_n) == len(usual.divergence) == len(usual.area) > 10
    assert usual.force_n[0] >= 0.5
    assert usual.force_n[-1] <= 5
    assert_allclose(usual.area, np.exp(np.cumsum(usual.divergence)))
    assert set(usual.spreads) == {"regression", "secant", "paper"}
    assert usual.spreads["regression"].rate_m2_n > 0  # pins move outwards as the force grows


def test_one_area_in_more_frames_has_one_regression_and_a_larger_sum() -> None:
    """A = 1 + 0.1 F, sampled at 20 and at 60 forces, through `above` as section V takes it."""

    def course(frames: int) -> AsReported:
        force = np.linspace(0.5, 5, frames)
        area = 1 + 0.1 * force
        divergence = np.diff(np.log(area), prepend=0.0)
        return AsReported(force, divergence, area).above(2.5)

    few, many = course(20), course(60)
    assert (few.force_n >= 2.5).all()
    assert_allclose([c.spreads["regression"].rate_m2_n for c in (few, many)], 0.1, rtol=1e-9)
    assert many.spreads["paper"].rate_m2_n > 2.5 * few.spreads["paper"].rate_m2_n


def test_the_circle_goes_through_the_outermost_pin_and_passes_lost_ones_over() -> None:
    at = np.array([[50.0, 40.0], [70.0, 40.0], [30.0, 40.0], [50.0, 60.0], [50.0, 20.0], [np.nan, np.nan]])
    circle = circle_through_pins(at, 80, 100)
    assert circle.shape == (80, 100)
    assert circle[40, 70]
    assert not circle[40, 71]
    assert_allclose(circle.sum(), np.pi * 20**2, rtol=0.02)


def test_what_is_no_press_is_refused(press) -> None:
    press, frames = press
    with refused("no-contact", InputError):
        as_reported(frames, press.raw_n / 20, press.frame_sample)
    with pytest.raises(InputError):
        as_reported(frames[:1], press.raw_n, press.frame_sample[:1])
    touched = int(np.argmax(press.true_force_n[press.frame_sample] > 1))
    late = press.frame_sample[touched]
    with refused("frames-differ", InputError):
        as_reported(frames[touched:], press.raw_n[late:], press.frame_sample[touched:] - late)
