"""Contact-area display on a LabJack T7 or T4, with an analog pressure regulator and a Hall sensor.

DAC0 is the set-point; two neighboring inputs measure displacement and pressure. The board's strict watchdog
sets 0 V after whole seconds unless a new pressure feeds it; a digital line can feed a faster timer in
hardware. One connection measures and sets, a second one vents, so that a vent waits for no reading. Not
tested on hardware.

References: LabJack, T-series datasheet, sections 6, 15, and 23; direct Modbus TCP; `ljm_constants.json`.

Scales of a display's sensors: volts to millimeters by a table, volts to pascals by a line.

A voltage outside its scale, beyond a stated tolerance, has no value; it is never clipped.
"""

from __future__ import annotations

import math
import struct
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from threading import Event, Lock, RLock

from palpate.core import (
    NS_PER_S,
    Clock,
    Closing,
    DeviceError,
    DisplayRange,
    DisplaySample,
    InputError,
    MonotonicClock,
    RangeError,
)
from palpate.softness.real.modbus_tcp import ModbusTcp


class OffScaleError(RangeError):
    """A voltage that stands for nothing: a broken wire, a lost magnet, a sensor beyond its range."""


@dataclass(frozen=True, slots=True)
class HallTable:
    """Piecewise linear calibration of the displacement sensor.

    Attributes:
        volts: strictly monotonic, two or more [V].
        pushed_mm: strictly rising, including 0 [mm].
        tolerance_mm: allowed excess beyond the table or below 0 [mm].

    Example:
        >>> table = HallTable(volts=(2.5, 3.1, 4.5), pushed_mm=(0.0, 4.0, 10.0))
        >>> round(1e3 * table.pushed_m(2.8), 6)
        2.0
    """

    volts: tuple[float, ...]
    pushed_mm: tuple[float, ...]
    tolerance_mm: float = 0.1

    def __post_init__(self) -> None:
        if len(self.volts) != len(self.pushed_mm) or len(self.volts) < 2:
            raise InputError(
                f"a table of {len(self.volts)} voltages and {len(self.pushed_mm)} displacements; give as "
                "many of each, two at least, measured on this display: no line is assumed",
                code="table-size",
            )
        if not all(map(math.isfinite, (*self.volts, *self.pushed_mm))):
            raise InputError(
                "the Hall sensor's table holds what is no finite number; give V and mm", code="not-finite"
            )
        if not (_rises(self.volts) or _rises(self.volts[::-1])) or not _rises(self.pushed_mm):
            raise InputError(
                f"the Hall sensor's table is not monotone: {self.volts} V at {self.pushed_mm} mm; the "
                "millimetres have to rise, and the volts to rise or to fall throughout: move the magnet, or "
                "shorten the table",
                code="not-monotone",
            )
        if not self.pushed_mm[0] <= 0 < self.pushed_mm[-1]:
            raise InputError(
                f"the Hall sensor's table goes from {self.pushed_mm[0]:g} to {self.pushed_mm[-1]:g} mm; it "
                "has to hold 0 mm, where nobody presses",
                code="no-zero",
            )
        if not 0 <= self.tolerance_mm < math.inf:
            raise RangeError(f"a tolerance of {self.tolerance_mm} mm; give 0 mm or more")

    def pushed_m(self, volts: float) -> float:
        """Displacement of the tip at a voltage [m]."""
        v, d = self.volts, self.pushed_mm
        passed = sum((volts - each) * (v[-1] - v[0]) > 0 for each in v)
        i = max(1, min(passed, len(v) - 1))  # end of the segment, or of the nearest one
        pushed_mm = d[i - 1] + (volts - v[i - 1]) * (d[i] - d[i - 1]) / (v[i] - v[i - 1])
        if not -self.tolerance_mm <= pushed_mm <= d[-1] + self.tolerance_mm:
            raise OffScaleError(
                f"the displacement's sensor gives {volts:.4g} V, outside its table of {v[0]:g} to {v[-1]:g} "
                "V or below 0 mm: check the magnet, the plug and the table"
            )
        return 1e-3 * pushed_mm


