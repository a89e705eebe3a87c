"""A virtual force sensor: noise, drift, resolution, latency, and a range beyond which it saturates."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from palpate.core import NS_PER_S, DeviceError, Float, Wrench, ndarray
from palpate.rig.virtual.virtual_world import Touch, World

RANGE_N = (40.0, 40.0, 120.0)
LATENCY_S = 0.002
BIAS_N = (0.31, -0.22, 1.7)
"""Bias: the reading without a load. Assumed."""
KEPT = 100_000
SPIKE_N = 1000.0
NOISIER = 100.0
SCALE = 0.1  # of a sensor whose scale has changed
HELD_BACK_S = 0.08
ONE_IN = 10  # samples of a slow sensor
UNKNOWN = "the virtual skin is pressed deeper than its law is known"

Triple = tuple[float, float, float]
Axes = Float[ndarray, "3"]


class VirtualForce:
    """Implements `core.ForceSensor`, in the skin's own axes.

    Args:
        world: whose contact it feels.
        range_n: to either side along each axis, beyond which it saturates [N].
    """

    def __init__(self, world: World, range_n: Triple = RANGE_N) -> None:
        self._world = world
        self._range_n = range_n
        self._rng = np.random.default_rng([world.seed & 0xFFFFFFFF, 0xF0])
        self._drift = np.zeros(3)
        self._ready: deque[Wrench] = deque(maxlen=KEPT)
        self._coming: deque[Wrench] = deque()
        self._latest: Wrench | None = None
        self._spiked = False
        self._stuck: Triple | None = None
        self._numb: Triple | None = None
        self._closed = False
        world.clock.sleep(0.05)  # so that there is a first sample
        self._take_in()

    @property
    def rate_hz(self) -> float:
        return self._world.rate_hz

    @property
    def range_n(self) -> tuple[float, float, float]:
        return self._range_n

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
            while self._coming and self._arrives_ns(self._coming[0]) <= now_ns:
                one = self._coming.popleft()
                self._latest = replace(one, time_ns=self._arrives_ns(one))
                self._ready.append(self._latest)

    def _arrives_ns(self, sample: Wrench) -> int:
        """When a sample comes: in its own time, or with all others that were kept [ns]."""
        since_ns = self._world.faults.since("force-held-back")
        if since_ns is None or sample.time_ns < since_ns:
            return sample.time_ns
        kept_ns = round(HELD_BACK_S * NS_PER_S)
        return since_ns + -(-(sample.time_ns - since_ns) // kept_ns) * kept_ns

    def _measured(self, touch: Touch) -> Wrench | None:
        world, vary, on = self._world, self._world.variation, self._world.faults.on
        at_ns = round(touch.time_s * NS_PER_S)
        if on("force-stalls", at_ns) or (
            on("force-slow", at_ns) and round(touch.time_s * world.rate_hz) % ONE_IN
        ):
            return None
        noise = vary.force_noise_n * (NOISIER if on("force-noisy", at_ns) else 1.0)
        self._drift += vary.force_drift_n * np.sqrt(1 / world.rate_hz / 60) * self._rng.standard_normal(3)
        force = self._felt(touch, at_ns) + self._drift + BIAS_N + noise * self._rng.standard_normal(3)
        if on("force-scaled", at_ns):
            force = SCALE * force
        if vary.force_step_n > 0:
            force = np.round(force / vary.force_step_n) * vary.force_step_n
        if on("force-spike", at_ns) and not self._spiked:
            self._spiked = True
            force[2] += SPIKE_N
        saturated = on("force-saturates", at_ns) or (
            not self._spiked and (np.abs(force) > self._range_n).any()
        )
        arrives_ns = at_ns + round(LATENCY_S * NS_PER_S)
        fault = "saturated" if saturated else ""
        fault = fault if touch.known else UNKNOWN
        return Wrench(arrives_ns, self._shown(force, at_ns), fault=fault)

    def _felt(self, touch: Touch, at_ns: int) -> Axes:
        """Force that the sensor feels, along its axes."""
        if self._world.faults.on("force-numb", at_ns):
            self._numb = touch.force_n if self._numb is None else self._numb
            return np.array(self._numb)
        reversed_ = self._world.faults.on("force-reversed", at_ns)
        return np.array(touch.force_n) * (1, 1, -1 if reversed_ else 1)

    def _shown(self, force: Axes, at_ns: int) -> Triple:
        """Reading that it gives of a force that it has measured."""
        if self._world.faults.on("force-dead", at_ns):
            return 0.0, 0.0, 0.0
        x, y, z = force.tolist()
        if not self._world.faults.on("force-stuck", at_ns):
            return x, y, z
        self._stuck = self._stuck or (x, y, z)
        return self._stuck
