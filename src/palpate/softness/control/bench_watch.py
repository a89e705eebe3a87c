"""Plausibility checks of a rendering bench: device states, timing, force, and energy, once per period."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from palpate.core import NS_PER_S, ArmRange, ArmSample, DisplayRange, DisplaySample
from palpate.devices.motion_limits import ForceLimits, ForceWatch, Reason, Tripped

SLACK = 1e-3  # of the greatest pressure, for rounding


@dataclass(frozen=True, slots=True)
class BenchLimits:
    """Limits of a rendering bench.

    Attributes:
        late_s: longest period of the loop [s]; shorter than the devices' watchdogs.
        margin_m: tolerance of positions outside their range [m].
        pressure_pa, settle_s: deviation from the set-point, and for how long.
        mean_pa, mean_share, mean_s: mean deviation, plus a fraction of the set-point, over a time constant.
        over_pa, over_s: overpressure, and for how long.
        frozen_s: longest time of identical readings [s].
        astray_m, astray_s: tracking error of the arm, and for how long.
        energy_j: energy returned by an object beyond the input since contact [J].
        step_n: largest change of the arm's force per period [N].
    """

    force: ForceLimits = field(default_factory=ForceLimits)
    late_s: float = 3e-3
    margin_m: float = 0.5e-3
    jump_m_s: float = 1.5
    pressure_pa: float = 12e3
    mean_pa: float = 4e3
    mean_share: float = 0.1
    mean_s: float = 0.2
    over_pa: float = 30e3
    settle_s: float = 0.1
    over_s: float = 0.015
    frozen_s: float = 0.1
    astray_m: float = 3e-3
    astray_s: float = 0.5
    energy_j: float = 5e-3
    step_n: float = 3.0


class BenchWatch:
    """Checks of one rendering; `display` is None if a plate is in its place."""

    def __init__(self, limits: BenchLimits, display: DisplayRange | None, arm: ArmRange) -> None:
        self._limits, self._display, self._arm = limits, display, arm
        self._force = ForceWatch(limits.force)
        self._last: dict[str, tuple[int, float]] = {}
        self._since: dict[str, int] = {}
        self._same: dict[str, tuple[float, int]] = {}
        self._mean: tuple[float, float, int] | None = None
        self.energy_j = 0.0

    def period(self, before_ns: int | None, now_ns: int) -> None:
        """Trip on a period that came too late."""
        if before_ns is not None and now_ns - before_ns > self._limits.late_s * NS_PER_S:
            raise Tripped(
                Reason.LOOP_LATE,
                f"a period of {(now_ns - before_ns) / 1e6:.1f} ms; {self._limits.late_s * 1e3:g} ms are "
                "allowed: close other programs, or run the loop on a computer of its own",
            )

    def samples(self, display: DisplaySample | None, arm: ArmSample, now_ns: int) -> None:
        """Trip on samples that cannot be, are old, faulty or frozen."""
        if display is not None:
            self._display_sample(display, now_ns)
        self._plain(Reason.ARM, "arm", arm.fault, (arm.displacement_m, arm.velocity_m_s))
        low, high = self._arm.least_m, self._arm.greatest_m
        self._inside(Reason.ARM, "the arm", arm.displacement_m, low, high)
        self._moved(Reason.ARM, "the arm", arm.time_ns, arm.displacement_m)
        self._aged(arm.time_ns, now_ns)

    def _display_sample(self, one: DisplaySample, now_ns: int) -> None:
        assert self._display is not None
        values = (one.pushed_m, one.pressure_pa)
        self._plain(Reason.DISPLAY, "display", one.fault, values)
        self._inside(Reason.PUSH, "the tip", one.pushed_m, 0.0, self._display.height_m)
        self._moved(Reason.PUSH, "the tip", one.time_ns, one.pushed_m)
        self._aged(one.time_ns, now_ns)
        for name, value in (("push", one.pushed_m), ("pressure", one.pressure_pa)):
            before = self._same.get(name)
            if before is None or before[0] != value:
                self._same[name] = (value, now_ns)
            elif now_ns - before[1] > self._limits.frozen_s * NS_PER_S:
                raise Tripped(
                    Reason.DISPLAY,
                    f"{name} has read the same to the last digit for {self._limits.frozen_s * 1e3:g} ms; no "
                    "sensor without noise is believed: read it at its full resolution",
                )

    def command(self, pressure_pa: float, force_n: float, greatest_pa: float) -> None:
        """Trip on references that are no numbers, or that no law gives."""
        if not (math.isfinite(pressure_pa) and math.isfinite(force_n)):
            raise Tripped(
                Reason.REFERENCE,
                f"a reference of {pressure_pa} Pa and {force_n} N; nothing is told to a device that is no "
                "number",
            )
        if pressure_pa > greatest_pa * (1 + SLACK):
            raise Tripped(
                Reason.REFERENCE,
                f"a reference of {pressure_pa / 1e3:.4g} kPa, and {greatest_pa / 1e3:g} kPa is the most",
            )

    def pressure(self, measured_pa: float, told_pa: float, now_ns: int) -> None:
        """Trip on a chamber that does not hold what it was told: a stuck valve, a leak, no supply."""
        off, limits = measured_pa - told_pa, self._limits
        self._check_mean(abs(off), told_pa, now_ns)
        for name, where, within_s, allowed in (
            ("off", abs(off) > limits.pressure_pa, limits.settle_s, limits.pressure_pa),
            ("over", off > limits.over_pa, limits.over_s, limits.over_pa),
        ):
            if self._lasts(name, where, within_s, now_ns):
                raise Tripped(
                    Reason.PRESSURE,
                    f"the chamber holds {measured_pa / 1e3:.1f} kPa and was told {told_pa / 1e3:.1f} kPa; "
                    f"{allowed / 1e3:g} kPa between them are allowed for {within_s * 1e3:g} ms: look at the "
                    "valve, the supply and the tube",
                )

    def _check_mean(self, off_pa: float, told_pa: float, now_ns: int) -> None:
        mean_off, mean_told, before_ns = self._mean or (0.0, 0.0, now_ns)
        share = min((now_ns - before_ns) / NS_PER_S / self._limits.mean_s, 1.0)
        mean_off, mean_told = (
            mean_off + share * (off_pa - mean_off),
            mean_told + share * (told_pa - mean_told),
        )
        self._mean = (mean_off, mean_told, now_ns)
        allowed = self._limits.mean_pa + self._limits.mean_share * mean_told
        if mean_off > allowed:
            raise Tripped(
                Reason.PRESSURE,
                f"the chamber has missed what it was told by {mean_off / 1e3:.1f} kPa in the mean over "
                f"{self._limits.mean_s * 1e3:g} ms; {allowed / 1e3:.1f} kPa are allowed: look at the valve, "
                "the supply and the tube",
            )

    def touch(self, force_n: float, speed_m_s: float, dt_s: float, time_ns: int, *, touched: bool) -> None:
        """Trip on force, force rate, or energy returned; `speed_m_s` is positive while pressing."""
        self._force.check_size(abs(force_n))
        self._force.check_rate(time_ns, force_n)
        self.energy_j = self.energy_j + force_n * speed_m_s * dt_s if touched else 0.0
        if self.energy_j < -self._limits.energy_j:
            raise Tripped(
                Reason.ENERGY,
                f"{-self.energy_j * 1e3:.2f} mJ more came out of the object than went in; "
                f"{self._limits.energy_j * 1e3:g} mJ are allowed: the loop drives the finger",
            )

    def arm_error(self, error_m: float, now_ns: int) -> None:
        """Trip on an arm that does not follow."""
        if self._lasts("astray", abs(error_m) > self._limits.astray_m, self._limits.astray_s, now_ns):
            raise Tripped(
                Reason.ARM,
                f"the arm has been {abs(error_m) * 1e3:.1f} mm from its reference for "
                f"{self._limits.astray_s * 1e3:g} ms; is it blocked, or its motors off?",
            )

    def _lasts(self, name: str, where: bool, within_s: float, now_ns: int) -> bool:
        if not where:
            self._since.pop(name, None)
            return False
        return now_ns - self._since.setdefault(name, now_ns) > within_s * NS_PER_S

    def _plain(self, reason: Reason, name: str, fault: str, values: tuple[float, ...]) -> None:
        if fault:
            raise Tripped(reason, f"the {name} says: {fault}")
        if not all(math.isfinite(one) for one in values):
            raise Tripped(reason, f"the {name} reads {values}, which are no numbers")

    def _inside(self, reason: Reason, name: str, at: float, low: float, high: float) -> None:
        if not low - self._limits.margin_m <= at <= high + self._limits.margin_m:
            raise Tripped(
                reason,
                f"{name} is said to be at {at * 1e3:.2f} mm, and goes from {low * 1e3:g} to {high * 1e3:g} "
                "mm: calibrate its sensor's zero and scale",
            )

    def _moved(self, reason: Reason, name: str, time_ns: int, at: float) -> None:
        before = self._last.get(name)
        self._last[name] = (time_ns, at)
        if before is None:
            return
        allowed = self._limits.jump_m_s * (time_ns - before[0]) / NS_PER_S + self._limits.margin_m
        if abs(at - before[1]) > allowed:
            raise Tripped(
                reason,
                f"{name} is said to have moved {abs(at - before[1]) * 1e3:.2f} mm in "
                f"{(time_ns - before[0]) / 1e6:.2f} ms, and {allowed * 1e3:.2f} mm are believed",
            )

    def _aged(self, time_ns: int, now_ns: int) -> None:
        self._force.check_age((now_ns - time_ns) / NS_PER_S)
