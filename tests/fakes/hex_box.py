"""A fake of the electronics of a HEX six-axis force sensor. It fails as it is told to.

Made from public interface descriptions, not from a device (Resense.py of resense-gmbh; ResenseHEX of TU
Darmstadt): 28 bytes a sample, seven little-endian 32-bit floats, Fx, Fy, Fz [N], Mx, My, Mz [mN m] and the
temperature [deg C], at 100, 500 or 1000 Hz, with no mark of where a sample begins; silent in trigger mode;
raw signals where the matrix is switched off. Baud and interface switch are not simulated.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Six = tuple[float, float, float, float, float, float]
RAW = 40_000.0  # raw signals of a newton; of the order of a 24-bit converter's


@dataclass(frozen=True, slots=True)
class HexFaults:
    """Faults; none by default.

    Attributes:
        trigger: it waits to be triggered, and sends nothing.
        raw: its matrix is off.
        stuck: it sends the last sample again and again.
        lose_every: of so many bytes one is lost; 0 for none.
        not_a_number: every force is NaN.
        slow: it sends a fifth of its samples.
    """

    trigger: bool = False
    raw: bool = False
    stuck: bool = False
    lose_every: int = 0
    not_a_number: bool = False
    slow: bool = False


class HexBox:
    """Device at the other end of a serial line; times in seconds.

    Args:
        load: forces [N] and torques [N m] at a time.
        rate_hz: samples a second [Hz].
        noise_n, noise_nm: standard deviations of one sample [N, N m].
        celsius: temperature of the sensor [deg C].
        cut: bytes of the first sample that the host never hears, as it opens the port in the midst of one.
        faults: may be changed at any time.
    """

    def __init__(
        self,
        load: Callable[[float], Six] = lambda t: (0.0,) * 6,
        *,
        rate_hz: float = 1000.0,
        noise_n: float = 5e-3,
        noise_nm: float = 5e-5,
        celsius: float = 26.4,
        cut: int = 0,
        faults: HexFaults | None = None,
        now_s: float = 0.0,
    ) -> None:
        self._load, self._rate_hz, self._celsius = load, rate_hz, celsius
        self._noise = np.array([noise_n] * 3 + [noise_nm] * 3)
        self.faults = faults or HexFaults()
        self._next_s, self._cut = now_s, cut
        self._out, self._draw = bytearray(), np.random.default_rng(0)
        self._last = b""
        self._sent = self._turn = 0

    def receive(self, data: bytes) -> None:
        """Bytes from the host, which it does not heed."""

    def take(self) -> bytes:
        """Bytes for the host."""
        sent, self._out = bytes(self._out), bytearray()
        return sent

    def run_to(self, now_s: float) -> None:
        """Let time go by until then [s]."""
        while self._next_s <= now_s:
            self._turn += 1
            if not self.faults.trigger and not (self.faults.slow and self._turn % 5):
                self._send(self._sample(self._next_s))
            self._next_s += 1.0 / self._rate_hz

    def _sample(self, time_s: float) -> bytes:
        if self.faults.stuck and self._last:
            return self._last
        values = np.array(self._load(time_s)) + self._noise * self._draw.standard_normal(6)
        values[3:] *= 1e3
        if self.faults.raw:
            values *= RAW
        if self.faults.not_a_number:
            values[:3] = np.nan
        self._last = struct.pack("<7f", *values, self._celsius)
        return self._last

    def _send(self, sample: bytes) -> None:
        sample, self._cut = sample[self._cut :], 0
        for byte in sample:
            self._sent += 1
            if not (self.faults.lose_every and self._sent % self.faults.lose_every == 0):
                self._out.append(byte)
