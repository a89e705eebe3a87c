"""The engine's events as documents that keep event-model's schemas, with ends that tell their kind."""

from __future__ import annotations

import json
import re
import shutil
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.core import ManualClock, RecordingError
from palpate.recordings import Manifest, Run, RunWriter
from palpate.rig.event_model import Document, documents
from palpate.rig.run_progress import State

# The keys that event-model's published schemas require, and all that they allow where others are refused.
REQUIRED = {
    "start": {"time", "uid"},
    "descriptor": {"data_keys", "run_start", "time", "uid"},
    "event": {"data", "descriptor", "seq_num", "time", "timestamps", "uid"},
    "stop": {"exit_status", "run_start", "time", "uid"},
}
EVENT_ONLY = REQUIRED["event"] | {"filled"}
DATA_KEY = {"dtype", "shape", "source"}
DTYPES = {"string": str, "number": float, "array": list, "boolean": bool, "integer": int}
EXITS = {"success", "abort", "fail"}
NAME = re.compile(r"[^./]+")

PLAN = {"name": "small", "cycles": 1, "places": {"kind": "grid", "at_mm": [[0.0, 0.0]]}}
SESSION: list[tuple[str, dict[str, Any]]] = [
    ("plan", {"hash": "abc", "plan": PLAN}),
    ("rig", {"name": "virtual:palm", "limits": {"force_n": 35.0}}),
    ("state", {"state": "running", "message": "begun", "shots": 0}),
    ("tare", {"force_n": [0.1, 0.2, 0.3], "noise_n": 0.005}),
    ("zero", {"place": "r0c0", "z_mm": 0.12}),
    ("shot", {"key": "r0c0/1/down/100/0", "frames": 25}),
    ("state", {"state": "paused", "message": "paused by the operator", "shots": 1}),
    ("state", {"state": "running", "message": "resumed", "shots": 1}),
    ("shot", {"key": "r0c0/1/sweep/100/0", "frames": 30, "whole": True}),
]


def ended(state: State, message: str = "that was it") -> tuple[str, dict[str, Any]]:
    return "state", {"state": state.value, "message": message, "shots": 2}


def recorded(path: Path, *sessions: list[tuple[str, dict[str, Any]]]) -> Run:
    """A run of as many segments, an event every tenth of a second."""
    clock = ManualClock(10**12)
    for events in sessions:
        manifest = Manifest.new(sensor="palm 3", rig="virtual:palm", seed=7)
        begin = RunWriter.resume if path.exists() else RunWriter.create
        arguments = (path,) if path.exists() else (path, manifest)
        with begin(*arguments, clock=clock) as writer:  # type: ignore[arg-type, operator]
            for kind, fields in events:
                clock.sleep(0.1)
                writer.event(kind, **fields)
        clock.sleep(10.0)
    return Run.open(path)


def check(found: list[Document]) -> None:
    """Against the schemas, and that documents refer to those before them."""
    starts: set[str] = set()
    streams: dict[str, dict[str, Any]] = {}
    counted: dict[str, Counter[str]] = defaultdict(Counter)
    open_run = None
    for name, fields in found:
        assert json.loads(json.dumps(fields, allow_nan=False)) == fields, "plain JSON"
        assert REQUIRED[name] <= set(fields)
        assert isinstance(fields["uid"], str)
        assert isinstance(fields["time"], float)
        check_names(fields)
        match name:
            case "start":
                assert open_run is None, "one run at a time"
                open_run = fields["uid"]
                starts.add(open_run)
                assert isinstance(fields["scan_id"], int)
            case "descriptor":
                assert fields["run_start"] == open_run
                assert all(set(key) >= DATA_KEY for key in fields["data_keys"].values())
                streams[fields["uid"]] = fields
            case "event":
                assert set(fields) <= EVENT_ONLY
                about = streams[fields["descriptor"]]
                assert about["run_start"] == open_run
                assert set(fields["data"]) == set(fields["timestamps"]) == set(about["data_keys"])
                counted[open_run][about["name"]] += 1
                assert fields["seq_num"] == counted[open_run][about["name"]]
                for key, value in fields["data"].items():
                    told = about["data_keys"][key]
                    assert type(value) is DTYPES[told["dtype"]]
                    assert list(np.shape(value)) == told["shape"]
            case "stop":
                assert fields["run_start"] == open_run
                assert fields["exit_status"] in EXITS
                assert fields["num_events"] == dict(counted[open_run])
                open_run = None
    assert open_run is None, "every run is ended"
    uids = [fields["uid"] for _, fields in found]
    assert len(set(uids)) == len(uids)
    times = [fields["time"] for _, fields in found]
    assert times == sorted(times)


