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

Validated fields of an object file: numbers with their unit in the key, no unknown fields.

Objects that a named fingertip presses, from the tables of an object file.

``[fingertip]`` alone is a rigid flat; ``[material]`` or ``[compliance]`` gives the flat's modulus.
``[specimen]`` is a published silicone specimen with a finger of its own.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core import InputError, RangeError, UnitError, storage_errors
from palpate.core.parsing import parser
from palpate.mechanics.fingertip_laws import (
    Fingertip,
    exponential_fingertip,
    finite_strain_fingertip,
    hertz_fingertip,
    on_flat,
)
from palpate.mechanics.half_space.hertz import Body
from palpate.softness.characteristics import (
    Characteristic,
    Cue,
    SoftObject,
    fingertip_object,
    hertz_object,
    polynomial,
)
from palpate.softness.specimens import SOFTENER, SpecimenClass, specimen_object, specimens
from palpate.softness.touched_flat import CUES, Cylinder, read_touched_flat

Fields = Mapping[str, Any]
BODY = ("modulus_kPa", "radius_mm", "poisson")


def table_of(name: str, fields: Any) -> Fields:
    """A table of the file."""
    if not isinstance(fields, Mapping):
        raise InputError(f"[{name}] is no table; write its fields below it", code="not-a-table")
    return fields


def only(table: str, fields: Fields, known: set[str]) -> None:
    """Refuse a field that is not known."""
    if extra := sorted(set(fields) - known):
        raise InputError(
            f"[{table}]: {extra[0]!r} is no field here; there are {', '.join(sorted(known))}",
            code="field-unknown",
        )


def number(table: str, fields: Fields, key: str) -> float:
    """A number."""
    value = fields.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"[{table}]: {key} is {value!r}; give a number", code="not-a-number")
    return float(value)


def above_zero(table: str, fields: Fields, key: str, *, endless: bool = False) -> float:
    """A number above 0 in the unit of its key, and finite unless `endless`."""
    value = number(table, fields, key)
    if not value > 0 or (math.isinf(value) and not endless):
        allowed = "above 0, inf among them," if endless else "above 0 and finite"
        raise RangeError(f"[{table}]: {key} is {value:g}; give one {allowed}", code="not-positive")
    return value


def poisson_of(table: str, fields: Fields, key: str = "poisson") -> float:
    """A Poisson's ratio."""
    nu = number(table, fields, key)
    if not 0 <= nu <= 0.5:
        raise RangeError(f"[{table}]: {key} is {nu:g}; 0 to 0.5 are allowed", code="poisson")
    return nu


def numbers(table: str, fields: Fields, key: str) -> list[float]:
    """A list of numbers."""
    values = fields.get(key)
    if not isinstance(values, list) or not all(
        isinstance(one, int | float) and not isinstance(one, bool) for one in values
    ):
        raise InputError(f"[{table}]: {key} is {values!r}; give a list of numbers", code="not-a-list")
    return [float(one) for one in values]


def word(table: str, fields: Fields, key: str, *allowed: str) -> str:
    """A word, one of those allowed where there are such."""
    value = fields.get(key)
    if not isinstance(value, str) or (allowed and value not in allowed):
        choice = f"one of {', '.join(allowed)}" if allowed else "words in quotes"
        raise InputError(f"[{table}]: {key} is {value!r}; give {choice}", code="word-unknown")
    return value


def body_of(table: str, fields: Fields, owner: str = "") -> Body:
    """An elastic ball of `modulus_kPa`, `radius_mm` and `poisson`, each after its owner's name."""
    modulus = above_zero(table, fields, f"{owner}modulus_kPa")
    radius = above_zero(table, fields, f"{owner}radius_mm", endless=True)
    nu = poisson_of(table, fields, f"{owner}poisson")
    return Body(1e3 * modulus / (1 - nu**2), 1e-3 * radius)


UNDER = ("material", "compliance")


def fingertip_press(name: str, fields: Mapping[str, Any], folder: Path) -> SoftObject:
    """Return what a finger feels of a rigid flat, a material, or a measured object."""
    own = table_of("fingertip", fields["fingertip"])
    tip = _fingertip(own)
    until = above_zero("fingertip", own, "until_N")
    under = [table for table in UNDER if table in fields]
    if len(under) > 1:
        raise InputError("[material] and [compliance]; leave one out", code="tables-exclude")
    words = "rigid flat"
    if under:
        fields_under = table_of(under[0], fields[under[0]])
        flat_pa, words = (
            _material(fields_under) if under == ["material"] else _compliance(fields_under, folder)
        )
        tip = on_flat(tip, flat_pa)
    felt = fingertip_object(name, tip, until)
    return SoftObject(name, felt.area, felt.displacement, f"{words}; {felt.source}")


