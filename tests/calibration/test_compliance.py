"""A tip calibrated on references: what it says of others, when it does not know, and its file."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from tests.virtual_presses import KAPPA_N_M, pressed, without_area

from palpate.calibration.compliance.compliance_calibration import (
    ComplianceCalibration,
    calibrate_compliance,
)
from palpate.calibration.compliance.compliance_reading import read_touch
from palpate.calibration.compliance.press_nuisances import NONE
from palpate.calibration.compliance.press_verdict import CueMisfit, drift_of, press_reasons
from palpate.core.errors import CertificateError, ExistsError, InputError, RangeError, StorageError
from palpate.core.reading import ReasonCode
from palpate.sensors.tactip import tactip
from palpate.sensors.tactip.tactip_press import modulus_pa
from palpate.sensors.tactip.tactip_sensor import TacTip

AGREE = CueMisfit(0.0, 0.0, 1.0)


@pytest.fixture(scope="module")
def fresh(spec, specimens):
    """One trial of every specimen that the calibration has not seen."""
    return {
        name: [t.press for t in pressed(spec, specimens[name], 1, 9000 + 100 * i, rendered=False)]
        for i, name in enumerate(KAPPA_N_M)
    }


@pytest.fixture(scope="module")
def read(calibration, fresh):
    return {name: read_touch(calibration, presses, name) for name, presses in fresh.items()}


def test_specimens_come_in_their_order_by_touch_alone(read) -> None:
    values = [read[name].stiffness.value for name in ("rigid", "S1", "new", "S2", "S3")]
    assert (np.diff(np.minimum(values, 1e9)) < 0).all()


def test_a_new_specimens_stiffness_is_found(read) -> None:
    """To 15 % by touch and 6 % with the approach beside it; the intervals hold it."""
    touch, both = read["new"].stiffness, read["new"].stiffness_both
    assert_allclose(touch.value, KAPPA_N_M["new"], rtol=0.15)
    assert_allclose(both.value, KAPPA_N_M["new"], rtol=0.06)
    for one in (touch, both):
        assert one.valid, one.why
        assert one.low <= KAPPA_N_M["new"] <= one.high
        assert one.unit == "N_per_m"
        low, high = one.calibrated_range
        assert 0.95e3 < low < 1.05e3  # 10 % of the references' span in softness beyond the softest
        assert high == np.inf  # a rigid plate is among the references


def test_a_rigid_plate_has_no_upper_end_and_is_outside_of_the_range(read) -> None:
    found = read["rigid"].stiffness
    assert found.high == np.inf
    assert not found.valid
    assert ReasonCode.OUTSIDE_RANGE in found.code


def test_contact_areas_come_back(spec, specimens, read) -> None:
    for name, words in specimens.items():
        true = float(TacTip(spec).on(words).area_m2(np.array([4.0]))[0])
        assert_allclose(read[name].area.value, true, rtol=0.05, err_msg=name)
    area = read["new"].area
    assert area.valid, area.why
    assert area.low < area.value < area.high


def test_the_area_of_every_frame_comes_back(given, calibration) -> None:
    plain = replace(calibration, nuisances=NONE)
    for one in given[::3]:
        course = read_touch(plain, [one.trials[0].press]).course
        inside = course.force_n >= 1
        off = course.area_m2[inside, 0] / one.trials[0].area_m2[inside] - 1
        assert np.median(np.abs(off)) < 0.05


def test_moduli_come_back_where_the_object_yields_a_fifth(spec, read) -> None:
    """E* = E / (1 - nu^2) to 10 %; a stiffer one is marked, and what is told of it is not used."""
    table = spec.table
    for name in ("new", "S2", "S3"):
        found = read[name].modulus
        true = modulus_pa(table, KAPPA_N_M[name]) / (1 - table.poisson_ratio**2)
        assert found.valid, found.why
        assert_allclose(found.value, true, rtol=0.1, err_msg=name)
    assert not read["rigid"].modulus.valid
    assert ReasonCode.TOO_STIFF in read["rigid"].modulus.code


def test_a_tip_that_is_no_hertz_body_tells_no_radius(calibration, read) -> None:
    assert calibration.finger.misfit > 0.1
    assert not read["S3"].radius.valid
    assert ReasonCode.NOT_HERTZ in read["S3"].radius.code


def test_another_speed_than_was_calibrated_is_flagged(calibration, fresh) -> None:
    (press, *_) = fresh["new"]
    for speed, flagged in ((0.004, False), (0.016, True), (0.0016, True), (np.nan, False)):
        reasons = press_reasons(calibration, [replace(press, speed_m_s=speed)], AGREE)
        assert [one.code for one in reasons] == [ReasonCode.SPEED] * flagged


def test_pins_that_moved_against_each_other_are_drift(calibration, fresh, rng) -> None:
    (press, *_) = fresh["new"]
    assert not drift_of(calibration, [press]).drifted
    moved = replace(press, untouched_px=press.untouched_px + rng.standard_normal(press.untouched_px.shape))
    for one in read_touch(calibration, [moved]).readings:
        assert one.drift.drifted
        assert not one.valid
        assert ReasonCode.DRIFTED in one.code


def test_a_motion_like_no_reference_is_flagged(calibration, fresh, rng) -> None:
    (press, *_) = fresh["new"]
    sheared = press.moved_px + (press.force_n / 5)[:, None, None] * rng.standard_normal((127, 2))
    found = read_touch(calibration, [replace(press, moved_px=sheared)]).stiffness
    assert not found.valid
    assert ReasonCode.CUES_DISAGREE in found.code


def test_flaws_of_a_press_make_every_reading_invalid(calibration, fresh) -> None:
    flawed = replace(fresh["new"][0], flaws=("the lamp went out",))
    for one in read_touch(calibration, [flawed]).readings:
        assert not one.valid
        assert ReasonCode.FLAWED_PRESS in one.code
        assert "lamp" in one.why


def test_a_few_lost_pins_change_little(calibration, fresh) -> None:
    (press, *_) = fresh["new"]
    moved = press.moved_px.copy()
    moved[4, ::11] = np.nan
    plain = replace(calibration, nuisances=NONE)
    found, whole = (read_touch(plain, [one]) for one in (replace(press, moved_px=moved), press))
    assert_allclose(found.stiffness.value, whole.stiffness.value, rtol=0.02)
    assert_allclose(found.area.value, whole.area.value, rtol=0.02)


def test_another_sensor_is_refused(spec, specimens, calibration) -> None:
    (other,) = pressed(tactip(331), specimens["S1"], 1, 1, rendered=False)
    with pytest.raises(InputError, match="calibrate for it"):
        read_touch(calibration, [other.press])


def test_a_press_that_ends_early_is_refused(calibration, fresh) -> None:
    (press, *_) = fresh["new"]
    n = int((press.force_n < 3).sum())
    short = replace(
        press, frame=press.frame[:n], force_n=press.force_n[:n], moved_px=press.moved_px[:n],
        position_m=press.position_m[:n], time_s=press.time_s[:n],
    )  # fmt: skip
    with pytest.raises(RangeError, match="press as far as the references"):
        read_touch(calibration, [short])
    with pytest.raises(InputError, match="no press"):
        read_touch(calibration, [])


@pytest.fixture(scope="module")
def bare(given) -> ComplianceCalibration:
    return calibrate_compliance(without_area(given))


def test_without_areas_or_positions_less_is_told_and_the_rest_is_the_same(bare, given, read, fresh) -> None:
    assert (bare.motions, bare.area, bare.finger) == (None, None, None)
    found = read_touch(bare, fresh["new"])
    assert (found.area, found.spread_rate, found.modulus, found.radius, found.course) == (None,) * 5
    assert_allclose(found.stiffness.value, read["new"].stiffness.value)
    placeless = [
        replace(r, trials=tuple(replace(t, press=replace(t.press, position_m=None)) for t in r.trials))
        for r in given
    ]
    touch = calibrate_compliance(placeless)
    assert touch.both is None
    assert touch.finger is None
    told = read_touch(touch, fresh["new"])
    assert told.stiffness_both is None
    assert told.modulus is None
    assert_allclose(told.area.value, read["new"].area.value)
    still = [replace(one, position_m=None) for one in fresh["new"]]
    assert read_touch(bare, still).stiffness_both is None


def test_two_references_tell_something_and_say_that_what_is_between_is_not_known(given, fresh) -> None:
    """By a rigid plate and S3 alone S2 reads half as stiff again, and no interval could know."""
    found = read_touch(calibrate_compliance([given[0], given[3]]), fresh["S2"][:1])
    for one in (found.stiffness, found.stiffness_both, found.area):
        assert np.isfinite(one.value)
        assert not one.valid
        assert ReasonCode.TWO_REFERENCES in one.code
    assert_allclose(found.stiffness.value, KAPPA_N_M["S2"], rtol=0.7)


def test_an_inclined_calibration_tells_no_modulus(calibration, fresh) -> None:
    found = read_touch(replace(calibration, tilt_rad=0.5), fresh["S3"][:1])
    assert not found.modulus.valid
    assert "inclined" in found.modulus.why


def test_a_saved_calibration_is_the_same_and_reads_the_same(calibration, fresh, read, tmp_path) -> None:
    path = tmp_path / "tip.npz"
    calibration.save(path)
    again = ComplianceCalibration.load(path)
    assert again.id == calibration.id
    assert again.names == calibration.names
    assert again.note == "virtual"
    assert again.speed_m_s == calibration.speed_m_s
    assert_array_equal(again.touch.basis, calibration.touch.basis)
    found = read_touch(again, fresh["new"], "new")
    assert found.stiffness == read["new"].stiffness
    assert found.modulus == read["new"].modulus
    assert found.stiffness.calibration == calibration.id


def test_a_calibration_without_areas_is_saved_too(bare, tmp_path) -> None:
    bare.save(tmp_path / "bare.npz")
    again = ComplianceCalibration.load(tmp_path / "bare.npz")
    assert again.id == bare.id
    assert again.area is None


def test_the_id_is_of_the_contents(calibration) -> None:
    assert replace(calibration, note="another").id != calibration.id


def test_nothing_is_overwritten(calibration, tmp_path) -> None:
    path = tmp_path / "tip.npz"
    path.write_text("mine")
    with pytest.raises(ExistsError):
        calibration.save(path)
    assert path.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("kind", ["garbage", "empty", "other", "pickle", "cut", "format", "missing"])
def test_what_is_no_calibration_is_refused(calibration, tmp_path, kind) -> None:
    path = tmp_path / "tip.npz"
    calibration.save(path)
    whole = path.read_bytes()
    with np.load(path) as held:
        arrays = {name: held[name] for name in held.files}
    if kind == "garbage":
        path.write_bytes(b"no calibration at all" * 50)
    elif kind == "empty":
        path.write_bytes(b"")
    elif kind == "other":
        np.savez(path, a=np.ones(3))
    elif kind == "pickle":
        np.savez(path, **arrays | {"note": np.array({"run": "me"}, dtype=object)})
    elif kind == "cut":
        path.write_bytes(whole[: len(whole) // 2])
    elif kind == "format":
        np.savez(path, **arrays | {"format": np.array(99)})
    else:
        np.savez(path, **{name: value for name, value in arrays.items() if name != "layout_px"})
    with pytest.raises(CertificateError):
        ComplianceCalibration.load(path)


def test_a_file_that_is_not_there_is_said_to_be(tmp_path) -> None:
    with pytest.raises(StorageError):
        ComplianceCalibration.load(tmp_path / "none.npz")
