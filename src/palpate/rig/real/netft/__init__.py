"""ATI's Net F/T boxes: records over UDP, calibration over HTTP."""

from palpate.rig.real.netft.sensor import NetFT, NetFTSettings

__all__ = ["NetFT", "NetFTSettings"]
