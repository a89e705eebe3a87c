"""ATI's Net F/T boxes: records over UDP, calibration over HTTP."""

from palpate.rig.real.netft.netft_sensor import NetFT, NetFTSettings

__all__ = ["NetFT", "NetFTSettings"]
