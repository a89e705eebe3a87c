"""Conformance checks that anybody can run on a driver of their own: does it keep its promises?

Every check returns findings, the good ones too. A stage is moved only inside a box that the caller states:
choose it in free air. No check pushes.
"""

from palpate.rig.check.camera import check_camera
from palpate.rig.check.finding import Finding
from palpate.rig.check.force import check_force_sensor
from palpate.rig.check.rig import check_rig
from palpate.rig.check.stage import check_stage

__all__ = ["Finding", "check_camera", "check_force_sensor", "check_rig", "check_stage"]
