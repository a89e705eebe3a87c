"""ATI's Net F/T box as a force sensor: calibration over HTTP, records over UDP, received by a thread.

An unreliable sample carries a fault and no numbers. A box that is silent, stands still, restarts, or reports
an error ends the stream with a `DeviceError`. Samples are dated by the box's own counters. Only start and
stop are sent. The protocol has no authentication: connect the box to a network of its own.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import asdict, dataclass, fields
from threading import Event, Lock, Thread
from typing import Literal

from palpate.core import (
    NS_PER_S,
    Clock,
    Closing,
    DeviceError,
    MonotonicClock,
    ProtocolError,
    RangeError,
    Wrench,
)
from palpate.devices.force_trust import SampleDating
from palpate.rig.real.device_hold import box_named, hold_device
from palpate.rig.real.netft.netft_calibration import NetFTCalibration, Triple, fetch
from palpate.rig.real.netft.netft_stream import (
    MONITOR_WARNING,
    PORT,
    Advance,
    RdtMeasurement,
    RdtRecord,
    RdtSequence,
    RdtStream,
    ahead,
    is_healthy,
    is_only_saturated,
    records,
    status_text,
)


@dataclass(frozen=True, slots=True)
class NetFTSettings:
    """Settings of the connection to a box.

    Attributes:
        rdt_port, http_port: where it listens.
        silence_s: without a new measurement for longer, the stream has failed [s].
        recovery: "stop" ends for good at the first failure. "reconnect" goes on trying; calls raise
            meanwhile, and a box whose page has changed is refused for good. It also takes the stream back
            from another client.
        retry_s: least and greatest wait between tries to reconnect; it doubles in between [s].
        start_tries, start_wait_s: how often to ask for the first record, and how long to wait each time [s].
        http_timeout_s: for the box's page [s].
        keep: how many samples are kept between two calls of `drain`.
        rate_hz: records a second, where the box's page does not say [Hz].
        range_n: greatest force along x, y, z [N]; by default what the page says, in the page's unit.
        calibration: what the page has to say, such as when a run goes on; None for anything.
    """

    rdt_port: int = PORT
    http_port: int = 80
    silence_s: float = 0.1
    recovery: Literal["stop", "reconnect"] = "stop"
    retry_s: tuple[float, float] = (0.25, 5.0)
    start_tries: int = 10
    start_wait_s: float = 0.1
    http_timeout_s: float = 2.0
    keep: int = 65536
    rate_hz: float | None = None
    range_n: Triple | None = None
    calibration: NetFTCalibration | None = None

    def __post_init__(self) -> None:
        seconds = (self.silence_s, *self.retry_s, self.start_wait_s, self.http_timeout_s)
        rate_hz = 1.0 if self.rate_hz is None else self.rate_hz
        numbers = (*seconds, *(self.range_n or ()), self.start_tries, self.keep, rate_hz)
        if not all(value > 0 and math.isfinite(value) for value in numbers):
            raise RangeError(
                f"times [s], range [N], rate [Hz] and numbers have to be greater than 0: {self}",
                code="settings-range",
            )
        if self.recovery not in ("stop", "reconnect"):
            raise RangeError(f"recovery is {self.recovery!r}; give 'stop' or 'reconnect'")


MAX_MALFORMED = 10  # datagrams in a row
JUMP_S, JUMP_FACTOR = 0.5, 2.0  # of records beyond the time that passed, for a counter that jumped
_NOTHING: Triple = (math.nan, math.nan, math.nan)
_RAILS = (-(2**31), 2**31 - 1)


@dataclass(slots=True)
class NetFTCounts:
    """Counts of what has come in.

    Attributes:
        received: records that were new.
        lost: records that never came, by their numbers.
        duplicate, out_of_order: records that were dropped.
        malformed: datagrams that were not RDT, dropped.
        faulty: samples with a fault, among the received.
        warned: samples during which a threshold set in the box was crossed, among the received.
        reconnected: how often the stream was taken up again.
    """

    received: int = 0
    lost: int = 0
    duplicate: int = 0
    out_of_order: int = 0
    malformed: int = 0
    faulty: int = 0
    warned: int = 0
    reconnected: int = 0

    def plus(self, more: NetFTCounts) -> NetFTCounts:
        """The sum of both."""
        mine, theirs = asdict(self), asdict(more)
        return NetFTCounts(**{f.name: mine[f.name] + theirs[f.name] for f in fields(self)})


class SilentError(DeviceError):
    """Nothing comes any more: the stream may be another client's, whom a stop would cut off."""


