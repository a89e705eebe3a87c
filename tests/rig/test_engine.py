"""The engine: what it records, how it ends, and that nothing is repeated or skipped however it is cut."""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from tests.refusals import refused
from tests.rig.rigs import CLEARANCE_MM, CLOCK_NS, keys, near, plan, quick, rig, wanted
from tests.slow_params import mostly_slow

from palpate.core import Frame, Wrench
from palpate.core.clock import ManualClock
from palpate.core.errors import DeviceError, RecordingError, StorageError
from palpate.devices import Limits, OperatorCommand, OperatorControl, Reason, Tripped, motion_guard
from palpate.recordings import Run, RunWriter, check
from palpate.recordings.segments import mcap_file
from palpate.rig import State, Status, record
from palpate.rig.engine import manifest_of
from palpate.rig.plans import Grid, Listed, Ramp
from palpate.rig.run_progress import fields_of
from palpate.rig.virtual import Fault, Variation
from palpate.rig.virtual.virtual_bench import TRAVEL

pytestmark = pytest.mark.usefixtures("coarse_looks")
CENTRE = Listed(kind="listed", at_mm=((0.0, 0.0),))
WHOLE = quick(frames=2)
ONE = quick(places=CENTRE, depth_mm=0.8)  # a reference and two depths


def later(n: int = 3) -> ManualClock:
    return ManualClock(n * CLOCK_NS)


def varied(**kwargs: Any):
    return near(variation=Variation(), seed=5, **kwargs)