def check_names(value: Any) -> None:
    if isinstance(value, dict):
        assert all(NAME.fullmatch(key) for key in value)
        for inner in value.values():
            check_names(inner)
    if isinstance(value, list):
        for inner in value:
            check_names(inner)


def stops(run: Run) -> list[dict[str, Any]]:
    return [fields for name, fields in documents(run) if name == "stop"]


def test_the_documents_keep_the_schemas_and_come_in_order(tmp_path: Path) -> None:
    run = recorded(tmp_path / "run", [*SESSION, ended(State.DONE)])
    found = list(documents(run))
    check(found)
    names = [name for name, _ in found]
    assert (names[0], names[-1]) == ("start", "stop")
    assert Counter(names) == {"start": 1, "descriptor": 5, "event": 8, "stop": 1}


def test_the_start_says_what_was_run_on_what(tmp_path: Path) -> None:
    run = recorded(tmp_path / "run", [*SESSION, ended(State.DONE)])
    name, start = next(documents(run))
    assert name == "start"
    assert start["plan_name"] == "small"
    assert start["plan_args"] == PLAN
    assert start["plan_hash"] == "abc"
    assert (start["rig"], start["sample"], start["seed"]) == ("virtual:palm", "palm 3", 7)
    assert start["limits"] == {"force_n": 35.0}
    assert start["run_id"] == run.manifest.run_id


def test_events_carry_the_engines_fields_and_times(tmp_path: Path) -> None:
    run = recorded(tmp_path / "run", [*SESSION, ended(State.DONE)])
    table = run.events()
    kept = table[~table["kind"].isin(["plan", "rig"])]
    events = [fields for name, fields in documents(run) if name == "event"]
    assert [one["data"] for one in events] == [json.loads(text) for text in kept["fields"]]
    created_s = run.manifest.created_ns / 1e9
    # Seconds since 1970 in double precision are good to a quarter of a microsecond.
    assert [one["time"] for one in events] == pytest.approx((kept["time_s"] + created_s).tolist(), abs=1e-6)


def test_units_come_from_the_fields_names(tmp_path: Path) -> None:
    run = recorded(tmp_path / "run", [*SESSION, ended(State.DONE)])
    keys = {
        name: key
        for kind, fields in documents(run)
        if kind == "descriptor"
        for name, key in fields["data_keys"].items()
    }
    assert keys["z_mm"]["units"] == "mm"
    assert keys["force_n"]["shape"] == [3]
    assert "units" not in keys["place"]


@pytest.mark.parametrize(
    ("state", "status"),
    [
        (State.DONE, "success"),
        (State.STOPPED, "success"),
        (State.ABORTED, "abort"),
        (State.ESTOPPED, "abort"),
        (State.FAILED, "fail"),
    ],
)
def test_every_end_is_told_from_every_other(tmp_path: Path, state: State, status: str) -> None:
    run = recorded(tmp_path / "run", [*SESSION, ended(state, "the camera failed")])
    (stop,) = stops(run)
    assert (stop["exit_status"], stop["state"], stop["reason"]) == (status, state.value, "the camera failed")


def test_a_pause_is_an_event_and_no_end(tmp_path: Path) -> None:
    run = recorded(tmp_path / "run", [*SESSION, ended(State.DONE)])
    states = [
        fields["data"]["state"]
        for name, fields in documents(run)
        if name == "event" and "state" in fields["data"]
    ]
    assert states == ["running", "paused", "running", "done"]
    assert stops(run)[0]["exit_status"] == "success"


