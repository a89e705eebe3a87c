"""Six-axis force sensors of the HEX series, with their electronics on a serial port."""

from palpate.rig.real.resense.hex_sensor import HexSensor, HexSpec

__all__ = ["HexSensor", "HexSpec"]
