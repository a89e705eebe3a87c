"""Palm units: constants fitted to a few presses of known force, presses read, and weight checks."""

from palpate.sensors.palm.copies.copy_estimate import UnsureConstant, unsure_constants
from palpate.sensors.palm.copies.palm_copy import (
    CopyFit,
    PalmCopy,
    PicturedPress,
    PressFound,
    designed_copy,
    measured_copy,
)
from palpate.sensors.palm.copies.palm_copy_fit import WeightCheck, check_weight, fit_copy, read_press

__all__ = [
    "CopyFit",
    "PalmCopy",
    "PicturedPress",
    "PressFound",
    "UnsureConstant",
    "WeightCheck",
    "check_weight",
    "designed_copy",
    "fit_copy",
    "measured_copy",
    "read_press",
    "unsure_constants",
]
