"""Validated fields of an object file: numbers with their unit in the key, no unknown fields."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from palpate.core import InputError, RangeError
from palpate.mechanics.half_space.hertz_pairs import Body

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
