"""Conformance checks of a whole rig before its first press: each device, and whether they fit together.

The checks of single devices are those of `palpate.devices.check`, offered here under the same names.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from palpate.core import NS_PER_S, ForceSensor, FrameSource, PalpateError, Position, Wrench
from palpate.devices import Mounting
from palpate.devices.check import check_camera, check_force_sensor, check_stage
from palpate.devices.check.interface_check import (
    CheckResult,
    Part,
    at_most,
    check_closing,
    gather,
    verdict,
    with_prefix,
)
from palpate.devices.check.stage_motion import Box, UnsafeError
from palpate.devices.supervisor.owning_process import FIFO, probe_realtime
from palpate.rig.commissioning.hand_motion import move_watched
from palpate.rig.mean_force import Hand
from palpate.rig.plans.plan_files import plan_of_sensor
from palpate.rig.plans.recording_plan import RecordingPlan
from palpate.rig.preflight import notes_of
from palpate.rig.rig import Rig

__all__ = ["CheckResult", "check_camera", "check_force_sensor", "check_rig", "check_stage"]

CLEAR_M = 2e-3  # between the box and the expected surface
HALF_M = 2e-3  # of the box's sides
SPEED_M_S = 5e-3
PUSHED_N = 1.0  # change of force, any direction, that ends all motion: nothing is to be touched
MORE_N = 0.2  # by which the force may rise on the way back
LISTENED, BORNE = 30.0, 3.0  # periods of a labelling sensor: listened to, and its oldest sample
SIGMAS = 5.0  # least contact threshold, in standard deviations of the force
NOISE_TOLERANCE = 1.25  # measured over stated noise: sampling error of 400 samples, and drift meanwhile


def check_rig(
    rig: Rig,
    *,
    clear_m: float = CLEAR_M,
    threshold_n: float | None = None,
    time_scale: float = 1.0,
    close: bool = True,
) -> list[CheckResult]:
    """Check a rig whose probe hangs in free air, a few millimetres above the skin.

    The stage is moved by 2 mm to each side of where it stands and 4 mm up, or down where the soft limits
    leave no 2 mm above, and never nearer to the expected surface than `clear_m`; a change of force by 1 N
    ends all motion.

    Args:
        rig: the devices, homed; the probe above the layer.
        clear_m: least distance to the expected surface [m].
        threshold_n: Contact threshold of the recordings to come, at least five standard deviations of the
            force [N]; by default that of the sensor's own plan.
        time_scale: of the stage, for one that is simulated slower than real time. See `check_stage`.
        close: close the devices at the end, and check that.

    Example:
        >>> from palpate.rig.virtual import virtual_rig
        >>> all(one.ok for one in check_rig(virtual_rig()))
        True
    """
    try:
        return _checks(rig, clear_m, _threshold_n(rig, threshold_n), time_scale, close=close)
    except BaseException:  # Ctrl-C: what moved stands by now, and the devices are let go of
        if close:
            rig.close()
        raise


def _threshold_n(rig: Rig, threshold_n: float | None) -> float:
    if threshold_n is not None:
        return threshold_n
    if rig.design is not None:
        return plan_of_sensor(rig.design).threshold_N
    return float(RecordingPlan.model_fields["threshold_N"].default)


def _checks(
    rig: Rig, clear_m: float, threshold_n: float, time_scale: float, *, close: bool
) -> list[CheckResult]:
    age_s, noise_n = rig.limits.age_s, threshold_n / SIGMAS
    if rig.noise_n is not None:
        noise_n = min(noise_n, NOISE_TOLERANCE * rig.noise_n)
    force = check_force_sensor(rig.force, clock=rig.clock, age_s=age_s, noise_n=noise_n, close=False)
    results = with_prefix("force", force)
    results += with_prefix("camera", check_camera(rig.camera, clock=rig.clock, close=False))
    if rig.label_force is not None:
        results += with_prefix("label-force", _labelling(rig.label_force, rig))
    results += with_prefix("rig", gather("fitting", _fits(rig)))
    if rig.seed is None:  # a real one
        results.append(scheduling_result(rig.scheduling if rig.supervisor else probe_realtime()))
        results.append(CheckResult("rig.force-gain", True, message="; ".join(notes_of(rig))))
    sensed = all(one.ok for one in force)
    results += with_prefix("stage", gather("checks", _stage(rig, clear_m, sensed, time_scale)))
    if close:
        closings = {
            "stage": check_closing(rig.stage, lambda: rig.stage.move_to(rig.origin_m, 1e-4), "move_to"),
            "force": check_closing(rig.force, lambda: rig.force.latest(), "latest()"),
            "camera": check_closing(rig.camera, lambda: rig.camera.grab(), "grab()"),
        }
        if (second := rig.label_force) is not None:
            closings["label-force"] = check_closing(second, second.latest, "latest()")
        for device, closing in closings.items():
            results += with_prefix(device, gather("close", closing))
    return results


def scheduling_result(granted: Mapping[str, str]) -> CheckResult:
    """Report whether the guard's process gets real-time scheduling; without it, a remedy."""
    is_fifo = granted["scheduling"] == FIFO
    return CheckResult("rig.real-time-scheduling", True, float(is_fifo), message=granted["remedy"])


def _labelling(sensor: ForceSensor, rig: Rig) -> list[CheckResult]:
    """Check a sensor that labels and does not guard: by its own rate and delay."""
    period_s = 1.0 / sensor.rate_hz
    return check_force_sensor(
        sensor,
        clock=rig.clock,
        seconds=max(2.0, LISTENED * period_s),
        age_s=getattr(sensor, "delay_s", 0.0) + BORNE * period_s,
        close=False,
    )


