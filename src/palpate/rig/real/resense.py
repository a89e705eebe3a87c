"""HEX six-axis force sensor on a serial port, such as the HEX-21 of the NUSense rig. Tested on a fake only.

Its box sends 100, 500, or 1000 samples per second, without counter or clock. A sample is seven little-endian
32-bit floats: Fx, Fy, Fz [N], Mx, My, Mz [mN m], and the temperature [deg C], 28 bytes without a mark. The
start of a sample is found by its plausible temperature, or else by the pauses between samples; if they
disagree, no sample is returned. The next temperature reveals a lost byte.

Source: the public interface libraries Resense.py (resense-gmbh) and ResenseHEX (TU Darmstadt, MUST).
"""

from __future__ import annotations

import math
import struct
from collections import Counter
from dataclasses import dataclass, replace
from itertools import pairwise

from palpate.core import NS_PER_S, Clock, DeviceError, ProtocolError, RangeError, Wrench
from palpate.rig.real.serial_force_sensor import SerialForceSensor
from palpate.rig.real.serial_port import SerialPort, open_port

SAMPLE_BYTES = 28
_FORMAT = struct.Struct("<7f")
ROOM_C = (5.0, 60.0)  # temperatures at which a laboratory's sensor may be
DRIFT_C = 0.5  # by which a temperature may change from one sample to the next
TRIED = 12  # samples that have to be plausible before one is believed
LOOKED_AT = 40  # samples at a time, while it is not known where one begins
MAX_TRIED = 400  # samples after which nothing will tell
MAX_RESETS = 60  # before any sample was read
BEYOND = 1.5  # of the range: no overload reads further than that
PAUSE = 0.4  # of a period without a byte: what comes then begins a sample, where it is sent in one piece
AGREE = 0.9  # of the pauses have to say so
MNM = 1e-3

Seven = tuple[float, float, float, float, float, float, float]


@dataclass(slots=True)
class HexCounts:
    """Counts of what has come in.

    Attributes:
        received: samples that were read.
        faulty: of these, with a fault.
        resets: times that the beginning of a sample was looked for anew.
    """

    received: int = 0
    faulty: int = 0
    resets: int = 0


