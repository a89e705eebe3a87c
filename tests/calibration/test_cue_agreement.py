"""Cues that do not belong to one flat object invalidate every quantity; sound presses stay valid."""

from dataclasses import replace

import numpy as np
import pytest
from tests.virtual_presses import ideal

from palpate.calibration.compliance.compliance_reading import read_touch
from palpate.calibration.compliance.press_cues import reading_record
from palpate.calibration.compliance.press_verdict import (
    MAX_APPROACH,
    MAX_PINS,
    cue_misfit,
    greatest_misfit,
)
from palpate.core.reading import ReasonCode
from palpate.workflows.tactip_trials import record_press, specimens_at

ALWAYS = "radius"  # invalid for every press of a tip that is no Hertz body
LAYERS = ("layer:h_mm=3,E_MPa=0.1", "layer:h_mm=8,E_MPa=0.1", "layer:h_mm=3,E_MPa=0.06")


def press_on(spec, body, seed: int):
    (words,) = specimens_at(spec, {"one": body}).values()
    return ideal(record_press(spec, words, seed)).press


@pytest.fixture(scope="module")
def sound(spec):
    return press_on(spec, 4.2e3, 81)


def codes(read) -> list[set[str]]:
    return [set(reading_record(one)["codes"]) for one in read.readings]


def test_a_sound_press_is_valid_in_every_quantity(calibration, sound) -> None:
    read = read_touch(calibration, [sound])
    assert {one.quantity for one in read.readings if not one.valid} == {ALWAYS}
    assert all(reading_record(one)["codes"] == [] for one in read.readings if one.valid)


@pytest.mark.parametrize("body", LAYERS)
@pytest.mark.parametrize("placed", [True, False])
@pytest.mark.cases(2)
def test_a_layer_on_a_hard_base_has_no_valid_area_that_is_wrong(spec, calibration, body, placed) -> None:
    """With positions no valid quantity at all; by pins and force of four trials none off by 3 half-widths."""
    press = press_on(spec, body, 82)
    read = read_touch(calibration, [press if placed else replace(press, position_m=None)])
    words = specimens_at(spec, {"one": body})["one"]
    true = float(record_press(spec, words, 82).sensor.on(words).area_m2(np.array([4.0]))[0])
    assert read.area is not None
    assert not read.area.valid or abs(read.area.value - true) < 1.5 * (read.area.high - read.area.low)
    if placed:
        assert not any(one.valid for one in read.readings)
        assert all(ReasonCode.CUES_DISAGREE in one for one in codes(read))


def test_limits_are_wider_for_a_scatter_of_few_trials(calibration) -> None:
    limits = [
        greatest_misfit(replace(calibration, touch=replace(calibration.touch, freedom=freedom)))
        for freedom in (3, 12, 16, 36, 10_000)
    ]
    for one in ([limit.pins for limit in limits], [limit.approach for limit in limits]):
        assert (np.diff(one) < 0).all()
    assert limits[-1].pins == pytest.approx(MAX_PINS, rel=0.01)
    assert limits[-1].approach == pytest.approx(MAX_APPROACH, rel=0.01)


@pytest.mark.slow
def test_few_sound_presses_are_refused(calibration, spec) -> None:
    """At most 3 % of 60, of specimens between the references."""
    kappas = np.exp(np.random.default_rng(5).uniform(np.log(1.15e3), np.log(7.4e3), 60))
    reads = [read_touch(calibration, [press_on(spec, float(k), 40_000 + i)]) for i, k in enumerate(kappas)]
    for name in ("stiffness", "stiffness_both", "area", "spread_rate"):
        assert sum(not getattr(read, name).valid for read in reads) <= 0.03 * len(reads), name


def test_a_layer_that_few_trials_cannot_refuse_widens_area_and_rate(spec, calibration) -> None:
    """Pins as of a stiff flat specimen with another area: both are within two half-widths."""
    body = "layer:h_mm=1.99,E_MPa=0.1"
    press = replace(press_on(spec, body, 915_606), position_m=None)
    assert cue_misfit(calibration, press).birge > 1
    words = specimens_at(spec, {"one": body})["one"]
    true = float(record_press(spec, words, 82).sensor.on(words).area_m2(np.array([4.0]))[0])
    area = read_touch(calibration, [press]).area
    assert area is not None
    assert abs(area.value - true) < area.high - area.low


def test_the_misfit_of_a_sound_press_is_small_and_grows_with_the_scale(calibration, sound) -> None:
    misfits = [
        cue_misfit(calibration, replace(sound, position_m=sound.position_m * f)) for f in (1, 1.05, 1.1)
    ]
    assert misfits[0].pins == misfits[2].pins < greatest_misfit(calibration).pins
    approach = [one.approach for one in misfits]
    assert 0 <= approach[0] < greatest_misfit(calibration).approach
    assert (np.diff(approach) > 0).all()


@pytest.mark.parametrize(("kappa", "inside"), [(0.95e3, False), (4.2e3, True), (9e4, False)])
def test_an_interval_that_reaches_beyond_the_references_is_not_valid(
    calibration, spec, kappa, inside
) -> None:
    both = read_touch(calibration, [press_on(spec, kappa, 84)]).stiffness_both
    low, high = both.calibrated_range
    assert both.valid == inside
    assert (low <= both.low and both.high <= high and np.isfinite(both.high)) == inside
    assert (ReasonCode.INTERVAL_OUTSIDE_RANGE in reading_record(both)["codes"]) != inside