def _fits(rig: Rig) -> Part:
    travel, limits = rig.stage.travel, rig.limits
    try:
        limits.check_within(travel)
        wrong = ""
    except PalpateError as e:
        wrong = str(e)
    yield verdict("limits-in-travel", not wrong, wrong)
    x, y, z = rig.origin_m
    inside = all(
        low <= at <= high for at, low, high in zip((x, y, z), limits.least_m, limits.greatest_m, strict=True)
    )
    yield verdict(
        "center-in-limits",
        inside,
        f"origin_m is {rig.origin_m}, the limits are {limits.least_m} to {limits.greatest_m} m",
    )
    try:
        limits.check_sensor(rig.force)
        slow = ""
    except PalpateError as e:
        slow = str(e)
    yield verdict("force-rate", not slow, slow)
    yield at_most(
        "force-latency",
        1.0 / rig.force.rate_hz + getattr(rig.force, "delay_s", 0.0),
        limits.force_latency_s,
        "s",
        "its period and delay exceed the limit force_latency_s, from which the run-on is counted; raise that",
    )
    yield at_most(
        "force-limit-in-range",
        limits.force_n,
        rig.force.range_n[rig.mounting.normal],
        "N",
        "the sensor would saturate before the rig stops; lower the limit",
    )
    yield verdict(
        "frame-source",
        isinstance(rig.camera, FrameSource),
        "sweeps need drain(), see palpate.rig.rig.FrameSource",
    )


def _stage(rig: Rig, clear_m: float, sensed: bool, time_scale: float) -> Part:
    if not sensed:
        yield verdict("was-moved", False, "it was not: the force sensor, which guards its motion, has failed")
        return
    try:
        rig.limits.check_sensor(rig.force)
    except PalpateError as e:
        yield verdict("was-moved", False, f"it was not: {e}")
        return
    at = rig.stage.position_m()
    highest_z = rig.origin_m[2] - clear_m
    yield verdict(
        "clear-of-skin",
        at[2] < highest_z,
        f"it stands {(rig.origin_m[2] - at[2]) * 1e3:.3f} mm above the expected surface; lift it to more "
        f"than {clear_m * 1e3:g} mm. Nothing was moved",
    )
    if at[2] >= highest_z:
        return
    speed = min(SPEED_M_S, rig.limits.fastest_m_s(rig.stage.travel))
    watch = _Untouched(rig)
    yield from check_stage(
        rig.stage,
        clock=rig.clock,
        region_m=_box(rig, highest_z),
        speed_m_s=speed,
        watch=watch,
        time_scale=time_scale,
        close=False,
    )
    told = _go_back(rig, at, speed, watch) if watch.most_n > PUSHED_N else ""
    yield at_most(
        "touched-nothing",
        watch.most_n,
        PUSHED_N,
        "N",
        f"the force changed while the probe should have hung in free air; {told}",
    )


def _go_back(rig: Rig, start: Position, speed_m_s: float, watch: _Untouched) -> str:
    """Return to where the check began, so that repeating it presses no harder; what came of it."""
    hand = Hand(rig.stage, rig.force, Mounting(), rig.clock)
    try:
        most_n = max(watch.most_n, math.dist(hand.felt().force_n, watch.air_n)) + MORE_N
        rose = move_watched(rig.stage, rig.force, rig.clock, start, speed_m_s, watch.air_n, most_n)
        left_n = math.dist(hand.felt().force_n, watch.air_n)
    except PalpateError as e:
        hand.distrust_position()
        return f"the stage did not go back to where it began: {e}"
    if rose or left_n > PUSHED_N / 2:
        hand.distrust_position()
        return f"{left_n:.2f} N are left where it went back: lift the probe by hand, and look at the stage"
    return "the stage went back to where it began"


def _box(rig: Rig, highest_z: float) -> Box:
    at, limits = rig.stage.position_m(), rig.limits
    least = [max(p - HALF_M, low) for p, low in zip(at, limits.least_m, strict=True)]
    most = [min(p + HALF_M, high) for p, high in zip(at, limits.greatest_m, strict=True)]
    if at[2] - limits.least_m[2] >= HALF_M:
        most[2] = at[2]  # the operator's word that the probe hangs free holds for where it stands alone
    most[2] = min(most[2], highest_z)
    least[2] = max(min(least[2], most[2] - 2 * HALF_M), limits.least_m[2])
    return (least[0], least[1], least[2]), (most[0], most[1], most[2])


class _Untouched:
    """Watches the force while the stage moves; ends the motion where it changes or is old."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        x, y, z = np.mean([one.force_n for one in self._fresh(0.2)], axis=0).tolist()
        self.air_n = x, y, z
        self.most_n = 0.0

    def __call__(self) -> None:
        for one in self._rig.force.drain():
            if one.fault:
                raise UnsafeError(f"the force sensor says: {one.fault}")
            self.most_n = max(self.most_n, math.dist(one.force_n, self.air_n))
        if self.most_n > PUSHED_N:
            raise UnsafeError(f"the force changed by {self.most_n:.2f} N in free air: it touches something")
        newest = self._rig.force.latest()
        age_s = (self._rig.clock.now_ns() - newest.time_ns) / NS_PER_S
        if age_s > self._rig.limits.age_s:
            raise UnsafeError(f"the newest force is {age_s:.2f} s old")

    def _fresh(self, time_s: float) -> list[Wrench]:
        self._rig.force.drain()
        self._rig.clock.sleep(time_s)
        return self._rig.force.drain()
