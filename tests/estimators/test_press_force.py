"""The force of a press: what the filter really does, and where contact is."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq
from tests.refusals import refused

from palpate.core.errors import InputError, RangeError
from palpate.estimators.compliance.press_force import loading, moving_average, rising, within, without_spikes


def press(rate_hz=200.0, peak_n=5.2, s=2.0) -> np.ndarray:
    """Zero, then rising as a square, then falling faster."""
    up, down = np.linspace(0, 1, int(s * rate_hz)) ** 2, np.linspace(1, 0, int(s * rate_hz / 3))
    return peak_n * np.concatenate([np.zeros(40), up, down])


def trailing_response(taps: int, rate_hz: float) -> tuple[float, float]:
    """Cut-off of a trailing moving average (1/sqrt 2 of an oscillation) [Hz], and its delay [s]."""

    def passed(turns: float) -> float:  # turns a sample
        return float(np.sin(np.pi * taps * turns) / (taps * np.sin(np.pi * turns)) - np.sqrt(0.5))

    return brentq(passed, 1e-9, 1 / taps) * rate_hz, (taps - 1) / 2 / rate_hz


def test_five_taps_at_200_hz_pass_18_hz_and_delay_by_10_ms() -> None:
    cutoff, delay = trailing_response(5, 200.0)
    assert_allclose(cutoff, 18.0, atol=0.05)
    assert delay == 0.010


@pytest.mark.parametrize(("taps", "rate", "cutoff", "delay"), [(18, 200, 5.0, 0.0425), (201, 200, 0.44, 0.5)])
def test_what_the_report_says_of_its_filter_needs_other_filters(taps, rate, cutoff, delay) -> None:
    assert_allclose(trailing_response(taps, rate), (cutoff, delay), rtol=0.02)


def test_the_centred_average_passes_18_hz_of_200_as_the_trailing_one_and_delays_nothing() -> None:
    cutoff, _ = trailing_response(5, 200.0)
    asked = np.sin(2 * np.pi * cutoff * np.arange(4000) / 200)
    passed = moving_average(asked)[100:-100]
    assert_allclose(passed, np.sqrt(0.5) * asked[100:-100], atol=1e-9)


def test_a_centred_average_leaves_a_straight_line_where_it_is() -> None:
    line = np.arange(50.0)
    assert_allclose(moving_average(line)[2:-2], line[2:-2])


def test_spikes_go_and_the_press_stays(rng) -> None:
    force = press() + 0.02 * rng.standard_normal(len(press()))
    hit = force.copy()
    hit[[60, 200, 201, 350]] += [3, -4, -4, 8]
    assert_allclose(without_spikes(hit), force, atol=0.3)
    assert_allclose(without_spikes(press()), press(), atol=0.02)


def test_loading_runs_from_contact_to_the_greatest_force() -> None:
    force = press()
    part = loading(force)
    assert force[part.first] >= 0.5 > force[part.first - 1]
    assert force[part.last] == force.max()
    inside = within(force, part, 2.5, 5.0)
    assert force[inside].min() >= 2.5
    assert force[inside].max() <= 5.0
    assert not part.saturated


def test_a_spike_before_contact_is_no_contact() -> None:
    force = press()
    force[10] = 2.0
    assert loading(force).first > 40


def test_a_plateau_at_the_top_is_saturation() -> None:
    assert loading(np.minimum(press(), 4.0)).saturated


@pytest.mark.parametrize(
    ("force", "code"),
    [
        (0.05 * press(), "no-contact"),
        (press()[440:], "not-loading"),
        (-press(), "no-contact"),
        (np.ones(3), "too-few-values"),
        (np.where(np.arange(len(press())) == 7, np.nan, press()), "not-finite"),
    ],
)
def test_a_press_without_a_loading_part_is_refused_with_the_reason(force, code) -> None:
    with refused(code, InputError):
        loading(force)


def test_bins_make_force_rise_strictly_and_keep_a_straight_line_straight(rng) -> None:
    force = np.abs(np.linspace(0.5, 5, 400) + 0.06 * rng.standard_normal(400))
    at, mean = rising(force, 3 * force + 1, 0.1)
    assert (np.diff(at) > 0).all()
    assert_allclose(mean, 3 * at + 1)
    _, rows = rising(force, np.stack([force, force**2], axis=1), 0.5)
    assert rows.shape[1] == 2


def test_limits_of_the_filters_are_named() -> None:
    with pytest.raises(RangeError, match="bins"):
        rising(np.ones(3), np.ones(3), 0.0)
