"""A second force sensor, too slow to guard, that labels frames taken at a stand.

It is tared with the first and read only while the probe stands: a frame's label is the mean of what it
measured since then, by stamps from which its own delay has been taken off. While anything moves it says
nothing.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from palpate.core import NS_PER_S, Clock, DeviceError, ForceSensor
from palpate.devices import Guard, Mounting, Reason, Tripped

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
