"""A sensor unit on disk: JSON with the preset's name, terms and covariance, and what one sensor adds."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from palpate.core import Float, InputError, ndarray, new_file, storage_errors

MAX_TERM = 100.0  # in its own unit: no logarithm, angle, millimeter, pixel or mired comes near

Unit = TypeVar("Unit")


def write_unit(
    path: Path, form: str, names: Sequence[str], terms: Float[ndarray, " t"],
    covariance: Float[ndarray, "t t"], others: dict[str, Any],
) -> None:  # fmt: skip
    """Write a sensor unit to a new file; `form` is name and version, `others` are plain numbers."""
    record = {
        "format": form, "terms": dict(zip(names, terms.tolist(), strict=True)),
        "covariance": covariance.tolist(), **others,
    }  # fmt: skip
    with new_file(path) as building:
        building.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_unit(
    path: Path, form: str, names: Sequence[str], command: str,
    made: Callable[[dict[str, Any], ndarray, ndarray], Unit],
) -> Unit:  # fmt: skip
    """Read a sensor unit as `write_unit` wrote it.

    Args:
        path: File.
        form: Name and version of the format.
        names: Names of the terms.
        command: Command that writes such a file, for messages.
        made: Function from record, terms, and covariance to the unit; raises ValueError.
    """
    if not path.is_file():
        raise InputError(f"there is no file {path}; `{command}` makes one", code="file-missing")
    with storage_errors(path):
        text = path.read_bytes()
    try:
        return made(*_numbers(json.loads(text), form, names))
    except InputError as e:
        raise InputError(f"{path} is no unit that can be used: {e}", code=e.code) from e
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as e:
        raise InputError(f"{path} is no unit's file: {type(e).__name__}: {e}", code="unit-damaged") from e


def _numbers(
    record: dict[str, Any], form: str, names: Sequence[str]
) -> tuple[dict[str, Any], ndarray, ndarray]:
    if record["format"] != form:
        raise InputError(f"its format is {record['format']!r}, not {form!r}; fit anew", code="unit-format")
    terms = np.array([float(record["terms"][name]) for name in names])
    covariance = np.array(record["covariance"], dtype=np.float64)
    if covariance.shape != (len(names),) * 2 or not np.isfinite(covariance).all():
        raise ValueError("its covariance is not one of its terms")
    sound = bool((np.abs(terms) < MAX_TERM).all())
    if not (sound and np.linalg.eigvalsh((covariance + covariance.T) / 2).min() > 0):
        raise ValueError(f"its numbers are not those of {form}")
    return record, terms, covariance
