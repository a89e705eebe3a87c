"""A run's engine events as event-model documents, which Bluesky's tools and databases take in.

Each time the engine recorded into the run, one segment, is a run of its own there: `start`, a `descriptor`
for every kind of event, the `event`s, and `stop`. A recording that was interrupted and resumed is several,
told together by `run_id`. How one ended is in `stop`:

| state | exit_status | |
|---|---|---|
| done | success | every shot is recorded |
| stopped | success | ended by the operator after a press; to be resumed |
| aborted, e-stopped | abort | ended by the operator at once |
| failed | fail | ended by a guard or a device; the reason says which |
| unfinished | fail | no end is recorded: it was killed, or is being recorded now |

A pause is no end: it is an event in the stream `state`.

Reference: the schemas of event-model, https://blueskyproject.io/event-model.
"""

from __future__ import annotations

import json
import uuid
from collections import Counter
from collections.abc import Iterator
from typing import Any

from palpate.core import NS_PER_S, RecordingError, has_unit, split_column
from palpate.recordings.run_reader import Run
from palpate.recordings.segments import EVENTS, StoredSegment, decode_json
from palpate.rig.run_progress import PLAN, State

Document = tuple[str, dict[str, Any]]
"""Its name, and its fields."""

STATE, RIG = "state", "rig"
UNFINISHED = "unfinished"
_STATUS = {
    State.DONE: "success",
    State.STOPPED: "success",
    State.ABORTED: "abort",
    State.ESTOPPED: "abort",
    State.FAILED: "fail",
}
_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_URL, "palpate-run/1")


def documents(run: Run) -> Iterator[Document]:
    """Documents of a run, in order.

    The same run gives the same, also once more was recorded into it: a document's `uid` is made of the run's
    id, the segment's number and the document's own. Only the `stop` of a segment that is still being recorded
    changes, and its `uid` with it.

    Args:
        run: recorded by a plan.

    Yields:
        ("start" | "descriptor" | "event" | "stop", fields): of plain JSON's types, keys without dots or
        slashes, times in seconds since 1970.

    Raises:
        RecordingError: the run was not recorded by a plan.
    """
    recordings = [(segment, list(_events(segment))) for segment in run.segments]
    if not any(kind == PLAN for _, events in recordings for _, kind, _ in events):
        raise RecordingError(f"{run.path} was not recorded by a plan, so the engine has left no events in it")
    for segment, events in recordings:
        yield from _Session(run, segment.number).documents(segment, events)