def at_shots(control: OperatorControl, shots: int, wish: OperatorCommand = OperatorCommand.ABORT):
    """Whoever watches, and gives a command once so many shots are recorded."""

    def watch(status: Status) -> None:
        if status.shots >= shots:
            control.ask(wish)

    return {"control": control, "watch": watch}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A small plan, recorded without interruption on a rig on which presses vary."""
    out = tmp_path_factory.mktemp("engine") / "run"
    outcome = record(varied(), WHOLE, out)
    assert (outcome.state, outcome.shots, outcome.planned) == (State.DONE, 8, 8)
    return Run.open(out)


@pytest.fixture(autouse=True)
def told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("palpate.rig.engine.TOLD_EVERY_S", 0.0)


def test_a_run_is_sound_and_holds_every_frame_of_its_plan_once(whole: Run) -> None:
    assert sorted(keys(whole)) == sorted(wanted(WHOLE))
    assert check(whole.path).sound
    assert (whole.manifest.sensor, whole.manifest.units["force_N"], whole.manifest.seed) == (
        "virtual tiny",
        "N",
        5,
    )
    assert fields_of(whole, "plan")[0]["hash"] == WHOLE.hash


def test_labels_are_the_truth_within_noise_and_the_contact_threshold(whole: Run) -> None:
    labels = whole.labels
    # 5 mN of noise over some samples, the tare's own 0.6 mN, drift, and relaxation during the exposure.
    assert (labels["force_N"] - labels["true_force_N"]).abs().max() < 0.03
    pressed = whole.labels.query("phase == 'down'")
    # 0.05 N is passed between 0.11 mm and, a search step of 0.02 mm later, 0.15 mm after first touch.
    assert (pressed["true_depth_mm"] - pressed["depth_mm"]).between(0.08, 0.16).all()
    references = labels.query("reference")
    assert len(references) == 2
    assert (references["true_depth_mm"] == 0).all()
    assert references["force_N"].abs().max() < 0.02
    zeros = [float(fields["z_mm"]) for fields in fields_of(whole, "zero")]
    assert whole.stage()["z_m"].max() * 1e3 <= max(zeros) + 1.2 + 1e-6


@pytest.mark.parametrize(("speed_mm_s", "taps"), [(1.0, 0), pytest.param(5.0, 3, marks=pytest.mark.slow)])
def test_depth_counts_from_the_same_zero_in_a_sweep(tmp_path, monkeypatch, speed_mm_s, taps):
    monkeypatch.setattr(motion_guard, "POLL_S", 0.002)
    sweep = Ramp(
        name="s", kind="swept", places=CENTRE, taps=taps, cycles=1, speed_mm_s=speed_mm_s, until_N=2.0,
        wait_s=0.1, clearance_mm=CLEARANCE_MM, seek_mm_s=5.0,
    )  # fmt: skip
    assert record(near(), sweep, tmp_path / "run").state is State.DONE
    run = Run.open(tmp_path / "run")
    swept = run.labels.query("phase == 'sweep'")
    below_touch = (swept["true_depth_mm"] - swept["depth_mm"])[swept["depth_mm"] > 0]
    # As above; a stamp 8 ms after the exposure, where no taps tell that, is 0.008 mm at 1 mm/s.
    assert len(below_touch) > 10
    assert below_touch.between(0.08, 0.16).all()
    assert (swept["depth_mm"] >= 0).all()
    assert len(fields_of(run, "zero")) == 1


def test_the_raw_force_is_kept_beside_the_tared_one(whole: Run) -> None:
    raw, tared = whole.force(raw=True), whole.force()
    assert len(raw) == len(tared) > 500
    assert (raw["time_s"] == tared["time_s"]).all()
    bias = raw["fz_N"].iloc[-20:].mean() - tared["fz_N"].iloc[-20:].mean()
    assert bias == pytest.approx(1.7, abs=0.05)


@pytest.mark.parametrize("after_shots", mostly_slow([0, 1, 2], lambda i: i == 1))
@pytest.mark.parametrize("wish", [OperatorCommand.ABORT, OperatorCommand.ESTOP, OperatorCommand.STOP])
@pytest.mark.cases(1)
def test_what_was_ended_goes_on_at_the_first_missing_shot(tmp_path, after_shots, wish):
    out, small = tmp_path / "run", quick()
    first = record(near(), small, out, **at_shots(OperatorControl(), after_shots, wish))
    ends = {
        OperatorCommand.ABORT: "aborted",
        OperatorCommand.ESTOP: "e-stopped",
        OperatorCommand.STOP: "stopped",
    }
    assert first.state == ends[wish]
    assert first.shots < 8
    second = record(near(clock=later()), small, out)
    assert (second.state, second.shots) == (State.DONE, 8)
    held = keys(Run.open(out))
    assert sorted(held) == sorted(wanted(small))
    assert check(out).sound
    assert record(near(clock=later(9)), small, out).state is State.DONE
    assert keys(Run.open(out)) == held, "a run that holds everything is not touched again"


@pytest.mark.parametrize(
    ("rig", "plan", "code"),
    [
        (lambda: near(variation=Variation(), seed=6), WHOLE, "seed-differs"),
        (varied, quick(frames=3), "recording"),
    ],
)
def test_a_run_is_not_gone_on_with_under_another_seed_or_plan(whole: Run, rig, plan, code: str) -> None:
    with refused(code, RecordingError):
        record(rig(), plan, whole.path)


def begun(out: Path, recorded: Callable[[RunWriter], object] = lambda writer: None) -> None:
    """A run as a kill leaves it before the engine has written its plan, with what was recorded into it."""
    with RunWriter.create(out, manifest_of(near(), ONE)) as writer:
        recorded(writer)


WAYS = {
    "only its manifest": lambda out: [path.unlink() for path in out.glob("*.mcap")],
    "one file of a segment": lambda out: (out / "0000-signals.mcap").unlink(),
    "empty files": lambda out: [os.truncate(path, 0) for path in out.glob("*.mcap")],
    "a segment without its end": lambda out: [os.truncate(path, 900) for path in out.glob("*.mcap")],
    "a frame without a record": lambda out: None,
}


@pytest.mark.parametrize("left", mostly_slow(list(WAYS), lambda i: i % 2 == 1))
@pytest.mark.cases(1)
def test_a_run_without_recorded_frames_is_begun_again_by_the_same_call(tmp_path: Path, left: str) -> None:
    out = tmp_path / "run"
    image = np.zeros((4, 4), np.uint8)
    begun(out, lambda writer: writer.frame(image) if left.startswith("a frame") else None)
    WAYS[left](out)
    before = {path: path.read_bytes() for path in out.iterdir()}
    assert record(near(), ONE, out).state is State.DONE
    assert sorted(keys(Run.open(out))) == sorted(wanted(ONE))
    assert {path: path.read_bytes() for path in before} == before, "nothing is overwritten"


def test_frames_of_another_rig_or_an_unknown_plan_are_not_gone_on_with(tmp_path: Path) -> None:
    begun(tmp_path / "empty")
    with refused("rig-differs", RecordingError):
        record(near(), quick(), tmp_path / "empty")
    image, labels = np.zeros((4, 4), np.uint8), {"shot": "l0/1/down/400/0"}
    begun(tmp_path / "run", lambda writer: writer.frame(image, labels=labels))
    with refused("plan-unreadable", RecordingError):
        record(near(), ONE, tmp_path / "run")


def test_the_plan_is_on_disk_before_anything_moves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("palpate.recordings.run_writer.SYNC_EVERY_S", 1e6)  # by itself it comes to disk late
    out, seen, made = tmp_path / "run", [], near()

    def first_move(position_m: tuple[float, float, float], speed_m_s: float) -> None:
        if not seen:
            run = Run.open(out)
            seen.extend(str(fields["hash"]) for fields in fields_of(run, "plan"))
            seen.extend(str(segment.note["plan"]) for segment in run.segments)
        raise DeviceError("far enough")

    monkeypatch.setattr(made.stage, "move_to", first_move)
    record(made, ONE, out)
    assert seen == [ONE.hash] * 2


def test_a_run_whose_plan_event_is_damaged_goes_on(tmp_path: Path) -> None:
    out = tmp_path / "run"
    record(near(), ONE, out, **at_shots(OperatorControl(), 1))
    path = out / "0000-signals.mcap"
    data = bytearray(path.read_bytes())
    data[data.index(b'"kind":"plan"')] ^= 1
    path.write_bytes(data)
    assert not fields_of(Run.open(out), "plan")
    with refused("recording", RecordingError, match="another plan"):
        record(near(), quick(places=CENTRE, frames=3), out)
    assert record(near(clock=later()), ONE, out).state is State.DONE
    assert sorted(keys(Run.open(out))) == sorted(wanted(ONE))


@pytest.mark.slow
def test_an_interrupted_run_is_the_uninterrupted_one_shot_by_shot(whole: Run, tmp_path: Path) -> None:
    out = tmp_path / "run"
    for after in (2, 6, 99):
        record(varied(clock=later(3 + after)), WHOLE, out, **at_shots(OperatorControl(), after))
    one, other = (
        run.labels.set_index(["shot", "frame_in_shot"]).sort_index() for run in (whole, Run.open(out))
    )
    columns = ["x_mm", "y_mm", "depth_mm", "location", "cycle", "phase", "reference"]
    pd.testing.assert_frame_equal(one[columns], other[columns], atol=1e-9)
    # Another approach seats differently by 0.02 mm, which is 0.1 N at this depth.
    assert (one["true_depth_mm"] - other["true_depth_mm"]).abs().max() < 0.08
    assert (one["force_N"] - other["force_N"]).abs().max() < 0.4


def test_a_pause_lifts_the_probe_and_a_resumed_press_finds_contact_anew(tmp_path: Path) -> None:
    control, seen, small = OperatorControl(), [], quick()

    def watch(status: Status) -> None:
        seen.append(status.state)
        if status.shots == 3 and State.PAUSED not in seen:
            control.ask(OperatorCommand.PAUSE)
            threading.Timer(0.1, control.resume).start()

    out = tmp_path / "run"
    assert record(near(), small, out, control=control, watch=watch).state is State.DONE
    run = Run.open(out)
    assert sorted(keys(run)) == sorted(wanted(small))
    assert len(fields_of(run, "zero")) == 2 + 1  # of the two presses, and of the resumed one again
    states = [fields["state"] for fields in fields_of(run, "state")]
    assert states == ["running", "paused", "running", "done"]
    events = run.events()
    paused_s = events.loc[events["fields"].map(lambda f: json.loads(f).get("state") == "paused"), "time_s"]
    stage = run.stage()
    at = stage.loc[(stage["time_s"] - float(paused_s.iloc[0])).abs().idxmin()]
    assert at["z_m"] <= -CLEARANCE_MM * 1e-3 + 1e-9


@pytest.mark.slow
def test_a_sweep_that_was_cut_is_done_again_and_the_cut_one_does_not_count(tmp_path: Path) -> None:
    sweep = Ramp(name="s", kind="swept", taps=0, places=CENTRE, cycles=2, speed_mm_s=2.0, depth_mm=2.0)
    out = tmp_path / "run"
    cut = record(near(Fault("force-stalls", 3.0)), sweep, out)
    assert (cut.state, cut.shots) == (State.FAILED, 0)
    assert record(near(clock=later()), sweep, out).state is State.DONE
    events = fields_of(Run.open(out), "shot")
    assert [fields["key"] for fields in events] == ["l0/1/sweep/2000/0", "l0/2/sweep/2000/0"]


# The engine when something fails: every stop has its name, and the recording goes on afterwards.


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("force-stalls", Reason.FORCE_STALE), ("force-saturates", Reason.FORCE_FAULT),
        ("force-gone", Reason.FORCE_SENSOR), ("force-spike", Reason.FORCE_LIMIT),
        ("force-noisy", Reason.FORCE_NOISE), ("force-reversed", Reason.FORCE_REVERSED),
        ("force-dead", Reason.FORCE_DEAD), ("force-scaled", Reason.FORCE_SCALED),
        ("force-held-back", Reason.FORCE_LATE), ("force-slow", Reason.FORCE_SLOW),
        ("stage-gone", Reason.STAGE), ("stage-stuck", Reason.STAGE), ("stage-slips", Reason.STAGE),
        ("camera-gone", Reason.CAMERA), ("camera-frozen", Reason.CAMERA), ("camera-resized", Reason.CAMERA),
        ("camera-stalls", Reason.CAMERA), ("layer-gone", Reason.NO_CONTACT),
    ],
)  # fmt: skip
@pytest.mark.parametrize("after_s", [0.1, pytest.param(1.2, marks=pytest.mark.slow)])
@pytest.mark.cases(2)
def test_every_fault_stops_with_its_name_and_the_run_goes_on_afterwards(tmp_path, fault, reason, after_s):
    out = tmp_path / "run"
    # Seven frames, so that a frozen camera is noticed within a shot; one place, which each fault comes at.
    small = plan(frames=7, cycles=1, depth_mm=0.8, places=CENTRE)
    faulty = rig(Fault(fault, after_s))
    outcome = record(faulty, small, out)
    assert outcome.state is State.FAILED
    noisy = {Reason.FORCE_NOISE, Reason.TOUCHED_EARLY, Reason.FORCE_RATE, Reason.FORCE_LIMIT}
    assert (
        outcome.reason == reason
        # A skin that is gone under a touch is as a sensor that feels nothing any more.
        or (fault == "layer-gone" and outcome.reason is Reason.FORCE_DEAD)
        or (fault == "force-noisy" and outcome.reason in noisy)
        or (fault == "stage-stuck" and outcome.reason is Reason.STAGE_LATE)
        # One large sample, or a changed scale of the bias, is noise or contact to a check in the air.
        or (fault in ("force-spike", "force-scaled") and outcome.reason in noisy)
        # It needs 20 samples, and a slow sensor gives fewer.
        or (fault == "force-slow" and outcome.reason is Reason.FORCE_STALE)
    ), outcome
    assert outcome.message
    run = Run.open(out)
    assert check(run.path).sound
    if fault not in ("stage-gone", "stage-stuck"):  # gone, or it takes no move
        assert faulty.stage.position_m()[2] <= -CLEARANCE_MM * 1e-3 + 1e-9, "the probe is lifted"
    assert record(near(clock=ManualClock(3 * CLOCK_NS)), small, out).state is State.DONE
    assert sorted(keys(Run.open(out))) == sorted(wanted(small))


def test_a_stage_that_does_not_stop_is_said_so(tmp_path: Path) -> None:
    outcome = record(near(Fault("stage-deaf"), Fault("force-stalls", 3.0)), plan(), tmp_path / "run")
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.STAGE)
    assert "not stop" in outcome.message


def test_a_force_beyond_the_limit_stops_within_the_overshoot_and_lifts(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(motion_guard, "POLL_S", 0.002)
    limits = Limits(TRAVEL.least_m, TRAVEL.greatest_m, force_n=3.0, overshoot_m=0.05e-3)
    faulty = rig(limits=limits)
    deep = plan(depth_mm=4.0, step_mm=1.0)
    out = tmp_path / "run"
    outcome = record(faulty, deep, out)
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.FORCE_LIMIT)
    force = Run.open(out).force()
    steepest = 6e3  # N/m at 3 N, from the table
    latency_m = 2e-3 * (2e-3 + 5e-3 + 2e-3)  # the sensor's, a sample's and a poll's time at 2 mm/s
    assert force["fz_N"].max() <= 3.0 + steepest * (limits.overshoot_m + latency_m) + 0.05
    assert faulty.stage.position_m()[2] <= -CLEARANCE_MM * 1e-3 + 1e-9


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"depth_mm": 11.0, "step_mm": 1.0}, Reason.SOFT_LIMIT),
        ({"clearance_mm": 40.0}, Reason.SOFT_LIMIT),
        ({"press_mm_s": 50.0}, Reason.TOO_FAST),
        ({"places": Grid(pitch_mm=30, per_side=3, layer_mm=100)}, Reason.SOFT_LIMIT),
    ],
)
def test_a_plan_that_leaves_the_limits_is_refused_before_anything_moves(tmp_path, change, reason):
    faulty = rig(limits=Limits((-20e-3, -20e-3, -30e-3), (20e-3, 20e-3, 12e-3)))
    before = faulty.stage.position_m()
    with pytest.raises(Tripped) as e:
        record(faulty, plan(**change), tmp_path / "run")
    assert e.value.reason is reason
    assert "mm" in str(e.value)
    assert faulty.stage.position_m() == before
    assert not (tmp_path / "run").exists()


def test_a_threshold_under_the_noise_is_refused(tmp_path: Path) -> None:
    outcome = record(rig(variation=Variation(force_noise_n=0.02)), plan(), tmp_path / "run")
    assert outcome.reason is Reason.FORCE_NOISE


def test_a_camera_that_gives_no_frames_stops_a_sweep(tmp_path: Path) -> None:
    slow = Ramp(name="slow", kind="swept", taps=0, places=CENTRE, cycles=1, speed_mm_s=1.0, depth_mm=2.0)
    stalled = near(Fault("camera-stalls", 2.0))
    outcome = record(stalled, slow, tmp_path / "run")
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.CAMERA)
    assert "no frame" in outcome.message
    assert stalled.stage.position_m()[2] < 0, "the probe is lifted"


def refused_writes(patch: pytest.MonkeyPatch) -> None:
    """No byte fits any more after some writes, not even the end's."""
    real, count = mcap_file.HeldFile.write, iter(range(10_000_000))

    def filling(self: mcap_file.HeldFile, data: bytes) -> None:
        if next(count) > 20:
            raise OSError(28, "No space left on device")
        real(self, data)

    patch.setattr(mcap_file.HeldFile, "write", filling)


