"""Velocity estimate of a noisy sampled position by a second-order filter that follows ramps."""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass
class SpeedTracker:
    """An alpha-beta filter with its two poles together at a bandwidth.

    Predict x + v dt, then x += alpha r and v += beta r / dt with the residual r, where alpha = 1 - q^2,
    beta = (1 - q)^2 and q = exp(-2 pi f dt): a ramp is followed without error.

    Reference: P. R. Kalata, IEEE Trans. Aerosp. Electron. Syst. 20 (1984) 174, doi:10.1109/TAES.1984.310438.
    """

    bandwidth_hz: float = 200.0
    _place: float | None = field(default=None, init=False)
    _speed: float = field(default=0.0, init=False)

    def speed(self, place_m: float, dt_s: float) -> float:
        """Speed after one more sample, dt_s after the last one [m/s]."""
        if self._place is None:
            self._place = place_m
            return 0.0
        q = math.exp(-2 * math.pi * self.bandwidth_hz * dt_s)
        ahead = self._place + self._speed * dt_s
        residual = place_m - ahead
        self._place = ahead + (1 - q**2) * residual
        self._speed += (1 - q) ** 2 * residual / dt_s
        return self._speed

    @property
    def place_m(self) -> float:
        """Filtered place [m]; 0 before the first sample."""
        return 0.0 if self._place is None else self._place
