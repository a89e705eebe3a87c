"""Frequency response of a display's pressure, with the tip held halfway.

The response depends on the amplitude: valve overlap attenuates small sines, saturation large ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palpate.core import (
    Clock,
    DeviceError,
    Float,
    InputError,
    Progress,
    RangeError,
    SoftnessDevice,
    ndarray,
    silent,
)
from palpate.softness.display_bench_test import PERIOD_S, each_period

MIDDLE_PA = 30e3
FREQUENCIES_HZ = (2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 30.0, 45.0, 65.0, 90.0, 130.0, 180.0)
SETTLE_S = 0.3
CYCLES = 4.0  # that are fitted, after one that is not
MIN_FITTED_S = 0.15
HALF_POWER = 1 / math.sqrt(2)

Column = Float[ndarray, " n"]


@dataclass(frozen=True, slots=True, eq=False)
class PressureResponse:
    """Gain and unwrapped phase (negative when late) of a pressure to sines of one amplitude."""

    amplitude_pa: float
    frequency_hz: Column
    gain: Column
    phase_rad: Column

    @property
    def bandwidth_hz(self) -> float:
        """Lowest frequency at which the gain falls to -3 dB [Hz]; infinite if never, 0 if from the first."""
        below = self.gain < HALF_POWER
        if not below.any():
            return math.inf
        i = int(np.argmax(below))
        if i == 0:
            return 0.0
        share = (self.gain[i - 1] - HALF_POWER) / (self.gain[i - 1] - self.gain[i])
        low, high = np.log(self.frequency_hz[i - 1 : i + 1])
        return float(np.exp(low + share * (high - low)))

    @property
    def peak(self) -> float:
        """Greatest gain."""
        return float(self.gain.max())


def measure_pressure_response(
    display: SoftnessDevice,
    amplitude_pa: float,
    clock: Clock,
    *,
    middle_pa: float = MIDDLE_PA,
    frequencies_hz: tuple[float, ...] = FREQUENCIES_HZ,
    progress: Progress = silent,
) -> PressureResponse:
    """Measure the response at each frequency, up to 200 Hz; the display is always vented at the end.

    The tip must be held stiffly halfway: a moving tip pumps the gas.
    """
    if not 0 < amplitude_pa <= min(middle_pa, display.range.greatest_pa - middle_pa):
        raise RangeError(
            f"a sine of {amplitude_pa / 1e3:g} kPa about {middle_pa / 1e3:g} kPa; it has to be above 0 and "
            f"to stay within 0 and {display.range.greatest_pa / 1e3:g} kPa",
            code="pressure",
        )
    rising = len(frequencies_hz) > 1 and np.all(np.diff(frequencies_hz) > 0)
    if not rising or not 0 < frequencies_hz[0] <= frequencies_hz[-1] <= 200.0:
        raise InputError("frequencies of a pressure's response are two or more, rising, above 0 to 200 Hz")
    answers = []
    display.release()
    try:
        for i, frequency_hz in enumerate(frequencies_hz):
            progress("frequencies", i, len(frequencies_hz))
            answers.append(_answer(display, amplitude_pa, middle_pa, 2 * math.pi * frequency_hz, clock))
    finally:
        display.vent()
    answer = np.array(answers)
    return PressureResponse(
        amplitude_pa, np.array(frequencies_hz), np.abs(answer) / amplitude_pa, np.unwrap(np.angle(answer))
    )


def _answer(
    display: SoftnessDevice, amplitude_pa: float, middle_pa: float, omega: float, clock: Clock
) -> complex:
    """Complex amplitude of what is measured while sin(omega t) is told [Pa]."""
    cycle_s = 2 * math.pi / omega
    fitted_s = max(CYCLES * cycle_s, MIN_FITTED_S)
    all(each_period(display, middle_pa, SETTLE_S, clock))
    times, seen = [], []
    began_ns = clock.now_ns()
    while (time_s := 1e-9 * (clock.now_ns() - began_ns)) < cycle_s + fitted_s:
        said = display.latest()
        if said.fault:
            raise DeviceError(f"the display says: {said.fault}", code="display-fault")
        times.append(time_s)
        seen.append(said.pressure_pa)
        wave = amplitude_pa * np.exp(1j * omega * time_s)
        display.set_pressure(middle_pa + float(wave.imag), omega * float(wave.real))
        clock.sleep(PERIOD_S)
    at, pressure = np.array(times), np.array(seen)
    if not np.isfinite(pressure).all():
        raise DeviceError("a pressure is no number; check the sensor")
    at, pressure = at[at >= cycle_s], pressure[at >= cycle_s]
    basis = np.column_stack([np.sin(omega * at), np.cos(omega * at), np.ones_like(at)])
    (sine, cosine, _), *_ = np.linalg.lstsq(basis, pressure, rcond=None)
    return complex(sine, cosine)
