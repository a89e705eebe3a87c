"""Proxies of a contact-area display and a haptic arm, which the same emergency stop holds as a stage."""

from __future__ import annotations

from palpate.core import ArmRange, ArmSample, DisplayRange, DisplaySample, HapticArm, SoftnessDevice
from palpate.devices.device_proxies import HeldProxy, driver_errors

DISPLAY_FAILED = "the display's driver failed"
ARM_FAILED = "the arm's driver failed"


class DisplayProxy(HeldProxy[SoftnessDevice]):
    """Implements `core.SoftnessDevice`; after an emergency stop it is vented, and stays so until released."""

    @property
    def range(self) -> DisplayRange:
        """Shape, greatest pressure and watchdog."""
        return self._inner.range

    def latest(self) -> DisplaySample:
        with self._noting_errors(), driver_errors(DISPLAY_FAILED):
            return self._inner.latest()

    def set_pressure(self, pressure_pa: float, rate_pa_s: float = 0.0) -> None:
        """Hold a pressure, unless it is held."""
        with self._ordering(), driver_errors(DISPLAY_FAILED):
            self._inner.set_pressure(pressure_pa, rate_pa_s)

    def vent(self) -> None:
        """Open the chamber to the air."""
        with self._noting_errors(), driver_errors(DISPLAY_FAILED):
            self._inner.vent()

    make_safe = vent


class ArmProxy(HeldProxy[HapticArm]):
    """Implements `core.HapticArm`; after an emergency stop it brakes, and goes on to until released."""

    @property
    def range(self) -> ArmRange:
        """Reach, greatest force and watchdog."""
        return self._inner.range

    def latest(self) -> ArmSample:
        with self._noting_errors(), driver_errors(ARM_FAILED):
            return self._inner.latest()

    def set_force(self, force_n: float) -> None:
        """Push with a force, unless it is held."""
        with self._ordering(), driver_errors(ARM_FAILED):
            self._inner.set_force(force_n)

    def brake(self) -> None:
        """Drop the force and brake."""
        with self._noting_errors(), driver_errors(ARM_FAILED):
            self._inner.brake()

    make_safe = brake
