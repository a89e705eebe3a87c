"""A HEX six-axis force sensor behind its electronics on a serial port, such as the HEX-21 of the NUSense rig.

Its box sends all the time, at the rate of its mode button: 100, 500 or 1000 samples a second. It has neither
counter nor clock: samples that arrive together are set apart by the stated rate, and the guard compares that
rate with the true one. The box takes its own zero by its tare button; palpate takes another in the air.

Source: the public interface libraries Resense.py (resense-gmbh) and ResenseHEX (TU Darmstadt, MUST). Tried on
a fake alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from palpate.core import Clock, RangeError
from palpate.rig.real.resense.hex_frames import MAX_TRIED, HexCounts, HexFrames
from palpate.rig.real.serial_force_sensor import SerialForceSensor
from palpate.rig.real.serial_port import SerialPort, open_port

BAUD = 2_000_000
RATES_HZ = (100.0, 500.0, 1000.0)
MAX_RANGE_N, MAX_RANGE_NM = 500.0, 20.0
BEGINS_S = 1.0  # until its first byte
MIN_SILENCE_S = 0.25
SILENT_PERIODS = 20.0


@dataclass(frozen=True, slots=True)
class HexSpec:
    """Specification of how a HEX sensor is reached, and what it measures.

    Attributes:
        port: a path such as /dev/ttyACM0, or the USB serial number of its box.
        range_n, range_nm: greatest force and torque of the model, from its data sheet [N, N m].
        rate_hz: by the lights of its mode button, one of `RATES_HZ` [Hz].
        keep: samples kept between two calls of `drain`.
    """

    port: str
    range_n: float
    range_nm: float
    rate_hz: float = 1000.0
    keep: int = 8192

    def __post_init__(self) -> None:
        for name, most, unit in (("range_n", MAX_RANGE_N, "N"), ("range_nm", MAX_RANGE_NM, "N m")):
            value = getattr(self, name)
            if not (0 < value <= most and math.isfinite(value)):
                raise RangeError(f"{name} is {value} {unit}; give more than 0 and at most {most:g} {unit}")
        if self.rate_hz not in RATES_HZ:
            rates = ", ".join(f"{rate:g}" for rate in RATES_HZ)
            raise RangeError(f"rate_hz is {self.rate_hz} Hz; its box has {rates} Hz, by its mode button")
        if self.keep < 1:
            raise RangeError(f"keep is {self.keep}; give 1 sample or more")


class HexSensor(SerialForceSensor):
    """A `palpate.core.ForceSensor` of six axes. Opening it waits until samples can be told apart.

    Args:
        spec: how it is reached, and what it measures.
        port: an open serial port, which this object closes.
        clock: stamps the samples.

    Raises:
        DeviceError: nothing came, or nothing of which it can be told where a sample begins.
    """

    def __init__(self, spec: HexSpec, port: SerialPort, clock: Clock | None = None) -> None:
        self._spec = spec
        self._frames = HexFrames(spec.rate_hz, spec.range_n, spec.range_nm)
        silent_s = max(MIN_SILENCE_S, SILENT_PERIODS / spec.rate_hz)
        begins_s = BEGINS_S + MAX_TRIED / spec.rate_hz
        what = f"the HEX sensor at {spec.port}"
        super().__init__(self._frames, port, what, silent_s, spec.keep, clock, begins_s)

    @classmethod
    def open(cls, spec: HexSpec, clock: Clock | None = None) -> HexSensor:
        """Open the spec's port."""
        return cls(spec, open_port(spec.port, BAUD), clock)

    @property
    def rate_hz(self) -> float:
        """Samples a second, as stated [Hz]."""
        return self._spec.rate_hz

    @property
    def range_n(self) -> tuple[float, float, float]:
        """Greatest force along each axis [N]."""
        return (self._spec.range_n,) * 3

    @property
    def counts(self) -> HexCounts:
        """Counts since it was opened."""
        with self._lock:
            return replace(self._frames.counts)

    def heard(self) -> str:
        """Say who speaks, where it is text; its own bytes are none."""
        words = self._tail.in_words()
        return "it sent bytes that are no text" if "no plain text" in words else words

    def in_silence(self) -> str:
        """Say that nothing comes, and what to check."""
        return (
            f"no sample that can be read came, {self.heard()}; check its cable, that its interface switch "
            "fits the port (USB or UART), and that its mode lights show a rate: in trigger mode it is silent"
        )
