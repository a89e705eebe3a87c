"""A force that is late under current timestamps is found in the first touch, before anything is pressed."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.rig.altered_force import AlteredForce
from tests.rig.guarded_presses import CENTRE, NoRecorder, PressBench
from tests.rig.rigs import near, plan

from palpate.core.sensor import for_rig, sensor as sensor_of
from palpate.devices import MotionGuard, OperatorControl, Reason, Tripped
from palpate.recordings import Run
from palpate.rig import State, record
from palpate.rig.force_lag import LAGS_S, lag_of
from palpate.rig.plans import Listed, StepHold
from palpate.rig.plans.recording_plan import PlannedPress
from palpate.rig.press_motion import PressMotion
from palpate.rig.run_progress import TOUCH, ZERO, fields_of
from palpate.rig.virtual.virtual_bench import default_variation

SENSORS = ("palm", "tactip", "nusense")
STEP_S = 0.005  # between two lags that are tried


class Events(NoRecorder):
    """Takes events, and keeps the fields of the last."""

    def __init__(self) -> None:
        super().__init__()
        self.last: dict[str, Any] = {}

    def event(self, kind: str, **fields: Any) -> None:
        self.last = fields


def touched(sensor: str, delay_s: float, noise: float = 1.0, seed: int = 0, latency_s: float = 0.01) -> Any:
    """The fields of a gentle touch with a late force; or what ended it."""
    usual = default_variation(for_rig(sensor_of(sensor)), sensor)
    variation = replace(usual, force_noise_n=noise * usual.force_noise_n)
    sigma_n = float(np.hypot(variation.force_noise_n, variation.force_step_n / np.sqrt(12)))
    places = Listed(kind="listed", at_mm=((0.0, 0.0),))
    of = StepHold(places=places, taps=0, threshold_N=max(0.05, 6 * sigma_n))
    bench = PressBench(sensor, of, variation=variation, seed=seed)
    force, limits = AlteredForce(bench.rig.force, bench.clock, delay_s), bench.rig.limits
    there: Any = replace(bench.rig, force=force, limits=replace(limits, force_latency_s=latency_s))
    events: Any = Events()
    guard = MotionGuard(there.stage, force, limits, bench.bias, bench.clock, OperatorControl())
    motion = PressMotion(there, of, guard, bench.bias, events)
    try:
        motion.try_sensor(PlannedPress(CENTRE, 1, bench.indenter))
    except Tripped as e:
        return e
    return events.last


@pytest.mark.parametrize("delay_s", [0.05, 0.1, 0.15])
@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.cases(3)
def test_a_force_that_is_late_is_found_in_the_touch_with_its_lag(sensor: str, delay_s: float) -> None:
    tripped = touched(sensor, delay_s)
    if (sensor, delay_s) == ("palm", 0.15):  # the monitor is first: nothing has fallen yet on the way back
        assert tripped.reason is Reason.FORCE_DEAD
        return
    assert tripped.reason is Reason.FORCE_LAG
    assert tripped.numbers["lag_s"] == pytest.approx(delay_s, abs=3 * STEP_S)
    assert tripped.numbers["allowed_s"] < tripped.numbers["least_s"] <= tripped.numbers["lag_s"]


@pytest.mark.parametrize("delay_s", [0.0, 0.01])
@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.cases(2)
def test_a_force_that_is_in_time_is_believed_with_its_lag(sensor: str, delay_s: float) -> None:
    fields = touched(sensor, delay_s)
    assert fields["lag_s"] == pytest.approx(delay_s, abs=3 * STEP_S)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.5, 2.0])
@pytest.mark.parametrize("sensor", SENSORS)
def test_detection_holds_at_other_noises(sensor: str, noise: float) -> None:
    """By either detector; 50 ms is within the interval of the TacTip's lag at twice its noise.

    At half its noise, the TacTip's force sensor may read one value in the air and is refused before it moves.
    """
    coarse = 0
    for seed in range(5):
        late = [touched(sensor, one, noise, seed) for one in (0.1, 0.15)]
        in_time = [touched(sensor, one, noise, seed) for one in (0.0, 0.005, 0.01)]
        if all(getattr(one, "reason", None) is Reason.FORCE_COARSE for one in late + in_time):
            coarse += 1
            continue
        assert all(getattr(one, "reason", None) in (Reason.FORCE_LAG, Reason.FORCE_DEAD) for one in late)
        assert all(isinstance(one, dict) for one in in_time)
    assert coarse < 5
    assert coarse == 0 or (sensor, noise) == ("tactip", 0.5)


def test_a_latency_that_the_rig_states_is_no_fault() -> None:
    assert touched("palm", 0.1, latency_s=0.1)["lag_s"] == pytest.approx(0.1, abs=STEP_S)


def test_no_press_begins_under_a_late_force(tmp_path: Path) -> None:
    sound = near()
    late = replace(sound, force=AlteredForce(sound.force, sound.clock, 0.1))
    outcome = record(late, plan(cycles=1), tmp_path / "run")
    assert (outcome.state, outcome.shots) == (State.FAILED, 0)
    assert outcome.reason in (Reason.FORCE_LAG, Reason.FORCE_DEAD)  # both detectors judge the gentle touch
    run = Run.open(tmp_path / "run")
    assert fields_of(run, ZERO) == fields_of(run, TOUCH) == []


class TestLagOf:
    """The estimate alone."""

    t = np.arange(0.0, 1.6, 0.005)
    depth = 1e-3 * np.interp(t, [0.1, 0.6, 0.8, 1.3], [-0.5, 0.5, 0.5, -0.5])

    def force(self, lag_s: float) -> np.ndarray:
        return 1e3 * np.maximum(np.interp(self.t - lag_s, self.t, self.depth), 0.0)

    @pytest.mark.parametrize("lag_s", [-0.02, 0.0, 0.03, 0.12, 0.25])
    def test_the_lag_of_noise_and_a_known_delay_lies_in_its_interval(self, lag_s: float) -> None:
        noise = 0.02 * np.random.default_rng(5).standard_normal(len(self.t))
        lag = lag_of(self.t, self.force(lag_s) + noise, self.t, self.depth)
        assert lag is not None
        assert lag.least_s - STEP_S <= lag_s <= lag.greatest_s + STEP_S
        assert lag.greatest_s - lag.least_s < 0.05

    def test_a_skin_that_dissipates_is_never_late(self) -> None:
        force = self.force(0.0)
        relaxed = np.zeros(len(force))
        for i in range(1, len(force)):  # 30 % of the modulus relaxes in 0.1 s
            relaxed[i] = np.exp(-0.05) * relaxed[i - 1] + 0.3 * (force[i] - force[i - 1])
        lag = lag_of(self.t, np.maximum(force + relaxed, 0.0), self.t, self.depth)
        assert lag is not None
        assert lag.least_s <= lag.lag_s <= 0.0

    def test_many_samples_are_averaged_and_few_give_no_lag(self) -> None:
        dense = np.arange(0.0, 1.6, 0.0002)
        force = np.interp(dense, self.t, self.force(0.1))
        lag = lag_of(dense, force, self.t, self.depth)
        assert lag is not None
        assert lag.lag_s == pytest.approx(0.1, abs=STEP_S)
        assert lag_of(self.t[:10], force[:10], self.t, self.depth) is None
        assert LAGS_S[0] < 0.0 < LAGS_S[-1]