class _Session:
    """The documents of one segment."""

    def __init__(self, run: Run, number: int) -> None:
        self._manifest = run.manifest
        self._number = number
        self._start_uid = self._uid("start")
        self._descriptors: dict[tuple[str, str], str] = {}
        self._counts: Counter[str] = Counter()

    def documents(
        self, segment: StoredSegment, events: list[tuple[int, str, dict[str, Any]]]
    ) -> Iterator[Document]:
        begin_ns = segment.begin_ns or (events[0][0] if events else self._manifest.created_ns)
        yield "start", self._start(begin_ns, events)
        for time_ns, kind, fields in events:
            if kind not in (PLAN, RIG):
                yield from self._event(time_ns / NS_PER_S, kind, _plain(fields))
        yield "stop", self._stop(max(segment.end_ns, begin_ns), events)

    def _start(self, begin_ns: int, events: list[tuple[int, str, dict[str, Any]]]) -> dict[str, Any]:
        first = {kind: fields for _, kind, fields in reversed(events)}
        plan, rig, manifest = first.get(PLAN, {}), first.get(RIG, {}), self._manifest
        return {
            "uid": self._start_uid,
            "time": begin_ns / NS_PER_S,
            "scan_id": self._number + 1,
            "run_id": manifest.run_id,
            "segment": self._number,
            "sample": manifest.sensor,
            "plan_name": str(_part(plan.get("plan"), "name")),
            "plan_hash": str(plan.get("hash", "")),
            "plan_args": _keyed(plan.get("plan", {})),
            "rig": str(rig.get("name", manifest.rig)),
            "limits": _keyed(rig.get("limits", {})),
            "licence": manifest.licence,
            "origin": manifest.origin,
            "software": manifest.software,
            "seed": manifest.seed,
        }

    def _event(self, time_s: float, stream: str, data: dict[str, Any]) -> Iterator[Document]:
        keys = {name: _data_key(name, value) for name, value in data.items()}
        layout = json.dumps(keys, sort_keys=True)
        if (stream, layout) not in self._descriptors:  # a new kind, or one whose fields have changed
            uid = self._descriptors[stream, layout] = self._uid("descriptor", stream, layout)
            about = {"uid": uid, "run_start": self._start_uid, "time": time_s}
            yield "descriptor", {**about, "name": stream, "data_keys": keys}
        self._counts[stream] += 1
        event = {
            "uid": self._uid("event", stream, str(self._counts[stream])),
            "descriptor": self._descriptors[stream, layout],
            "time": time_s,
            "seq_num": self._counts[stream],
            "data": data,
            "timestamps": dict.fromkeys(data, time_s),
            "filled": {},
        }
        yield "event", event

    def _stop(self, end_ns: int, events: list[tuple[int, str, dict[str, Any]]]) -> dict[str, Any]:
        ended = [
            (at, fields) for at, kind, fields in events if kind == STATE and fields.get("state") in _STATUS
        ]
        at_ns, last = ended[-1] if ended else (end_ns, {})
        state = str(last.get("state", UNFINISHED))
        why = str(last.get("message", "no end is recorded: it was killed, or is being recorded now"))
        return {
            "uid": self._uid("stop", state),
            "run_start": self._start_uid,
            "time": at_ns / NS_PER_S,
            "exit_status": _STATUS[State(state)] if ended else "fail",
            "reason": why,
            "state": state,
            "num_events": dict(self._counts),
        }

    def _uid(self, *of: str) -> str:
        return str(uuid.uuid5(_NAMESPACE, "/".join((self._manifest.run_id, str(self._number), *of))))


def _events(segment: StoredSegment) -> Iterator[tuple[int, str, dict[str, Any]]]:
    for message in segment.messages(EVENTS):
        event = decode_json(message.data, EVENTS)
        fields = event.get("fields")
        yield message.time_ns, _key(str(event.get("kind"))), fields if isinstance(fields, dict) else {}


def _plain(fields: dict[str, Any]) -> dict[str, Any]:
    """Values that an event's data may hold: scalars and lists of them; unknown ones are left out."""
    return {_key(name): _value(value) for name, value in fields.items() if value is not None}


def _value(value: Any) -> Any:
    scalars = (str, bool, int, float)
    if isinstance(value, scalars) or (isinstance(value, list) and all(isinstance(v, scalars) for v in value)):
        return value
    return json.dumps(value, sort_keys=True)


def _data_key(name: str, value: Any) -> dict[str, Any]:
    about: dict[str, Any] = {"source": "palpate engine", "dtype": _dtype(value), "shape": []}
    if isinstance(value, list):
        about["shape"] = [len(value)]
    if has_unit(name) and not isinstance(value, str):
        about["units"] = split_column(name)[1].symbol
    return about


def _dtype(value: Any) -> str:
    match value:
        case bool():
            return "boolean"
        case int():
            return "integer"
        case float():
            return "number"
        case list():
            return "array"
        case _:
            return "string"


def _keyed(value: Any) -> Any:
    """The same with keys that the schemas allow, all the way down."""
    if isinstance(value, dict):
        return {_key(str(name)): _keyed(inner) for name, inner in value.items()}
    return [_keyed(inner) for inner in value] if isinstance(value, list) else value


def _key(name: str) -> str:
    """Dots and slashes part names elsewhere."""
    return name.replace(".", "_").replace("/", "_")


def _part(fields: Any, name: str) -> Any:
    return fields.get(name, "") if isinstance(fields, dict) else ""
