"""Taps at the start of a recording set the frames' clock against the force's."""

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from tests.refusals import refused
from tests.rig.rigs import CLOCK_NS, SPEC, keys, near, quick, wanted
from tests.slow_params import mostly_slow

from palpate.core import DeviceError, InputError, RangeError, Wrench
from palpate.core.clock import ManualClock
from palpate.devices import Mounting, OperatorCommand, OperatorControl, Reason, Tripped
from palpate.recordings import Offset, Run, mean_over_exposures, offset_between
from palpate.rig import State, Status, clock_sync, record
from palpate.rig.clock_sync import CLOCKS, MAX_S, awaited, most_telling
from palpate.rig.label_force import LABEL_FORCE
from palpate.rig.plans import Listed, Ramp, StepHold
from palpate.rig.rig_check import check_rig
from palpate.rig.run_progress import fields_of
from palpate.rig.virtual import Fault, Variation
from palpate.rig.virtual.virtual_sensors import LATENCY_S, TRANSPORT_S
from palpate.sensors.palm.palm_sensor import Palm

pytestmark = pytest.mark.usefixtures("coarse_looks")
TRUE_S = TRANSPORT_S - LATENCY_S
CENTRE = Listed(kind="listed", at_mm=((0.0, 0.0),))


def tapping(taps: int = 2, **fields) -> StepHold:
    """One place, tapped at the usual speeds."""
    usual = {"taps": taps, "places": CENTRE, "depth_mm": 0.8, "seek_mm_s": 2.0, "press_mm_s": 2.0}
    return quick(**usual | fields)


def later(n: int) -> ManualClock:
    return ManualClock(n * CLOCK_NS)


def test_taps_find_how_late_frames_are_stamped_and_the_run_holds_what_it_was_found_from(tmp_path):
    out = tmp_path / "run"
    outcome = record(near(variation=Variation(), seed=2), tapping(4), out)
    assert outcome.state is State.DONE
    assert outcome.clocks is not None
    assert outcome.clocks.taps == 4
    assert outcome.clocks.seconds == pytest.approx(TRUE_S, abs=1e-3)
    assert outcome.clocks.low_s < TRUE_S < outcome.clocks.high_s
    assert outcome.clocks.jitter_s < 4e-3
    run = Run.open(out)
    assert len(run) == run.labels["shot"].notna().sum() == 3, "nothing but the plan's frames"
    (stored,) = fields_of(run, CLOCKS)
    assert stored["seconds"] == outcome.clocks.seconds
    events = run.events()
    tared_s, event_s = (float(events.loc[events["kind"] == k, "time_s"].iloc[0]) for k in ("tare", CLOCKS))
    force = run.force()
    tapped = force[force["time_s"].between(tared_s, event_s)]
    again = offset_between(
        tapped["time_s"].to_numpy(), tapped["fz_N"].to_numpy(), event_s - np.array(stored["frames_ago_s"]),
        np.array(stored["change"]), exposure_s=float(run.frame(0).exposure_s or 0), most_s=MAX_S,
    )  # fmt: skip
    assert again.seconds == pytest.approx(outcome.clocks.seconds, abs=2e-4)


@pytest.mark.slow
def test_a_recording_that_goes_on_taps_again(tmp_path: Path) -> None:
    control, small, out = OperatorControl(), tapping(3), tmp_path / "run"

    def watch(status: Status) -> None:
        if status.shots >= 2:
            control.ask(OperatorCommand.ABORT)

    assert record(near(), small, out, control=control, watch=watch).state is State.ABORTED
    assert record(near(clock=later(3)), small, out).state is State.DONE
    assert len(fields_of(Run.open(out), CLOCKS)) == 2
    done = record(near(clock=later(9)), small, out)
    assert done.clocks is None, "where nothing is missing, nothing moves"


@pytest.mark.parametrize(
    ("kind", "reason"),
    mostly_slow(
        [
            ("camera-frozen", Reason.CLOCKS),
            ("camera-resized", Reason.CAMERA),
            ("camera-stalls", Reason.CAMERA),
            ("camera-gone", Reason.CAMERA),
            ("force-stalls", Reason.FORCE_STALE),
            ("layer-gone", Reason.NO_CONTACT),
        ],
        lambda i: i == 0,
    ),
)
def test_what_fails_while_tapping_stops_with_its_name(tmp_path, kind, reason):
    tapping_s = 3.5  # after the first approach and the touch
    outcome = record(near(Fault(kind, tapping_s)), tapping(), tmp_path / "run")
    assert (outcome.state, outcome.reason, outcome.shots) == (State.FAILED, reason, 0)


def test_what_varies_most_tells_more_than_any_one_pixel() -> None:
    rng, true = np.random.default_rng(1), np.sin(np.linspace(0, 9, 60))
    weights = rng.uniform(-20, 20, 500)
    lamp = 1 + 0.02 * rng.standard_normal(60)
    frames = lamp[:, None] * (100 + true[:, None] * weights) + 4 * rng.standard_normal((60, 500))
    found = most_telling(list(frames.astype(np.uint8)))
    assert abs(np.corrcoef(found, true)[0, 1]) > 0.999


