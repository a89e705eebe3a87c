"""Conformance checks that anybody can run on a driver of their own: does it keep its promises?

Every check returns results, the good ones too. A stage is moved only inside a box that the caller states:
choose it in free air. No check pushes.
"""

from palpate.devices.check.camera_check import check_camera
from palpate.devices.check.check_result import CheckResult
from palpate.devices.check.force_check import check_force_sensor
from palpate.devices.check.interface_check import check_interface
from palpate.devices.check.stage_check import check_stage

__all__ = ["CheckResult", "check_camera", "check_force_sensor", "check_interface", "check_stage"]
