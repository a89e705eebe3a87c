"""Objects that a named fingertip presses, from the tables of an object file.

``[fingertip]`` alone is a rigid flat; ``[material]`` or ``[compliance]`` gives the flat's modulus.
``[specimen]`` is a published silicone specimen with a finger of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from palpate.core import InputError, RangeError
from palpate.mechanics.fingertip_laws import (
    Fingertip,
    exponential_fingertip,
    finite_strain_fingertip,
    hertz_fingertip,
    on_flat,
)
from palpate.softness.characteristics import SoftObject, fingertip_object
from palpate.softness.object_fields import (
    BODY,
    Fields,
    above_zero,
    body_of,
    number,
    numbers,
    only,
    poisson_of,
    table_of,
    word,
)
from palpate.softness.specimens import SOFTENER, SpecimenClass, specimen_object, specimens
from palpate.softness.touched_flat import CUES, Cylinder, read_touched_flat

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


def _hertz(fields: Fields) -> Fingertip:
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
    "hertz": _hertz, "exponential": _exponential, "finite-strain": _finite_strain,
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