def _fingertip(fields: Fields) -> Fingertip:
    model = word("fingertip", fields, "model", *MODELS)
    return MODELS[model](fields)


def _hertz_fingertip(fields: Fields) -> Fingertip:
    only("fingertip", fields, {"model", "until_N", *BODY})
    return hertz_fingertip(body_of("fingertip", fields))


def _exponential(fields: Fields) -> Fingertip:
    keys = ("b_N", "m_per_mm", "area_at_1_N_mm2")
    only("fingertip", fields, {"model", "until_N", "area_exponent", *keys})
    b, m, k = (above_zero("fingertip", fields, key) for key in keys)
    return exponential_fingertip(b, 1e3 * m, 1e-6 * k, number("fingertip", fields, "area_exponent"))


def _finite_strain(fields: Fields) -> Fingertip:
    only("fingertip", fields, {"model", "until_N", "tip", "radius_mm", "gel_modulus_kPa"})
    radius, modulus = (above_zero("fingertip", fields, key) for key in ("radius_mm", "gel_modulus_kPa"))
    return finite_strain_fingertip(word("fingertip", fields, "tip"), 1e-3 * radius, 1e3 * modulus)


MODELS: Mapping[str, Callable[[Fields], Fingertip]] = {
    "hertz": _hertz_fingertip, "exponential": _exponential, "finite-strain": _finite_strain,
}  # fmt: skip


def _material(fields: Fields) -> tuple[float, str]:
    """A thick flat by its Young's modulus: E / (1 - nu^2) [Pa], and words."""
    only("material", fields, {"name", "modulus_kPa", "poisson", "source"})
    modulus, nu = above_zero("material", fields, "modulus_kPa"), poisson_of("material", fields)
    where = f" ({word('material', fields, 'source')})" if "source" in fields else ""
    named = f"{word('material', fields, 'name')}: {modulus:g} kPa, Poisson's ratio {nu:g}{where}"
    return 1e3 * modulus / (1 - nu**2), named


def _compliance(fields: Fields, folder: Path) -> tuple[float, str]:
    """A thick flat by a reading of `palpate read`: E / (1 - nu^2) [Pa], and words."""
    use = word("compliance", fields, "use", *CUES)
    shape = set() if use == "modulus" else {"specimen_radius_mm", "specimen_height_mm", "poisson", "ends"}
    only("compliance", fields, {"readings", "use", *shape})
    cylinder = None
    if use != "modulus":
        radius, height = (
            1e-3 * above_zero("compliance", fields, f"specimen_{side}_mm") for side in ("radius", "height")
        )
        ends = word("compliance", fields, "ends", "bonded", "free") if "ends" in fields else "bonded"
        cylinder = Cylinder(radius, height, poisson_of("compliance", fields), ends)  # type: ignore[arg-type]
    flat = read_touched_flat(folder / word("compliance", fields, "readings"), use, cylinder)
    return flat.flat_pa, flat.words


def specimen_press(name: str | None, fields: Any) -> SoftObject:
    """One of the report's specimens; see `palpate.softness.specimens`."""
    fields = table_of("specimen", fields)
    finger = {f"finger_{key}" for key in BODY}
    only("specimen", fields, {"class", "number", "moduli_kPa", "poisson", "until_N", *finger})
    kind = SpecimenClass(word("specimen", fields, "class", *SpecimenClass))
    place = number("specimen", fields, "number")
    if place not in range(1, len(SOFTENER) + 1):
        raise RangeError(
            f"[specimen]: number is {place:g}; 1 to {len(SOFTENER)} are allowed, of which 1 has the upper "
            "silicone with no softener (of CL2 the only one)",
            code="specimen-number",
        )
    moduli = [1e3 * E for E in numbers("specimen", fields, "moduli_kPa")]
    one = specimens(kind, moduli, poisson_of("specimen", fields))[int(place) - 1]
    felt = specimen_object(
        one, body_of("specimen", fields, "finger_"), above_zero("specimen", fields, "until_N")
    )
    return SoftObject(name or one.name, felt.area, felt.displacement, felt.source)


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
