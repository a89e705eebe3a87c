"""An object to be felt, read from a TOML file: measured tables, polynomials, or elastic bodies by Hertz.

Each number's key says its unit. Two tables, as measured:

    name = "foam ball"
    [force_area]
    area_mm2 = [0.0, 20.0, 60.0, 130.0]
    force_N = [0.0, 0.6, 1.6, 3.4]
    [force_displacement]
    displacement_mm = [0.0, 1.0, 2.0, 4.0]
    force_N = [0.0, 0.5, 1.3, 3.6]

A polynomial takes the place of either table, as in ``N_per_cm2 = [0.554, 0.33, 1.4]`` with ``until_cm2``.
In place of both, ``[hertz]`` gives ``modulus_kPa``, ``radius_mm`` (inf for a flat) and ``poisson`` of the
object, the same of the finger with ``finger_`` before them, and ``until_N``.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core import InputError, UnitError, storage_errors
from palpate.mechanics.half_space.hertz_pairs import Body
from palpate.softness.characteristics import Characteristic, Cue, SoftObject, hertz_object, polynomial

AREAS = {"mm2": 1e-6, "cm2": 1e-4, "m2": 1.0}
LENGTHS = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0}
UNITS: Mapping[Cue, Mapping[str, float]] = {"area": AREAS, "displacement": LENGTHS}
BODY = ("modulus_kPa", "radius_mm", "poisson")
MAX_BYTES = 1 << 20
GIVES = "give [force_area] and [force_displacement], or [hertz]"


def read_object(path: Path) -> SoftObject:
    """Read an object's file.

    Raises:
        UnitError: a value has no unit in its key.
        InputError: the file is not TOML, or lacks something, or force does not rise throughout.
        RangeError: a value that no object has.
        StorageError: the file cannot be read.
    """
    with storage_errors(path):
        if not path.is_file() or path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path} is no object's file: a TOML file of 1 MiB at most is needed; {GIVES}")
        raw = path.read_bytes()
    try:
        fields = tomllib.loads(raw.decode("utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as e:
        raise InputError(f"{path} is not TOML: {e}") from e
    try:
        return object_from(fields, path.stem)
    except InputError as e:
        raise type(e)(f"{path}: {e}") from e


def object_from(fields: Mapping[str, Any], name: str = "object") -> SoftObject:
    """An object from the fields of its file; all that `read_object` raises."""
    known = {"name", "source", "force_area", "force_displacement", "hertz"}
    if extra := sorted(set(fields) - known):
        raise InputError(f"{extra[0]!r} is no field of an object; there are {', '.join(sorted(known))}")
    name = str(fields.get("name", name))
    if "hertz" in fields:
        if {"force_area", "force_displacement"} & set(fields):
            raise InputError(f"[hertz] and a measured curve; {GIVES}")
        return _hertz(name, fields["hertz"])
    cues: dict[Cue, str] = {"area": "force_area", "displacement": "force_displacement"}
    for table in cues.values():
        if not isinstance(fields.get(table), Mapping):
            raise InputError(f"[{table}] is missing; {GIVES}")
    area, displacement = (_curve(cue, table, fields[table]) for cue, table in cues.items())
    return SoftObject(name, area, displacement, str(fields.get("source", "as given")))


def _curve(cue: Cue, table: str, fields: Mapping[str, Any]) -> Characteristic:
    unit = _unit_of(cue, table, fields)
    factor = UNITS[cue][unit]
    try:
        if f"N_per_{unit}" in fields:
            _only(table, fields, {f"N_per_{unit}", f"until_{unit}"})
            until = factor * _number(table, fields, f"until_{unit}")
            return polynomial(cue, _numbers(table, fields, f"N_per_{unit}"), factor, until)
        _only(table, fields, {f"{cue}_{unit}", "force_N"})
        x, force = (np.array(_numbers(table, fields, key)) for key in (f"{cue}_{unit}", "force_N"))
        return Characteristic(cue, factor * x, force)
    except InputError as e:
        raise type(e)(f"[{table}]: {e}") from e


def _unit_of(cue: Cue, table: str, fields: Mapping[str, Any]) -> str:
    """The one unit in which a curve is given."""
    found = [unit for unit in UNITS[cue] if f"{cue}_{unit}" in fields or f"N_per_{unit}" in fields]
    if len(found) == 1:
        return found[0]
    allowed = ", ".join(f"{cue}_{unit}" for unit in UNITS[cue])
    raise UnitError(
        f"[{table}] has {len(found)} columns of {cue} with a unit; give one of {allowed} beside force_N, or "
        f"a polynomial such as N_per_{next(iter(UNITS[cue]))}"
    )


def _hertz(name: str, fields: Any) -> SoftObject:
    if not isinstance(fields, Mapping):
        raise InputError(f"[hertz] is no table; {GIVES}")
    _only("hertz", fields, {*BODY, *(f"finger_{key}" for key in BODY), "until_N"})
    bodies = [_body(fields, owner) for owner in ("", "finger_")]
    return hertz_object(name, bodies[0], bodies[1], _number("hertz", fields, "until_N"))


def _body(fields: Mapping[str, Any], owner: str) -> Body:
    modulus, radius, nu = (_number("hertz", fields, f"{owner}{key}") for key in BODY)
    if not 0 <= nu <= 0.5:
        raise InputError(f"[hertz]: {owner}poisson is {nu:g}; 0 to 0.5 are allowed")
    return Body(1e3 * modulus / (1 - nu**2), 1e-3 * radius)


def _only(table: str, fields: Mapping[str, Any], known: set[str]) -> None:
    if extra := sorted(set(fields) - known):
        raise InputError(f"[{table}]: {extra[0]!r} is no field here; there are {', '.join(sorted(known))}")


def _number(table: str, fields: Mapping[str, Any], key: str) -> float:
    value = fields.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"[{table}]: {key} is {value!r}; give a number")
    return float(value)


def _numbers(table: str, fields: Mapping[str, Any], key: str) -> list[float]:
    values = fields.get(key)
    if not isinstance(values, list) or not all(
        isinstance(one, int | float) and not isinstance(one, bool) for one in values
    ):
        raise InputError(f"[{table}]: {key} is {values!r}; give a list of numbers")
    return [float(one) for one in values]