@dataclass(frozen=True, slots=True)
class PressureScale:
    """Linear scale from `low_v` at 0 Pa to `high_v` at `high_pa`, with a tolerance beyond both ends.

    Example:
        >>> PressureScale(low_v=1.0, high_v=5.0, high_pa=100e3).volts(25e3)
        2.0
    """

    low_v: float
    high_v: float
    high_pa: float
    tolerance_pa: float = 2e3

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (self.low_v, self.high_v, self.high_pa, self.tolerance_pa))):
            raise InputError(f"a scale of pressure holds what is no finite number: {self}; give V and Pa")
        if not (self.low_v < self.high_v and self.high_pa > 0 and self.tolerance_pa >= 0):
            raise RangeError(
                f"a scale of {self.low_v:g} V at 0 Pa to {self.high_v:g} V at {self.high_pa:g} Pa; the volts "
                "have to rise and the pressure to be above 0 Pa: the regulator's manual has both"
            )

    def volts(self, pressure_pa: float) -> float:
        """Volts that stand for a pressure [V]."""
        return self.low_v + (self.high_v - self.low_v) * pressure_pa / self.high_pa

    def pressure_pa(self, volts: float) -> float:
        """Gauge pressure at a voltage [Pa]."""
        pressure_pa = (volts - self.low_v) / (self.high_v - self.low_v) * self.high_pa
        if not -self.tolerance_pa <= pressure_pa <= self.high_pa + self.tolerance_pa:
            raise OffScaleError(
                f"the pressure's sensor gives {volts:.4g} V, outside its {self.low_v:g} to {self.high_v:g} "
                "V: check its supply and plug"
            )
        return pressure_pa


def _rises(values: tuple[float, ...]) -> bool:
    return all(b > a for a, b in pairwise(values))


AIN0, DAC0, DIO0, PRODUCT_ID = 0, 1000, 2000, 60000
WATCHDOG_ENABLE, WATCHDOG_ADVANCED, WATCHDOG_TIMEOUT_S = 61600, 61602, 61604
WATCHDOG_STRICT_ENABLE, WATCHDOG_STRICT_KEY, WATCHDOG_STRICT_CLEAR = 61610, 61612, 61614
WATCHDOG_RESET_ENABLE, WATCHDOG_DAC0_ENABLE, WATCHDOG_DAC0 = 61620, 61640, 61642

STRICT_KEY = 0x50414C50  # any number that no other program would write
BOARDS = {"T7": 7, "T4": 4}
"""What the register of the product's number says."""
INPUTS = {"T7": 14, "T4": 12}
DIGITAL = {"T7": range(23), "T4": range(4, 20)}
MAX_DAC_V = 5.0
FEEDING = 0.1  # of the shortest watchdog: so soon the next pressure feeds it again, and no sooner
TICK_S = 1.0  # of the watchdog; nothing says when in a second it counts, so it may be late by one


