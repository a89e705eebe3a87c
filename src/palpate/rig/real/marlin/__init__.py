"""Stages on Marlin controllers, as 3-D printers have them, over a serial port."""

from palpate.rig.real.marlin.marlin_spec import MarlinSpec
from palpate.rig.real.marlin.marlin_stage import MarlinStage

__all__ = ["MarlinSpec", "MarlinStage"]
