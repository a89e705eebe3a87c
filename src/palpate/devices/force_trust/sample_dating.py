"""Age of samples by the device's own counter.

A device counts its samples at an even rate; the sample with the least delay dates the counter, and the delay
of every other is measured from its turn. The rate is estimated from arrival times and the offset decays
slowly, to allow for clock drift. A constant delay is invisible here; taps measure it.
"""

from __future__ import annotations

from palpate.core import NS_PER_S

LEARNT_S = 1.0  # of samples, until the rate is learnt; and then again at every doubling
FADE = 0.01  # by which the two clocks may seem to run apart, a few lost samples with them, relative
MAX_OFF = 0.5  # of the rate that was learnt before, relative, for one that is learnt again
PUNCTUAL = 2.0  # periods by which a sample may be late from which the rate is learnt
PUNCTUAL_S = 0.005  # and time


class SampleDating:
    """Dates the samples of one device.

    Attributes:
        period_s: between samples, as stated or as learnt since [s].
    """

    def __init__(self, rate_hz: float, heard_s: float = LEARNT_S) -> None:
        """Begin to date.

        Args:
            rate_hz: as stated, or as it was measured before [Hz].
            heard_s: for how long samples are only listened to, where the rate is not known well [s].
        """
        self.period_s = 1.0 / rate_hz
        self._heard_s, self._learn_s = heard_s, max(heard_s, LEARNT_S)
        self._learnt = heard_s == 0
        self._first: tuple[int, int] | None = None
        self._last: tuple[int, int] = (0, 0)
        self._least_s = 0.0  # offset of the arrival from the count, of the sample that came fastest

    def late_s(self, count: int, arrival_ns: int) -> float:
        """Time by which a sample came after its turn; 0 while samples are only listened to [s].

        Args:
            count: the device's number of the sample, counting on without wrapping.
            arrival_ns: when it came [ns].
        """
        if self._first is None or count < self._last[0]:
            self._first = self._last = (count, arrival_ns)
            self._least_s = 0.0
        since_s, numbers = (arrival_ns - self._first[1]) / NS_PER_S, count - self._first[0]
        step_s = (arrival_ns - self._last[1]) / NS_PER_S
        self._last = (count, arrival_ns)
        offset_s = since_s - numbers * self.period_s
        self._least_s = min(self._least_s + FADE * step_s, offset_s)
        late_s = offset_s - self._least_s
        late_s = 0.0 if since_s < self._heard_s or not self._learnt else late_s
        if since_s >= self._learn_s and numbers > 0 and self._is_punctual(late_s):
            self._learn(since_s / numbers, late_s)
        return late_s

    def date_ns(self, count: int, arrival_ns: int) -> int:
        """Time at which a sample would have come, had it not been held back [ns]."""
        return arrival_ns - round(self.late_s(count, arrival_ns) * NS_PER_S)

    def _is_punctual(self, late_s: float) -> bool:
        """Whether a sample may teach the rate; while nothing is known of it, any may."""
        return not self._learnt or late_s <= max(PUNCTUAL * self.period_s, PUNCTUAL_S)

    def _learn(self, period_s: float, late_s: float) -> None:
        # What is heard first counts for more than what was stated: a slower device must show as slow.
        is_first = not self._learnt
        self._learn_s, self._learnt = 2 * self._learn_s, True
        if is_first or abs(period_s / self.period_s - 1) <= MAX_OFF:
            self.period_s, self._least_s = period_s, -late_s  # since its offset is nothing now
