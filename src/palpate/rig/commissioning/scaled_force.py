"""A force sensor whose readings are multiplied by a factor that a known weight gave."""

from __future__ import annotations

from dataclasses import replace

from palpate.core import ForceSensor, Wrench


class ScaledForce:
    """A `palpate.core.ForceSensor` behind a factor; its range grows by the same.

    Args:
        sensor: what measures.
        scale: true force over the one that is read.
    """

    def __init__(self, sensor: ForceSensor, scale: float) -> None:
        self._sensor, self.scale = sensor, scale

    @property
    def rate_hz(self) -> float:
        """Samples a second."""
        return self._sensor.rate_hz

    @property
    def range_n(self) -> tuple[float, float, float]:
        """Greatest force along each axis [N]."""
        x, y, z = (self.scale * force for force in self._sensor.range_n)
        return x, y, z

    def latest(self) -> Wrench:
        """The newest sample. See `palpate.core.ForceSensor`."""
        return self._scaled(self._sensor.latest())

    def drain(self) -> list[Wrench]:
        """All samples since the last call. See `palpate.core.ForceSensor`."""
        return [self._scaled(one) for one in self._sensor.drain()]

    def close(self) -> None:
        """Let go of the sensor."""
        self._sensor.close()

    def _scaled(self, sample: Wrench) -> Wrench:
        fx, fy, fz = (self.scale * force for force in sample.force_n)
        tx, ty, tz = (self.scale * torque for torque in sample.torque_nm)
        return replace(sample, force_n=(fx, fy, fz), torque_nm=(tx, ty, tz))
