"""Drift is in every JSON form of a reading, with the verdict and the code."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from palpate.core import CircularReading, ClassReading, Drift, Frame, Readings
from palpate.core.reading import (
    AlignedBox,
    MeasurementResult,
    Reading,
    VectorReading,
)
from palpate.estimators.lattice import ControlPoints
from palpate.estimators.shear import ShearTouch
from palpate.estimators.shear.touch_places import TouchPlaces
from palpate.sensing.frame_readers import TouchedFrame
from palpate.sensing.live_loop import LiveReading
from palpate.sensing.sensing_loop import Sensed
from palpate.sensing.streaming.live_statistics import LiveStatistics

STALE = Drift(2.0, 0.5)
COMMON = {
    "unit": "N", "coverage": 0.9, "valid": False, "why": "moved", "code": "camera_moved", "drift": STALE,
    "calibration": "cal", "frame": "a.png", "time_s": 0.0,
}  # fmt: skip
FORCE = Reading(quantity="force", value=1.0, low=0.5, high=1.5, calibrated_range=(0.0, 2.0), **COMMON)
GRID = np.ones(2)
KINDS = [
    FORCE,
    CircularReading(
        quantity="edge", value=1.0, low=0.5, high=1.5, period=math.pi, calibrated_range=(0.0, 3.0), **COMMON
    ),
    VectorReading(
        quantity="force", components=("x", "y"), value=GRID, region=AlignedBox(GRID),
        calibrated_range=np.ones((2, 2)), **COMMON,
    ),
    ClassReading(quantity="object", value="a", members=("a",), classes=("a", "b"), **COMMON | {"unit": ""}),
]  # fmt: skip
READINGS = Readings({"force_N": FORCE})


def _touched() -> TouchedFrame:
    none = ControlPoints(np.empty((0, 2), int), np.empty((0, 2)), np.empty(0))
    touch = ShearTouch(
        READINGS, none, None, TouchPlaces((), 0, None, None), "moved", "camera_moved", "as calibrated"
    )
    return TouchedFrame(0, Frame(np.zeros((4, 4), np.uint8), name="a.png"), touch)


def _live() -> LiveReading:
    statistics = LiveStatistics(None, None, None, None, 1, 0, 0, 0)
    image = np.zeros((2, 2), np.uint8)
    return LiveReading("a.png", 0, 0.0, READINGS, 0.0, image, None, "", "virtual:palm", statistics)


FORMS = {
    "sense": Sensed("a.png", 0.0, READINGS, 0.0).to_dict(),
    "live": _live().to_dict(),
    "shear": _touched().to_dict(),
}


def test_every_kind_of_reading_is_tried() -> None:
    def kinds(of: type) -> set[str]:  # by name: a dataclass with slots is made twice
        return {name for one in of.__subclasses__() for name in (one.__name__, *kinds(one))}

    assert kinds(MeasurementResult) == {type(one).__name__ for one in KINDS}


@pytest.mark.parametrize("one", KINDS, ids=lambda one: type(one).__name__)
def test_a_reading_s_json_has_its_drift_and_its_code(one) -> None:
    plain = json.loads(json.dumps(one.to_dict()))
    assert plain["drift"] == {"statistic": 2.0, "limit": 0.5, "drifted": True}
    assert plain["code"] == "camera_moved"
    fresh = replace(one, drift=Drift(0.4, 0.5)).to_dict()
    assert fresh["drift"]["drifted"] is False
    assert replace(one, drift=None).to_dict()["drift"] is None


@pytest.mark.parametrize("form", FORMS)
def test_a_frame_s_json_has_the_drift_of_its_calibration_and_of_each_reading(form) -> None:
    plain = json.loads(json.dumps(FORMS[form], allow_nan=False))
    assert plain["drift"]["drifted"] is True
    assert plain["readings"]["force_N"]["drift"]["drifted"] is True


def test_a_drift_that_is_no_number_counts_as_drifted() -> None:
    assert Drift(math.nan, 0.5).drifted
    assert Drift(math.inf, 0.5).drifted
