"""What labels come from: the reference instrument of a label column, and its own uncertainty.

Written in a file of TOML, one section a column, all numbers in the column's unit::

    [force_N]
    instrument = "ATI Nano17, FT12345"
    certificate = "D-K-15070-2026-03"
    certified_on = "2026-03-01"
    standard_uncertainty = 0.02
    resolution = 0.003
    backlash = 0.0
    bias_removed = 0.05
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from datetime import date
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from palpate.core import InputError, LabelError, PathText, storage_errors
from palpate.core.parsing import parser

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
