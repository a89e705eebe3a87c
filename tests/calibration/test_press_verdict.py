"""One verdict of a press, which all its quantities carry, and intervals that contain what cannot be seen."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.virtual_presses import ideal

from palpate.calibration.compliance.compliance_calibration import rate_by_areas
from palpate.calibration.compliance.compliance_reading import read_touch
from palpate.calibration.compliance.press_nuisances import NONE, Nuisances
from palpate.calibration.compliance.press_verdict import CueMisfit, press_reasons
from palpate.core.errors import InputError, RangeError
from palpate.estimators.compliance.pin_press import fit_seat
from palpate.estimators.compliance.spread_rate import fit_rate
from palpate.workflows.tactip_trials import record_press

SEED = 70_000


@pytest.fixture(scope="module")
def made(spec, specimens):
    return record_press(spec, specimens["new"], SEED)


def as_made(made):
    return ideal(made).press


def frozen(made):
    press = ideal(made).press
    moved = press.moved_px.copy()
    moved[12:] = moved[12]
    return replace(press, moved_px=moved)


def late(made):
    """Every frame shows the state of 50 ms before its force's."""
    ago = round(0.05 / float(np.median(np.diff(made.time_s))))
    seen = ideal(replace(made, frame_sample=np.maximum(made.frame_sample - ago, 0))).press
    press = ideal(made).press
    frames = len(press.frame)
    return replace(press, moved_px=seen.moved_px[-frames:]) if len(seen.frame) >= frames else shifted(press)


def shifted(press):
    """The same by one frame, 50 ms at 20 frames a second."""
    return replace(press, moved_px=np.concatenate([press.moved_px[:1] * 0.9, press.moved_px[:-1]]))


def too_much_force(made):
    return ideal(replace(made, raw_n=1.2 * made.raw_n)).press


def off_centre(made):
    return ideal(replace(made, touches=tuple(replace(one, x_m=0.55e-3) for one in made.touches))).press


def bumped(made):
    middle_s = made.time_s[int(np.argmax(made.true_force_n > made.true_force_n[-1] / 2))]
    return ideal(replace(made, raw_n=made.raw_n + np.exp(-50 * (made.time_s - middle_s) ** 2))).press


def other_tip(made):
    other = record_press(replace(made.sensor.spec, tip="stiff-skin"), made.words, SEED)
    return ideal(other).press


FAULTS = {
    frozen: "frames repeat the one before",
    late: "as on no reference",
    too_much_force: "as on no reference",
    off_centre: "off centre",
    bumped: "as on no reference",
    other_tip: "as on no reference",
}


@pytest.mark.parametrize("fault", FAULTS, ids=lambda one: one.__name__)
def test_a_faulty_press_is_refused_with_its_cause(calibration, made, fault) -> None:
    reasons = press_reasons(calibration, [fault(made)], CueMisfit(0.0, 0.0, 1.0))
    assert any(FAULTS[fault] in one.why for one in reasons), reasons


def test_a_fault_of_one_trial_makes_every_quantity_of_all_invalid(calibration, made) -> None:
    for one in read_touch(calibration, [as_made(made), frozen(made)]).readings:
        assert not one.valid
        assert FAULTS[frozen] in one.why


@pytest.mark.parametrize("name", ["force_bias_n", "force_gain", "late_s", "lever", "frame_yield_m_n"])
@pytest.mark.cases(2)
def test_an_interval_contains_a_nuisance_of_its_size(calibration, made, name) -> None:
    calibration = replace(calibration, area=None)
    alone = replace(NONE, **{name: getattr(Nuisances(), name)})
    press = as_made(made)
    plain, wide = (
        read_touch(replace(calibration, nuisances=sizes), [press]).stiffness_both for sizes in (NONE, alone)
    )
    changed = read_touch(replace(calibration, nuisances=NONE), [alone.altered(press)[name]]).stiffness_both
    s = 1 / (
        1 + np.array([plain.value, plain.high, wide.high, changed.value]) / calibration.touch.turning_n_m
    )
    assert_allclose(s[0] - s[2], np.hypot(s[0] - s[1], 1.645 * (s[3] - s[0])), rtol=1e-6)
    assert wide.value == plain.value


