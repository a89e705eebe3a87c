"""Virtual trials as files: what the sensor made comes back from them."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from tests.refusals import refused

from palpate.core.errors import ExistsError, InputError, RangeError
from palpate.estimators.pins import find_pins, follow
from palpate.recordings.exchange.frame_sequences import TiffFrames
from palpate.recordings.exchange.press_folder import press_folder
from palpate.recordings.exchange.press_table import read_press_table
from palpate.rig.virtual.linear_rig import LINEAR_RIG
from palpate.sensors.tactip import tactip
from palpate.workflows.tactip_trials import at_finite_strain, record_press, record_trials, specimens_at


@pytest.fixture(scope="module")
def spec():
    return replace(tactip(), speed_m_s=20e-3)  # a quarter of the frames


@pytest.fixture(scope="module")
def folder(spec, tmp_path_factory):
    """One specimen, two trials, as runs too."""
    out = tmp_path_factory.mktemp("trials") / "presses"
    record_trials(out, spec, specimens_at(spec, {"S1": 7.6e3}), 2, seed=4, runs=True)
    return out


def made(spec, folder, press):
    seed = json.loads((folder / "virtual.json").read_text())["specimens"]["S1"]["presses"][press]["seed"]
    return record_press(spec, "S1=7.6", seed)


def test_a_press_is_recorded_as_the_report_records_it() -> None:
    made = record_press(tactip(), "S1=7.6", seed=3)
    assert_allclose(np.diff(made.time_s), 1 / 200)
    assert_allclose(np.diff(made.frame_sample), 10)
    steps = (made.raw_n - made.raw_n[0]) / 0.0625
    assert_allclose(steps, np.rint(steps), atol=1e-9)
    in_air = made.raw_n[made.true_approach_m < 0]
    assert abs(in_air.mean()) < 0.02  # tared, to less than its noise
    assert made.true_force_n[0] == 0
    assert made.true_force_n[-1] >= 5.2
    assert_allclose(np.diff(made.position_m), 5e-3 / 200, rtol=1e-9)
    frames = list(made.frames())
    assert frames[0].shape == (300, 300)
    assert frames[0].dtype == np.uint8
    assert_array_equal(made.frame(5), frames[5])
    again = record_press(tactip(), "S1=7.6", seed=3)
    assert_array_equal(again.raw_n, made.raw_n)


def test_pins_in_the_frames_are_where_the_press_says() -> None:
    made = record_press(tactip(), "S1=7.6", seed=4)
    frames = list(made.frames())
    first = find_pins(frames[0])
    truth, _ = made.points_px(0)
    order = [int(np.argmin(np.hypot(*(truth - xy).T))) for xy in first.xy_px]
    *_, last = follow(frames[1:], first)
    assert last.found.all()
    at, _ = made.points_px(len(frames) - 1)
    assert np.hypot(*(last.xy_px - at[order]).T).max() < 0.15


@pytest.fixture(scope="module")
def driven():
    """A press on the linear rig at the report's speed."""
    return record_press(tactip(), "S1=7.6", seed=3, rig=LINEAR_RIG)


def test_on_the_linear_rig_frames_and_force_are_of_where_the_tip_really_is(driven) -> None:
    """And the encoder tells where, to half a step to either side."""
    ideal, rig = record_press(tactip(), "S1=7.6", seed=3), LINEAR_RIG
    force = driven.sensor.on("S1=7.6").force_n(driven.true_approach_m)
    # the world's law is read along straight lines
    assert_allclose(driven.true_force_n, force, atol=2e-3)
    off = driven.position_m - driven.true_approach_m
    assert np.ptp(off) <= rig.quantum_m * (1 + 1e-9)
    steps = driven.position_m / rig.quantum_m
    assert_allclose(steps, np.rint(steps), atol=1e-6)
    assert_allclose(np.diff(driven.desired_m), 5e-3 / 200, rtol=1e-9)
    assert driven._contact(-1).pose.depth_m == driven.true_approach_m[-1]
    # from the air to the end of the press it comes to lag by the closed form, of its speeds and the load
    air, behind = int(np.argmax(driven.true_approach_m > 0)) - 1, driven.desired_m - driven.position_m
    speeds = [(driven.true_approach_m[i] - driven.true_approach_m[i - 20]) * 10 for i in (air, -1)]
    assert_allclose(speeds[0], 5e-3, rtol=0.02)
    expected = rig.lag_m(speeds[1], driven.true_force_n[-1]) - rig.lag_m(speeds[0])
    assert_allclose(behind[-1] - behind[air], expected, atol=2 * rig.quantum_m)
    assert len(driven.frame_sample) > len(ideal.frame_sample)  # the tip comes later to the same force
    assert_array_equal(ideal.desired_m, ideal.position_m)
    assert_array_equal(record_press(tactip(), "S1=7.6", 3, LINEAR_RIG).raw_n, driven.raw_n)