@dataclass(frozen=True, slots=True)
class LabJackSettings:
    """Settings and wiring of a display.

    Attributes:
        setpoint, monitor: scales of regulator (volts at DAC0) and pressure sensor (volts at its input).
        hall_ain: input of the displacement sensor; the next one is the pressure's.
        watchdog_s: board watchdog, whole seconds [s].
        heartbeat_dio: digital line toggled with new pressures; None without a hardware timer.
        hardware_vent_s: measured time from the last toggle to the vent [s].
    """

    host: str
    hall: HallTable
    setpoint: PressureScale
    monitor: PressureScale
    greatest_pa: float
    height_m: float = 10e-3
    radius_m: float = 6.5e-3
    board: str = "T7"
    hall_ain: int = 0
    watchdog_s: int = 1
    heartbeat_dio: int | None = None
    hardware_vent_s: float | None = None
    timeout_s: float = 0.25
    port: int = 502
    unit: int = 1

    def __post_init__(self) -> None:
        if self.board not in BOARDS:
            raise RangeError(
                f"the board is {self.board!r}; give one of {', '.join(BOARDS)}", code="board-unknown"
            )
        self._check_pressure()
        if not 0 <= self.hall_ain <= INPUTS[self.board] - 2:
            raise RangeError(
                f"the displacement at AIN{self.hall_ain} and the pressure at the next input; a {self.board} "
                f"has AIN0 to AIN{INPUTS[self.board] - 1}",
                code="line",
            )
        if not 1 <= self.watchdog_s <= 3600:
            raise RangeError(
                f"a watchdog of {self.watchdog_s} s; the board counts whole seconds, give 1 to 3600",
                code="watchdog-time",
            )
        if not (0 < self.height_m < math.inf and 0 < self.radius_m < math.inf):
            raise RangeError(
                f"a display {self.height_m} m high of {self.radius_m} m; both have to be above 0 m",
                code="display-size",
            )
        if not self.height_m * 1e3 <= self.hall.pushed_mm[-1] + self.hall.tolerance_mm:
            raise RangeError(
                f"the Hall sensor's table ends at {self.hall.pushed_mm[-1]:g} mm and the tip can be pushed "
                f"by {self.height_m * 1e3:g} mm; calibrate it over the whole way",
                code="hall-table",
            )
        self._check_heartbeat()

    def _check_pressure(self) -> None:
        top_v = self.setpoint.volts(self.greatest_pa)
        if not 0 < self.greatest_pa <= self.monitor.high_pa:
            raise RangeError(
                f"a greatest pressure of {self.greatest_pa / 1e3:g} kPa; the sensor measures above 0 up to "
                f"{self.monitor.high_pa / 1e3:g} kPa",
                code="pressure",
            )
        if not (self.setpoint.low_v >= 0 and top_v <= MAX_DAC_V):
            raise RangeError(
                f"the set-point goes from {self.setpoint.low_v:g} to {top_v:.3g} V at DAC0, which gives 0 to "
                f"{MAX_DAC_V:g} V; take an amplifier and give the volts before it, or a lower pressure",
                code="set-point",
            )

    def _check_heartbeat(self) -> None:
        if (self.heartbeat_dio is None) != (self.hardware_vent_s is None):
            raise RangeError(
                "a timer in hardware needs both, the line that feeds it and the time [s] after which it was "
                f"measured to open the vent; given are DIO {self.heartbeat_dio} and {self.hardware_vent_s} s",
                code="timer",
            )
        if self.heartbeat_dio is not None and self.heartbeat_dio not in DIGITAL[self.board]:
            lines = DIGITAL[self.board]
            raise RangeError(
                f"the heartbeat at DIO{self.heartbeat_dio}; a {self.board} has DIO{lines[0]} to "
                f"DIO{lines[-1]}",
                code="line",
            )
        if self.hardware_vent_s is not None and not 0 < self.hardware_vent_s < math.inf:
            raise RangeError(
                f"a timer in hardware of {self.hardware_vent_s} s; give what was measured, above 0 s",
                code="timer",
            )

    @property
    def shortest_watchdog_s(self) -> float:
        """Time after the last feeding in which the first of its watchdogs may vent [s]."""
        return min(self.watchdog_s, self.hardware_vent_s or math.inf)

    @property
    def range(self) -> DisplayRange:
        """Size, pressure, and watchdog: the hardware timer, or the board's watchdog, late by
        up to a second.
        """
        late_s = self.watchdog_s + TICK_S if self.hardware_vent_s is None else self.hardware_vent_s
        return DisplayRange(self.height_m, self.radius_m, self.greatest_pa, late_s)


