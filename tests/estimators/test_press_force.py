"""The force of a press: what the filter really does, and where contact is."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core.errors import InputError, RangeError
from palpate.estimators.compliance.stiffness_curve import (
    loading,
    moving_average,
    rising,
    within,
    without_spikes,
)


def press(rate_hz=200.0, peak_n=5.2, s=2.0) -> np.ndarray:
    """Zero, then rising as a square, then falling faster."""
    up, down = np.linspace(0, 1, int(s * rate_hz)) ** 2, np.linspace(1, 0, int(s * rate_hz / 3))
    return peak_n * np.concatenate([np.zeros(40), up, down])


def test_the_centred_average_attenuates_18_hz_of_200_by_3_db_and_delays_nothing() -> None:
    asked = np.sin(2 * np.pi * 18.0 * np.arange(4000) / 200)
    passed = moving_average(asked)[100:-100]
    gain = np.sin(5 * np.pi * 18 / 200) / (5 * np.sin(np.pi * 18 / 200))
    assert gain == pytest.approx(np.sqrt(0.5), abs=2e-3)
    assert_allclose(passed, gain * asked[100:-100], atol=1e-9)


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


def test_a_spike_before_contact_is_no_contact_and_a_plateau_at_the_top_is_saturation() -> None:
    force = press()
    force[10] = 2.0
    assert loading(force).first > 40
    assert loading(np.minimum(press(), 4.0)).saturated


@pytest.mark.parametrize(
    ("force", "code"),
    [
        (0.05 * press(), "no-contact"),
        (press()[440:], "not-loading"),
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
