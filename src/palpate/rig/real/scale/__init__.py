"""Load cells and balances that print what they weigh, over a serial port."""

from palpate.rig.real.scale.serial_scale import ScaleSpec, SerialScale

__all__ = ["ScaleSpec", "SerialScale"]
