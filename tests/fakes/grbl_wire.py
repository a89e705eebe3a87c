"""What the fake GRBL controller says, on its way to the host: whole, late, damaged or lost, as it is told."""

from __future__ import annotations

from tests.fakes.grbl_parameters import GrblFaults


class OutgoingLines:
    """Lines and status reports of the controller until the host takes them.

    Sources of the faults, all observed on Grbl 1.1h: a question that comes while a report is printed is
    lost, because the request is forgotten when the report ends; on a busy host one answer in some hundreds
    is late by seconds; noise on the wire damages single bytes.

    Attributes:
        faults: may be changed at any time.
        reports: status reports said, also those that were damaged or lost on their way.
        lost: questions that were not answered.
    """

    def __init__(self, faults: GrblFaults, print_s: float) -> None:
        self.faults = faults
        self.reports = self.lost = 0
        self._questions = 0
        self._print_s = print_s
        self._printing_until_s = 0.0
        self._out = bytearray()
        self._now_s = self._held_until_s = 0.0

    def say(self, *lines: str) -> None:
        """Say whole lines at once."""
        for line in lines:
            self._out += self.faults.noise + line.encode() + b"\r\n"

    def put(self, data: bytes) -> None:
        """Say bytes as they are."""
        self._out += data

    def hears_question(self, now_s: float) -> bool:
        """Whether a `?` that comes now will be answered."""
        self._questions += 1
        faults = self.faults
        lost = faults.silent or now_s < self._printing_until_s or _every(faults.lose_every, self._questions)
        self.lost += lost
        return not lost

    def report(self, text: str, now_s: float) -> None:
        """Say a status report, as the faults will have it."""
        self.reports += 1
        faults, data = self.faults, text.encode() + b"\r\n"
        self._printing_until_s = now_s + self._print_s
        if _every(faults.garble_every, self.reports):
            middle = len(data) // 2
            data = data[:middle] + b"\xb0" + data[middle + 1 :]  # one byte with bits flipped
        if _every(faults.wrong_digit_every, self.reports):
            at = data.index(b".", data.index(b"Pos:")) - 1  # the ones of X
            data = data[:at] + b"%d" % ((data[at] - ord("0") + 5) % 10) + data[at + 1 :]
        late_s = faults.late_s if _every(faults.late_every, self.reports) else self._print_s
        self._held_until_s = max(self._held_until_s, now_s + late_s)
        self._out += data

    def run_to(self, now_s: float) -> None:
        """Let time go by until then [s]."""
        self._now_s = now_s

    def take(self) -> bytes:
        """Bytes for the host; what follows a late report waits with it, as bytes on a wire do."""
        if self._now_s < self._held_until_s:
            return b""
        sent = bytes(self._out)
        self._out.clear()
        return b"" if self.faults.mute else sent


def _every(period: int, count: int) -> bool:
    return period > 0 and count % period == 0
