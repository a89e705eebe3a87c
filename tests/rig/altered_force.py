"""A force sensor whose samples come late with current timestamps, or have another gain."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from palpate.core import NS_PER_S, Wrench
from palpate.devices.force_trust import StiffnessRange


class ChangedForce:
    """A force sensor of which a function makes other samples."""

    def __init__(self, device: Any, change: Callable[[Wrench], Wrench]) -> None:
        self._device, self._change = device, change

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def drain(self) -> list[Wrench]:
        return [self._change(one) for one in self._device.drain()]

    def latest(self) -> Wrench:
        return self._change(self._device.latest())


class AlteredForce:
    """Alters the samples of a force sensor.

    Args:
        device: the sensor.
        clock: that it is stamped on.
        delay_s: by which each sample comes late, stamped when it comes.
        gain: of all axes, the bias included.
        settle_s: time that passes until the first sample is there.
    """

    def __init__(
        self, device: Any, clock: Any, delay_s: float = 0.0, gain: float = 1.0, *, settle_s: float = 0.05
    ) -> None:
        self._device, self._clock, self._gain = device, clock, gain
        self._delay_ns = round(delay_s * NS_PER_S)
        self._kept: deque[Wrench] = deque()
        self._ready: list[Wrench] = []
        self._last: Wrench | None = None
        if settle_s > 0:  # so that there is a first sample
            clock.sleep(delay_s + settle_s)
            self._take_in()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def _take_in(self) -> None:
        self._kept += self._device.drain()
        while self._kept and self._kept[0].time_ns + self._delay_ns <= self._clock.now_ns():
            one = self._kept.popleft()
            x, y, z = (self._gain * value for value in one.force_n)
            self._last = replace(one, time_ns=one.time_ns + self._delay_ns, force_n=(x, y, z))
            self._ready.append(self._last)

    def latest(self) -> Wrench:
        self._take_in()
        assert self._last is not None
        return self._last

    def latest_or(self, sound: Any) -> Wrench:
        """The newest; that of the sound sensor while none has come, with the gain."""
        self._take_in()
        return self._last if self._last is not None else sound()

    def drain(self) -> list[Wrench]:
        self._take_in()
        ready, self._ready = self._ready, []
        return ready


FORCES_N = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)


def law_range(world: Any, factor: float, forces_n: tuple[float, ...] = FORCES_N) -> StiffnessRange:
    """Range of stiffness about a virtual skin's own law, by a factor to each side."""
    law = world._skin.law
    depth = np.linspace(law.depth_m[0], law.depth_m[-1], 2000)
    force = np.interp(depth, law.depth_m, law.force_n)
    known = tuple(one for one in forces_n if one < force[-1])
    at = np.interp(known, force, depth)
    slopes = np.interp(at, depth, np.gradient(force, depth))
    return StiffnessRange(known, tuple(slopes / factor), tuple(slopes * factor))