def refused_room(patch: pytest.MonkeyPatch) -> None:
    """A disk with some 150 kB for each file."""
    real = os.posix_fallocate

    def small(handle: int, at: int, count: int) -> None:
        if at + count > 150_000:
            raise OSError(28, "No space left on device")
        real(handle, at, count)

    patch.setattr(mcap_file.os, "posix_fallocate", small)


@pytest.mark.parametrize("full", [refused_writes, refused_room])
@pytest.mark.cases(1)
def test_a_full_disk_stops_and_lifts_and_the_run_stays_readable(tmp_path, monkeypatch, full):
    if full is refused_room and not hasattr(os, "posix_fallocate"):
        pytest.skip("this system holds no room on a disk")
    full(monkeypatch)
    small, seen, out, of = near(), [], tmp_path / "run", quick()
    # The engine ends with a named state; closing the segment then says once more that the disk is full.
    with pytest.raises(StorageError, match=r"full|space|room"):
        record(small, of, out, watch=seen.append)
    assert seen[-1].state is State.FAILED
    monkeypatch.undo()
    assert small.stage.position_m()[2] <= -CLEARANCE_MM * 1e-3 + 1e-9
    run = Run.open(out)
    held = keys(run)
    assert len(held) == len(set(held))
    if full is refused_room:
        assert check(out).sound, "both files have their end"
        last = fields_of(run, "state")[-1]
        assert last["state"] == "failed"
        assert "room left" in str(last["message"])
    assert record(near(clock=ManualClock(3 * CLOCK_NS)), of, out).state is State.DONE
    assert sorted(keys(Run.open(out))) == sorted(wanted(of))


