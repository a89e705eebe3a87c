"""An object to be felt, read from a TOML file: measured curves, elastic bodies, or what a fingertip presses.

Each number's key says its unit. Two tables, as measured:

    name = "foam ball"
    [force_area]
    area_mm2 = [0.0, 20.0, 60.0, 130.0]
    force_N = [0.0, 0.6, 1.6, 3.4]
    [force_displacement]
    displacement_mm = [0.0, 1.0, 2.0, 4.0]
    force_N = [0.0, 0.5, 1.3, 3.6]

A polynomial takes the place of either table, as in ``N_per_cm2 = [0.554, 0.33, 1.4]`` with ``until_cm2``.
In place of both stands one of

* ``[hertz]``: ``modulus_kPa``, ``radius_mm`` (inf for a flat) and ``poisson`` of the object, the same of the
  finger with ``finger_`` before them, and ``until_N``;
* ``[fingertip]``: ``until_N`` and ``model``, which is ``hertz`` (``modulus_kPa``, ``radius_mm``,
  ``poisson``), ``exponential`` (``b_N``, ``m_per_mm``, ``area_at_1_N_mm2``, ``area_exponent``) or
  ``finite-strain`` (``tip``, ``radius_mm``, ``gel_modulus_kPa``), on a rigid flat; beside it ``[material]``
  with ``name``, ``modulus_kPa`` and ``poisson`` makes the flat one of that material, or ``[compliance]`` one
  that was measured: ``readings``, a file, and ``use``, ``modulus`` or ``stiffness``, the latter with
  ``specimen_radius_mm``, ``specimen_height_mm`` and ``poisson``;
* ``[specimen]``: ``class`` (CL1, CL2, CL3), ``number`` 1 to 5, ``moduli_kPa`` of the five silicones,
  ``poisson``, the finger as in ``[hertz]``, and ``until_N``.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core import InputError, UnitError, storage_errors
from palpate.core.parsing import parser
from palpate.softness.characteristics import Characteristic, Cue, SoftObject, hertz_object, polynomial
from palpate.softness.object_fields import BODY, body_of, number, numbers, only, table_of
from palpate.softness.pressed_bodies import UNDER, fingertip_press, specimen_press

AREAS = {"mm2": 1e-6, "cm2": 1e-4, "m2": 1.0}
LENGTHS = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0}
UNITS: Mapping[Cue, Mapping[str, float]] = {"area": AREAS, "displacement": LENGTHS}
CURVES = ("force_area", "force_displacement")
WHOLE = ("hertz", "fingertip", "specimen")  # each in place of both curves
MAX_BYTES = 1 << 20
GIVES = f"give [force_area] and [force_displacement], or one of {', '.join(f'[{one}]' for one in WHOLE)}"


@parser("soft object", InputError)
def read_object(path: Path) -> SoftObject:
    """Read an object's file."""
    with storage_errors(path):
        if not path.exists():
            raise InputError(f"there is no object's file {path}; {GIVES}", code="file-missing")
        if not path.is_file() or path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path} is no TOML file of 1 MiB at most; {GIVES}", code="file-size")
        raw = path.read_bytes()
    try:
        fields = tomllib.loads(raw.decode("utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as e:
        raise InputError(f"{path} is not TOML: {e}", code="toml") from e
    try:
        return object_from(fields, path.stem, path.parent)
    except InputError as e:
        raise type(e)(f"{path}: {e}", code=e.code) from e


def is_object_file(path: Path) -> bool:
    """Whether a TOML file has a table of an object; True where it cannot be read."""
    try:
        return bool({*CURVES, *WHOLE} & set(tomllib.loads(path.read_bytes()[:MAX_BYTES].decode("utf-8"))))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError):
        return True


def object_from(fields: Mapping[str, Any], name: str = "object", folder: Path = Path()) -> SoftObject:
    """Return an object from the fields of its file; `folder` resolves relative file names."""
    known = {"name", "source", *CURVES, *WHOLE, *UNDER}
    if extra := sorted(set(fields) - known):
        raise InputError(
            f"{extra[0]!r} is no field of an object; there are {', '.join(sorted(known))}",
            code="field-unknown",
        )
    given = str(fields["name"]) if "name" in fields else None
    whole = [table for table in WHOLE if table in fields]
    if whole and (len(whole) > 1 or set(CURVES) & set(fields)):
        raise InputError(f"[{whole[0]}] and {_beside(whole, fields)}; {GIVES}", code="tables-exclude")
    if set(UNDER) & set(fields) and whole != ["fingertip"]:
        raise InputError("[material] and [compliance] need [fingertip]", code="table-missing")
    if whole:
        if "source" in fields:
            raise InputError("source is of measured curves; leave it out", code="source-excluded")
        if whole == ["specimen"]:
            return specimen_press(given, fields["specimen"])
        if whole == ["fingertip"]:
            return fingertip_press(given or name, fields, folder)
        return _hertz(given or name, fields["hertz"])
    name = given or name
    cues: dict[Cue, str] = {"area": "force_area", "displacement": "force_displacement"}
    for table in cues.values():
        if not isinstance(fields.get(table), Mapping):
            raise InputError(f"[{table}] is missing; {GIVES}", code="table-missing")
    area, displacement = (_curve(cue, table, fields[table]) for cue, table in cues.items())
    return SoftObject(name, area, displacement, str(fields.get("source", "as given")))


def _beside(whole: list[str], fields: Mapping[str, Any]) -> str:
    """What stands beside the first of the tables that belong alone."""
    return f"[{whole[1]}]" if len(whole) > 1 else "a measured curve"


def _curve(cue: Cue, table: str, fields: Mapping[str, Any]) -> Characteristic:
    unit = _unit_of(cue, table, fields)
    factor = UNITS[cue][unit]
    try:
        if f"N_per_{unit}" in fields:
            only(table, fields, {f"N_per_{unit}", f"until_{unit}"})
            until = factor * number(table, fields, f"until_{unit}")
            return polynomial(cue, numbers(table, fields, f"N_per_{unit}"), factor, until)
        only(table, fields, {f"{cue}_{unit}", "force_N"})
        x, force = (np.array(numbers(table, fields, key)) for key in (f"{cue}_{unit}", "force_N"))
        return Characteristic(cue, factor * x, force)
    except InputError as e:
        raise type(e)(f"[{table}]: {e}", code=e.code) from e


def _unit_of(cue: Cue, table: str, fields: Mapping[str, Any]) -> str:
    """The one unit in which a curve is given."""
    found = [unit for unit in UNITS[cue] if f"{cue}_{unit}" in fields or f"N_per_{unit}" in fields]
    if len(found) == 1:
        return found[0]
    allowed = ", ".join(f"{cue}_{unit}" for unit in UNITS[cue])
    raise UnitError(
        f"[{table}] has {len(found)} columns of {cue} with a unit; give one of {allowed} beside force_N, or "
        f"a polynomial such as N_per_{next(iter(UNITS[cue]))}",
        code="unit-missing",
    )


def _hertz(name: str, given: Any) -> SoftObject:
    fields = table_of("hertz", given)
    only("hertz", fields, {*BODY, *(f"finger_{key}" for key in BODY), "until_N"})
    ball, finger = (body_of("hertz", fields, owner) for owner in ("", "finger_"))
    return hertz_object(name, ball, finger, number("hertz", fields, "until_N"))
