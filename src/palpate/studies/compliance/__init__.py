"""Compliance by touch from recorded presses: read one, calibrate on references, compare specimens."""

from palpate.studies.compliance.compare import compare_specimens
from palpate.studies.compliance.cues import Cues, cues_of
from palpate.studies.compliance.files import calibrate_folder, read_files
from palpate.studies.compliance.plate import by_plate

__all__ = ["Cues", "by_plate", "calibrate_folder", "compare_specimens", "cues_of", "read_files"]