@pytest.mark.parametrize("upto", [0, 1, 3, 7, 9])
def test_a_recording_that_was_killed_has_failed_and_says_so(tmp_path: Path, upto: int) -> None:
    whole = [*SESSION, ended(State.DONE)]
    run = recorded(tmp_path / "run", whole, SESSION[:upto])
    found = list(documents(run))
    check(found)
    first, last = stops(run)
    assert (first["exit_status"], first["state"]) == ("success", "done")
    assert (last["exit_status"], last["state"]) == ("fail", "unfinished")
    assert "killed" in last["reason"]


def test_each_resumption_is_a_run_of_its_own_told_together_by_the_runs_id(tmp_path: Path) -> None:
    run = recorded(
        tmp_path / "run",
        [*SESSION, ended(State.ABORTED)],
        [*SESSION, ended(State.FAILED)],
        [*SESSION, ended(State.DONE)],
    )
    found = list(documents(run))
    check(found)
    starts = [fields for name, fields in found if name == "start"]
    assert [one["scan_id"] for one in starts] == [1, 2, 3]
    assert len({one["run_id"] for one in starts}) == 1
    assert len({one["uid"] for one in starts}) == 3
    assert [one["exit_status"] for one in stops(run)] == ["abort", "fail", "success"]


def test_the_same_run_gives_the_same_documents_also_once_more_was_recorded(tmp_path: Path) -> None:
    path = tmp_path / "run"
    run = recorded(path, [*SESSION, ended(State.STOPPED)])
    before = list(documents(run))
    assert list(documents(Run.open(path))) == before
    shutil.copytree(path, tmp_path / "copy")
    assert list(documents(Run.open(tmp_path / "copy"))) == before
    after = list(documents(recorded(path, [*SESSION, ended(State.DONE)])))
    assert after[: len(before)] == before
    assert len(after) > len(before)


def test_another_run_has_other_uids(tmp_path: Path) -> None:
    session = [*SESSION, ended(State.DONE)]
    one, other = (documents(recorded(tmp_path / name, session)) for name in ("one", "other"))
    assert not {fields["uid"] for _, fields in one} & {fields["uid"] for _, fields in other}


def test_fields_of_any_shape_and_name_are_taken_in(tmp_path: Path) -> None:
    odd = (
        "odd/kind",
        {"a.b": 1, "c/d": [1.5, 2], "nested": {"x": [1, {"y": None}]}, "none": None, "empty": []},
    )
    run = recorded(tmp_path / "run", [*SESSION, odd, ("odd/kind", {"a.b": "now a text"}), ended(State.DONE)])
    found = list(documents(run))
    check(found)
    (first, second) = (
        fields["data"] for name, fields in found if name == "event" and "a_b" in fields["data"]
    )
    assert first == {"a_b": 1, "c_d": [1.5, 2], "nested": '{"x": [1, {"y": null}]}', "empty": []}
    assert second == {"a_b": "now a text"}


def test_a_run_that_no_plan_recorded_is_refused(tmp_path: Path) -> None:
    run = recorded(tmp_path / "run", [("note", {"text": "by hand"})])
    with pytest.raises(RecordingError, match="not recorded by a plan"):
        list(documents(run))


def test_what_the_engine_itself_records_becomes_documents(tmp_path: Path) -> None:
    from palpate.rig.engine import record
    from palpate.rig.plans import Listed, StepHold
    from palpate.rig.virtual import virtual_rig
    from palpate.sensors import palm
    from palpate.sensors.palm.palm_sensor import Palm

    plan = StepHold(
        taps=0,
        name="small",
        places=Listed(kind="listed", at_mm=((0.0, 0.0),)),
        cycles=1,
        depth_mm=0.2,
        step_mm=0.1,
        clearance_mm=0.3,
        frames=2,
        reference_frames=1,
    )
    made = virtual_rig(Palm(palm.cropped(palm.palm(), 16, "tiny")), clock=ManualClock(10**11))
    outcome = record(made, plan, tmp_path / "run")
    assert outcome.state is State.DONE
    found = list(documents(Run.open(tmp_path / "run")))
    check(found)
    shots = [fields["data"]["key"] for name, fields in found if name == "event" and "key" in fields["data"]]
    assert len(shots) == outcome.planned
    assert found[0][1]["plan_hash"] == plan.hash
    assert found[-1][1]["exit_status"] == "success"