def test_a_motor_too_weak_for_a_press_is_told_of() -> None:
    with refused("force-range", RangeError, match="'linear'"):
        record_press(tactip(), "S1=7.6", 3, replace(LINEAR_RIG, stall_n_m=0.7e-3))
    with pytest.raises(InputError, match="whole number"):
        record_press(tactip(), "S1=7.6", 3, replace(LINEAR_RIG, control_hz=300.0))


def test_frames_force_position_and_area_come_back(spec, folder) -> None:
    (one,) = press_folder(folder).specimens
    assert (one.name, one.stiffness_n_m) == ("S1", pytest.approx(7.6e3))
    for tiff, path in one.presses:
        rig = made(spec, folder, path.stem)
        with TiffFrames(tiff) as pages:
            assert_array_equal(np.stack(list(pages)), np.stack(list(rig.frames())))
            table = read_press_table(path, len(pages))
        assert table.force_column == "force_raw_N"
        assert_array_equal(table.frame_sample, rig.frame_sample)
        # nine digits of newtons and millimetres
        assert_allclose(table.force_n, rig.raw_n, rtol=1e-8, atol=1e-12)
        assert_allclose(table.position_m, rig.position_m, rtol=1e-8)
        assert_allclose(table.area_m2, rig.true_area_m2, rtol=1e-8)


@pytest.mark.slow
def test_trials_differ_and_the_same_seed_makes_them_again_in_any_company(spec, folder, tmp_path) -> None:
    assert (folder / "S1" / "01.csv").read_bytes() != (folder / "S1" / "02.csv").read_bytes()
    both = specimens_at(spec, {"rigid": math.inf, "S1": 7.6e3})
    record_trials(tmp_path / "again", spec, both, 1, seed=4)
    for name in ("01.csv", "01.tif"):
        again = (tmp_path / "again" / "S1" / name).read_bytes()
        assert again == (folder / "S1" / name).read_bytes()


def test_stopped_or_refused_trials_leave_nothing(spec, tmp_path) -> None:
    def stop(what: str, done: int, total: int) -> None:
        raise KeyboardInterrupt

    pressed = specimens_at(spec, {"S1": 7.6e3})
    with pytest.raises(KeyboardInterrupt):
        record_trials(tmp_path / "a", spec, pressed, 2, progress=stop)
    for wrong in ({"specimens": {}}, {"trials": 0}, {"seed": -1}, {"specimens": {"../b": pressed["S1"]}}):
        with pytest.raises(InputError):
            record_trials(tmp_path / "a", spec, **{"specimens": pressed, **wrong})
    assert not list(tmp_path.iterdir())
    (tmp_path / "a").mkdir()
    with pytest.raises(ExistsError):
        record_trials(tmp_path / "a", spec, pressed)


@pytest.mark.parametrize("stiffness", [0.0, -1.0, math.nan, 0.5e3])
@pytest.mark.cases(1)
def test_a_stiffness_that_is_not_modelled_is_refused_in_its_unit(spec, stiffness) -> None:
    with refused("stiffness-range", RangeError, match=r"0\.942 N/mm"):
        specimens_at(spec, {"S9": stiffness})


