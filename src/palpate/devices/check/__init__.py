"""Conformance checks that anybody can run on a driver of their own: does it keep its promises?

Every check returns results, the good ones too. A stage is moved only inside a box that the caller states:
choose it in free air. A haptic arm is pushed so too, and a display is put under pressure with nobody on it.
No other check pushes.
"""

from palpate.devices.check.arm_check import check_arm
from palpate.devices.check.camera_check import check_camera
from palpate.devices.check.display_check import check_display
from palpate.devices.check.force_check import check_force_sensor
from palpate.devices.check.interface_check import CheckResult, check_interface
from palpate.devices.check.stage_check import check_stage

__all__ = [
    "CheckResult",
    "check_arm",
    "check_camera",
    "check_display",
    "check_force_sensor",
    "check_interface",
    "check_stage",
]
