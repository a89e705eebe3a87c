"""A force that is not believed: in every phase of a press each fault stops within its way and has its
name."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.rig.guarded_presses import CENTRE, MM, AlteredForce, ChangedForce, NoRecorder, PressBench, stop_of
from tests.rig.rigs import CLEARANCE_MM, CLOCK_NS, near, plan
from tests.slow_params import mostly_slow

from palpate.core import NS_PER_S, Position, Wrench
from palpate.core.sensor import for_rig, force_law, sensor, sensor as sensor_of
from palpate.devices import MotionGuard, OperatorControl, Reason, Tripped
from palpate.devices.force_trust import ForceMonitor
from palpate.recordings import Run, check
from palpate.rig import PLANS, State, record
from palpate.rig.force_checks import LAGS_S, lag_of
from palpate.rig.plans import Known, Listed, StepHold
from palpate.rig.plans.recording_plan import PlannedPress
from palpate.rig.press_motion import PressMotion
from palpate.rig.run_progress import TOUCH, ZERO, fields_of
from palpate.rig.virtual import Variation, virtual_rig
from palpate.rig.virtual.virtual_bench import default_variation
from palpate.rig.virtual.virtual_sensors import BIAS_N

ALLOWED_MM = 0.2  # from the step at which the force read is five standard deviations off
ALLOWED_COARSE_MM = 0.3  # whose quantum is thrice its noise: before contact, and on a soft specimen
NAMES = {
    "force-stuck": "force-stuck", "force-dead": "force-dead", "force-reversed": "force-reversed",
    "force-scaled": "force-scaled", "force-held-back": "force-late", "force-slow": "force-slow",
}  # fmt: skip
PHASES = ("seek", "press", "hold", "slide", "retreat")
Go = Callable[[], object]


def palm(seed: int) -> PressBench:
    """A palm whose sensor was tried and that was pressed once, over a place again with its zero taken."""
    bench = PressBench("palm", seed=seed, variation=Variation())
    bench.touch()
    bench.stepped(2e-3, 0.5e-3, 0.1)
    bench.approach()
    return bench


def palm_until(bench: PressBench, phase: str) -> Go:
    """Bring a press as far as a phase; what comes next is returned."""
    if phase == "seek":
        x, y, _ = bench.guard.position_m()
        bench.guard.towards((x, y, -0.05 * MM), 2e-3, step_m=0.02e-3)
        return lambda: (bench.seek(), bench.depth(3e-3))
    bench.seek()
    if phase == "press":
        bench.depth(0.7e-3)
        return lambda: bench.depth(4e-3)
    if phase == "hold":
        bench.depth(1.5e-3)
        bench.guard.wait(0.1)
        return lambda: (bench.guard.wait(1.0), bench.depth(3e-3))
    if phase == "slide":
        bench.depth(0.8e-3)
        return lambda: (
            [bench.motion.aside(x, 0.0, 0.5e-3) for x in (0.2e-3, 0.4e-3, 0.0)],
            bench.depth(1.5e-3),
        )
    bench.depth(2e-3)
    bench.depth(1.7e-3)
    return lambda: bench.depth(-0.2e-3)


def tip(seed: int, indenter: str = "rigid") -> PressBench:
    bench = PressBench("tactip", PLANS["tactip"], seed=seed, indenter=indenter)
    bench.touch()
    bench.swept(5.1, 11e-3)
    bench.approach()
    return bench


def tip_until(bench: PressBench, phase: str) -> Go:
    x, y, top = bench.guard.position_m()

    def down(until_n: float) -> None:
        bench.guard.towards((x, y, 11e-3), 5e-3, lambda force: force[2] >= until_n, step_m=11e-3 - top)

    def up(z: float) -> None:
        bench.guard.away((x, y, z), 5e-3)

    if phase == "seek":
        bench.guard.towards((x, y, -0.2e-3), 5e-3)
        return lambda: bench.sweep(5.1, 11e-3)
    down(5.1 if phase == "retreat" else 1.0)
    if phase == "press":
        return lambda: bench.sweep(5.1, 11e-3)
    if phase == "hold":
        bench.guard.wait(0.1)
        return lambda: (bench.guard.wait(1.0), bench.sweep(5.1, 11e-3))
    up(bench.guard.position_m()[2] - 0.3e-3)
    return lambda: up(top)


# A third of them in every run: each fault in one or two phases, each phase with two faults.
@pytest.mark.parametrize(
    ("kind", "phase"),
    mostly_slow([(kind, phase) for kind in NAMES for phase in PHASES], lambda i: i % 3 == 0),
)
@pytest.mark.cases(3)
def test_on_the_palm_each_fault_stops_within_its_way_and_has_its_name(kind: str, phase: str) -> None:
    bench = palm(seed=3)
    stop = stop_of(bench, kind, palm_until(bench, phase))
    assert stop.reason == NAMES[kind], bench.message
    assert stop.after_m <= ALLOWED_MM * MM


@pytest.mark.slow
@pytest.mark.parametrize("phase", [phase for phase in PHASES if phase != "slide"])
@pytest.mark.parametrize("kind", NAMES)
@pytest.mark.parametrize("indenter", ["rigid", "S3=1.1"])
def test_on_the_tactip_too_at_5_mm_s_under_a_coarse_sensor(kind: str, phase: str, indenter: str) -> None:
    bench = tip(1, indenter)
    stop = stop_of(bench, kind, tip_until(bench, phase))
    assert stop.reason == NAMES[kind], bench.message
    coarse = (kind, phase) == ("force-reversed", "seek") or (
        (kind, phase) == ("force-stuck", "press") and indenter != "rigid"
    )
    assert stop.after_m <= (ALLOWED_COARSE_MM if coarse else ALLOWED_MM) * MM


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["force-stuck", "force-scaled", "force-held-back", "force-reversed"])
def test_without_the_monitor_the_same_faults_are_pressed_on(kind, monkeypatch):
    """The negative control: what is tested is the monitor, not the limits."""
    bench = palm(seed=3)
    go = palm_until(bench, "press")
    monkeypatch.setattr(ForceMonitor, "take", lambda self, sample: None)
    monkeypatch.setattr(ForceMonitor, "oldest_s", property(lambda self: 1.0))
    stop = stop_of(bench, kind, go)
    assert stop.reason == ""
    assert bench.motion.contact_m is not None
    assert bench.guard.position_m()[2] - bench.motion.contact_m == pytest.approx(4e-3, abs=1e-5)


@pytest.mark.parametrize(
    ("kind", "reason"), [("force-reversed", "force-reversed"), ("force-dead", "force-dead")]
)
def test_a_gentle_touch_finds_a_wrong_sign_and_a_dead_sensor_before_any_press(kind: str, reason: str) -> None:
    bench = PressBench("palm", seed=1, variation=Variation())
    stop = stop_of(bench, kind, bench.touch)
    assert stop.reason == reason
    assert stop.ran_n < 3 * bench.plan.threshold_N


@pytest.mark.parametrize("relaxation", [((0.6, 0.1), (0.4, 2.0)), ((0.06, 0.2), (0.05, 5.0)), ()])
@pytest.mark.cases(1)
def test_healthy_presses_are_believed_on_lasting_skins_too(relaxation):
    bench = PressBench("palm", seed=2, variation=Variation(relaxation=relaxation))
    bench.touch()
    bench.stepped(3e-3, 0.25e-3, 0.2, back=True)
    bench.stepped(2e-3, 1e-3, 1.0)


@pytest.mark.parametrize("waits_s", [0.05, 0.3])
@pytest.mark.cases(1)
def test_a_line_that_waits_for_its_answer_makes_no_healthy_force_look_dead(waits_s: float) -> None:
    """A controller may begin a move that late; until then no force is due to rise."""
    bench = palm(seed=3)
    move_to = bench.rig.stage.move_to

    def late(position_m: Position, speed_m_s: float) -> None:
        bench.clock.sleep(waits_s)
        move_to(position_m, speed_m_s)

    bench.rig.stage.move_to = late
    bench.seek()
    bench.depth(3e-3)
    assert bench.guard.position_m()[2] - (bench.motion.contact_m or 0.0) == pytest.approx(3e-3, abs=1e-6)


def block(bench: PressBench, before_s: float, after_s: float) -> None:
    """Let each call that sends the stage wait before the stage begins, and answer so long after."""
    move_to = bench.rig.stage.move_to

    def blocked(position_m: Position, speed_m_s: float) -> None:
        for wait_s, then in ((before_s, lambda: move_to(position_m, speed_m_s)), (after_s, lambda: None)):
            if wait_s:
                bench.clock.sleep(wait_s)
            then()

    bench.rig.stage.move_to = blocked


BLOCKED_S = [(0.0, 0.3), (0.5, 0.5), (0.0, 1.0)]


@pytest.mark.parametrize(("before_s", "after_s"), BLOCKED_S)
@pytest.mark.cases(1)
def test_a_tool_that_gives_way_while_the_call_that_sends_the_stage_is_blocked_is_found_on_that_step(
    before_s, after_s
):
    bench = palm(seed=3)
    go = palm_until(bench, "press")
    block(bench, before_s, after_s)
    stop = stop_of(bench, "force-numb", go)
    assert stop.reason == "force-dead", bench.message
    assert "way down" in bench.message
    assert stop.after_m <= ALLOWED_MM * MM


@pytest.mark.parametrize(("before_s", "after_s"), BLOCKED_S[:2])
@pytest.mark.parametrize("relaxation", [(), ((0.06, 0.2), (0.05, 5.0)), ((0.6, 0.1), (0.4, 2.0))])
@pytest.mark.cases(1)
def test_a_blocked_call_makes_no_force_of_a_lasting_skin_look_dead(before_s, after_s, relaxation):
    bench = PressBench("palm", seed=2, variation=Variation(relaxation=relaxation))
    block(bench, before_s, after_s)
    bench.touch()
    bench.stepped(3e-3, 0.25e-3, 0.2, back=True)
    bench.stepped(2e-3, 1e-3, 1.0)
    assert bench.guard.monitor.corridor._median, "from whole steps, as no sample had a way"


@pytest.mark.parametrize(("before_s", "after_s"), [(0.0, 0.3), (0.5, 0.5)])
@pytest.mark.cases(1)
def test_a_force_that_does_not_fall_on_a_blocked_way_back_is_found(before_s: float, after_s: float) -> None:
    bench = palm(seed=3)
    go = palm_until(bench, "retreat")
    block(bench, before_s, after_s)
    assert stop_of(bench, "force-numb", go).reason == "force-dead"
    assert "way back" in bench.message


def cut(plan: Known, sensor: str) -> Known:
    """A plan with one press at each of its places, and few frames."""
    few = {"cycles": 1, "reference_frames": 1, "taps": 0, "frames": 1, "wait_s": 0.1, "name": plan.name}
    return plan.model_copy(update={k: v for k, v in few.items() if k in type(plan).model_fields})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor", "name"),
    [("palm", name) for name in ("layer", "palm-reduced", "palm-lateral", "palm-creep", "repeated", "slow")]
    + [("tactip", "tactip")],
)
def test_an_untroubled_rig_completes_the_plans_that_come_with_palpate(tmp_path, sensor, name):
    rig = virtual_rig(sensor, seed=1)
    outcome = record(rig, cut(PLANS[name], sensor), tmp_path / "run")
    assert outcome.state is State.DONE, outcome.message


@pytest.mark.parametrize("seed", [26, 31])
@pytest.mark.cases(1)
def test_what_the_first_moments_of_contact_rise_by_teaches_no_stiffness(seed: int) -> None:
    design = sensor("palm")
    law = force_law(design, design.probe(design.default_probe))
    bench = PressBench("palm", seed=seed, variation=Variation())
    bench.touch()
    for depth_mm in (1.0, 2.0):
        bench.stepped(depth_mm * MM, 0.25 * MM, 0.3, back=True)
    bench.approach()
    slope_n_m = np.gradient(law.force_n, law.depth_m)
    for power, learnt in bench.guard.monitor.corridor._median.items():
        low, high = np.interp([2.0 ** (power - 1), 2.0**power], law.force_n, slope_n_m)
        assert 0.7 * low < learnt < 1.5 * low or learnt < high, f"at {2.0**power} N"


@pytest.mark.parametrize("hz", [30.0, 50.0, 66.0])
def test_a_slow_sensor_is_listened_to_for_as_long_as_a_zero_takes(hz: float) -> None:
    bench = PressBench("palm", seed=1, variation=Variation(), force_hz=hz)
    bench.approach()
    assert bench.bias.force_n[2] == pytest.approx(BIAS_N[2], abs=0.01)


# A force that is late under current timestamps is found in the first touch, before anything is pressed.

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


# Force stamps that run backwards end a recording by their own name, and the probe is lifted.


@pytest.mark.parametrize("after_s", [1.0, 2.0, 3.0, 4.0])
@pytest.mark.cases(1)
def test_force_stamps_that_run_back_are_a_force_fault_and_the_probe_is_lifted(tmp_path, after_s):
    one = near()
    set_back_ns = CLOCK_NS + round(after_s * NS_PER_S)

    def dated(sample: Wrench) -> Wrench:
        back = sample.time_ns > set_back_ns
        return replace(sample, time_ns=sample.time_ns - NS_PER_S) if back else sample

    backdated = ChangedForce(one.force, dated)
    outcome = record(replace(one, force=backdated), plan(), tmp_path / "run")
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.FORCE_FAULT)
    assert "runs backwards" in outcome.message
    assert one.from_origin_mm(one.stage.position_m())[2] <= -CLEARANCE_MM + 1e-6
    assert check(tmp_path / "run").sound