class Samples:
    """Follows one stream: which records are new, what they measure, and when the stream has failed."""

    def __init__(
        self,
        calibration: NetFTCalibration,
        range_n: Triple,
        silence_s: float,
        start_ns: int,
        rate_hz: float | None = None,
    ) -> None:
        """Follow a stream.

        Args:
            calibration: what its counts mean.
            range_n: greatest force along x, y, z; beyond it a sample is faulty [N].
            silence_s: without a new measurement for longer, the stream has failed [s].
            start_ns: when it was asked for [ns].
            rate_hz: as the box states it, from which samples are dated by its own numbers, so that those that
                were held back are as old as they are; None to date all by their arrival [Hz].
        """
        self.calibration, self.range_n, self.silence_s = calibration, range_n, silence_s
        self.counts = NetFTCounts()
        self._dating = None if rate_hz is None else SampleDating(rate_hz)
        self.failure: DeviceError | None = None
        self._sequence, self._measurement = RdtSequence(), RdtMeasurement()
        self._progress_ns = start_ns
        self._numbered = self._dated = 0
        self._arrived_ns: int | None = None
        self._stalled = self._stale = self._malformed = 0  # since the last new measurement

    def take(self, datagram: bytes, time_ns: int) -> list[Wrench]:
        """The samples in a datagram. What ends the stream is told by `failure`, the sample included."""
        try:
            batch = records(datagram)
        except ProtocolError as error:
            self.counts.malformed += 1
            self._malformed += 1
            if self._malformed >= MAX_MALFORMED:
                self.failure = ProtocolError(f"{MAX_MALFORMED} datagrams in a row were no records: {error}")
            return []
        self._malformed = 0
        new = [record for record in batch if self._is_new(record)]
        return [self._sample(record, self._dated_ns(record, time_ns), time_ns) for record in new]

    def is_overdue(self, now_ns: int) -> bool:
        """Whether no new measurement has come for longer than is borne."""
        return now_ns - self._progress_ns > self.silence_s * NS_PER_S

    def overdue(self) -> DeviceError:
        """Why none has come, as far as what did come tells."""
        since = f"for {self.silence_s:g} s"
        if self._stalled:
            return DeviceError(f"it sends, but its measurement stands still {since}; switch it off and on")
        if self._stale:
            return DeviceError(f"all records {since} have old numbers: it restarted; open it anew")
        return SilentError(
            f"no record came {since}: it lost power or cable, or another client took the stream, since it "
            "serves only one; close other clients, then open it anew"
        )

    def _is_new(self, record: RdtRecord) -> bool:
        sequence = self._sequence
        new = sequence.accept(record.rdt_sequence)
        self.counts.lost, self.counts.duplicate = sequence.lost, sequence.duplicate
        self.counts.out_of_order = sequence.out_of_order
        self._stale += not new
        return new

    def _dated_ns(self, record: RdtRecord, arrival_ns: int) -> int:
        """When a sample would have come, had it not been held back; never before the last one [ns]."""
        if self._dating is None:
            return arrival_ns
        step = ahead(record.rdt_sequence, self._numbered % 2**32)
        self._check_step(step, arrival_ns)
        number = self._numbered = self._numbered + step
        self._dated = max(self._dated, self._dating.date_ns(number, arrival_ns))
        return self._dated

    def _check_step(self, step: int, arrival_ns: int) -> None:
        """Tell a counter that ran on further than time did: the computer slept, or the box is another."""
        assert self._dating is not None  # as the caller made sure of
        arrived, self._arrived_ns = self._arrived_ns, arrival_ns
        if arrived is None:
            return
        passed_s = (arrival_ns - arrived) / NS_PER_S
        counted_s = step * self._dating.period_s
        if counted_s > JUMP_FACTOR * passed_s + JUMP_S:
            self.failure = DeviceError(
                f"its record counter ran on by {step}, which is {counted_s:.2f} s of records, within "
                f"{passed_s:.3f} s: this computer slept, or the box was restarted or changed; open it anew"
            )

    def _sample(self, record: RdtRecord, time_ns: int, arrival_ns: int) -> Wrench:
        progress = self._measurement.progress(record.ft_sequence)
        if progress is Advance.NEW:
            self._progress_ns, self._stalled, self._stale = arrival_ns, 0, 0
        elif progress is Advance.STALLED:
            self._stalled += 1
        elif progress is Advance.RESTARTED:
            self.failure = DeviceError("it restarted: its measurement counter began anew; open it anew")
        if not (is_healthy(record.status) or is_only_saturated(record.status)):
            why = status_text(record.status)
            self.failure = DeviceError(f"it reports: {why} (status {record.status:#010x}); see its web page")
        force_n = self.calibration.force_n(record.counts)
        fault = self._fault(record, progress, force_n)
        self.counts.received += 1
        self.counts.faulty += bool(fault)
        self.counts.warned += record.status == MONITOR_WARNING
        if fault:
            return Wrench(time_ns, _NOTHING, _NOTHING, fault)
        return Wrench(time_ns, force_n, self.calibration.torque_nm(record.counts))

    def _fault(self, record: RdtRecord, progress: Advance, force_n: Triple) -> str:
        """Fault of a sample; empty where its numbers hold."""
        if not is_healthy(record.status):
            return status_text(record.status)
        if progress is not Advance.NEW:
            return progress.value
        if any(count in _RAILS for count in record.counts):
            return "counts-saturated"
        if any(abs(f) > most for f, most in zip(force_n, self.range_n, strict=True)):
            return "force-range"
        return ""


