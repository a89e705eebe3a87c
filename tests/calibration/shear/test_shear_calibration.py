"""Laws of a force calibration of a patterned skin, against the virtual pad's truth."""

from dataclasses import replace

import numpy as np
import pytest
from tests.virtual_shears import VirtualPad, slow_presses

from palpate.calibration.shear import ForceFollower, ShearCalibration, calibrate_shear
from palpate.calibration.shear.shear_calibration import PAD_STIFFNESS
from palpate.core import CertificateError, ExistsError, InputError, RangeError
from palpate.estimators.lattice import ControlPoints

PAD = VirtualPad()
SPEC = PAD.sensor.spec


@pytest.fixture(scope="module")
def presses():
    return slow_presses(PAD, 60, 1, ("round", "flat"))


@pytest.fixture(scope="module")
def calibrated(presses):
    return {law: fitted(presses, law) for law in ("published", "any-tip")}


def fitted(presses, law="any-tip", **words):
    return calibrate_shear(presses, PAD.reference, SPEC.lens, SPEC.camera_m, law=law, **words)


@pytest.fixture(scope="module")
def unseen():
    return slow_presses(PAD, 30, 2, ("round", "flat"), low_n=1.3, high_n=7.7, shift=0.5)


def errors(calibration, samples):
    readings = [calibration.read(cues) for cues in samples.cues]
    return np.array([r.value for r in readings]) - samples.force_n, readings


def test_force_of_unseen_presses_comes_back(calibrated, unseen):
    """Both tips, other places and forces: 0.15 N in the mean, where the published cue alone leaves more."""
    same_pad = replace(calibrated["any-tip"], scale_error=1e-6)  # whose stiffness is as it was
    off, readings = errors(same_pad, unseen)
    baseline, _ = errors(calibrated["published"], unseen)
    assert np.abs(off).mean() < 0.15
    assert np.abs(baseline).mean() > 2 * np.abs(off).mean()
    held = [r.contains(f) for r, f in zip(readings, unseen.force_n, strict=True) if r.valid]
    assert len(held) > 24
    assert 0.8 < np.mean(held) < 0.98


def test_shuffled_forces_are_not_learnt(presses):
    """The control: forces of other presses leave the spread of the forces themselves."""
    mixed = replace(presses, force_n=np.random.default_rng(0).permutation(presses.force_n))
    assert fitted(mixed).mae_n[0] > 0.8 * np.abs(presses.force_n - presses.force_n.mean()).mean()


def test_a_reading_outside_the_calibration_is_not_valid(calibrated):
    calibration = calibrated["any-tip"]
    rng, meter = np.random.default_rng(4), PAD.meter()

    def read(x, y, depth, tip="round"):
        return calibration.read(meter.cues(PAD.marks(PAD.contact(tip, x, y, depth), rng)))

    assert read(2e-3, 1e-3, 1.2e-3).valid
    below, above, beside = read(0.0, 0.0, 0.45e-3), read(0.0, 0.0, 2.0e-3), read(19e-3, 1e-3, 1.2e-3)
    two, none = read(0.0, 0.0, 1.0e-3, "two-points:6:16"), read(0.0, 0.0, 0.0)
    for reading, code in (
        (below, "out_of_range"),
        (above, "out_of_range"),
        (beside, "outside_calibrated_area"),
        (two, "several_contacts"),
        (none, "no_contact"),
    ):
        assert not reading.valid
        assert reading.code == code
    assert none.value == 0.0
    assert calibration.range_n[0] >= 1.0


def test_a_kept_calibration_reads_the_same(calibrated, unseen, tmp_path):
    calibration = calibrated["any-tip"]
    path = tmp_path / "pad.npz"
    calibration.save(path)
    again = ShearCalibration.load(path)
    assert again.id == calibration.id
    for cues in unseen.cues[:5]:
        assert again.read(cues).to_dict() == calibration.read(cues).to_dict()
    with pytest.raises(ExistsError):
        calibration.save(path)
    assert replace(calibration, scale=1.01).id != calibration.id


def test_a_damaged_file_is_refused(calibrated, tmp_path):
    whole, cut, other = (tmp_path / name for name in ("whole.npz", "cut.npz", "other.npz"))
    calibrated["any-tip"].save(whole)
    cut.write_bytes(whole.read_bytes()[:-200])
    np.savez(other, format=np.array(1), nothing=np.zeros(3))
    for path in (cut, other):
        with pytest.raises(CertificateError):
            ShearCalibration.load(path)


