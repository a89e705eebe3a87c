"""Normal force of a patterned skin in newtons, with its interval, from the motion of its marks."""

from palpate.calibration.shear.calibrate_runs import calibrate_runs, weigh_copy
from palpate.calibration.shear.shear_calibration import (
    ForceFollower,
    ShearCalibration,
    calibrate_shear,
    calibration_record,
)
from palpate.calibration.shear.touch_cues import CueMeter, LabelledCues, TouchCues, cues_of_run, joined
from palpate.calibration.shear.traction_force import SkinDoubt, force_budget, traction_readings

__all__ = [
    "CueMeter", "ForceFollower", "LabelledCues", "ShearCalibration", "SkinDoubt", "TouchCues",
    "calibrate_runs", "calibrate_shear", "calibration_record", "cues_of_run", "force_budget", "joined",
    "traction_readings", "weigh_copy",
]  # fmt: skip
