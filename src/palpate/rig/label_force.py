"""A second force sensor, too slow to guard, that labels frames taken at a stand.

It is tared with the first and read only while the probe stands: a frame's label is the mean of what it
measured since then, by stamps from which its own delay has been taken off. While anything moves it says
nothing.

Drift of a force sensor's zero over a press: how far it moved, and how far it may.

Every force of a press counts from the zero taken before it. A zero taken after it, in the air again, says by
how much those forces may be wrong.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from palpate.core import NS_PER_S, Clock, DeviceError, ForceSensor, Wrench
from palpate.devices import ForceBias, Guard, Mounting, Reason, Tripped

LABEL_FORCE = "label_force_N"
"""The label: along the skin's z, positive in compression, without the force that it read in the air."""

FRESH = 3  # samples of the stand, for a label or a tare
PERIODS = 3.0  # and a second more than these and the delay, until they must be there
LATE_S = 1.0
KEPT = 4096


class LabelForce:
    """Reads the second sensor at a stand.

    Args:
        sensor: its stamps say when it measured; `delay_s` is its delay, where it states one [s].
        mounting: of the sensor.
        guard: lets time pass, and watches the first sensor meanwhile.
        clock: that samples are stamped on.
    """

    def __init__(self, sensor: ForceSensor, mounting: Mounting, guard: Guard, clock: Clock) -> None:
        self._sensor, self._mounting, self._guard, self._clock = sensor, mounting, guard, clock
        self._samples: deque[tuple[int, float]] = deque(maxlen=KEPT)
        self._bias_n = 0.0
        self._stood_ns = clock.now_ns()
        guard.looks.subscribe(self._take_in)

    def tare(self) -> None:
        """Take what it reads from now on, in the air, for its zero."""
        self.settle()
        self._bias_n += self.force_n()

    def settle(self) -> None:
        """Wait until it has measured the stand that begins now."""
        self._stood_ns = begun_ns = self._clock.now_ns()
        delay_s = getattr(self._sensor, "delay_s", 0.0)
        due_s = delay_s + (FRESH + PERIODS) / self._sensor.rate_hz + LATE_S
        while len(self._since_stand()) < FRESH:
            if self._clock.now_ns() - begun_ns > due_s * NS_PER_S:
                raise Tripped(
                    Reason.FORCE_STALE,
                    f"the labelling force sensor measured {len(self._since_stand())} times of {FRESH} in "
                    f"{due_s:.2g} s at a stand; are its rate ({self._sensor.rate_hz:g} Hz) and its delay "
                    f"({delay_s:g} s) as stated?",
                )
            self._guard.wait(0.5 / self._sensor.rate_hz)
            self._take_in(strict=True)

    def force_n(self) -> float:
        """Mean force since the stand began [N]."""
        return float(np.mean(self._since_stand())) - self._bias_n

    def _since_stand(self) -> list[float]:
        """Samples that lie in the stand whole: each is a mean over its own period [N]."""
        whole_ns = self._stood_ns + round(NS_PER_S / self._sensor.rate_hz)
        return [force for at_ns, force in self._samples if at_ns >= whole_ns]

    def _take_in(self, *, strict: bool = False) -> None:
        """Keep what is new; on the way, where it guards nothing, a sensor that is gone stops nothing."""
        try:
            samples = self._sensor.drain()
        except DeviceError as e:
            if strict:
                raise Tripped(Reason.FORCE_SENSOR, f"the labelling force sensor failed: {e}") from e
            return
        self._samples.extend(
            (one.time_ns, self._mounting.to_skin(one.force_n)[2]) for one in samples if not one.fault
        )


ERRORS = 5.0  # standard errors of the two zeros' difference
SHARE = 0.005  # of the limit of force
QUIET = 3.0  # times the noise of before, beneath which samples about a slope are no noisier than they were


def moved_n(before: ForceBias, after: ForceBias) -> float:
    """Largest movement of the zero along x, y or z [N]."""
    return max(abs(b - a) for a, b in zip(before.force_n, after.force_n, strict=True))


def allowed_n(before: ForceBias, after: ForceBias, samples: int, force_limit_n: float) -> float:
    """Movement of the zero that a press may have: five errors of the two zeros, or 0.5 % of the limit [N].

    Args:
        before, after: the zeros and their noise.
        samples: of each zero.
        force_limit_n: greatest force that the rig allows [N].
    """
    error_n = math.hypot(before.noise_n, after.noise_n) / math.sqrt(max(samples, 1))
    return max(ERRORS * error_n, SHARE * force_limit_n)


def slope_n_s(samples: Sequence[Wrench], before: ForceBias) -> float:
    """Slope of a force that drifts along a line while its zero is taken; 0 where it does not [N/s].

    It drifts where the samples about their line are about as quiet as they were, and the line rises by more
    than their noise.
    """
    good = [one for one in samples if not one.fault]
    if len(good) < 3:
        return 0.0
    times_s = np.array([one.time_ns - good[0].time_ns for one in good]) / NS_PER_S
    normal_n = np.array([before.force(one)[2] for one in good])
    if not np.ptp(times_s) > 0:
        return 0.0
    slope, level = np.polyfit(times_s, normal_n, 1)
    spread_n = float(np.std(normal_n - level - slope * times_s, ddof=2))
    rise_n = abs(float(slope)) * float(np.ptp(times_s))
    drifts = spread_n <= QUIET * before.noise_n and rise_n > ERRORS * before.noise_n
    return float(slope) if drifts else 0.0
