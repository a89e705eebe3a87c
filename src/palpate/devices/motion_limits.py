"""Limits of position, speed and force: refused in software, whatever the devices allow.

Bounds of a force that presses something, a skin or a finger: its size, its rate, and how old it may be.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, runtime_checkable

from palpate.core import NS_PER_S, Position, RangeError, SafetyError, Travel

AXES = "xyz"


class Reason(StrEnum):
    """Reason for which a recording ends that should have gone on."""

    FORCE_LIMIT = "force-limit"
    FORCE_RATE = "force-rate"
    FORCE_STALE = "force-stale"
    FORCE_FAULT = "force-fault"
    FORCE_NOISE = "force-noise"
    FORCE_DEAD = "force-dead"  # it does not follow what is touched
    FORCE_STUCK = "force-stuck"  # it repeats one sample
    FORCE_COARSE = "force-coarse"  # its resolution hides its noise, so that a stuck one cannot be told
    FORCE_REVERSED = "force-reversed"
    FORCE_SCALED = "force-scaled"  # its scale has changed since the air
    FORCE_DRIFT = "force-drift"  # its zero moved while it pressed
    FORCE_LATE = "force-late"  # samples are held back on their way
    FORCE_LAG = "force-lag"  # it follows the motion too late, whatever its timestamps state
    FORCE_SLOW = "force-slow"  # fewer samples come than it states
    STIFFNESS = "stiffness"  # force over depth lies outside the range that the rig states
    FORCE_IMPLAUSIBLE = "force-implausible"  # no motion explains it, and nothing else of these
    TOUCHED_EARLY = "touched-early"
    NO_CONTACT = "no-contact"
    SOFT_LIMIT = "soft-limit"
    TOO_FAST = "too-fast"
    HARDWARE_STOP = "hardware-stop"  # the stage's own door or hold input
    STAGE = "stage"
    STAGE_LATE = "stage-late"
    CAMERA = "camera"
    FORCE_SENSOR = "force-sensor"
    CLIENT_SILENT = "client-silent"  # whoever records says nothing any more
    SUPERVISOR = "supervisor"  # the process that guards is gone, or says nothing any more
    DISPLAY = "display"  # a contact-area display says that something is wrong, or says nothing
    PRESSURE = "pressure"  # its chamber does not hold what it is told
    PUSH = "push"  # its tip is where it cannot be
    ARM = "arm"
    ENERGY = "energy"  # more came out of a rendered object than went in
    LOOP_LATE = "loop-late"  # a period of the control loop came too late
    REFERENCE = "reference"  # what is asked of the devices is no number
    CLOCKS = "clocks"
    STORAGE = "storage"
    PLAN = "plan"


class Tripped(SafetyError):  # noqa: N818 - a guard trips
    """A guard stopped a motion, or refused it.

    Attributes:
        reason: which guard; its value is the code of the error.
        numbers: what was measured and what is allowed, by name with the unit.
    """

    def __init__(self, reason: Reason, message: str, numbers: Mapping[str, float] | None = None) -> None:
        super().__init__(message, code=reason.value)
        self.reason = reason
        self.numbers = dict(numbers or {})


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits that a guarded motion keeps to.

    Attributes:
        least_m, greatest_m: soft limits of each axis, inside the stage's travel [m].
        force_n: greatest force, any direction [N].
        force_rate_n_s: greatest change of force, over `rate_window_s` [N/s].
        rate_window_s: long enough that noise is no rate [s].
        age_s: oldest force sample on which anything still moves [s].
        force_latency_s: from a force at the skin to the guard's knowing of it, at worst, while samples come:
            the sensor's filter and period, its way, and one look [s]. Where samples cease to come, it is
            `age_s` instead.
        overshoot_m: how far the probe may run on into the skin after a force that stops it [m].
        step_m: longest single move towards the skin [m]: what a broken link can run on.
    """

    least_m: Position
    greatest_m: Position
    force_n: float = 30.0
    force_rate_n_s: float = 400.0
    rate_window_s: float = 0.02
    age_s: float = 0.1
    force_latency_s: float = 0.01
    overshoot_m: float = 0.1e-3
    step_m: float = 0.2e-3

    def __post_init__(self) -> None:
        for name in (
            "force_n", "force_rate_n_s", "rate_window_s", "age_s", "force_latency_s", "overshoot_m", "step_m",
        ):  # fmt: skip
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise RangeError(f"the rig's limit {name} is {value}; it must be positive")
        for axis, low, high in zip(AXES, self.least_m, self.greatest_m, strict=True):
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise RangeError(
                    f"soft limits of {axis}: {low * 1e3:g} to {high * 1e3:g} mm; the first must be less",
                    code="limits-order",
                )

    def check_within(self, travel: Travel) -> None:
        """Refuse soft limits that the stage cannot reach."""
        for i, axis in enumerate(AXES):
            if self.least_m[i] < travel.least_m[i] or self.greatest_m[i] > travel.greatest_m[i]:
                raise RangeError(
                    f"soft limits of {axis}, {self.least_m[i] * 1e3:g} to {self.greatest_m[i] * 1e3:g} mm, "
                    f"lie outside the stage's travel, {travel.least_m[i] * 1e3:g} to "
                    f"{travel.greatest_m[i] * 1e3:g} mm",
                    code="limits-outside-travel",
                )

    def check_range(self, range_n: float) -> None:
        """Refuse a limit of force that the sensor cannot measure.

        Args:
            range_n: greatest force along the skin's normal that it measures [N].
        """
        if self.force_n > range_n:
            raise RangeError(
                f"the rig's limit of force is {self.force_n:g} N, and its sensor measures to {range_n:g} N "
                f"along the press: it would saturate before anything stops; give force_N of {range_n:g} or "
                f"less",
                code="limit-above-sensor",
            )

    def check_sensor(self, sensor: object) -> None:
        """Refuse to guard by a force sensor whose newest sample may be older than `age_s`.

        Just before a sample arrives, the one before it is as old as the sensor's period and its own delay,
        `delay_s`, which a slow sensor states beside the protocol [s]. What states no rate is not judged.
        """
        rate_hz, delay_s = getattr(sensor, "rate_hz", None), getattr(sensor, "delay_s", 0.0)
        if rate_hz is None or 1.0 / rate_hz + delay_s <= self.age_s:
            return
        raise Tripped(
            Reason.FORCE_STALE,
            f"the force sensor is too slow to guard a motion towards the skin: at {rate_hz:g} samples a "
            f"second and a delay of {delay_s:g} s its newest sample is up to {1.0 / rate_hz + delay_s:.3g} s "
            f"old, and the rig's limit age_s is {self.age_s:g} s. It may label frames beside a faster one",
        )

    def check_target(self, target: Position) -> None:
        """Refuse a target outside the soft limits."""
        for axis, at, low, high in zip(AXES, target, self.least_m, self.greatest_m, strict=True):
            if not low <= at <= high:
                raise Tripped(
                    Reason.SOFT_LIMIT,
                    f"{axis} = {at * 1e3:.3f} mm lies outside the soft limits, {low * 1e3:g} to "
                    f"{high * 1e3:g} mm",
                )

    def runs_on_m(self, speed_m_s: float, travel: Travel) -> float:
        """How far the probe runs on after a force that stops it, v^2 / 2a + v (latencies of both) [m].

        That of the stage counts, from asking for a stop to slowing down, and that of the force on its way.
        """
        return travel.overshoot_m(speed_m_s, self.force_latency_s)

    def fastest_m_s(self, travel: Travel) -> float:
        """The greatest speed towards the skin whose `runs_on_m` is allowed [m/s]."""
        a, tau = travel.acceleration_m_s2, travel.latency_s + self.force_latency_s
        allowed = a * (math.sqrt(tau**2 + 2 * self.overshoot_m / a) - tau)
        return min(travel.top_speed_m_s, allowed * (1 - 1e-9))  # so that rounding does not refuse it

    def check_speed(self, speed_m_s: float, travel: Travel) -> None:
        """Refuse a speed towards the skin at which the probe would run on too far."""
        if not (math.isfinite(speed_m_s) and speed_m_s > 0):
            raise Tripped(Reason.TOO_FAST, f"a speed of {speed_m_s} m/s; give a positive number")
        runs_on = self.runs_on_m(speed_m_s, travel)
        if runs_on > self.overshoot_m:
            raise Tripped(
                Reason.TOO_FAST,
                f"at {speed_m_s * 1e3:g} mm/s the probe runs on {runs_on * 1e3:.3f} mm after a force that "
                f"stops it (the force comes {self.force_latency_s * 1e3:g} ms late, the stage obeys "
                f"{travel.latency_s * 1e3:g} ms later); {self.overshoot_m * 1e3:g} mm are allowed, which is "
                f"at most {self.fastest_m_s(travel) * 1e3:.2f} mm/s; go slower (a plan's press_mm_s and "
                "seek_mm_s), or allow more (overshoot_mm under [limits] of the rig's file)",
            )


