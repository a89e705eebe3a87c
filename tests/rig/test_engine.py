"""The engine: what it records, how it ends, and that nothing is repeated or skipped however it is cut."""

import json
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from tests.refusals import refused
from tests.rig.rigs import CLEARANCE_MM, CLOCK_NS, keys, near, quick, wanted
from tests.slow_params import mostly_slow

from palpate.core.clock import ManualClock
from palpate.core.errors import DeviceError, RecordingError
from palpate.devices import OperatorCommand, OperatorControl, motion_guard
from palpate.recordings import Run, RunWriter, check
from palpate.rig import State, Status, record
from palpate.rig.engine import manifest_of
from palpate.rig.plans import Listed, Ramp
from palpate.rig.run_progress import fields_of
from palpate.rig.virtual import Fault, Variation

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
