"""Force and stage at 125 Hz beside 12 frames a second: each frame has the force of its own exposure."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from tests.refusals import refused
from tests.rig.rigs import SPEC, near

from palpate.core import InputError, RangeError
from palpate.recordings import Offset, Run, mean_over_exposures
from palpate.rig import State, record
from palpate.rig.plans import Listed, Ramp
from palpate.rig.virtual.virtual_camera import TRANSPORT_S
from palpate.rig.virtual.virtual_force import LATENCY_S
from palpate.sensors.palm.palm_sensor import Palm

FORCE_HZ, FRAMES_HZ = 125.0, 12.0
SPEED_MM_S = 5.0
CENTRE = Listed(kind="listed", at_mm=((0.0, 0.0),))
NOISE_N = 4e-4  # four of the rig's own


class SlowPalm(Palm):
    """Palm that is filmed as the NUSense is."""

    @property
    def rate_hz(self) -> float:
        return FRAMES_HZ


@dataclass
class Swept:
    """A sweep and its taps; force and depth as recorded, and the truth at the middle of each exposure."""

    offset: Offset
    force_t: np.ndarray
    force: np.ndarray
    stage_t: np.ndarray
    z_mm: np.ndarray
    frame_t: np.ndarray
    exposure_s: float
    true_n: np.ndarray
    true_mm: np.ndarray
    labelled_n: np.ndarray

    def force_at(self, offset_s: float) -> np.ndarray:
        return mean_over_exposures(
            self.force_t, self.force, self.frame_t, exposure_s=self.exposure_s, offset_s=offset_s
        )

    def error_n(self, offset_s: float) -> float:
        return float(np.abs(self.force_at(offset_s) - self.true_n).max())

    @property
    def slope_n_s(self) -> float:
        """Greatest slope of the true force [N/s]."""
        return float(np.abs(np.diff(self.true_n)).max() * FRAMES_HZ)


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Swept:
    sweep = Ramp(
        name="sweep", kind="swept", places=CENTRE, cycles=1, speed_mm_s=SPEED_MM_S, depth_mm=3.0, taps=5
    )
    out = tmp_path_factory.mktemp("swept") / "run"
    outcome = record(near(sensor=SlowPalm(SPEC), force_hz=FORCE_HZ), sweep, out)
    assert outcome.state is State.DONE
    assert outcome.clocks is not None
    run = Run.open(out)
    force, stage, labels = run.force(), run.stage(), run.labels
    force_t, stage_t = force["time_s"].to_numpy(), stage["time_s"].to_numpy()
    _, first = np.unique(np.floor(stage_t * FORCE_HZ), return_index=True)  # as an arm tells its place
    assert np.median(np.diff(force_t)) == pytest.approx(1 / FORCE_HZ)
    assert np.median(np.diff(run.times_s)) == pytest.approx(1 / FRAMES_HZ, rel=0.01)
    return Swept(
        outcome.clocks, force_t, force["fz_N"].to_numpy(), stage_t[first],
        1e3 * stage["z_m"].to_numpy()[first], run.times_s, float(run.frame(0).exposure_s or 0.0),
        labels["true_force_N"].to_numpy(), labels["true_depth_mm"].to_numpy(), labels["force_N"].to_numpy(),
    )  # fmt: skip


@pytest.mark.slow
def test_taps_at_12_frames_a_second_tell_the_clocks_apart(swept: Swept) -> None:
    assert swept.offset.low_s < TRANSPORT_S - LATENCY_S < swept.offset.high_s
    assert swept.offset.high_s - swept.offset.low_s < 2e-3


def test_a_frames_force_is_that_of_its_own_exposure(swept: Swept) -> None:
    offset = swept.offset
    wrong_s = max(offset.high_s - offset.seconds, 1e-4)
    # Bend: from no slope to the greatest in half a period of the frames. The truth is of the middle alone.
    bend_n = 2 * swept.slope_n_s * FRAMES_HZ * (1 / FORCE_HZ**2 / 8 + swept.exposure_s**2 / 24)
    allowed_n = swept.slope_n_s * wrong_s + bend_n + NOISE_N
    assert allowed_n < 0.05
    assert swept.error_n(offset.seconds) <= allowed_n


def test_a_latency_of_the_wrong_sign_or_left_out_breaks_it(swept: Swept) -> None:
    right, out, wrong = (swept.error_n(s * swept.offset.seconds) for s in (1.0, 0.0, -1.0))
    assert wrong > 0.9 * 2 * swept.offset.seconds * swept.slope_n_s * 0.8
    assert right < out / 3 < wrong / 5


def test_a_frames_depth_is_that_of_its_own_exposure(swept: Swept) -> None:
    def worst_mm(offset_s: float) -> float:
        z_mm = mean_over_exposures(
            swept.stage_t,
            swept.z_mm,
            swept.frame_t,
            exposure_s=swept.exposure_s,
            offset_s=offset_s,
            most_gap_s=1.0,  # a stage that stands is not asked
        )
        touching = swept.true_mm > 0.2
        gone = (z_mm - swept.true_mm)[touching]
        return float(np.abs(gone - np.median(gone)).max())

    # The stage tells where it is now: its stamps are late by nothing, a frame's by its whole way.
    assert worst_mm(TRANSPORT_S) < 0.01
    assert worst_mm(-TRANSPORT_S) > 0.9 * 2 * TRANSPORT_S * SPEED_MM_S


@settings(max_examples=40, deadline=None)
@given(st.floats(-0.2, 0.2), st.floats(0.0, 0.05), st.floats(0.3, 3.0), st.floats(0.0, 6.0))
def test_the_stated_error_of_a_bent_force_holds(offset_s, exposure_s, turns_hz, phase) -> None:
    t = np.arange(0.0, 4.0, 1 / FORCE_HZ)
    w = 2 * np.pi * turns_hz
    frames = np.arange(1.0, 3.0, 1 / FRAMES_HZ)
    ends = frames - offset_s
    if exposure_s < 1e-6:
        exposure_s, true = 0.0, np.sin(w * ends + phase)
    else:
        true = (np.cos(w * (ends - exposure_s) + phase) - np.cos(w * ends + phase)) / (w * exposure_s)
    found = mean_over_exposures(t, np.sin(w * t + phase), frames, exposure_s=exposure_s, offset_s=offset_s)
    assert np.abs(found - true).max() <= w**2 / FORCE_HZ**2 / 8 + 1e-9


def test_frames_outside_or_in_a_gap_are_refused() -> None:
    t = np.concatenate([np.arange(0.0, 1.0, 0.008), np.arange(1.2, 2.0, 0.008)])
    kwargs = {"exposure_s": 0.01, "offset_s": 0.0}
    mean_over_exposures(t, t, np.array([0.5, 1.5]), **kwargs)
    with refused("frames-without-force", RangeError):
        mean_over_exposures(t, t, np.array([0.5, 1.1]), **kwargs)
    with refused("frames-without-force", RangeError):
        mean_over_exposures(t, t, np.array([0.005]), **kwargs)
    with refused("frames-without-force", RangeError):
        mean_over_exposures(t, t, np.array([1.99]), exposure_s=0.01, offset_s=-0.01)
    with pytest.raises(InputError, match="finite"):
        mean_over_exposures(t, t, np.array([np.nan]), **kwargs)
