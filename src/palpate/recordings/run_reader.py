"""Reader of a run: frames by index or time, labels and signals as tables, and what is damaged."""

from __future__ import annotations

import json
import warnings
from array import array
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from palpate.core import (
    NS_PER_S,
    Frame,
    InputError,
    PalpateError,
    PathText,
    RangeError,
    RecordingError,
    sha256_of_all,
)
from palpate.core.parsing import parser
from palpate.recordings.label_tables import Label, finite, label_values
from palpate.recordings.manifest import MANIFEST, LabelKind, StoredManifest
from palpate.recordings.segments import (
    EVENTS,
    FORCE,
    KINDS,
    LABELS,
    RAW,
    STAGE,
    Channel,
    Damage,
    StoredFrame,
    StoredSegment,
    file_name,
    segment_numbers,
    segment_writer,
)

__all__ = ["Damage", "Run"]

NAME_COLUMN = "image_file"  # the label that names a frame, where a run has it
FORCE_COLUMNS = ("fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm")
STAGE_COLUMNS = ("x_m", "y_m", "z_m")


VOID = "void"
"""Event that takes back the frames of some approaches: their labels are as those of frames without any."""

ZERO_MOVED = "zero-moved"
"""Event that says how far a force sensor's zero moved over a press, and how far it may [N]."""


