"""Arms of Universal Robots, over the library ur_rtde."""

from palpate.rig.real.ur_arm.arm_spec import MAX_SPEED_M_S, ArmFrame, UrArmSpec
from palpate.rig.real.ur_arm.ur_arm_stage import UrArmStage

__all__ = ["MAX_SPEED_M_S", "ArmFrame", "UrArmSpec", "UrArmStage"]
