"""The manifest: what a run is of, written once beside its segments and never again.

What labels come from: the reference instrument of a label column, and its own uncertainty.

Written in a file of TOML, one section a column, all numbers in the column's unit::

    [force_N]
    instrument = "ATI Nano17, FT12345"
    certificate = "D-K-15070-2026-03"
    certified_on = "2026-03-01"
    standard_uncertainty = 0.02
    resolution = 0.003
    backlash = 0.0
    bias_removed = 0.05

Notes on a run: what somebody saw in it, when; kept beside the run, which itself is never altered.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import tomllib
import uuid
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from palpate.core import (
    NS_PER_S,
    InputError,
    LabelError,
    PathText,
    RecordingError,
    has_unit,
    new_file,
    split_column,
    storage_errors,
    unit,
)
from palpate.core.parsing import parser
from palpate.core.provenance import Provenance, earlier_provenance
from palpate.version import __version__, needed_version

MAX_FILE_BYTES = 1 << 20


class ReferenceInstrument(BaseModel):
    """Instrument of one label column; numbers are in the column's unit.

    Attributes:
        instrument: Name and serial number.
        certificate: Number and issuer of the calibration certificate; empty for none.
        certified_on: Date of the certificate, ISO 8601; empty for none.
        standard_uncertainty: Systematic uncertainty (scale, zero, alignment) for a coverage factor of 1;
            included in every reading's interval.
        resolution: Smallest displayed difference; varies from row to row, so held-out errors contain it.
        backlash: Loss on reversal; varies from row to row if presses come from both sides.
        bias_removed: Known error already subtracted from the labels; informative only.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    instrument: str = Field(min_length=1)
    certificate: str = ""
    certified_on: str = ""
    standard_uncertainty: float = Field(default=0.0, ge=0)
    resolution: float = Field(default=0.0, ge=0)
    backlash: float = Field(default=0.0, ge=0)
    bias_removed: float = 0.0

    @field_validator("certified_on", mode="before")
    @classmethod
    def _dated(cls, day: object) -> object:
        """A date of TOML or a text of one, as text."""
        if isinstance(day, date):
            return day.isoformat()
        if isinstance(day, str) and day:
            date.fromisoformat(day)
        return day