_POLL_S = 0.05  # how often the thread looks whether it shall end


class _ChangedError(DeviceError):
    """The box is no longer the instrument it was."""


class NetFT(Closing):
    """A Net F/T box. Opening it reads its page, starts the stream and waits for the first record.

    Use it in a ``with`` block, or close it.

    Example:
        >>> with NetFT("192.168.1.1") as sensor:  # doctest: +SKIP
        ...     sensor.latest().force_n
        (0.0, 0.0, -2.5)
    """

    def __init__(
        self, host: str = "192.168.1.1", settings: NetFTSettings | None = None, clock: Clock | None = None
    ) -> None:
        """Open the sensor.

        Args:
            host: the box's name or address; the default is how it leaves the factory.
            settings: how to talk to it.
            clock: stamps the samples.
        """
        self._host, self._settings = host, settings or NetFTSettings()
        self._clock = clock or MonotonicClock()
        self._lock, self._closing = Lock(), Event()
        self._kept: deque[Wrench] = deque(maxlen=self._settings.keep)
        self._overflowed = 0
        self._latest: Wrench | None = None
        self._failure = ""
        self._before = NetFTCounts()
        self._held = hold_device(box_named(host, self._settings.rdt_port))
        try:
            self.calibration = self._page(self._settings.calibration)
            self._rate_hz = self._known_rate()
            self._range_n = self._known_range()
            self._samples = self._new_samples()
            stream = self._start()
        except BaseException:
            self._held.release()
            raise
        self._thread = Thread(target=self._run, args=(stream,), name=f"Net F/T {host}", daemon=True)
        self._thread.start()

    @property
    def rate_hz(self) -> float:
        """Records a second that the box is set to send [Hz]; it may round its setting up."""
        return self._rate_hz

    @property
    def range_n(self) -> Triple:
        """Greatest force along x, y, z, to either side [N]. A sample beyond it is faulty."""
        return self._range_n

    @property
    def counts(self) -> NetFTCounts:
        """Counts since the sensor was opened."""
        with self._lock:
            return self._before.plus(self._samples.counts)

    def latest(self) -> Wrench:
        """The newest sample. One with a fault has no numbers: its force and torque are not-a-number."""
        with self._lock:
            return self._refuse_failed()

    def drain(self) -> list[Wrench]:
        with self._lock:
            self._refuse_failed()
            if self._overflowed:
                lost, self._overflowed = self._overflowed, 0
                raise DeviceError(
                    f"{lost} samples were overwritten: drain at least every "
                    f"{self._settings.keep / self._rate_hz:.2g} s, or keep more than {self._settings.keep}",
                    code="samples-overwritten",
                )
            samples = list(self._kept)
            self._kept.clear()
            return samples

    def close(self) -> None:
        """Ask the box to stop, and let go of it. Closing again does nothing."""
        self._closing.set()
        self._thread.join()
        with self._lock:
            self._failure = self._failure or "the sensor was closed; open it anew"
        self._held.release()

    def _refuse_failed(self) -> Wrench:
        if self._failure or self._latest is None:
            raise DeviceError(f"the Net F/T box at {self._host}: {self._failure}")
        return self._latest

    def _page(self, expected: NetFTCalibration | None) -> NetFTCalibration:
        page = fetch(self._host, self._settings.http_port, self._settings.http_timeout_s)
        if expected is not None and page != expected:
            raise _ChangedError(
                f"its calibration, units or settings changed: {expected} became {page}; "
                "put them back, or begin anew with a new no-load force",
                code="sensor-changed",
            )
        return page

    def _known_rate(self) -> float:
        rate = self.calibration.rate_hz or self._settings.rate_hz
        if rate is None:
            raise DeviceError("the box's page does not say how many records a second it sends; give rate_hz")
        if self._settings.silence_s * rate < 3:
            raise RangeError(
                f"silence_s is {self._settings.silence_s:g} s, but the box sends only {rate:g} records a "
                f"second; give at least {3 / rate:.2g} s, or set the box to a higher rate",
                code="silence-too-short",
            )
        return rate

    def _known_range(self) -> Triple:
        known = self._settings.range_n or self.calibration.range_n
        if known is None:
            raise DeviceError("the box's page does not say what forces it can measure; give range_n [N]")
        return known

    def _new_samples(self) -> Samples:
        settings, now_ns = self._settings, self._clock.now_ns()
        return Samples(self.calibration, self._range_n, settings.silence_s, now_ns, self._rate_hz)

    def _start(self) -> RdtStream:
        """Ask for records until the first one comes. Every try has a socket of its own."""
        s = self._settings
        for _ in range(s.start_tries):
            stream = RdtStream(self._host, s.rdt_port, self._clock)
            try:
                stream.start()
                with self._lock:
                    self._before = self._before.plus(self._samples.counts)
                    self._samples = self._new_samples()
                until_ns = self._clock.now_ns() + round(s.start_wait_s * NS_PER_S)
                while self._latest is None and (left_ns := until_ns - self._clock.now_ns()) > 0:
                    self._take(stream.receive(left_ns / NS_PER_S))
            except DeviceError:
                stream.close()
                raise
            if self._latest is not None:
                return stream
            stream.close()
        raise DeviceError(
            f"the box at {self._host} sent no record though asked {s.start_tries} times; check that RDT is "
            f"enabled on its page and that UDP port {s.rdt_port} is open",
            code="no-records",
        )

    def _run(self, begun: RdtStream) -> None:
        """Follow the stream to its end, and the next one where that is wanted."""
        stream: RdtStream | None = begun
        try:
            while stream is not None:
                self._follow(stream)
                stream = self._reconnect() if self._settings.recovery == "reconnect" else None
        finally:  # also after what nobody thought of: an old sample must not pass for the newest for ever
            if not self._closing.is_set() and not self._failure:
                self._fail("its receiving thread ended; open it anew")

    def _follow(self, stream: RdtStream) -> None:
        """Receive until closed or failed, then end the stream unless it may be another client's."""
        stop = True
        try:
            while not self._closing.is_set():
                self._step(stream)
        except DeviceError as error:
            stop = not isinstance(error, SilentError)
            self._fail(str(error))
        finally:
            if stop:
                stream.stop(quiet_s=min(max(0.02, 2 / self._rate_hz), 0.5))
            stream.close()

    def _reconnect(self) -> RdtStream | None:
        """A new stream of the same instrument; None where that cannot be, or it was closed meanwhile."""
        wait_s, most_s = self._settings.retry_s
        while not self._closing.wait(wait_s):
            wait_s = min(2 * wait_s, most_s)
            try:
                self._page(self.calibration)
                stream = self._start()
            except _ChangedError as error:
                self._fail(str(error))
                return None
            except DeviceError as error:
                self._fail(f"{error}; trying again")
            else:
                with self._lock:
                    self._failure = ""
                    self._before.reconnected += 1
                return stream
        return None

    def _fail(self, why: str) -> None:
        with self._lock:
            self._failure, self._latest = why, None

    def _step(self, stream: RdtStream) -> None:
        got = stream.receive(min(self._settings.silence_s / 2, _POLL_S))
        now_ns = self._clock.now_ns() if got is None else got[1]
        if got is None and self._samples.is_overdue(now_ns):
            got = stream.receive(0.0)  # a busy computer may be what was late, not the box
            now_ns = now_ns if got is None else got[1]
        self._take(got)
        if self._samples.is_overdue(now_ns):
            raise self._samples.overdue()

    def _take(self, got: tuple[bytes, int] | None) -> None:
        if got is None:
            return
        with self._lock:
            for wrench in self._samples.take(*got):
                self._overflowed += len(self._kept) == self._kept.maxlen
                self._kept.append(wrench)
                self._latest = wrench
        if self._samples.failure is not None:
            raise self._samples.failure