class Run:
    """Recorded run, as on disk when it was opened.

    Frames of a closed segment are verified when first read; a damaged one raises and keeps its index. An
    unclosed segment is verified at opening and its damaged parts are left out. Runs may be pickled and
    shared by threads.

    Attributes:
        segments: Readable content of each segment.
    """

    def __init__(
        self,
        path: Path,
        stored: StoredManifest,
        segments: tuple[StoredSegment, ...],
        damage: tuple[Damage, ...] = (),
    ) -> None:
        self.path = path
        self.stored_manifest = stored
        self.manifest = stored.manifest
        self.segments = segments
        self._manifest_damage = damage
        self._frames: list[StoredFrame] = [frame for segment in segments for frame in segment.frames]
        self._checked = bytearray(len(self._frames))

    @classmethod
    @parser("run", RecordingError)
    def open(cls, path: PathText) -> Run:
        """Open a run, whole or damaged.

        Where the manifest beside the segments is damaged, gone or altered, the copy that the segments hold is
        read instead; that is warned of, and told as damage.
        """
        path = Path(path)
        segments = _segments(path)
        stored, damage = _believed(path, segments)
        for one in damage:
            warnings.warn(f"{path}: {one}", stacklevel=2)
        return cls(path, stored, tuple(segment.of_run(stored) for segment in segments), damage)

    def __len__(self) -> int:
        return len(self._frames)

    def __repr__(self) -> str:
        about, labels = self.manifest, ", ".join(self.manifest.labels) or "none"
        return f"<Run {self.path}: {len(self)} frames of {about.sensor or 'a sensor'}; labels: {labels}>"

    def _repr_html_(self) -> str:
        about = self.manifest
        facts = {
            "run": str(self.path),
            "frames": str(len(self)),
            "sensor": about.sensor,
            "rig": about.rig,
            "begun": about.created_utc,
            "labels": ", ".join(about.labels),
            "targets": ", ".join(about.targets),
        }
        rows = (f"<tr><th>{name}</th><td>{escape(fact)}</td></tr>" for name, fact in facts.items() if fact)
        return f"<table>{''.join(rows)}</table>"

    @cached_property
    def times_s(self) -> np.ndarray:
        """Capture time of each frame ``[n]``, from the run's first instant [s]."""
        return np.array([self._seconds(frame.time_ns) for frame in self._frames], np.float64)

    def labelled(self) -> Run:
        """The same without frames that have no label at all, as a writer that was killed leaves its last."""
        some = {id(frame) for frame, about in zip(self._frames, self._abouts, strict=True) if about[1]}
        if len(some) == len(self._frames):
            return self
        segments = tuple(
            replace(segment, frames=tuple(frame for frame in segment.frames if id(frame) in some))
            for segment in self.segments
        )
        return Run(self.path, self.stored_manifest, segments, self._manifest_damage)

    def frame(self, index: int) -> Frame:
        """Frame by index; its name is its `NAME_COLUMN` label where the run has it, else its index."""
        if not 0 <= index < len(self):
            raise RangeError(
                f"{self.path} has frames 0 to {len(self) - 1}, and {index} was asked for", code="index-range"
            )
        image = self._frames[index].image(check=not self._checked[index])
        self._checked[index] = 1
        exposure_s, time_s = self._abouts[index][0], float(self.times_s[index])
        return Frame(image, time_s, exposure_s, self.manifest.sensor, self._name(index), index)

    def frames(self) -> Iterator[Frame]:
        """Frames, in order."""
        return (self.frame(index) for index in range(len(self)))

    @cached_property
    def labels(self) -> pd.DataFrame:
        """A row a frame, a column a label; NaN or None where it is not known."""
        rows = [about[1] for about in self._abouts]
        columns = {
            name: _column([row.get(name) for row in rows], kind)
            for name, kind in self.manifest.labels.items()
        }
        return pd.DataFrame(columns, index=pd.RangeIndex(len(self)))

    @property
    def void_frames(self) -> int:
        """Count of frames that were taken back, since the force sensor's zero moved while it pressed."""
        count = 0
        for segment in self.segments:
            void = _void_in(segment)
            for message in segment.messages(LABELS) if void else ():
                labels = segment_writer.decode_json(message.data, LABELS).get("labels", {})
                count += labels.get("approach") in void
        return count

    def force(self, *, raw: bool = False) -> pd.DataFrame:
        """Force and torque over time: ``time_s`` and `FORCE_COLUMNS`; raw ones as the sensor said them."""

        def six(message: Any) -> tuple[float, ...]:
            force, torque = message.wrench.force, message.wrench.torque
            return force.x, force.y, force.z, torque.x, torque.y, torque.z

        return self._table(RAW if raw else FORCE, FORCE_COLUMNS, six)

    def stage(self) -> pd.DataFrame:
        """Stage position over time: ``time_s`` and `STAGE_COLUMNS`."""
        return self._table(STAGE, STAGE_COLUMNS, lambda m: (m.point.x, m.point.y, m.point.z))

    def events(self) -> pd.DataFrame:
        """Events of the run: ``time_s``, ``kind`` and ``fields`` as JSON text."""
        rows = [
            (self._seconds(message.time_ns), str(event.get("kind")), json.dumps(event.get("fields")))
            for segment in self.segments
            for message in segment.messages(EVENTS)
            for event in [segment_writer.decode_json(message.data, EVENTS)]
        ]
        return pd.DataFrame(rows, columns=["time_s", "kind", "fields"]).astype({"time_s": np.float64})

    @cached_property
    def damage(self) -> tuple[Damage, ...]:
        """Damage: all that is not as it was written; empty for a sound run. Reads every byte, once."""
        numbers = [segment.number for segment in self.segments]
        missing = sorted(set(range(max(numbers, default=0) + 1)) - set(numbers))
        gone = [Damage(file_name(n, kind), 0, "is missing") for n in missing for kind in KINDS]
        return (
            *self._manifest_damage,
            *gone,
            *(fault for segment in self.segments for fault in segment.verify()),
        )

    @cached_property
    def hash(self) -> str:
        """SHA-256 over the manifest that is read and the segments, which names this very data."""
        segments = [path for path in self.files if path.name != MANIFEST]
        return sha256_of_all(segments, {MANIFEST: self.stored_manifest.sha256})

    @property
    def files(self) -> tuple[Path, ...]:
        """The manifest and the segments' files that are there."""
        names = [file_name(segment.number, kind) for segment in self.segments for kind in KINDS]
        return tuple(self.path / name for name in (MANIFEST, *names) if (self.path / name).is_file())

    @property
    def end_ns(self) -> int:
        """The last message's time [ns since 1970]; the run's beginning where there is none."""
        return max((segment.end_ns for segment in self.segments), default=0) or self.manifest.created_ns

    def _seconds(self, time_ns: int) -> float:
        return (time_ns - self.manifest.created_ns) / NS_PER_S

    def _name(self, index: int) -> str:
        name = self._abouts[index][1].get(NAME_COLUMN)
        return str(index) if name is None else str(name)

    @cached_property
    def _abouts(self) -> list[tuple[float | None, dict[str, Label]]]:
        """Exposure [s] and labels of each frame."""
        return [
            abouts.get(frame.sequence, (None, {}))
            for segment in self.segments
            for abouts in [self._abouts_of(segment)]
            for frame in segment.frames
        ]

    def _abouts_of(self, segment: StoredSegment) -> dict[int, tuple[float | None, dict[str, Label]]]:
        abouts = {}
        void = _void_in(segment)
        for message in segment.messages(LABELS):
            about = segment_writer.decode_json(message.data, LABELS)
            exposure, labels = about.get("exposure_s"), about.get("labels", {})
            try:
                exposure_s = None if exposure is None else finite([exposure], 1, "exposure [s]")[0]
                abouts[int(about["frame"])] = (exposure_s, label_values(labels, self.manifest.labels))
                if void and abouts[int(about["frame"])][1].get("approach") in void:
                    abouts[int(about["frame"])] = (exposure_s, {})
            except (InputError, KeyError, TypeError, ValueError, AttributeError) as e:
                raise RecordingError(
                    f"{segment.signals_file.path} holds a label that does not fit: {e}"
                ) from e
        return abouts

    def _table(
        self, channel: Channel, columns: tuple[str, ...], values: Callable[[Any], tuple[float, ...]]
    ) -> pd.DataFrame:
        # Packed doubles: an hour at 1 kHz is 0.2 GB so, and 1 GB as tuples of floats.
        rows = array("d")
        for segment in self.segments:
            for message in segment.messages(channel):
                rows.append(self._seconds(message.time_ns))
                rows.extend(values(segment_writer.decode(message.data, channel)))
        table = np.frombuffer(rows, np.float64) if rows else np.empty(0)
        return pd.DataFrame(table.reshape(-1, 1 + len(columns)), columns=["time_s", *columns])


