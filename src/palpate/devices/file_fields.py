"""Files that name devices: how they are read, and fields that their tables share.

Millimetres stand in a file, since people write it, and metres behind it.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from palpate.core import InputError, Position, storage_errors
from palpate.core.parsing import parser

MM = 1e-3
Three = tuple[float, float, float]


MAX_HOST = 253  # characters of a name, by RFC 1035
_HOST = re.compile(rf"[A-Za-z0-9._:-]{{1,{MAX_HOST}}}")


def _names_a_host(host: str) -> str:
    if not _HOST.fullmatch(host):
        raise ValueError(
            f"{host[:40]!r} is no host: give its number or name, of 1 to {MAX_HOST} letters, digits, "
            "'.', '-', '_' and ':', as in 192.168.1.1"
        )
    return host


Host = Annotated[str, AfterValidator(_names_a_host)]
"""Name or number of a device in the network."""


MAX_BYTES = 1 << 20
Of = TypeVar("Of", bound=BaseModel)


class Part(BaseModel):
    """A table of a file: nothing in it changes, and no field is unknown."""

    model_config = ConfigDict(frozen=True, extra="forbid")


def check_below(ceilings: dict[str, float], part: BaseModel) -> None:
    """Refuse a field above its ceiling, with both numbers; fields that were left out are not compared."""
    for name, ceiling in ceilings.items():
        value = getattr(part, name, None)
        if value is not None and value > ceiling:
            raise ValueError(
                f"{name} is {value:g}, and {ceiling:g} is the greatest allowed; give {ceiling:g} "
                f"{_unit(name)} or less"
            )


def _unit(name: str) -> str:
    """Unit of a field, from the end of its name: "mm" of ``step_mm``, "N/s" of ``force_rate_N_s``."""
    for ending in ("N_s", "mm_s"):
        if name.endswith(f"_{ending}"):
            return ending.replace("_", "/")
    return name.rpartition("_")[2]


def check_above(floors: dict[str, float], part: BaseModel) -> None:
    """Refuse a field below its floor, with both numbers; fields that were left out are not compared."""
    for name, floor in floors.items():
        value = getattr(part, name, None)
        if value is not None and value < floor:
            raise ValueError(
                f"{name} is {value:g}, and {floor:g} is the least allowed; give {floor:g} "
                f"{_unit(name)} or more"
            )


def metres(mm: Three) -> Position:
    """Metres of three millimetres."""
    x, y, z = (MM * value for value in mm)
    return x, y, z


@parser("TOML file", InputError, max_bytes=MAX_BYTES)
def read_toml(path: Path) -> dict[str, Any]:
    """The fields of a file that people write; of its first MiB.

    Raises:
        InputError: it is not TOML.
        StorageError: it cannot be read.
    """
    with storage_errors(path):
        data = path.read_bytes()[:MAX_BYTES]
    try:
        return tomllib.loads(data.decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as e:
        raise InputError(f"{path} is not TOML: {e}") from e


def validated(model: type[Of], path: Path, fields: dict[str, Any]) -> Of:
    """What the fields of a file say.

    Raises:
        InputError: a field that is not one, or out of range; each is named.
    """
    try:
        return model.model_validate(fields)
    except ValidationError as e:
        problems = "; ".join(f"{_field(d['loc'])}: {d['msg']}" for d in e.errors())
        raise InputError(f"{path}: {problems}", code="field") from e


def _field(location: tuple[str | int, ...]) -> str:
    """The field's name in the file, without the tags of its kinds."""
    return ".".join(str(part) for part in location if not str(part).startswith("#"))