class LabJackDisplay(Closing):
    """The display, vented when opened. After a lost or wrong answer only `release` allows pressure again."""

    def __init__(self, settings: LabJackSettings, clock: Clock | None = None) -> None:
        """Connect, set 0 V, and start the board's watchdog."""
        self._settings, self._clock = settings, clock or MonotonicClock()
        self._state, self._setting = RLock(), Lock()  # a signal's handler may vent in between
        self._vents = 0
        self._why = ""  # nothing may be set, for this reason
        self._closed = Event()
        self._pressure_pa, self._fed_ns = 0.0, 0
        self._heartbeat = False
        reach = (settings.host, settings.port, settings.unit, settings.timeout_s)
        self._main = ModbusTcp(*reach)
        try:
            self._safety = ModbusTcp(*reach)
        except DeviceError:
            self._main.close()
            raise
        try:
            self._prepare()
        except DeviceError:
            self._let_go()
            raise

    @property
    def range(self) -> DisplayRange:
        """Size, greatest pressure and watchdog of the display."""
        return self._settings.range

    def latest(self) -> DisplaySample:
        """Its state now, dated in the middle of the exchange."""
        self._refuse_closed()
        asked_ns = self._clock.now_ns()
        try:
            hall_v, monitor_v = struct.unpack(">2f", self._main.read(AIN0 + 2 * self._settings.hall_ain, 4))
        except DeviceError as error:
            self._lost(error)
            raise
        time_ns = (asked_ns + self._clock.now_ns()) // 2
        return self._sample(time_ns, hall_v, monitor_v)

    def set_pressure(self, pressure_pa: float, rate_pa_s: float = 0.0) -> None:
        """Hold a gauge pressure until the next call or the watchdog; the rate is not used."""
        if not (0 <= pressure_pa <= self._settings.greatest_pa and math.isfinite(rate_pa_s)):
            raise RangeError(
                f"{pressure_pa} Pa, changing by {rate_pa_s} Pa/s, were asked for; the display takes 0 to "
                f"{self._settings.greatest_pa:g} Pa; the pressure stays as it is",
                code="pressure",
            )
        with self._setting:
            self._refuse_closed()
            self._watch_for_watchdog()
            self._refuse_vented()
            try:
                self._put(pressure_pa)
            except DeviceError as error:
                self._lost(error)
                raise
            with self._state:
                vented = bool(self._why)
            if vented:  # meanwhile, by another thread, whose 0 V may have come before this pressure
                self._zero(self._main)
                self._refuse_vented()

    def vent(self) -> None:
        """Set 0 V, and accept no pressure until `release`; from any thread, waiting for no reading."""
        self._latch("it was vented")
        if self._closed.is_set():
            return
        self._tell_to_vent()
        if self._setting.acquire(blocking=False):
            self._setting.release()
            return
        if self._setting.acquire(timeout=4 * self._settings.timeout_s):
            self._setting.release()
        if not self._closed.is_set():
            self._tell_to_vent()

    def release(self) -> None:
        """Let it hold pressure again after `vent`; the board is checked as when it was opened."""
        with self._setting:
            self._refuse_closed()
            with self._state:
                seen = self._vents
            self._prepare()
            with self._state:
                if self._vents != seen:
                    raise DeviceError("the display was vented while it was being released; release it again")
                self._why = ""

    def close(self) -> None:
        """Vent, and let go of the board, whose watchdog goes on. Closing again does nothing."""
        if self._closed.is_set():
            return
        try:
            self.vent()
        finally:
            self._closed.set()
            self._let_go()

    def _sample(self, time_ns: int, hall_v: float, monitor_v: float) -> DisplaySample:
        faults = []
        pushed_m = pressure_pa = math.nan
        try:
            pushed_m = self._settings.hall.pushed_m(hall_v)
        except OffScaleError as error:
            faults.append(str(error))
        try:
            pressure_pa = self._settings.monitor.pressure_pa(monitor_v)
        except OffScaleError as error:
            faults.append(str(error))
        most_pa = self._settings.greatest_pa + self._settings.monitor.tolerance_pa
        if pressure_pa > most_pa:
            faults.append(
                f"the chamber is at {pressure_pa / 1e3:.1f} kPa and may hold "
                f"{self._settings.greatest_pa / 1e3:g} kPa: shut the air off, and check the regulator"
            )
        return DisplaySample(time_ns, pushed_m, pressure_pa, "; ".join(faults))

    def _prepare(self) -> None:
        """See that it is the board, set 0 V as a vent does, and see that its watchdog is set and runs."""
        (product,) = struct.unpack(">f", self._main.read(PRODUCT_ID, 2))
        if product != BOARDS[self._settings.board]:
            raise DeviceError(
                f"{self._main.where} says that it is product {product:g} and not "
                f"{BOARDS[self._settings.board]}, a {self._settings.board}; check its address, or name the "
                "board that it is"
            )
        self._zero(self._safety)  # which also shows that a vent would be heard
        wanted = self._watchdog()
        if self._watchdog_now() != wanted:  # it is kept in the board's flash: write only what differs
            self._write_int(WATCHDOG_ENABLE, 0)
            for register, word in wanted.items():
                if register != WATCHDOG_ENABLE:
                    self._main.write(register, word)
            self._write_int(WATCHDOG_ENABLE, 1)
        if (kept := self._watchdog_now()) != wanted:
            wrong = ", ".join(f"{each}: {kept[each].hex()}" for each in wanted if kept[each] != wanted[each])
            raise DeviceError(
                f"{self._main.where} does not keep its watchdog's settings (register: bytes {wrong}); do not "
                "use it on a finger: update its firmware, and see that no other program sets it"
            )
        self._write_int(WATCHDOG_STRICT_CLEAR, STRICT_KEY)
        self._fed_ns = self._clock.now_ns() - self._settings.watchdog_s * NS_PER_S  # the next pressure feeds

    def _watchdog(self) -> dict[int, bytes]:
        """Words of the watchdog's registers as they have to be."""
        numbers = {
            WATCHDOG_ENABLE: 1,
            WATCHDOG_ADVANCED: 0,
            WATCHDOG_TIMEOUT_S: self._settings.watchdog_s,
            WATCHDOG_STRICT_ENABLE: 1,
            WATCHDOG_STRICT_KEY: STRICT_KEY,
            WATCHDOG_RESET_ENABLE: 0,
            WATCHDOG_DAC0_ENABLE: 1,
        }
        words = {each: struct.pack(">I", n) for each, n in numbers.items()}
        return words | {WATCHDOG_DAC0: struct.pack(">f", 0.0)}

    def _watchdog_now(self) -> dict[int, bytes]:
        return {register: self._main.read(register, 2) for register in self._watchdog()}

    def _put(self, pressure_pa: float) -> None:
        """Set the pressure, and only then feed the watchdogs, whom a pressure that is lost must not feed."""
        self._main.write(DAC0, struct.pack(">f", self._settings.setpoint.volts(pressure_pa)))
        if self._unfed_s() > FEEDING * self._settings.shortest_watchdog_s:
            self._feed()
        self._pressure_pa = pressure_pa

    def _feed(self) -> None:
        self._write_int(WATCHDOG_STRICT_CLEAR, STRICT_KEY)
        if self._settings.heartbeat_dio is not None:
            self._heartbeat = not self._heartbeat
            self._main.write(DIO0 + self._settings.heartbeat_dio, struct.pack(">H", self._heartbeat))
        self._fed_ns = self._clock.now_ns()

    def _unfed_s(self) -> float:
        return (self._clock.now_ns() - self._fed_ns) / NS_PER_S

    def _watch_for_watchdog(self) -> None:
        """Latch where the watchdog may have vented: the old pressure must not come back by surprise."""
        limit_s = self._settings.shortest_watchdog_s
        if self._pressure_pa > 0 and self._unfed_s() >= limit_s:
            self._latch(f"its watchdog of {limit_s:g} s vented it for want of a new pressure")

    def _zero(self, connection: ModbusTcp) -> None:
        connection.write(DAC0, struct.pack(">f", 0.0))
        self._pressure_pa = 0.0

    def _tell_to_vent(self) -> None:
        """Set 0 V by the connection for that, by a new one in its place, or behind what is being measured."""
        with suppress(DeviceError):
            self._zero(self._safety)
            return
        with suppress(DeviceError):
            self._zero(self._safety)
            return
        try:
            self._zero(self._main)
        except DeviceError as error:
            raise DeviceError(
                f"the display could not be told to vent ({error}); its watchdog does within "
                f"{self.range.watchdog_s:g} s: take the finger away and shut the air off",
                code="vent-failed",
            ) from error

    def _write_int(self, register: int, number: int) -> None:
        self._main.write(register, struct.pack(">I", number))

    def _latch(self, why: str) -> None:
        with self._state:
            self._vents += 1
            self._why = why

    def _lost(self, error: DeviceError) -> None:
        """Vent after an answer that did not come; whether that was heard is not known."""
        self._latch(f"an answer was lost ({error})")
        with suppress(DeviceError):
            self._tell_to_vent()

    def _refuse_vented(self) -> None:
        with self._state:
            why = self._why
        if why:
            raise DeviceError(
                f"the display takes no pressure since {why}; see why, and release it", code="watchdog"
            )

    def _refuse_closed(self) -> None:
        if self._closed.is_set():
            raise DeviceError("the display is closed; open it anew")

    def _let_go(self) -> None:
        self._main.close()
        self._safety.close()