def test_nuisances_are_of_their_sign_and_unit(made) -> None:
    press = as_made(made)
    altered = Nuisances(0.1, 0.03, 0.02, 0.05, 3e-5).altered(press)
    assert_allclose(altered["force_bias_n"].force_n - press.force_n, 0.1)
    assert_allclose(altered["force_gain"].force_n, 1.03 * press.force_n)
    assert_allclose(altered["lever"].moved_px, 1.05 * press.moved_px)
    assert_allclose(altered["frame_yield_m_n"].position_m - press.position_m, 3e-5 * press.force_n)
    ahead = altered["late_s"].position_m - press.position_m
    assert_allclose(ahead, 0.02 * press.speed_m_s, rtol=0.1)  # the stage is ahead of what the frame shows
    assert NONE.altered(press) == {}


def test_sizes_are_named_with_units_and_refused_where_they_mean_nothing() -> None:
    assert Nuisances.named(["late_ms=5", "lever=0"]) == replace(Nuisances(), late_s=5e-3, lever=0.0)
    assert Nuisances.named([]).at_edge()["frame_yield_mm_per_N"] == pytest.approx(0.02)
    with pytest.raises(InputError, match="NAME is one of force_bias_N"):
        Nuisances.named(["weather=1"])
    with pytest.raises(InputError, match="no number"):
        Nuisances.named(["lever=much"])
    with pytest.raises(RangeError, match="0 or more"):
        Nuisances.named(["lever=-1"])


def test_a_seat_is_told_in_standard_deviations_between_its_references() -> None:
    trials = [np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, 0.0]]) + shift for shift in (0.0, 4.0)]
    seat = fit_seat(np.array([0.8, 0.2]), trials)
    assert_allclose(seat.spread_px, np.sqrt(4 / 8))  # four squares, eight freedoms: two axes of 6 - 2
    assert_allclose(seat.off(np.array([2.0, 2.0]), 0.5), 0.0, atol=1e-12)
    assert_allclose(seat.off(np.array([3.0, 2.0]), 0.5), 1 / np.sqrt(0.5))
    assert seat.off(np.array([4.0, 4.0]), 0.2) == 0.0 < seat.off(np.array([4.0, 4.0]), 0.8)


def test_a_rate_is_taken_at_even_forces_however_frames_crowd() -> None:
    """Of A = a sqrt(F): the line through areas at 1, 1.5 to 4.5 N, from crowded and from even frames."""
    levels = np.arange(1.0, 4.51, 0.5)
    expected = np.polyfit(levels, np.sqrt(levels), 1)[0]
    crowded = 0.5 + 4.5 * np.linspace(0, 1, 25) ** 3
    for force in (crowded, np.linspace(0.5, 5, 25)):
        assert_allclose(rate_by_areas(force, np.sqrt(force)), expected, rtol=2e-3)
    assert abs(np.polyfit(crowded, np.sqrt(crowded), 1)[0] / expected - 1) > 0.1  # as frames lie
    assert np.isnan(rate_by_areas(crowded, np.where(crowded > 4.9, 1.0, np.nan)))


def test_intervals_of_rates_hold_new_rates_as_often_as_they_say(rng) -> None:
    """Rates that are off by a bent law and scatter by 3 %: held in 90 % of 400."""
    held = tight = 0
    for _ in range(400):
        true = np.repeat([80.0, 90.0, 100.0, 110.0], 2)
        found = true**1.2 * np.exp(0.03 * rng.standard_normal(8))
        fit = fit_rate(list(found), list(true), [0, 0, 1, 1, 2, 2, 3, 3])
        new = rng.uniform(85, 105)
        value, low, high = fit.of(np.array([new**1.2 * np.exp(0.03 * rng.standard_normal())]))
        held += low <= new <= high
        tight += abs(np.log(new / value)) < 1.645 * np.std(np.log(found) / 1.2 - np.log(true)) / np.sqrt(2)
    assert 0.88 < held / 400 < 0.97
    assert tight / 400 < 0.85  # by the error of a mean of two