@runtime_checkable
class ForceBounds(Protocol):
    """What a `ForceWatch` keeps to; `Limits` of a stage are such, and so are `ForceLimits`."""

    @property
    def force_n(self) -> float:
        """Greatest force [N]."""

    @property
    def force_rate_n_s(self) -> float:
        """Greatest change, over `rate_window_s` [N/s]."""

    @property
    def rate_window_s(self) -> float:
        """Long enough that noise is no rate [s]."""

    @property
    def age_s(self) -> float:
        """Oldest sample on which anything goes on [s]."""


@dataclass(frozen=True, slots=True)
class ForceLimits:
    """Bounds of the force on a finger; see `ForceBounds`."""

    force_n: float = 10.0
    force_rate_n_s: float = 1000.0
    rate_window_s: float = 0.02
    age_s: float = 0.01

    def __post_init__(self) -> None:
        for name in ("force_n", "force_rate_n_s", "rate_window_s", "age_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise RangeError(f"the limit {name} is {value}; it must be positive")


class ForceWatch:
    """Trips on a force beyond its bounds."""

    def __init__(self, bounds: ForceBounds) -> None:
        self._bounds = bounds
        self._recent: deque[tuple[int, float]] = deque()

    def check_size(self, size_n: float) -> None:
        """Trip on too much force, in whatever direction."""
        if not size_n <= self._bounds.force_n:
            raise Tripped(Reason.FORCE_LIMIT, f"{size_n:.2f} N; {self._bounds.force_n:g} N are allowed")

    def check_rate(self, time_ns: int, normal_n: float) -> None:
        """Trip on too fast a change, from the oldest force inside the window to this one."""
        window_ns = self._bounds.rate_window_s * NS_PER_S
        while self._recent and time_ns - self._recent[0][0] > window_ns:
            self._recent.popleft()
        self._recent.append((time_ns, normal_n))
        rate = abs(normal_n - self._recent[0][1]) / self._bounds.rate_window_s
        if rate > self._bounds.force_rate_n_s:
            raise Tripped(
                Reason.FORCE_RATE,
                f"the force changed at {rate:.0f} N/s; {self._bounds.force_rate_n_s:g} N/s are allowed",
            )

    def check_age(self, age_s: float) -> None:
        """Trip on a sample that is too old."""
        if age_s > self._bounds.age_s:
            raise Tripped(
                Reason.FORCE_STALE,
                f"the newest force is {age_s * 1e3:.0f} ms old; nothing moves on more than "
                f"{self._bounds.age_s * 1e3:g} ms",
                {"age_s": age_s, "allowed_s": self._bounds.age_s},
            )
