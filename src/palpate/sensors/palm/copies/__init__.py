"""Palm units: constants fitted to a few presses of known force, presses read, and weight checks."""

from palpate.sensors.palm.copies.copy_advice import UnsureConstant, unsure_constants
from palpate.sensors.palm.copies.palm_copy import (
    CopyFit,
    PalmCopy,
    PicturedPress,
    PressFound,
    designed_copy,
    measured_copy,
)
from palpate.sensors.palm.copies.palm_copy_fit import fit_copy, read_press
from palpate.sensors.palm.copies.palm_weight import WeightCheck, check_weight

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
