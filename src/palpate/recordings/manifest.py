"""The manifest: what a run is of, written once beside its segments and never again."""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from palpate.core import (
    NS_PER_S,
    InputError,
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
from palpate.recordings.reference_instruments import ReferenceInstrument
from palpate.version import __version__, needed_version

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
