"""Drivers of real devices, one a file or folder; each needs its own library only when it is opened."""

from palpate.rig.real.grbl import GrblSpec, GrblStage
from palpate.rig.real.marlin import MarlinSpec, MarlinStage
from palpate.rig.real.netft import NetFT, NetFTSettings
from palpate.rig.real.resense import HexSensor, HexSpec
from palpate.rig.real.scale import ScaleSpec, SerialScale
from palpate.rig.real.ur_arm import ArmFrame, UrArmSpec, UrArmStage
from palpate.rig.real.uvc_camera import UvcCamera, UvcSettings

__all__ = [
    "ArmFrame",
    "GrblSpec",
    "GrblStage",
    "HexSensor",
    "HexSpec",
    "MarlinSpec",
    "MarlinStage",
    "NetFT",
    "NetFTSettings",
    "ScaleSpec",
    "SerialScale",
    "UrArmSpec",
    "UrArmStage",
    "UvcCamera",
    "UvcSettings",
]