class SlowAnalysis:
    """An analysis that computes for 20 s, and then does what it should; `given_up` lets it end before."""

    TAKES_S = 20.0

    def __init__(self) -> None:
        self.begun, self.given_up = threading.Event(), threading.Event()

    def __call__(self, images: list[np.ndarray]) -> np.ndarray:
        self.begun.set()
        end_s = time.monotonic() + self.TAKES_S
        while time.monotonic() < end_s and not self.given_up.is_set():
            np.linalg.eigh(np.eye(60) + sum(range(1000)))  # half in numpy, half in Python
        return most_telling(images)


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> Iterator[SlowAnalysis]:
    analysis = SlowAnalysis()
    monkeypatch.setattr(clock_sync, "most_telling", analysis)
    yield analysis
    analysis.given_up.set()


ANSWERED_S = 0.2
TRIES = 3  # the machine may have other work


@pytest.mark.parametrize(
    ("command", "state"),
    mostly_slow(
        [
            (OperatorCommand.STOP, State.STOPPED),
            (OperatorCommand.ABORT, State.ABORTED),
            (OperatorCommand.ESTOP, State.ESTOPPED),
        ],
        lambda i: i == 2,
    ),
)
def test_a_stop_is_answered_while_the_taps_are_analysed_and_the_runs_frames_stay_whole(
    tmp_path, monkeypatch, command, state
):
    small, out, first = tapping(depth_mm=1.2), tmp_path / "run", OperatorControl()

    def early(status: Status) -> None:
        if status.shots >= 1:
            first.ask(OperatorCommand.ABORT)

    assert 0 < record(near(), small, out, control=first, watch=early).shots < 4
    before = keys(Run.open(out))
    took_s: list[float] = []
    while len(took_s) < TRIES and not (took_s and min(took_s) < ANSWERED_S):
        slow = SlowAnalysis()
        with monkeypatch.context() as patched:
            patched.setattr(clock_sync, "most_telling", slow)
            took_s.append(_stopped_s(out, small, slow, command, state, CLOCK_NS * (2 + len(took_s))))
    assert min(took_s) < ANSWERED_S, took_s
    assert keys(Run.open(out)) == before
    assert record(near(clock=later(9)), small, out).state is State.DONE
    assert sorted(keys(Run.open(out))) == sorted(wanted(small))


def _stopped_s(
    out: Path, small: StepHold, slow: SlowAnalysis, command: OperatorCommand, state: State, now_ns: int
) -> float:
    control, asked_s, told_s = OperatorControl(), [0.0], [0.0]

    def ask() -> None:
        assert slow.begun.wait(60)
        time.sleep(0.1)
        asked_s[0] = time.monotonic()
        control.ask(command)

    def told(status: Status) -> None:
        if status.state is state:
            told_s[0] = time.monotonic()

    operator = threading.Thread(target=ask)
    operator.start()
    outcome = record(near(clock=ManualClock(now_ns)), small, out, control=control, watch=told)
    operator.join()
    slow.given_up.set()
    assert (outcome.state, outcome.clocks) == (state, None)
    assert told_s[0] > asked_s[0] > 0
    return told_s[0] - asked_s[0]


def test_the_status_is_told_on_while_the_taps_are_analysed_until_a_force_that_fails_ends_the_recording(
    tmp_path, slow
):
    broken, told = near(), list[Status]()
    drain = broken.force.drain

    class Broken:
        def __getattr__(self, name: str) -> object:
            return getattr(broken.force, name)

        def drain(self) -> list[object]:
            if len(told) >= 5:
                raise DeviceError("its cable is out")
            return list(drain())

    def watch(status: Status) -> None:
        if slow.begun.is_set() and status.state is State.RUNNING:
            told.append(status)

    begun_s = time.monotonic()
    outcome = record(replace(broken, force=Broken()), tapping(), tmp_path / "run", watch=watch)
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.FORCE_SENSOR)
    assert time.monotonic() - begun_s < SlowAnalysis.TAKES_S, "the fifth status came while it ran"
    assert all(status.force_n is not None and status.position_mm is not None for status in told)


def test_an_analysis_that_takes_too_long_is_given_up_and_named(tmp_path, slow, monkeypatch):
    monkeypatch.setattr(clock_sync, "MAX_ANALYSIS_S", 0.3)
    outcome = record(near(), tapping(), tmp_path / "run")
    assert (outcome.state, outcome.reason, outcome.shots) == (State.FAILED, Reason.CLOCKS, 0)
    assert "than 0.3" in outcome.message


def test_what_is_awaited_is_the_result_or_the_error_of_the_work() -> None:
    looks: list[int] = []

    def work() -> int:
        time.sleep(0.1)
        return 7

    def fails() -> int:
        raise RangeError("no tap stands out")

    assert awaited(work, lambda: looks.append(1), 60.0) == 7
    assert looks
    with pytest.raises(RangeError, match="no tap"):
        awaited(fails, lambda: None, 60.0)


