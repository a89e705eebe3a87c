"""Drivers of softness devices: an arm and a contact-area display."""

from palpate.softness.real.force_dimension_arm import ForceDimensionArm, ForceDimensionSpec
from palpate.softness.real.labjack_display import LabJackDisplay, LabJackSettings
from palpate.softness.real.modbus_tcp import ModbusError, ModbusTcp, UnreachedError
from palpate.softness.real.sensor_scales import HallTable, OffScaleError, PressureScale

__all__ = [
    "ForceDimensionArm", "ForceDimensionSpec", "HallTable", "LabJackDisplay", "LabJackSettings",
    "ModbusError", "ModbusTcp", "OffScaleError", "PressureScale", "UnreachedError",
]  # fmt: skip
