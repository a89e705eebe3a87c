"""A TacTip's copy on disk."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core import InputError, new_file, storage_errors
from palpate.core.parsing import parser
from palpate.sensors.tactip.tactip_sensor import tactip
from palpate.sensors.tactip.tip_copies.tip_copy import COPY_TERMS, TipCopy

TIP_COPY_FORMAT = "palpate tip copy 1"


def write_tip_copy(copy: TipCopy, design: str, path: Path) -> None:
    """Write a copy as JSON.

    Args:
        copy: with its untouched pins.
        design: preset of the TacTip, see `tactip_sensor.tactip`.
        path: must not exist.

    Raises:
        ExistsError: `path` exists.
        InputError: a copy that has seen no pins yet.
        StorageError: the disk refused.
    """
    if copy.rest_px is None or copy.cells is None:
        raise InputError("this copy has seen no press; fit it to presses first")
    record: dict[str, Any] = {
        "format": TIP_COPY_FORMAT, "preset": design,
        "terms": dict(zip(COPY_TERMS, copy.terms.tolist(), strict=True)),
        "covariance": copy.covariance.tolist(), "rest_px": copy.rest_px.tolist(),
        "cells": copy.cells.tolist(), "limit_off": copy.limit_off,
    }  # fmt: skip
    with new_file(path) as building:
        building.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n", encoding="utf-8")


@parser("tip unit", InputError)
def load_tip_copy(path: Path) -> TipCopy:
    """A copy as `write_tip_copy` wrote it.

    Raises:
        InputError: no copy's file, or one whose numbers make none.
        StorageError: it cannot be read.
    """
    if not path.is_file():
        raise InputError(f"there is no copy's file {path}; `palpate tip calibrate` makes one")
    with storage_errors(path):
        text = path.read_bytes()
    try:
        record = json.loads(text)
        terms = np.array([float(record["terms"][name]) for name in COPY_TERMS])
        covariance = np.array(record["covariance"], dtype=np.float64)
        rest, cells = np.array(record["rest_px"], np.float64), np.array(record["cells"], np.int64)
        fits = record["format"] == TIP_COPY_FORMAT and covariance.shape == (len(COPY_TERMS),) * 2
        fits = fits and rest.shape == cells.shape == (len(rest), 2) and len(rest) > 0
        spec, limit = tactip(str(record["preset"])).spec, float(record["limit_off"])
    except (ValueError, KeyError, TypeError) as e:
        raise InputError(f"{path} is no tip's copy: {type(e).__name__}: {e}") from e
    sound = fits and all(np.isfinite(one).all() for one in (terms, covariance, rest, np.array(limit)))
    if not (sound and np.linalg.eigvalsh((covariance + covariance.T) / 2).min() > 0):
        raise InputError(f"{path} is no tip's copy: its numbers are not those of {TIP_COPY_FORMAT}")
    return TipCopy(spec, terms, covariance, rest, cells, limit)
