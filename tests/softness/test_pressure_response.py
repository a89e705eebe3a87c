"""How fast a pressure follows: a display of first order has its closed form, and bad requests are refused."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import DeviceError, DisplayRange, DisplaySample, InputError, ManualClock, RangeError
from palpate.softness.display_bench_test import PressureResponse, measure_pressure_response

LAG_S, DELAY_S = 10e-3, 2e-3


class FirstOrder:
    """A display whose pressure follows by a lag and a delay of whole periods."""

    range = DisplayRange(10e-3, 6.5e-3, 100e3, 0.1)

    def __init__(self, clock: ManualClock, broken_after: float = math.inf) -> None:
        self._clock, self._broken_after = clock, broken_after
        self._told: list[tuple[int, float]] = [(clock.now_ns(), 0.0)]
        self._pressure_pa = 0.0
        self._seen_ns = clock.now_ns()
        self.vented = True

    def release(self) -> None:
        self.vented = False

    def vent(self) -> None:
        self.vented = True

    def set_pressure(self, pressure_pa: float, rate_pa_s: float = 0.0) -> None:
        assert not self.vented
        assert 0 <= pressure_pa <= self.range.greatest_pa
        self._follow()
        self._told.append((self._clock.now_ns(), pressure_pa))

    def _follow(self) -> None:
        """Exact over each microsecond of a lag that sees what was told `DELAY_S` before."""
        now = self._clock.now_ns()
        while self._seen_ns < now:
            step_ns = min(now - self._seen_ns, 100_000)
            told = [p for t, p in self._told[-8:] if t <= self._seen_ns - DELAY_S * 1e9]
            aim = told[-1] if told else 0.0
            share = -math.expm1(-step_ns * 1e-9 / LAG_S)
            self._pressure_pa += share * (aim - self._pressure_pa)
            self._seen_ns += step_ns

    def close(self) -> None:
        self.vented = True

    def latest(self) -> DisplaySample:
        self._follow()
        now = self._clock.now_ns()
        fault = "supply is gone" if now * 1e-9 > self._broken_after else ""
        return DisplaySample(now, 5e-3, self._pressure_pa, fault)


def test_a_lag_and_a_delay_have_their_gain_their_phase_and_their_bandwidth() -> None:
    clock = ManualClock()
    found = measure_pressure_response(
        FirstOrder(clock), 10e3, clock, frequencies_hz=(2.0, 8.0, 14.0, 20.0, 40.0)
    )
    omega = 2 * np.pi * found.frequency_hz
    held_s = 0.5e-3  # what is told is held for a period
    assert found.gain == pytest.approx(1 / np.hypot(1, omega * LAG_S), rel=0.01)
    late = np.arctan(omega * LAG_S) + omega * (DELAY_S + held_s)
    assert found.phase_rad == pytest.approx(-late, abs=0.02)
    assert found.bandwidth_hz == pytest.approx(1 / (2 * math.pi * LAG_S), rel=0.03)


def test_a_bandwidth_is_that_of_the_first_fall_infinite_without_one_and_nought_from_the_first() -> None:
    frequency, phase = np.array([1.0, 10.0, 100.0]), np.zeros(3)
    one = PressureResponse(1.0, frequency, np.array([1.0, 0.8, 0.6142135]), phase)
    assert one.bandwidth_hz == pytest.approx(10**1.5, rel=1e-3)
    assert math.isinf(replace(one, gain=np.array([1.0, 0.9, 0.8])).bandwidth_hz)
    assert replace(one, gain=np.array([0.5, 0.9, 0.1])).bandwidth_hz == 0.0


@pytest.mark.parametrize("amplitude_pa", [0.0, 31e3, math.nan, math.inf])
def test_a_sine_that_leaves_the_range_is_refused_before_anything_moves(amplitude_pa: float) -> None:
    clock = ManualClock()
    display = FirstOrder(clock)
    with refused("pressure", RangeError, match="100 kPa"):
        measure_pressure_response(display, amplitude_pa, clock)
    assert display.vented
    assert clock.now_ns() == ManualClock().now_ns()


@pytest.mark.parametrize("frequencies_hz", [(5.0,), (5.0, 5.0), (0.0, 5.0), (5.0, 400.0)])
def test_frequencies_that_periods_of_a_millisecond_do_not_show_are_refused(frequencies_hz) -> None:
    clock = ManualClock()
    with pytest.raises(InputError, match="200 Hz"):
        measure_pressure_response(FirstOrder(clock), 10e3, clock, frequencies_hz=frequencies_hz)


def test_a_fault_ends_it_with_the_display_vented() -> None:
    clock = ManualClock()
    display = FirstOrder(clock, broken_after=1e-9 * clock.now_ns() + 0.5)
    with refused("display-fault", DeviceError):
        measure_pressure_response(display, 10e3, clock)
    assert display.vented