# Force and stage at 125 Hz beside 12 frames a second: each frame has the force of its own exposure.

FORCE_HZ, FRAMES_HZ = 125.0, 12.0
SPEED_MM_S = 5.0
FRAMES_CENTRE = Listed(kind="listed", at_mm=((0.0, 0.0),))
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
        name="sweep",
        kind="swept",
        places=FRAMES_CENTRE,
        cycles=1,
        speed_mm_s=SPEED_MM_S,
        depth_mm=3.0,
        taps=5,
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


# A slow force sensor labels frames at a stand beside a fast one that guards, and never guards itself.

SMALL = quick(frames=2)
PRELOAD_N = 3.0  # of the specimen on the scale, which the tare takes off


class SlowScale:
    """The force that a virtual rig knows, ten times a second, upside down and late by its delay."""

    rate_hz, range_n = 10.0, (100.0, 100.0, 100.0)

    def __init__(self, of, delay_s: float = 0.4) -> None:
        self.rig, self.delay_s, self.gone_after_s = of, delay_s, float("inf")
        self.begun_ns = self.next_ns = of.clock.now_ns()
        self.closed = 0

    def latest(self) -> Wrench:
        return self._sample(self.rig.clock.now_ns())

    def drain(self) -> list[Wrench]:
        now_ns = self.rig.clock.now_ns()
        if now_ns > self.begun_ns + self.gone_after_s * 1e9:
            raise DeviceError("unplugged")
        samples = []
        while self.next_ns <= now_ns:
            samples.append(self._sample(self.next_ns))
            self.next_ns += 100_000_000
        return samples

    def _sample(self, arrives_ns: int) -> Wrench:
        at_ns = arrives_ns - round(self.delay_s * 1e9)
        force = self.rig.truth(at_ns)["true_force_N"]
        return Wrench(at_ns, (0.0, 0.0, -(force + PRELOAD_N)))

    def close(self) -> None:
        self.closed += 1


def with_scale(**kwargs):
    fast = near()
    scale = SlowScale(fast, **kwargs)
    return replace(fast, label_force=scale, label_mounting=Mounting(("x", "y", "-z"))), scale


@pytest.mark.usefixtures("coarse_looks")
def test_frames_at_a_stand_carry_what_the_scale_measured_since_it_began(tmp_path: Path) -> None:
    bench, scale = with_scale()
    outcome = record(bench, SMALL, tmp_path / "run")
    assert outcome.state is State.DONE, outcome.message
    labels = Run.open(tmp_path / "run").labels
    assert labels["true_force_N"].max() > 0.2  # there is something to weigh
    assert (labels[LABEL_FORCE] - labels["true_force_N"]).abs().max() < 1e-6
    bench.close()
    assert scale.closed == 1


@pytest.mark.usefixtures("coarse_looks")
def test_without_its_delay_taken_off_the_labels_would_be_wrong(tmp_path: Path) -> None:
    """Negative control: the same scale that keeps its delay for itself."""
    bench, scale = with_scale()
    honest = scale._sample
    scale._sample = lambda arrives_ns: replace(honest(arrives_ns), time_ns=arrives_ns)
    assert record(bench, SMALL, tmp_path / "run").state is State.DONE
    labels = Run.open(tmp_path / "run").labels
    assert (labels[LABEL_FORCE] - labels["true_force_N"]).abs().max() > 0.05


@pytest.mark.usefixtures("coarse_looks")
def test_a_scale_that_goes_ends_the_run_by_name_with_the_probe_lifted(tmp_path: Path) -> None:
    bench, scale = with_scale()
    scale.gone_after_s = 5.0
    outcome = record(bench, SMALL, tmp_path / "run")
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.FORCE_SENSOR)
    assert "failed: unplugged" in outcome.message
    assert bench.stage.position_m()[2] < bench.origin_m[2]


def test_a_scale_that_prints_too_seldom_ends_the_run_by_name(tmp_path: Path) -> None:
    bench, scale = with_scale(delay_s=0.1)
    scale.drain = list
    outcome = record(bench, SMALL, tmp_path / "run")
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.FORCE_STALE)
    assert "measured 0" in outcome.message


def test_a_slow_sensor_is_refused_as_the_guard_before_anything_is_written(tmp_path: Path) -> None:
    bench, scale = with_scale()
    alone = replace(bench, force=scale, label_force=None)
    with refused("force-stale", Tripped):
        record(alone, SMALL, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_the_check_moves_nothing_by_a_slow_sensor_and_takes_it_as_a_label() -> None:
    bench, scale = with_scale()
    found = {one.code: one for one in check_rig(bench, close=False)}
    assert found["rig.force-rate"].ok
    assert found["label-force.sample-rate"].ok
    assert found["label-force.sample-gap"].ok
    alone = {one.code: one for one in check_rig(replace(bench, force=scale, label_force=None), close=False)}
    assert not alone["rig.force-rate"].ok
    assert not alone["stage.was-moved"].ok
