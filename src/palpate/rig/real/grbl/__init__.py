"""Stages on Grbl 1.1 and grblHAL controllers, over a serial port."""

from palpate.rig.real.grbl.spec import GrblSpec
from palpate.rig.real.grbl.stage import GrblStage

__all__ = ["GrblSpec", "GrblStage"]
