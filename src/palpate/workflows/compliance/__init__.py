"""Compliance by touch from recorded presses: read one, calibrate on references, compare specimens."""

from palpate.workflows.compliance.compliance_files import calibrate_folder, read_files
from palpate.workflows.compliance.press_cues import PressCues, cues_of
from palpate.workflows.compliance.rigid_plate import by_plate
from palpate.workflows.compliance.specimen_comparison import compare_specimens

__all__ = ["PressCues", "by_plate", "calibrate_folder", "compare_specimens", "cues_of", "read_files"]
