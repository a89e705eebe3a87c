"""A virtual force sensor: noise, drift, resolution, latency, and a range beyond which it saturates."""

from __future__ import annotations

from collections import deque

import numpy as np

from palpate.core import NS_PER_S, DeviceError, Wrench
from palpate.rig.virtual.virtual_world import Touch, World

RANGE_N = (40.0, 40.0, 120.0)
LATENCY_S = 0.002
BIAS_N = (0.31, -0.22, 1.7)
"""Bias: the reading without a load. Assumed."""
KEPT = 100_000
SPIKE_N = 1000.0
NOISIER = 100.0
UNKNOWN = "the virtual skin is pressed deeper than its law is known"


class VirtualForce:
    """Implements `core.ForceSensor`, in the skin's own axes."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._rng = np.random.default_rng([world.seed & 0xFFFFFFFF, 0xF0])
        self._drift = np.zeros(3)
        self._ready: deque[Wrench] = deque(maxlen=KEPT)
        self._coming: deque[Wrench] = deque()
        self._latest: Wrench | None = None
        self._spiked = False
        self._closed = False
        world.clock.sleep(0.05)  # so that there is a first sample
        self._take_in()

    @property
    def rate_hz(self) -> float:
        """Samples a second."""
        return self._world.rate_hz

    @property
    def range_n(self) -> tuple[float, float, float]:
        """Range to either side [N]."""
        return RANGE_N

    def latest(self) -> Wrench:
        """The newest sample that has arrived."""
        self._take_in()
        if self._latest is None:
            raise DeviceError("the force sensor has not measured yet")
        return self._latest

    def drain(self) -> list[Wrench]:
        """Samples that have arrived since the last call."""
        self._take_in()
        with self._world.lock:
            fresh = list(self._ready)
            self._ready.clear()
        return fresh

    def close(self) -> None:
        """Let go."""
        self._closed = True

    def _take_in(self) -> None:
        world, now_ns = self._world, self._world.clock.now_ns()
        if self._closed:
            raise DeviceError("the force sensor is closed")
        if world.faults.on("force-gone", now_ns):
            raise DeviceError("the force sensor does not answer")
        with world.lock:
            world.advance()
            for touch in world.fresh():
                wrench = self._measured(touch)
                if wrench is not None:
                    self._coming.append(wrench)
            while self._coming and self._coming[0].time_ns <= now_ns:
                self._latest = self._coming.popleft()
                self._ready.append(self._latest)

    def _measured(self, touch: Touch) -> Wrench | None:
        world, vary = self._world, self._world.variation
        at_ns = round(touch.time_s * NS_PER_S)
        if world.faults.on("force-stalls", at_ns):
            return None
        noise = vary.force_noise_n * (NOISIER if world.faults.on("force-noisy", at_ns) else 1.0)
        self._drift += vary.force_drift_n * np.sqrt(1 / world.rate_hz / 60) * self._rng.standard_normal(3)
        force = np.array(touch.force_n) * (1, 1, -1 if world.faults.on("force-reversed", at_ns) else 1)
        force = force + self._drift + BIAS_N + noise * self._rng.standard_normal(3)
        if vary.force_step_n > 0:
            force = np.round(force / vary.force_step_n) * vary.force_step_n
        if world.faults.on("force-spike", at_ns) and not self._spiked:
            self._spiked = True
            force[2] += SPIKE_N
        saturated = world.faults.on("force-saturates", at_ns) or (
            not self._spiked and (np.abs(force) > RANGE_N).any()
        )
        fx, fy, fz = force.tolist()
        arrives_ns = at_ns + round(LATENCY_S * NS_PER_S)
        fault = "saturated" if saturated else ""
        return Wrench(arrives_ns, (fx, fy, fz), fault=fault if touch.known else UNKNOWN)