def test_marks_are_read_against_todays_reference(calibrated):
    """A pattern that sits 0.3 px elsewhere today reads the same force, and its drift is told."""
    calibration, rng = calibrated["any-tip"], np.random.default_rng(5)
    contact = PAD.contact("round", 1e-3, 2e-3, 1.2e-3)
    shift = np.array([0.6, 0.5])
    moved, rest = PAD.marks(contact, rng), PAD.reference
    today = ControlPoints(rest.cells, rest.places + shift, rest.sigma)
    seen = ControlPoints(moved.cells, moved.places + shift, moved.sigma)
    reading = ForceFollower(calibration, today).read(seen, 0.0)
    assert reading.value == pytest.approx(contact.force_n, abs=0.3)
    assert reading.drift.drifted
    assert not ForceFollower(calibration, rest).read(moved, 0.0).drift.drifted


def test_too_little_to_learn_from_is_refused(presses):
    few = slow_presses(PAD, 8, 3)
    with pytest.raises(InputError):
        fitted(few, "published")
    with pytest.raises(InputError):
        fitted(presses, "cubic")
    with pytest.raises(InputError):
        fitted(presses, coverage=1.0)
    with pytest.raises(InputError, match="without contact on"):
        fitted(presses, hysteresis=True)


def test_a_copy_has_wider_intervals_until_a_weight_is_laid(calibrated, unseen):
    calibration = calibrated["any-tip"]
    copy = calibration.on_copy(0.20)
    for cues, force in zip(unseen.cues[:10], unseen.force_n, strict=False):
        own, other = calibration.read(cues), copy.read(cues)
        assert other.value == own.value
        half, wide = (own.high - own.low) / 2, (other.high - other.low) / 2
        more = np.sqrt(0.20**2 - PAD_STIFFNESS**2)
        assert wide == pytest.approx(np.hypot(half, 1.645 * more * own.value), rel=1e-3)
        assert force > 0
    assert calibration.on_copy().stiffness_error > calibration.stiffness_error
    with pytest.raises(RangeError):
        calibration.on_copy(0.0)
    with pytest.raises(RangeError):
        calibration.weighed(unseen.cues[:1], 50.0)


@pytest.mark.slow
@pytest.mark.parametrize("number", ["4", "8"])
def test_one_known_weight_tells_a_copys_stiffness(calibrated, number):
    """A softer and a stiffer copy: within 0.15 N after, twice as far off before, within the wide interval."""
    calibration, pad = calibrated["any-tip"], VirtualPad(number, 1)
    samples = slow_presses(pad, 30, 5, ("round", "flat"), low_n=1.6, high_n=7.0)
    weight = pad.contact("round", 0.0, 0.0, 1.2e-3)
    laid = [pad.meter().cues(pad.marks(weight, np.random.default_rng(i))) for i in range(3)]
    before, wide = errors(calibration.on_copy(), samples)
    after, narrow = errors(calibration.weighed(laid, weight.force_n, 0.01 * weight.force_n), samples)
    assert np.abs(after).mean() < min(0.15, 0.5 * np.abs(before).mean())
    for readings in (wide, narrow):
        assert np.mean([r.contains(f) for r, f in zip(readings, samples.force_n, strict=True)]) > 0.9
    assert np.mean([r.high - r.low for r in narrow]) < 0.5 * np.mean([r.high - r.low for r in wide])


@pytest.mark.parametrize(("error_n", "lays"), [(np.nan, 1), (np.inf, 1), (-0.01, 1), (0.01, 0)])
def test_a_weight_has_a_finite_error_and_is_laid(calibrated, error_n, lays):
    pad = VirtualPad()
    cues = [pad.meter().cues(pad.marks(pad.contact("round", 0.0, 0.0, 1.2e-3), np.random.default_rng(1)))]
    with pytest.raises(RangeError, match="lays of a weight"):
        calibrated["any-tip"].weighed(cues, 4.0, error_n, lays=lays)


def test_a_pad_of_half_the_modulus_is_within_three_half_widths_until_a_weight_is_laid(calibrated):
    """No frame shows the stiffness: the interval holds the stated 12 %, and a weight the pad's own."""
    calibration, soft = calibrated["any-tip"], VirtualPad("soft")
    assert "stiffness within 12 %" in calibration.assumes
    weight = soft.contact("round", 0.0, 0.0, 1.2e-3)
    meter, rng = soft.meter(), np.random.default_rng(1)
    weighed = calibration.weighed(
        [meter.cues(soft.marks(weight, rng))], weight.force_n, 0.01 * weight.force_n
    )
    for depth in np.linspace(0.9e-3, 1.4e-3, 20):
        contact = soft.contact("round", 2e-3, -1e-3, depth)
        cues = meter.cues(soft.marks(contact, rng))
        one, told = calibration.read(cues), weighed.read(cues)
        assert not one.valid or abs(one.value - contact.force_n) < 1.5 * (one.high - one.low)
        assert not told.valid or abs(told.value - contact.force_n) < 1.5 * (told.high - told.low)
