"""Stages on Marlin controllers, as 3-D printers have them, over a serial port."""

from palpate.rig.real.marlin.marlin_stage import MarlinSpec, MarlinStage

__all__ = ["MarlinSpec", "MarlinStage"]
