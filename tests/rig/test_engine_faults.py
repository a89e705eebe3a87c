"""The engine when something fails: every stop has its name, and the recording goes on afterwards."""

import math
import os
from dataclasses import replace
from pathlib import Path

import pytest
from tests.rig.rigs import CLEARANCE_MM, CLOCK_NS, keys, near, plan, quick, rig, wanted

from palpate.core import Frame, Wrench
from palpate.core.clock import ManualClock
from palpate.core.errors import DeviceError, StorageError
from palpate.devices import Limits, OperatorCommand, OperatorControl, Reason, Tripped
from palpate.recordings import Run, check
from palpate.recordings.segments import mcap_file
from palpate.rig import State, record
from palpate.rig.plans import Grid, Listed, Ramp
from palpate.rig.run_progress import fields_of
from palpate.rig.virtual import Fault, Variation
from palpate.rig.virtual.virtual_bench import TRAVEL

CENTRE = Listed(kind="listed", at_mm=((0.0, 0.0),))


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


def test_a_force_beyond_the_limit_stops_within_the_overshoot_and_lifts(tmp_path: Path) -> None:
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


class Odd:
    """A device that raises an exception of its own, or measures no number, once the skin is touched."""

    def __init__(self, inner: object, name: str, rig: object, result: object) -> None:
        self._inner, self._name, self._rig, self._result = inner, name, rig, result

    def __getattr__(self, name: str) -> object:
        real = getattr(self._inner, name)
        if name != self._name:
            return real

        def call(*args: object) -> object:
            touched = self._rig.stage._world.stand_at()[2] > 0.3e-3
            if not touched:
                return real(*args)
            if isinstance(self._result, Exception):
                raise self._result
            return [replace(one, force_n=(0.0, 0.0, self._result)) for one in real(*args)]

        return call


@pytest.mark.parametrize(
    ("device", "call", "result", "reason"),
    [
        ("force", "drain", math.nan, Reason.FORCE_FAULT),
        ("force", "drain", KeyError("Fz"), Reason.FORCE_SENSOR),
        ("force", "latest", ValueError("odd"), Reason.FORCE_SENSOR),
        ("camera", "grab", RuntimeError("usb"), Reason.CAMERA),
    ],
)
@pytest.mark.cases(1)
def test_whatever_a_driver_does_the_probe_is_lifted_and_the_name_is_the_device_s(
    tmp_path, device, call, result, reason
):
    sound = near()
    odd = replace(sound, **{device: Odd(getattr(sound, device), call, sound, result)})
    outcome = record(odd, plan(), tmp_path / "run")
    assert (outcome.state, outcome.reason) == (State.FAILED, reason)
    assert "not lifted" not in outcome.message
    assert sound.stage.position_m()[2] <= -CLEARANCE_MM * 1e-3 + 1e-9
    assert check(tmp_path / "run").sound


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
