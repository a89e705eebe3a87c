"""Stages on Grbl 1.1 and grblHAL controllers, over a serial port."""

from palpate.rig.real.grbl.grbl_stage import GrblStage
from palpate.rig.real.grbl.grbl_supervisor import GrblSpec

__all__ = ["GrblSpec", "GrblStage"]