class HexFrames:
    """Bytes in, samples out; tells by `failure` when the stream is worth nothing any more.

    Args:
        rate_hz: samples a second, by which those that arrive together are set apart [Hz].
        range_n, range_nm: greatest force and torque [N, N m].
    """

    def __init__(self, rate_hz: float, range_n: float, range_nm: float) -> None:
        self._period_ns = NS_PER_S / rate_hz
        self._range_n, self._range_mnm = range_n, range_nm / MNM
        self._bytes = bytearray()
        self._celsius: float | None = None  # of the last sample; None while it is not known where one begins
        self._before_c: float | None = None  # of the last one that was ever known
        self._gone, self._heard_ns = 0, 0  # bytes that were dropped; when the last ones came
        self._dated_ns = 0  # the last sample
        self._after_pauses: Counter[int] = Counter()  # by byte of a sample that came first
        self.counts = HexCounts()
        self.failure: DeviceError | None = None

    def take(self, data: bytes, time_ns: int) -> list[Wrench]:
        """The samples that end in these bytes, of which the last arrived at `time_ns` [ns]."""
        if data and time_ns - self._heard_ns > PAUSE * self._period_ns:
            self._after_pauses[(self._gone + len(self._bytes)) % SAMPLE_BYTES] += 1
        self._heard_ns = time_ns if data else self._heard_ns
        self._bytes += data
        if self._celsius is None and not self._find_beginning():
            return []
        read: list[Seven] = []
        while len(self._bytes) >= SAMPLE_BYTES:
            values = _FORMAT.unpack_from(self._bytes)
            if not self._is_next(values):
                self._celsius = None
                self._after_pauses.clear()
                self.counts.resets += 1
                break
            self._drop(SAMPLE_BYTES)
            self._celsius = self._before_c = values[6]
            read.append(values)
        return [
            self._sample(v, at_ns) for v, at_ns in zip(read, self._times(len(read), time_ns), strict=True)
        ]

    def _times(self, count: int, last_ns: int) -> list[int]:
        """Times of samples that came together: a period apart, or closer where they came sooner [ns]."""
        apart_ns = min(self._period_ns, (last_ns - self._dated_ns) / max(count, 1))
        self._dated_ns = last_ns if count else self._dated_ns
        return [last_ns - round((count - 1 - k) * apart_ns) for k in range(count)]

    def _find_beginning(self) -> bool:
        """Drop the bytes before the first sample, where one place alone can be its beginning."""
        if len(self._bytes) < (TRIED + 1) * SAMPLE_BYTES:
            return False
        fits = [first for first in range(SAMPLE_BYTES) if self._fits(first)]
        if not fits:  # a byte was lost among them: the oldest are of no use
            self._drop(SAMPLE_BYTES)
            self._after_pauses.clear()
            self.counts.resets += 1
        first = fits[0] if len(fits) == 1 else self._told_by_pauses(fits)
        if first is not None:
            self._drop(first)
            self._celsius = _FORMAT.unpack_from(self._bytes)[6]
            return True
        if len(self._bytes) > LOOKED_AT * SAMPLE_BYTES:
            self._drop(len(self._bytes) // SAMPLE_BYTES * SAMPLE_BYTES - LOOKED_AT * SAMPLE_BYTES)
        if self._gone >= MAX_TRIED * SAMPLE_BYTES and fits and not self.counts.received:
            self.failure = DeviceError(
                "where a sample begins cannot be told: a force or torque looks like a temperature. Take the "
                "load off, press the tare button of its electronics, and open it anew"
            )
        if self.counts.resets >= MAX_RESETS and not self.counts.received:
            self.failure = ProtocolError(
                "no samples can be read from what comes; check that this port is a HEX sensor's, that its "
                "matrix light is on (newtons, not raw signals), and its interface switch"
            )
        return False

    def _told_by_pauses(self, fits: list[int]) -> int | None:
        """The one place of these that nearly all pauses come before; None where there is none."""
        told = [self._after_pauses[(self._gone + first) % SAMPLE_BYTES] for first in fits]
        most = max(told, default=0)
        return fits[told.index(most)] if most >= max(TRIED, AGREE * sum(told)) else None

    def _drop(self, count: int) -> None:
        del self._bytes[:count]
        self._gone += count

    def _fits(self, first: int) -> bool:
        whole = (len(self._bytes) - first) // SAMPLE_BYTES
        values = [_FORMAT.unpack_from(self._bytes, first + k * SAMPLE_BYTES) for k in range(whole)]
        steady = all(abs(b[6] - a[6]) <= DRIFT_C for a, b in pairwise(values))
        known = self._before_c is None or abs(values[0][6] - self._before_c) <= DRIFT_C
        return steady and known and all(self._is_plausible(one) for one in values)

    def _is_plausible(self, values: Seven) -> bool:
        forces, torques, celsius = values[:3], values[3:6], values[6]
        return (
            ROOM_C[0] <= celsius <= ROOM_C[1]
            and all(abs(f) <= BEYOND * self._range_n for f in forces)
            and all(abs(t) <= BEYOND * self._range_mnm for t in torques)
        )

    def _is_next(self, values: Seven) -> bool:
        return self._celsius is not None and abs(values[6] - self._celsius) <= DRIFT_C

    def _sample(self, values: Seven, time_ns: int) -> Wrench:
        self.counts.received += 1
        fault = self._fault(values)
        self.counts.faulty += bool(fault)
        fx, fy, fz, mx, my, mz = (math.nan,) * 6 if fault else values[:6]
        return Wrench(time_ns, (fx, fy, fz), (mx * MNM, my * MNM, mz * MNM), fault)

    def _fault(self, values: Seven) -> str:
        if not all(map(math.isfinite, values)):
            return "not-a-number"
        if max(map(abs, values[:3])) > self._range_n or max(map(abs, values[3:6])) > self._range_mnm:
            return "force-range"
        return ""


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
        return self._spec.rate_hz

    @property
    def range_n(self) -> tuple[float, float, float]:
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
