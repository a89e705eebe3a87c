"""Drivers of softness devices: an arm and a contact-area display."""

from palpate.softness.real.force_dimension_arm import ForceDimensionArm, ForceDimensionSpec
from palpate.softness.real.labjack_display import (
    HallTable,
    LabJackDisplay,
    LabJackSettings,
    OffScaleError,
    PressureScale,
)
from palpate.softness.real.modbus_tcp import ModbusError, ModbusTcp, UnreachedError

__all__ = [
    "ForceDimensionArm", "ForceDimensionSpec", "HallTable", "LabJackDisplay", "LabJackSettings",
    "ModbusError", "ModbusTcp", "OffScaleError", "PressureScale", "UnreachedError",
]  # fmt: skip
