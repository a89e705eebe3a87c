"""Drivers of real devices, one a file; each needs its own library only when it is opened."""

from palpate.rig.real.grbl import GrblStage
from palpate.rig.real.grbl_spec import GrblSpec
from palpate.rig.real.netft import NetFT
from palpate.rig.real.netft_settings import NetFTSettings
from palpate.rig.real.uvc import UvcCamera, UvcSettings

__all__ = ["GrblSpec", "GrblStage", "NetFT", "NetFTSettings", "UvcCamera", "UvcSettings"]