def _void_in(segment: StoredSegment) -> set[float]:
    """Approaches of a segment whose frames were taken back, since the force sensor's zero moved."""
    events = (segment_writer.decode_json(message.data, EVENTS) for message in segment.messages(EVENTS))
    return {
        float(one)
        for event in events
        if event.get("kind") == VOID
        for one in (event.get("fields") or {}).get("approaches", ())
    }


def _segments(path: Path) -> tuple[StoredSegment, ...]:
    """The segments in a folder; none where it is no folder."""
    numbers = segment_numbers(path) if path.is_dir() else []
    return tuple(StoredSegment.open(path, number) for number in numbers)


def _believed(path: Path, segments: tuple[StoredSegment, ...]) -> tuple[StoredManifest, tuple[Damage, ...]]:
    """The manifest beside the segments where one of them has its checksum; else the copy that most hold."""
    try:
        stored: StoredManifest | None = StoredManifest.read(path)
        why = "has changed since the run was recorded"
    except PalpateError as e:
        stored, why, unreadable = None, str(e).removeprefix(f"{path / MANIFEST} "), e
    noted = {about.get("manifest_sha256") for segment in segments for about in segment.abouts}
    if stored is not None and stored.sha256 in noted:
        return stored, ()
    copies = [(one.number, copy) for one in segments if (copy := one.manifest) is not None]
    if not copies:
        if stored is None:
            raise unreadable
        return stored, ()
    (text, _), *_ = Counter(copy.text for _, copy in copies).most_common(1)
    number, copy = next(one for one in copies if one[1].text == text)
    what = f"{why.partition(';')[0]}; the copy in segment {number} is read instead"
    return copy, (Damage(MANIFEST, 0, what),)


def _column(values: list[Label | None], kind: LabelKind) -> pd.Series[Any]:
    if kind == "number":
        return pd.Series([np.nan if value is None else value for value in values], dtype=np.float64)
    return pd.Series(values, dtype=object)
