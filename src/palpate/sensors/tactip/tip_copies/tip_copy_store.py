"""A TacTip unit on disk."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core import InputError, ndarray
from palpate.core.parsing import parser
from palpate.estimators.unit_fit import read_unit, write_unit
from palpate.sensors.tactip.tactip_sensor import tactip
from palpate.sensors.tactip.tip_copies.tip_copy import COPY_TERMS, TipCopy

TIP_COPY_FORMAT = "palpate tip copy 1"


def write_tip_copy(copy: TipCopy, design: str, path: Path) -> None:
    """Write a unit of the preset `design` with its untouched pins as JSON; the path must not exist."""
    if copy.rest_px is None or copy.cells is None:
        raise InputError("this copy has seen no press; fit it to presses first", code="no-presses")
    others = {
        "preset": design, "rest_px": copy.rest_px.tolist(), "cells": copy.cells.tolist(),
        "limit_off": copy.limit_off,
    }  # fmt: skip
    write_unit(path, TIP_COPY_FORMAT, COPY_TERMS, copy.terms, copy.covariance, others)


@parser("tip unit", InputError)
def load_tip_copy(path: Path) -> TipCopy:
    """Read a unit written by `write_tip_copy`."""
    return read_unit(path, TIP_COPY_FORMAT, COPY_TERMS, "palpate calibrate --method tip-unit", _made)


def _made(record: dict[str, Any], terms: ndarray, covariance: ndarray) -> TipCopy:
    rest, cells = np.array(record["rest_px"], np.float64), np.array(record["cells"], np.int64)
    spec, limit = tactip(str(record["preset"])).spec, float(record["limit_off"])
    if not (rest.shape == cells.shape == (len(rest), 2) and len(rest) > 0):
        raise ValueError("its pins and their cells do not fit each other")
    if not (np.isfinite(rest).all() and math.isfinite(limit)):
        raise ValueError("places of pins, or the limit of a misfit, are not finite")
    return TipCopy(spec, terms, covariance, rest, cells, limit)
