"""Presses by their pins' centres are those that rendered frames give, with nuisances as they are stated."""

import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial import cKDTree

from palpate.calibration.compliance.press_nuisances import ALTER, Nuisances
from palpate.estimators.compliance.pin_press import at_forces, follow_press
from palpate.sensors.tactip import fitted_tactip
from palpate.workflows.tactip_trials import record_press

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from centre_presses import NOISE_PX, CentrePress

SIZES = Nuisances()
LEVELS_N = np.array([1.5, 3.0, 4.5])


@pytest.fixture(scope="module")
def pressed() -> CentrePress:
    return CentrePress(record_press(fitted_tactip(), "A=5.3", 3))


@pytest.fixture(scope="module")
def plain(pressed):
    return pressed.press({})


def test_a_centre_press_has_the_frames_forces_and_noise_of_a_rendered_one(pressed, plain) -> None:
    made = pressed.made
    seen = follow_press(made.frames(), made.raw_n, made.frame_sample, made.position_m, made.time_s)
    assert (seen.frame == plain.frame).all()
    assert_allclose(seen.force_n, plain.force_n)
    assert_allclose(seen.position_m, plain.position_m)
    true = np.stack([made.points_px(int(frame))[0] for frame in plain.frame]) - made.points_px(0)[0]
    _, which = cKDTree(seen.untouched_px).query(made.points_px(0)[0])
    noise = [np.sqrt(np.mean((moved - true) ** 2)) for moved in (seen.moved_px[:, which], plain.moved_px)]
    assert_allclose(noise[1], noise[0], rtol=0.15)
    assert noise[1] > NOISE_PX[331]  # the untouched pins have noise of their own


@pytest.mark.parametrize("name", [name for name in ALTER if name != "late_s"])
@pytest.mark.cases(2)
def test_a_nuisance_of_a_press_is_what_the_intervals_take_it_for(pressed, plain, name) -> None:
    """The noise is the same in both. A zero of the force too high by its size is refused: here too low."""
    size = -getattr(SIZES, name)
    made, altered = pressed.press({name: size}), ALTER[name](plain, size)
    moved, same = (at_forces(press.force_n, press.moved_px, LEVELS_N) for press in (made, altered))
    assert_allclose(moved, same, atol=2e-3)
    place, there = (at_forces(press.force_n, press.position_m, LEVELS_N) for press in (made, altered))
    assert_allclose(place - place[0], there - there[0], atol=1e-6)
    if name != "frame_yield_m_n":
        assert np.abs(same - at_forces(plain.force_n, plain.moved_px, LEVELS_N)).max() > 0.1


def test_late_frames_show_an_earlier_moment(pressed, plain) -> None:
    late = pressed.press({"late_s": 0.05})
    moved, usual = (
        at_forces(press.force_n, np.abs(press.moved_px).mean(axis=(1, 2))[:, None], LEVELS_N)
        for press in (late, plain)
    )
    assert (moved < usual).all()
    undone = ALTER["late_s"](late, -0.05)
    again = at_forces(undone.force_n, np.abs(undone.moved_px).mean(axis=(1, 2))[:, None], LEVELS_N)
    assert (np.abs(again - usual) < 0.4 * np.abs(moved - usual)).all()


def test_a_force_whose_zero_is_too_low_takes_no_touched_frame_for_untouched(pressed) -> None:
    """Pins near the apex move before 0.1 N are felt, and motion is counted from the untouched ones."""
    low = pressed.press({"force_bias_n": -0.05})
    rest, _ = pressed.made.points_px(0)
    assert np.abs(low.untouched_px - rest).max() < 4 * NOISE_PX[331]