@parser("instrument file", InputError)
def read_instruments(path: PathText) -> dict[str, ReferenceInstrument]:
    """Reference instruments of label columns, from a file of TOML."""
    path = Path(path)
    if not path.is_file() or path.stat().st_size > MAX_FILE_BYTES:
        raise InputError(f"{path} is no file of instruments of up to {MAX_FILE_BYTES} bytes; check the name")
    with storage_errors(path):
        data = path.read_bytes()
    try:
        sections = tomllib.loads(data.decode("utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as e:
        raise InputError(f"{path} is no TOML ({e}); write one section a column, as in [force_N]") from e
    found = {}
    for column, fields in sections.items():
        try:
            found[column] = ReferenceInstrument.model_validate(fields)
        except ValidationError as e:
            first = e.errors(include_url=False)[0]
            where = ".".join(map(str, first["loc"])) or "it"
            allowed = ", ".join(ReferenceInstrument.model_fields)
            raise InputError(
                f"{path}, [{column}]: {where}: {first['msg']}; a section has {allowed}, in the column's unit"
            ) from e
    return found


def refuse_strangers(instruments: Mapping[str, object], columns: tuple[str, ...], source: str) -> None:
    """Raise a LabelError if an instrument is given for what is no label column."""
    if strangers := sorted(set(instruments) - set(columns)):
        raise LabelError(
            f"{source}: instruments are given for {', '.join(strangers)}, and the label columns are "
            f"{', '.join(columns)}"
        )


MANIFEST = "manifest.json"
FORMAT = "palpate-run/1"
MAX_MANIFEST_BYTES = 1 << 20  # ten thousand label columns fit; more is no manifest
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

LabelKind = Literal["number", "text", "flag"]


class Manifest(BaseModel):
    """Content of a run and the terms of use of its data.

    Attributes:
        run_id: Identity of the recording; a repaired copy keeps it.
        created_utc: Start of `Frame.time_s`, ISO 8601 with offset.
        clock: ``measured``, or ``ordinal`` for times that only state an order.
        software: Program that wrote the run.
        seed: Seed of the plan or simulation; None for none.
        units: Label column -> unit symbol of `core.units`.
        labels: Label column -> kind.
        targets: Label columns estimated by default.
        regions: Named image regions, such as "fringes": (x, y, width, height) [px].
        instruments: Reference instruments of label columns.
        order: ``recorded`` for rows in temporal order, ``names`` for the order of image names.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    format: Literal["palpate-run/1"]
    run_id: str
    created_utc: str
    clock: Literal["measured", "ordinal"]
    sensor: str
    rig: str
    licence: str
    origin: str
    software: str
    seed: int | None
    units: dict[str, str]
    labels: dict[str, LabelKind]
    targets: tuple[str, ...] = ()
    regions: dict[str, tuple[int, int, int, int]] = Field(default_factory=dict)
    instruments: dict[str, ReferenceInstrument] = Field(default_factory=dict)
    order: Literal["recorded", "names"] = "recorded"
    provenance: Provenance = Provenance.MEASURED

    @model_validator(mode="before")
    @classmethod
    def _earlier(cls, fields: Any) -> Any:
        """Complete the manifest of a run from before manifests stated a provenance."""
        if (
            not isinstance(fields, dict)
            or "provenance" in fields
            or not isinstance(fields.get("origin"), str)
        ):
            return fields
        return {**fields, "provenance": earlier_provenance(fields["origin"])}

    @model_validator(mode="after")
    def _check(self) -> Manifest:
        if _nanoseconds(self.created_utc) < 0:
            raise ValueError(f"created_utc {self.created_utc} lies before 1970")
        if "" in self.labels:
            raise ValueError("a label column has an empty name")
        if strangers := self.units.keys() - self.labels.keys():
            raise ValueError(f"units are given for {sorted(strangers)}, which are no label columns")
        for symbol in self.units.values():
            unit(symbol)
        if bare := sorted(set(self.targets) - self.units.keys()):
            raise ValueError(f"targets {bare} are no label columns of numbers with a unit")
        if strangers := self.instruments.keys() - self.units.keys():
            raise ValueError(f"instruments are given for {sorted(strangers)}, which are no labels with unit")
        for name, (x, y, width, height) in self.regions.items():
            if min(x, y) < 0 or min(width, height) < 1:
                raise ValueError(f"the region {name} is {width} x {height} px at ({x}, {y})")
        return self

    @classmethod
    def new(
        cls,
        *,
        sensor: str,
        rig: str = "",
        licence: str = "",
        origin: str = "",
        labels: Mapping[str, LabelKind] | None = None,
        targets: tuple[str, ...] = (),
        regions: Mapping[str, tuple[int, int, int, int]] | None = None,
        instruments: Mapping[str, ReferenceInstrument] | None = None,
        seed: int | None = None,
        clock: Literal["measured", "ordinal"] = "measured",
        order: Literal["recorded", "names"] = "recorded",
        provenance: Provenance = Provenance.MEASURED,
    ) -> Manifest:
        """The manifest of a run that begins now; units come from the columns' names.

        Example:
            >>> Manifest.new(sensor="tactip-3", labels={"depth_mm": "number"}).units
            {'depth_mm': 'mm'}
        """
        kinds = dict(labels or {})
        numbers = [name for name, kind in kinds.items() if kind == "number" and has_unit(name)]
        try:
            return cls(
                format=FORMAT,
                run_id=str(uuid.uuid4()),
                created_utc=datetime.now(UTC).isoformat(timespec="microseconds"),
                clock=clock,
                sensor=sensor,
                rig=rig,
                licence=licence,
                origin=origin,
                software=f"palpate {__version__}",
                seed=seed,
                units={name: split_column(name)[1].symbol for name in numbers},
                labels=kinds,
                targets=targets,
                regions=dict(regions or {}),
                instruments=dict(instruments or {}),
                order=order,
                provenance=provenance,
            )
        except ValidationError as e:
            raise InputError(f"these do not make a manifest: {_first(e)}", code="manifest-field") from e

    @classmethod
    def read(cls, run: PathText) -> Manifest:
        """The manifest in a run's folder."""
        return StoredManifest.read(run).manifest

    def write(self, run: PathText) -> None:
        """Write the manifest into a run's folder, whole or not at all."""
        StoredManifest.of(self).write(run)

    @property
    def created_ns(self) -> int:
        """`created_utc` since 1970 [ns], what the segments' times count from."""
        return _nanoseconds(self.created_utc)

    @property
    def is_simulated(self) -> bool:
        """Whether a simulated sensor gave the run, or a part of it."""
        return self.provenance is Provenance.SIMULATED


@dataclass(frozen=True, slots=True)
class StoredManifest:
    """Manifest as stored: its very text, which each segment keeps a copy of.

    Attributes:
        text: in UTF-8.
    """

    manifest: Manifest
    text: bytes

    @classmethod
    def of(cls, manifest: Manifest) -> StoredManifest:
        """The text that a manifest is written as."""
        # Fields that older versions do not know are written only where they are used.
        plain = {"instruments": not manifest.instruments, "order": manifest.order == "recorded"}
        unused = {name for name, left_out in plain.items() if left_out}
        return cls(manifest, (manifest.model_dump_json(indent=2, exclude=unused) + "\n").encode())

    @classmethod
    @parser("run manifest", RecordingError)
    def read(cls, run: PathText) -> StoredManifest:
        """The one beside a run's segments; errors as of `Manifest.read`."""
        path = Path(run) / MANIFEST
        if not path.is_file():
            raise RecordingError(
                f"{run} is not a run: it holds no {MANIFEST}; name a run's folder", code="not-a-run"
            )
        with storage_errors(path):
            if path.stat().st_size > MAX_MANIFEST_BYTES:
                raise RecordingError(f"{path} is no manifest: it is larger than {MAX_MANIFEST_BYTES} bytes")
            text = path.read_bytes()
        try:
            return cls(Manifest.model_validate_json(text), text)
        except ValidationError as e:
            if version := needed_version(text, FORMAT):
                raise RecordingError(f"{path} {version}") from e
            raise RecordingError(
                f"{path} is damaged: {_first(e)}; restore it from a copy of the run", code="manifest-damaged"
            ) from e

    @classmethod
    def copied(cls, text: object, sha256: object) -> StoredManifest | None:
        """The copy in a segment; None where there is none, or it is not what the checksum is of."""
        if not isinstance(text, str) or len(text) > MAX_MANIFEST_BYTES:
            return None
        data = text.encode("utf-8", "surrogatepass")
        try:
            stored = cls(Manifest.model_validate_json(data), data)
        except ValidationError:
            return None
        return stored if stored.sha256 == sha256 else None

    def write(self, run: PathText) -> None:
        """Write it into a run's folder, whole or not at all, and never over another."""
        with new_file(Path(run) / MANIFEST) as path:
            path.write_bytes(self.text)

    @property
    def sha256(self) -> str:
        """Checksum of the text, as 64 hexadecimal digits."""
        return hashlib.sha256(self.text).hexdigest()


def _nanoseconds(iso: str) -> int:
    moment = datetime.fromisoformat(iso)
    if moment.tzinfo is None:
        raise ValueError(f"created_utc {iso} carries no offset from UTC")
    return (moment - _EPOCH) // timedelta(microseconds=1) * (NS_PER_S // 1_000_000)


def _first(error: ValidationError) -> str:
    problem = error.errors(include_url=False, include_context=False)[0]
    where = ".".join(str(part) for part in problem["loc"])
    return f"{where}: {problem['msg']}" if where else problem["msg"]


NOTES = "notes.jsonl"
MAX_NOTE = 500
"""Characters of a note."""
MAX_NOTES = 2000
MAX_NOTES_BYTES = 4 << 20


@dataclass(frozen=True, slots=True)
class RunNote:
    """Note on a moment of a run.

    Attributes:
        time_s: from the run's first instant [s].
        written_utc: when, in ISO 8601.
    """

    time_s: float
    text: str
    written_utc: str


@parser("run notes", RecordingError)
def read_notes(run: PathText) -> list[RunNote]:
    """Read the notes on a run, in the order of their times; lines that are none are left out."""
    path = Path(run) / NOTES
    if path.is_symlink():
        raise RecordingError(f"{path} is a link; notes lie beside their run: move the file there")
    if not path.is_file():
        return []
    with storage_errors(path):
        if path.stat().st_size > MAX_NOTES_BYTES:
            raise RecordingError(f"{path} is larger than {MAX_NOTES_BYTES} bytes, and notes never are")
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    return sorted((note for line in lines if (note := _note(line))), key=lambda note: note.time_s)


def add_note(run: PathText, time_s: float, text: str) -> RunNote:
    """Add a note to a run.

    Args:
        time_s: what the note is on, from the run's first instant [s].
        text: 1 to `MAX_NOTE` characters; line ends become spaces.
    """
    path, text = Path(run) / NOTES, " ".join(text.split())
    if not (path.parent / MANIFEST).is_file():
        raise RecordingError(
            f"{run} is not a run: it holds no {MANIFEST}; name a run's folder", code="not-a-run"
        )
    if not 0 < len(text) <= MAX_NOTE or not math.isfinite(time_s):
        raise InputError(
            f"a note of {len(text)} characters at {time_s} s; it takes 1 to {MAX_NOTE} characters at a time "
            "within the run"
        )
    if len(read_notes(run)) >= MAX_NOTES:
        raise InputError(f"{run} has {MAX_NOTES} notes, and no more are kept; take some out of {NOTES}")
    note = RunNote(round(time_s, 6), text, datetime.now(UTC).isoformat(timespec="seconds"))
    line = json.dumps(asdict(note), ensure_ascii=False, allow_nan=False) + "\n"
    with storage_errors(path):
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
        handle = os.open(path, flags, 0o644)
        try:
            os.write(handle, line.encode())
            os.fsync(handle)
        finally:
            os.close(handle)
    return note


def _note(line: str) -> RunNote | None:
    try:
        fields = json.loads(line)
        note = RunNote(
            float(fields["time_s"]), str(fields["text"])[:MAX_NOTE], str(fields["written_utc"])[:40]
        )
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return note if math.isfinite(note.time_s) else None
