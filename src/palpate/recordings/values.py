"""Whether a value may stand in a run: finite, of its label's kind."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from numbers import Integral, Real

import numpy as np

from palpate.core.errors import InputError, LabelError
from palpate.recordings.manifest import LabelKind

Label = float | str | bool


def finite(values: Sequence[float] | np.ndarray, count: int, what: str) -> list[float]:
    """So many finite numbers, as plain floats.

    Raises:
        InputError: they are not.
    """
    try:
        array = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise InputError(f"{what} takes {count} finite numbers, got {values!r:.200}")
    return [float(value) for value in array]


def label_values(labels: Mapping[str, object], kinds: Mapping[str, LabelKind]) -> dict[str, Label]:
    """Labels as plain numbers, texts and flags.

    Raises:
        LabelError: a column that the manifest does not list, or a value of another kind than its column.
    """
    return {name: _value(name, value, kinds) for name, value in labels.items()}


def _value(name: str, value: object, kinds: Mapping[str, LabelKind]) -> Label:
    if name not in kinds:
        raise LabelError(
            f"label column {name!r} is not in the run's manifest, which lists {', '.join(kinds) or 'none'}; "
            "name every column when the manifest is made"
        )
    match kinds[name]:
        case "flag" if isinstance(value, bool | np.bool_):
            return bool(value)
        case "text" if isinstance(value, str):
            return str(value)
        case "number" if _is_number(value):
            return float(value)  # type: ignore[arg-type]
    raise LabelError(
        f"label {name!r} is a {kinds[name]} by the manifest, got {value!r:.80}; numbers are finite, and a "
        "label that is not known is left out"
    )


def _is_number(value: object) -> bool:
    if isinstance(value, Integral):
        return not isinstance(value, bool)
    return isinstance(value, Real) and math.isfinite(value)
