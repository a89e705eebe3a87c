"""Taps at the start of a recording set the frames' clock against the force's."""

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.rig.rigs import CLOCK_NS, keys, near, quick, wanted
from tests.slow_params import mostly_slow

from palpate.core import DeviceError, RangeError
from palpate.core.clock import ManualClock
from palpate.devices import OperatorCommand, OperatorControl, Reason
from palpate.recordings import Run, offset_between
from palpate.rig import State, Status, clock_sync, record
from palpate.rig.clock_sync import CLOCKS, MAX_S, awaited, most_telling
from palpate.rig.plans import Listed, StepHold
from palpate.rig.run_progress import fields_of
from palpate.rig.virtual import Fault, Variation
from palpate.rig.virtual.virtual_camera import TRANSPORT_S
from palpate.rig.virtual.virtual_force import LATENCY_S

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
def test_what_fails_while_tapping_stops_with_its_name_and_the_recording_goes_on_afterwards(
    tmp_path, kind, reason
):
    small, out = tapping(), tmp_path / "run"
    tapping_s = 3.5  # after the first approach and the touch
    outcome = record(near(Fault(kind, tapping_s)), small, out)
    assert (outcome.state, outcome.reason, outcome.shots) == (State.FAILED, reason, 0)
    assert record(near(clock=later(3)), small, out).state is State.DONE


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
