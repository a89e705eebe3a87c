"""From a Net F/T box's datagrams to samples that say what they are worth. No socket, no thread, no clock."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields

from palpate.core.clock import NS_PER_S
from palpate.core.errors import DeviceError, ProtocolError
from palpate.core.protocols import Wrench
from palpate.rig.real import rdt
from palpate.rig.real.netft_calibration import Calibration, Triple
from palpate.rig.real.rdt import Progress, Record

MOST_MALFORMED = 10  # datagrams in a row
_NOTHING: Triple = (math.nan, math.nan, math.nan)
_RAILS = (-(2**31), 2**31 - 1)


@dataclass(slots=True)
class NetFTCounts:
    """What has come in.

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

    def __init__(self, calibration: Calibration, range_n: Triple, silence_s: float, start_ns: int) -> None:
        """Follow a stream.

        Args:
            calibration: what its counts mean.
            range_n: greatest force along x, y, z; beyond it a sample is faulty [N].
            silence_s: without a new measurement for longer, the stream has failed [s].
            start_ns: when it was asked for [ns].
        """
        self.calibration, self.range_n, self.silence_s = calibration, range_n, silence_s
        self.counts = NetFTCounts()
        self.failure: DeviceError | None = None
        self._sequence, self._measurement = rdt.Sequence(), rdt.Measurement()
        self._progress_ns = start_ns
        self._stalled = self._stale = self._malformed = 0  # since the last new measurement

    def take(self, datagram: bytes, time_ns: int) -> list[Wrench]:
        """The samples in a datagram. What ends the stream is told by `failure`, the sample included.

        Args:
            datagram: any bytes.
            time_ns: when they came [ns].
        """
        try:
            found = rdt.records(datagram)
        except ProtocolError as error:
            self.counts.malformed += 1
            self._malformed += 1
            if self._malformed >= MOST_MALFORMED:
                self.failure = ProtocolError(f"{MOST_MALFORMED} datagrams in a row were no records: {error}")
            return []
        self._malformed = 0
        new = [record for record in found if self._is_new(record)]
        return [self._sample(record, time_ns) for record in new]

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

    def _is_new(self, record: Record) -> bool:
        sequence = self._sequence
        new = sequence.accept(record.rdt_sequence)
        self.counts.lost, self.counts.duplicate = sequence.lost, sequence.duplicate
        self.counts.out_of_order = sequence.out_of_order
        self._stale += not new
        return new

    def _sample(self, record: Record, time_ns: int) -> Wrench:
        progress = self._measurement.progress(record.ft_sequence)
        if progress is Progress.NEW:
            self._progress_ns, self._stalled, self._stale = time_ns, 0, 0
        elif progress is Progress.STALLED:
            self._stalled += 1
        elif progress is Progress.RESTARTED:
            self.failure = DeviceError("it restarted: its measurement counter began anew; open it anew")
        if not (rdt.is_healthy(record.status) or rdt.is_only_saturated(record.status)):
            why = rdt.status_text(record.status)
            self.failure = DeviceError(f"it reports: {why} (status {record.status:#010x}); see its web page")
        force_n = self.calibration.force_n(record.counts)
        fault = self._fault(record, progress, force_n)
        self.counts.received += 1
        self.counts.faulty += bool(fault)
        self.counts.warned += record.status == rdt.MONITOR_WARNING
        if fault:
            return Wrench(time_ns, _NOTHING, _NOTHING, fault)
        return Wrench(time_ns, force_n, self.calibration.torque_nm(record.counts))

    def _fault(self, record: Record, progress: Progress, force_n: Triple) -> str:
        """What is wrong with a sample; empty where its numbers hold."""
        if not rdt.is_healthy(record.status):
            return rdt.status_text(record.status)
        if progress is not Progress.NEW:
            return progress.value
        if any(count in _RAILS for count in record.counts):
            return "counts at their rail"
        if any(abs(f) > most for f, most in zip(force_n, self.range_n, strict=True)):
            return "force beyond the range"
        return ""
