"""Noise, quantum and rate of a force sensor, learnt in the air for the sensor at hand.

A sensor that measures shows noise: a coarse one repeats a sample now and then, a dead one repeats all. How
often this one repeats itself in the air says how long a row of equal samples may become before it is no
chance. A sensor that is dead, slower than it states or another than at the last tare is refused by name.

Age of samples by the device's own counter.

A device counts its samples at an even rate; the sample with the least delay dates the counter, and the delay
of every other is measured from its turn. The rate is estimated from arrival times and the offset decays
slowly, to allow for clock drift. A constant delay is invisible here; taps measure it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

import numpy as np

from palpate.core import NS_PER_S, Float, Wrench, ndarray
from palpate.devices.motion_limits import Reason, Tripped

CHANCE = 1e-5  # of a row of equal samples that is still taken for noise
CHANCE_COARSE = 1e-7  # where repeats are frequent, and their probability moves with the zero
MIN_RUN = 5  # equal samples, whatever the noise: fewer are a stutter
MAX_RUN = 400  # of a sensor so coarse that its noise hardly shows
FINE = (
    0.6  # noise over quantum, above which the noise does not depend on where between two steps the mean lies
)
TELLING = 50  # samples from which an axis that reads one value is too coarse
DOUBT = 5.0  # standard errors, since pieces shift stamps together
NEAR = 0.005  # relative
TOGETHER = 0.25  # of a period between two samples
MIN_TIMED = 10  # samples that are left to tell the rate
DIGITS = 9  # to which values are compared for their quantum [N]
SLOW = 0.8  # of the stated rate
BURST_S = 0.05  # between two samples in the air
BURST_PERIODS = 6.0
LEAP = 5.0  # between the noise of two tares
SAME_SCALE = 0.05  # relative, of the reading in the air from one tare to the next, on all axes together

Six = tuple[float, float, float, float, float, float]


def six_of(sample: Wrench) -> Six:
    """All six axes of a sample, as the device gave them."""
    return *sample.force_n, *sample.torque_nm


@dataclass(frozen=True, slots=True)
class AirNoise:
    """What a sensor reads in the air.

    Attributes:
        mean: of all six axes, as the device gives them [N, Nm].
        noise_n: along the device's x, y, z: standard deviation, at least what a step of the quantum makes
        [N]. fine: for each of x, y, z, whether the noise is wider than the quantum.
        spans_n: greatest less least value, along x, y, z [N].
        quantum_n: least difference between two values; 0 where there is none [N].
        repeats, count: samples equal to the one before in all six axes, of so many.
        longest: equal samples in a row, 1 where none is repeated.
        period_s: between two samples, see `period_of` [s].
    """

    mean: Six
    noise_n: tuple[float, float, float]
    fine: tuple[bool, bool, bool]
    spans_n: tuple[float, float, float]
    quantum_n: float
    repeats: int
    count: int
    longest: int
    period_s: float

    @classmethod
    def of(cls, samples: Sequence[Wrench], stated_hz: float | None = None) -> AirNoise:
        """Learn it from samples without contact and without a fault, oldest first; at least three.

        Args:
            stated_hz: samples a second, as the sensor states [Hz].
        """
        six = np.array([six_of(one) for one in samples])
        force = six[:, :3]
        quantum = max(_quantum(force[:, i]) for i in range(3))
        spread = force.std(axis=0, ddof=1)
        least = quantum * math.sqrt(1 / 12 + 0.1)  # of noise that is hardly wider than the steps
        equal = (np.diff(six, axis=0) == 0).all(axis=1)
        times_s = np.array([one.time_ns for one in samples]) / NS_PER_S
        mx, my, mz, tx, ty, tz = six.mean(axis=0).tolist()
        nx, ny, nz = np.maximum(spread, least).tolist()
        fx, fy, fz = (spread > FINE * quantum).tolist()
        sx, sy, sz = np.ptp(force, axis=0).tolist()
        return cls(
            mean=(mx, my, mz, tx, ty, tz),
            noise_n=(nx, ny, nz),
            fine=(fx, fy, fz),
            spans_n=(sx, sy, sz),
            quantum_n=quantum,
            repeats=int(equal.sum()),
            count=len(equal),
            longest=1 + _longest(equal),
            period_s=period_of(times_s, stated_hz),
        )

    @property
    def is_constant(self) -> bool:
        """Whether every sample was the same in all six axes."""
        return self.repeats == self.count

    def run_limit(self, before: Sequence[AirNoise] = ()) -> int:
        """Equal samples in a row that are no chance any more, from this air and those of before.

        With a repeat of probability p, at most the upper bound of two standard errors on what was seen, a row
        of n has the probability p^n; never less than twice the longest row that was seen.
        """
        airs = [*before, self]
        pooled = _most_often(sum(one.repeats for one in airs), sum(one.count for one in airs))
        share = max(_most_often(self.repeats, self.count), pooled)
        chance = CHANCE if all(self.fine) else CHANCE_COARSE
        run = math.ceil(math.log(chance) / math.log(share)) if share < 1 else MAX_RUN
        longest = max(one.longest for one in airs)
        return min(max(run, 2 * longest, MIN_RUN), MAX_RUN)


def period_of(times_s: Float[ndarray, " n"], stated_hz: float | None) -> float:
    """Time between two samples by their stamps, or as stated, where the stamps do not tell otherwise [s].

    Stamps are of arrival. A line that delivers in pieces, and a stall just before, shift some of them by more
    than a period; the straight line through all of them is hardly turned by that, and less than its own
    error. `DOUBT` times that error, or `NEAR` of the stated period, is no difference.
    """
    if stated_hz is not None:  # what a stall before had held back comes first, and all at once
        together = np.diff(times_s) < TOGETHER / stated_hz
        begins = int(np.argmin(together)) if not together.all() else 0
        times_s = times_s[min(begins, len(times_s) - min(len(times_s), MIN_TIMED)) :]
    count = np.arange(len(times_s)) - (len(times_s) - 1) / 2
    weight = float(count @ count)
    period_s = float(count @ times_s) / weight
    off_s = times_s - times_s.mean() - period_s * count
    error_s = math.sqrt(float(off_s @ off_s) / max(len(times_s) - 2, 1) / weight)
    if stated_hz is not None and abs(period_s - 1 / stated_hz) <= max(DOUBT * error_s, NEAR / stated_hz):
        return 1 / stated_hz
    return period_s


def check_pace(times_s: Sequence[float], stated_hz: float) -> None:
    """Refuse samples that come more slowly than is stated, or in bursts.

    Args:
        times_s: of the samples in the air, oldest first; two at least [s].
        stated_hz: samples a second that the sensor states [Hz].

    Raises:
        Tripped: they do.
    """
    steps = [after - before for before, after in pairwise(times_s)]
    span_s, period_s = times_s[-1] - times_s[0], 1.0 / stated_hz
    if span_s > 0 and len(steps) / span_s < SLOW * stated_hz:
        raise Tripped(
            Reason.FORCE_SLOW,
            f"the force sensor measures {len(steps) / span_s:.3g} times a second and states {stated_hz:g}; "
            "set it to the rate it states",
        )
    if (longest_s := max(steps)) > max(BURST_S, BURST_PERIODS * period_s):
        raise Tripped(
            Reason.FORCE_LATE,
            f"the force came in bursts {longest_s * 1e3:.0f} ms apart at {stated_hz:g} samples a second; "
            "look at what lies between the sensor and this computer",
        )


def check_same_air(before: AirNoise, air: AirNoise) -> None:
    """Refuse a sensor whose zero or noise is another one than at the last tare.

    Raises:
        Tripped: all axes read a multiple of what they did, or one is far noisier.
    """
    old, new, noise_n = before.mean[:3], air.mean[:3], 3 * max(*before.noise_n, *air.noise_n)
    size2 = math.fsum(a * a for a in old)
    scale = math.fsum(a * b for a, b in zip(old, new, strict=True)) / size2 if size2 > 0 else 1.0
    off_n = math.dist(new, [scale * a for a in old])
    told = sum(abs((scale - 1) * a) > noise_n for a in old) > 1  # one axis alone has drifted
    if (
        told
        and scale != 0
        and abs(scale - 1) > SAME_SCALE
        and off_n < noise_n
        and math.dist(old, new) > 3 * off_n
    ):
        raise Tripped(
            Reason.FORCE_SCALED,
            f"in the air all axes read {scale:.3g} times what they did before the last press: has the "
            "sensor's gain or unit changed?",
        )
    for axis, was, is_ in zip("xyz", before.noise_n, air.noise_n, strict=True):
        if is_ > LEAP * was:
            raise Tripped(
                Reason.FORCE_NOISE,
                f"the noise along the sensor's {axis} is {is_:.4f} N, and was {was:.4f} N before the last "
                "press",
            )


def check_fineness(air: AirNoise, normal: int) -> None:
    """Refuse a sensor that is too coarse to guard by: its noise hardly ever moves it to the next step.

    It may repeat one sample for as long as nothing touches it, and so does one that is stuck.

    Args:
        air: what it reads in the air.
        normal: its axis along the skin's normal; 0, 1, 2 for x, y, z.

    Raises:
        Tripped: it reads one value along the normal.
    """
    if air.spans_n[normal] > 0 or air.count < TELLING:
        return
    raise Tripped(
        Reason.FORCE_COARSE,
        f"all {air.count + 1} samples in the air are the same along the sensor's {'xyz'[normal]}: its noise "
        "is far below its resolution"
        + (f" of {air.quantum_n:.3g} N" if air.quantum_n else "")
        + ", so that one that is stuck cannot be told; set a finer resolution, or a weaker filter",
    )


def constant_air(air: AirNoise, was_alive: bool) -> Tripped:
    """Name of a sensor that reads but one value in the air: dead, or stuck where it was alive before."""
    zero = not any(air.mean)
    reason = Reason.FORCE_STUCK if was_alive and not zero else Reason.FORCE_DEAD
    return Tripped(
        reason,
        f"all {air.count + 1} samples in the air are the same on all six axes"
        + (", zero" if zero else "")
        + ": a sensor that measures shows noise; is its load connected, or is it set too coarse?",
    )


def _most_often(repeats: int, count: int) -> float:
    """Upper bound of the probability of a repeat, by Agresti's and Coull's interval, two errors wide."""
    n = count + 4
    share = (repeats + 2) / n
    return min(share + 2 * math.sqrt(share * (1 - share) / n), 1.0)


def _quantum(values: Float[ndarray, " n"]) -> float:
    """Least difference between two different values; 0 where all are one."""
    steps = np.diff(np.unique(values.round(DIGITS)))
    return float(steps.min()) if len(steps) else 0.0


def _longest(equal: ndarray) -> int:
    """Longest row of True."""
    return max((len(list(row)) for alike, row in groupby(equal) if alike), default=0)


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
