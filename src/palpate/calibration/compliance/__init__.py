"""Compliance by touch from recorded presses: calibrate on references, read a press, compare specimens."""

from palpate.calibration.compliance.compliance_calibration import calibrate_folder
from palpate.calibration.compliance.latency_file import CameraLatency, measure_latency
from palpate.calibration.compliance.press_cues import press_record, read_press
from palpate.calibration.compliance.reference_stiffness import plate_stiffness
from palpate.calibration.compliance.specimen_comparison import compare_specimens

__all__ = [
    "CameraLatency",
    "calibrate_folder",
    "compare_specimens",
    "measure_latency",
    "plate_stiffness",
    "press_record",
    "read_press",
]
