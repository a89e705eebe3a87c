"""Words of readings in a terminal's line: the units of a bench, intervals, verdicts, each reason once."""

import math

from palpate.cli.verb_support import reading_words
from palpate.core import ClassReading, Reading, Readings

COMMON = {"coverage": 0.9, "drift": None, "calibration": "c", "frame": "0", "time_s": 0.0}


def length(name: str, value: float, half: float, why: str = "") -> Reading:
    return Reading(
        quantity=name, unit="m", value=value, low=value - half, high=value + half,
        calibrated_range=(-0.02, 0.02), valid=not why, why=why, **COMMON,
    )  # fmt: skip


def test_a_length_is_told_in_mm_with_its_interval_and_verdict_and_each_reason_once() -> None:
    nothing, why = math.nan, "no contact"
    told = reading_words(
        Readings(
            {
                "x_m": length("x", -0.0115412, 0.0000134),
                "y_m": length("y", nothing, nothing, why),
                "shift_x_m": length("shift_x", nothing, nothing, why),
                "depth_m": length("depth", 0.03, 0.001, "outside the calibrated range"),
                "slip": ClassReading(
                    quantity="slip", unit="", value="", members=(), classes=("no", "yes"),
                    valid=False, why="one frame alone", **COMMON,
                ),
            }
        )
    )  # fmt: skip
    assert told == [
        "x -11.541 mm ± 0.013 mm, inside the calibrated range",
        "depth 30.0 mm ± 1.0 mm, outside the calibrated range",
        "y, shift_x –: no contact",
        "slip –: one frame alone",
    ]