def test_presses_of_two_laws_are_not_made_together(spec) -> None:
    both, tilt = {"rigid": math.inf, "S9": 1.0e3}, math.radians(30)
    assert at_finite_strain(spec, both.values(), tilt) == spec
    assert at_finite_strain(spec, [math.inf], math.radians(29)) == spec
    assert at_finite_strain(spec, [math.inf], 0.0) == spec
    with refused("laws-mixed", RangeError):
        specimens_at(replace(spec, friction=0.0), both, tilt)


SLOW_BODY = "viscous:E_MPa=0.1,E1_MPa=0.1,tau1_s=0.3"


@pytest.mark.slow
def test_a_viscous_specimens_force_falls_while_the_tip_stands_still() -> None:
    spec = tactip()
    (slow, soft) = specimens_at(spec, {"slow": SLOW_BODY, "soft": 3.1e3}).values()
    held, elastic = (record_press(spec, words, 3, hold_s=3.0) for words in (slow, soft))
    first = int(np.argmax(held.true_force_n))
    assert held.true_force_n[first] == pytest.approx(5.2, abs=0.15)
    relaxed = spec.table.press(0.1e6).force_at(held.true_approach_m[-1:])[0]
    assert_allclose(held.true_force_n[-1], relaxed, rtol=0.01)
    assert held.true_force_n[-1] < 0.93 * held.true_force_n[first]
    assert held.true_area_m2[-1] < held.true_area_m2[first]
    assert_allclose(np.ptp(elastic.true_force_n[-500:]), 0.0, atol=1e-9)
    assert len(held.frame_sample) > 60


def test_a_viscous_specimen_is_refused_where_it_is_not_modelled() -> None:
    (words,) = specimens_at(tactip(), {"slow": SLOW_BODY}).values()
    with pytest.raises(InputError, match="way back"):
        record_press(tactip(), words, 3, back=True)
    with pytest.raises(InputError, match="linear rig"):
        record_press(tactip(), words, 3, LINEAR_RIG)
    with refused("hold", RangeError, match="60 s"):
        record_press(tactip(), words, 3, hold_s=-1.0)
    with pytest.raises(InputError, match="head-on"):
        specimens_at(tactip(), {"slow": SLOW_BODY}, math.radians(20)).values()
    with pytest.raises(InputError, match="head-on"):
        specimens_at(tactip(), {"ball": "sphere:R_mm=30"}, math.radians(20))


def test_files_hold_the_truth_of_spheres_and_layers(spec, tmp_path) -> None:
    bodies = {
        "S1": 7.6e3,
        "ball": "sphere:R_mm=30,E_MPa=0.15",
        "new": "sphere:R_mm=25",
        "sheet": "layer:h_mm=2,E_MPa=0.1",
    }
    record_trials(tmp_path / "a", spec, specimens_at(spec, bodies), 1, unknown=["new"])
    found = {one.name: one for one in press_folder(tmp_path / "a").specimens}
    plane = 1 - spec.table.poisson_ratio**2
    assert_allclose(found["ball"].body.modulus_pa, 0.15e6 / plane, rtol=1e-8)
    assert_allclose(found["ball"].body.radius_m, 30e-3)
    assert found["ball"].stiffness_n_m is None
    assert found["S1"].body.radius_m == math.inf
    assert not found["new"].body.known
    assert not found["sheet"].body.known
    truth = json.loads((tmp_path / "a" / "virtual.json").read_text())["specimens"]
    assert (truth["new"]["shape"], truth["new"]["reduced_modulus_MPa"]) == ("sphere", "inf")
    assert truth["new"]["radius_mm"] == pytest.approx(25)
    assert truth["sheet"]["thickness_mm"] == pytest.approx(2)
    assert truth["sheet"]["youngs_modulus_MPa"] == pytest.approx(0.1)


def test_a_tilt_beyond_the_model_is_refused(spec) -> None:
    with refused("tilt", InputError, match="50 degrees"):
        specimens_at(spec, {"S1": 7.6e3}, math.radians(60))
