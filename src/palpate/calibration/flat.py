"""Nested dataclasses of arrays, numbers and words as one flat set of arrays, and back; no pickles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from types import UnionType
from typing import Any, get_args, get_type_hints

import numpy as np
from numpy import ndarray


def flat(held: Any, prefix: str = "") -> dict[str, ndarray]:
    """Every field under its dotted name; what is None is left out."""
    found: dict[str, ndarray] = {}
    for field in fields(held):
        value, name = getattr(held, field.name), prefix + field.name
        if is_dataclass(value):
            found |= flat(value, f"{name}.")
        elif value is not None:
            found[name] = np.asarray(value)
    return found


def built(kind: type, data: Mapping[str, ndarray], prefix: str = "") -> Any:
    """The dataclass that `flat` took apart.

    Raises:
        KeyError: a field is missing that may not be None.
    """
    made: dict[str, Any] = {}
    for name, hint in get_type_hints(kind).items():
        full, (inner, optional) = prefix + name, _plain(hint)
        if optional and not any(key == full or key.startswith(f"{full}.") for key in data):
            made[name] = None
        elif is_dataclass(inner):
            made[name] = built(inner, data, f"{full}.")  # type: ignore[arg-type]
        else:
            made[name] = _value(data[full], inner)
    return kind(**made)


def _plain(hint: Any) -> tuple[Any, bool]:
    """A type without its None, and whether it had one."""
    if isinstance(hint, UnionType):
        rest = [one for one in get_args(hint) if one is not type(None)]
        return rest[0], len(rest) < len(get_args(hint))
    return hint, False


def _value(value: ndarray, kind: Any) -> Any:
    if kind in (int, float, str):
        return kind(value.item())
    return tuple(value.tolist()) if getattr(kind, "__origin__", None) is tuple else value
