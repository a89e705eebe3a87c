"""Does a force sensor keep what `core.ForceSensor` promises? Nothing touches it meanwhile."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from palpate.core import NS_PER_S, Clock, ForceSensor, RangeError, Wrench
from palpate.devices.check.check_result import (
    CheckResult,
    Part,
    at_most,
    closing,
    gathered,
    held,
    judged,
    measured_only,
    seconds,
)
from palpate.devices.check.interface_check import force_interface

AGE_S = 0.1  # oldest sample on which the rig moves
RATE_WITHIN = 0.05  # of what is stated
AT_ONCE_S = 0.02  # for a call that only hands out what is there
SAMPLES = 20  # fewest that say anything
EARLY_S = 1e-3  # by which a stamp may lie ahead of the clock: rounding


def check_force_sensor(
    sensor: object,
    *,
    clock: Clock,
    seconds: float = 2.0,
    noise_n: float | None = None,
    close: bool = True,
) -> list[CheckResult]:
    """Check a driver of a force sensor that nothing touches.

    Args:
        sensor: the driver's, a `core.ForceSensor`.
        clock: that it stamps on: `MonotonicClock` for a real one.
        seconds: for how long to listen; long enough for 20 samples [s].
        noise_n: greatest standard deviation along each axis [N]; it is only told where left out. A contact
            threshold needs a fifth of itself.
        close: close it at the end, and check that.

    Raises:
        RangeError: no such time or noise.

    Example:
        >>> from palpate.rig.virtual import virtual_rig
        >>> rig = virtual_rig()
        >>> all(one.ok for one in check_force_sensor(rig.force, clock=rig.clock))
        True
    """
    for name, value in (("seconds", seconds), ("noise_n", noise_n)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise RangeError(
                f"{name} is {value}; give a number above 0, in {'s' if name != 'noise_n' else 'N'}"
            )
    found = [*gathered("the protocol", _described(sensor, seconds))]
    if isinstance(sensor, ForceSensor) and all(one.ok for one in found):
        found += gathered("listening", _listened(sensor, clock, seconds, noise_n))
    if close and isinstance(sensor, ForceSensor):
        found += gathered("close", closing(sensor, sensor.latest, "latest()"))
    return found


def _described(sensor: object, time_s: float) -> Part:
    yield from force_interface(sensor)
    if isinstance(sensor, ForceSensor):
        rate = sensor.rate_hz
        yield held(
            "is listened to for long enough",
            rate * time_s >= SAMPLES,
            f"{rate:g} samples a second give fewer than {SAMPLES} in {time_s:g} s; listen for longer",
        )


def _listened(sensor: ForceSensor, clock: Clock, time_s: float, noise_n: float | None) -> Part:
    seen = watched(sensor, clock, time_s)
    enough = len(seen.samples) >= SAMPLES
    yield held(
        "measures all the time",
        enough,
        f"{len(seen.samples)} samples in {time_s:g} s; is it streaming?",
    )
    if not enough:
        return
    yield from _handed_out(seen)
    yield from _timed(sensor, seen)
    yield from _measured(sensor, seen.samples, noise_n)


def _handed_out(seen: Watched) -> Part:
    yield at_most(
        "drain returns each sample once",
        seen.again,
        0,
        "",
        f"{seen.again} samples came a second time; drain() must forget what it returned",
    )
    yield at_most(
        "drain returns the oldest first",
        seen.unordered,
        0,
        "",
        f"{seen.unordered} drains were out of order",
    )
    yield at_most(
        "latest is the newest sample",
        seen.latest_old,
        0,
        "",
        f"latest() was older than what was drained before, {seen.latest_old} times",
    )
    yield at_most(
        "drain returns what latest showed",
        seen.latest_lost,
        0,
        "",
        f"{seen.latest_lost} samples that latest() showed were in no drain; latest() must not take them away",
    )
    yield at_most(
        "calls return at once",
        float(max(np.median(seen.latest_s), np.median(seen.drain_s))),
        AT_ONCE_S,
        "s",
        "latest() and drain() must hand out what is there, and not wait for the device",
    )


def _timed(sensor: ForceSensor, seen: Watched) -> Part:
    times_s = np.array([one.time_ns / NS_PER_S for one in seen.samples])
    steps = np.diff(times_s)
    yield at_most(
        "timestamps increase",
        float(np.count_nonzero(steps < 0)),
        0,
        "",
        "stamps go back in time; stamp samples on a monotonic clock",
    )
    lag_s = min(seen.lags_s)
    yield judged(
        "timestamps are on the host's clock",
        -EARLY_S <= lag_s <= AGE_S,
        lag_s,
        AGE_S,
        "s",
        f"the newest samples are {lag_s:g} s old at best; stamp them when they arrive, with the clock "
        "that was given, in ns",
    )
    yield at_most(
        "latest is never old",
        max(seen.ages_s),
        AGE_S,
        "s",
        "nothing moves on a force that is older than this",
    )
    # Between stamps, so that the first and last look do not count.
    rate = (len(times_s) - 1) / max(times_s[-1] - times_s[0], 1e-9)
    yield judged(
        "measures at the stated rate",
        abs(rate / sensor.rate_hz - 1) <= RATE_WITHIN,
        rate,
        sensor.rate_hz,
        "Hz",
        f"{rate:.4g} Hz were measured, {sensor.rate_hz:g} Hz are stated: are samples lost or doubled?",
    )
    yield at_most(
        "leaves no gap",
        float(steps.max()),
        AGE_S,
        "s",
        "between two samples more time passed than anything may move for",
    )


def _measured(sensor: ForceSensor, samples: list[Wrench], noise_n: float | None) -> Part:
    faulty = [one for one in samples if one.fault]
    yield at_most(
        "tells of no fault",
        len(faulty),
        0,
        "",
        f"{len(faulty)} samples are faulty, such as {faulty[0].fault if faulty else ''!r}; see to the device",
    )
    good = np.array([one.force_n for one in samples if not one.fault])
    if len(good) < SAMPLES:
        return
    beyond = np.abs(good) / np.array(sensor.range_n)
    yield held(
        "reads finite forces inside its range",
        bool(np.isfinite(good).all() and (beyond <= 1).all()),
        f"of a stated range of {sensor.range_n} N it reads {np.abs(good).max(axis=0)} N; a sample "
        "beyond it is a fault, not a force",
    )
    yield held(
        "is not frozen",
        bool(np.ptp(good, axis=0).any()),
        "every sample is the same to the last bit; is the device measuring?",
    )
    for axis, noise in zip("xyz", good.std(axis=0, ddof=1).tolist(), strict=True):
        name = f"noise along its {axis}"
        if noise_n is None:
            yield measured_only(name, noise, "N")
        else:
            yield at_most(
                name, noise, noise_n, "N", "too noisy: filter in the device, or ask for a higher threshold"
            )


POLL_S = 0.01


@dataclass
class Watched:
    """What a sensor gave while it was watched.

    Attributes:
        begun_s, ended_s: from when to when [s].
        samples: of all drains, in order.
        again: how many came a second time.
        unordered: drains that were not oldest first, or began before the last one's end.
        lags_s: at each drain that gave any, how old its newest sample was.
        ages_s: of `latest`, at each look.
        latest_s, drain_s: how long each call took.
        latest_old: how often `latest` was older than what was drained before.
        latest_lost: how often `latest` was in no drain.
    """

    begun_s: float = 0.0
    ended_s: float = 0.0
    samples: list[Wrench] = field(default_factory=list)
    again: int = 0
    unordered: int = 0
    lags_s: list[float] = field(default_factory=list)
    ages_s: list[float] = field(default_factory=list)
    latest_s: list[float] = field(default_factory=list)
    drain_s: list[float] = field(default_factory=list)
    latest_old: int = 0
    latest_lost: int = 0


def watched(sensor: ForceSensor, clock: Clock, time_s: float) -> Watched:
    """Listen for a time, asking for the newest sample and for all that are new."""
    sensor.drain()  # what came before is of no interest, and may be too much
    clock.sleep(POLL_S)
    seen = Watched(begun_s=seconds(clock))
    known: Counter[Wrench] = Counter()
    while (now_s := seconds(clock)) - seen.begun_s < time_s:
        newest = sensor.latest()
        called_s = seconds(clock)
        drained = sensor.drain()
        seen.latest_s.append(called_s - now_s)
        seen.drain_s.append(seconds(clock) - called_s)
        seen.ages_s.append(called_s - newest.time_ns / NS_PER_S)
        _take(seen, known, newest, drained, called_s)
        clock.sleep(POLL_S)
    seen.ended_s = seconds(clock)
    return seen


def _take(
    seen: Watched, known: Counter[Wrench], newest: Wrench, drained: Sequence[Wrench], now_s: float
) -> None:
    last = seen.samples[-1].time_ns if seen.samples else None
    times = [one.time_ns for one in drained]
    fresh = [one for one in drained if _key(one) not in known]
    seen.again += len(drained) - len(fresh)
    seen.unordered += times != sorted(times) or (last is not None and bool(times) and times[0] < last)
    seen.latest_old += last is not None and newest.time_ns < last
    known.update(_key(one) for one in fresh)
    seen.latest_lost += last is not None and _key(newest) not in known
    seen.samples += fresh
    if drained:
        seen.lags_s.append(now_s - max(times) / NS_PER_S)


def _key(sample: Wrench) -> Wrench:
    """A sample that compares, also where it is faulty and its numbers are none."""
    return Wrench(sample.time_ns, (0.0, 0.0, 0.0), fault=sample.fault) if sample.fault else sample