def test_a_stage_that_answers_only_at_the_second_try_is_lifted_at_the_third(tmp_path: Path) -> None:
    sound, failures = near(), iter(range(2))

    class Late:
        """Silent for two calls after the force failed."""

        def __getattr__(self, name: str) -> object:
            return getattr(sound.stage, name)

        def position_m(self) -> tuple[float, float, float]:
            at = sound.stage.position_m()
            if at[2] > 0.3e-3 and next(failures, None) is not None:
                raise DeviceError("the stage has not answered")
            return at

    outcome = record(replace(sound, stage=Late()), plan(), tmp_path / "run")
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.STAGE)
    assert sound.stage.position_m()[2] <= -CLEARANCE_MM * 1e-3 + 1e-9


def test_a_probe_that_stays_is_said_to_stay(tmp_path: Path) -> None:
    outcome = record(rig(Fault("stage-gone", 1.2)), plan(), tmp_path / "run")
    assert outcome.reason is Reason.STAGE
    assert "not lifted" in outcome.message


def test_one_who_watches_and_fails_does_not_hold_the_probe_in_the_skin(tmp_path: Path) -> None:
    sound = near()

    def watch(status: object) -> None:
        if sound.stage.position_m()[2] > 0.3e-3:
            raise LookupError("a page that is gone")

    with pytest.raises(LookupError):
        record(sound, plan(), tmp_path / "run", watch=watch)
    assert sound.stage.position_m()[2] <= -CLEARANCE_MM * 1e-3 + 1e-9


def test_a_zero_that_was_taken_in_contact_is_given_up_and_the_probe_lifted(tmp_path: Path) -> None:
    sound = near()
    world, drain = sound.stage._world, sound.force.drain

    def risen() -> list[Wrench]:
        if world._presses == 2 and world._lifted:  # the gentle touch, and the first press
            world._origin = (0.0, 0.0, -1.5e-3)
        return drain()

    sound.force.drain = risen
    outcome = record(sound, plan(), tmp_path / "run")
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.TOUCHED_EARLY), outcome.message
    assert "not lifted" not in outcome.message
    assert sound.stage.position_m()[2] < -1.5e-3


def test_a_recording_that_is_aborted_before_it_begins_moves_nothing(tmp_path: Path) -> None:
    sound, control = rig(), OperatorControl()
    before = sound.stage.position_m()
    control.ask(OperatorCommand.ABORT)
    assert record(sound, plan(), tmp_path / "run", control=control).state is State.ABORTED
    assert sound.stage.position_m() == before


def test_frames_that_run_backwards_are_the_camera_s_fault(tmp_path: Path) -> None:
    sound, count = near(), iter(range(1, 1000))
    grab = sound.camera.grab

    def back(timeout_s: float = 1.0) -> tuple[int, Frame]:
        time_ns, frame = grab(timeout_s)
        return time_ns - next(count) * 40_000_000, frame  # they come 33 ms apart

    sound.camera.grab = back
    outcome = record(sound, plan(), tmp_path / "run")
    assert (outcome.state, outcome.reason) == (State.FAILED, Reason.CAMERA), outcome.message
    assert "backwards" in outcome.message


# Recordings that are killed at random moments: begun again, they hold their plan exactly.

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.mark.skipif(sys.platform != "linux", reason="kills by another process's processor time")
@pytest.mark.parametrize("kills", [4, pytest.param(1000, marks=pytest.mark.slow)])
def test_a_run_killed_at_any_moment_goes_on_by_the_same_call_to_its_plan_exactly(
    tmp_path, kills: int
) -> None:
    words = [sys.executable, "-m", "tests.rig.killed_recordings", str(kills), str(tmp_path)]
    done = subprocess.run(words, check=True, capture_output=True, text=True, cwd=REPOSITORY)
    met = json.loads(done.stdout)
    assert met["wrong"] == []
    assert met["kills"] == kills
    assert met["runs"] >= 1
    assert met["early"] >= kills // 10, "kills at its very beginning are among them"
    if kills >= 1000:
        assert met["unbegun"] > 0, "and kills before the run's folder is there"
        assert met["empty"] > 0, "and runs without a frame"
