"""Checks of a force sensor against `core.ForceSensor`, while nothing touches it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from palpate.core import NS_PER_S, Clock, ForceSensor, RangeError, Wrench
from palpate.devices.check.interface_check import (
    CheckResult,
    Part,
    at_most,
    check_closing,
    force_interface,
    gather,
    judge,
    measurement,
    seconds,
    verdict,
)

AGE_S = 0.1  # oldest sample on which the rig moves
RATE_WITHIN = 0.05  # of what is stated
AT_ONCE_S = 0.02  # for a call that only hands out what is there
MIN_SAMPLES = 20  # fewer say nothing
EARLY_S = 1e-3  # by which a stamp may lie ahead of the clock: rounding


def check_force_sensor(
    sensor: object,
    *,
    clock: Clock,
    seconds: float = 2.0,
    noise_n: float | None = None,
    age_s: float = AGE_S,
    close: bool = True,
) -> list[CheckResult]:
    """Check a driver of a force sensor that nothing touches.

    Args:
        sensor: the driver's, a `core.ForceSensor`.
        clock: that it stamps on: `MonotonicClock` for a real one.
        seconds: for how long to listen; long enough for 20 samples [s].
        noise_n: greatest standard deviation along each axis [N]; only reported where left out. A contact
            threshold needs a fifth of itself.
        age_s: oldest sample that is borne [s]; the default is what guarded motion needs. A slow sensor, which
            labels and never guards, is judged by its own delay and some of its periods.
        close: close it at the end, and check that.

    Raises:
        RangeError: no such time or noise.

    Example:
        >>> from palpate.rig.virtual import virtual_rig
        >>> rig = virtual_rig()
        >>> all(one.ok for one in check_force_sensor(rig.force, clock=rig.clock))
        True
    """
    for name, value in (("seconds", seconds), ("noise_n", noise_n), ("age_s", age_s)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise RangeError(
                f"{name} is {value}; give a number above 0, in {'s' if name != 'noise_n' else 'N'}"
            )
    findings = [*gather("protocol", _description(sensor, seconds))]
    if isinstance(sensor, ForceSensor) and all(one.ok for one in findings):
        findings += gather("listening", _listening(sensor, clock, seconds, noise_n, age_s))
    if close and isinstance(sensor, ForceSensor):
        findings += gather("close", check_closing(sensor, sensor.latest, "latest()"))
    return findings


def _description(sensor: object, time_s: float) -> Part:
    yield from force_interface(sensor)
    if isinstance(sensor, ForceSensor):
        rate = sensor.rate_hz
        yield verdict(
            "listening-time", rate * time_s >= MIN_SAMPLES,
            f"{rate:g} samples a second give fewer than {MIN_SAMPLES} in {time_s:g} s; listen for longer",
        )  # fmt: skip


def _listening(sensor: ForceSensor, clock: Clock, time_s: float, noise_n: float | None, age_s: float) -> Part:
    stream = listen(sensor, clock, time_s)
    enough = len(stream.samples) >= MIN_SAMPLES
    yield verdict(
        "samples-continuous", enough, f"{len(stream.samples)} samples in {time_s:g} s; is it streaming?"
    )
    if not enough:
        return
    yield from _samples(stream)
    yield from _times(sensor, stream, age_s)
    yield from _forces(sensor, stream.samples, noise_n)


def _samples(stream: ForceStream) -> Part:
    yield at_most(
        "drain-once", stream.repeats, 0, "",
        f"{stream.repeats} samples came a second time; drain() must forget what it returned",
    )  # fmt: skip
    yield at_most(
        "drain-order",
        stream.unordered,
        0,
        "",
        f"{stream.unordered} drains were out of order",
    )
    yield at_most(
        "latest-newest", stream.latest_old, 0, "",
        f"latest() was older than what was drained before, {stream.latest_old} times",
    )  # fmt: skip
    yield at_most(
        "drain-complete", stream.latest_lost, 0, "",
        f"{stream.latest_lost} samples that latest() showed were in no drain; latest() must leave them there",
    )  # fmt: skip
    yield at_most(
        "call-time",
        float(max(np.median(stream.latest_s), np.median(stream.drain_s))), AT_ONCE_S, "s",
        "latest() and drain() must hand out what is there, and not wait for the device",
    )  # fmt: skip


def _times(sensor: ForceSensor, stream: ForceStream, age_s: float) -> Part:
    times_s = np.array([one.time_ns / NS_PER_S for one in stream.samples])
    steps = np.diff(times_s)
    yield at_most(
        "time-order", float(np.count_nonzero(steps < 0)), 0, "",
        "stamps go back in time; stamp samples on a monotonic clock",
    )  # fmt: skip
    lag_s = min(stream.lags_s)
    yield judge(
        "host-clock", -EARLY_S <= lag_s <= age_s, lag_s, age_s, "s",
        f"the newest samples are {lag_s:g} s old at best; stamp them when they arrive, with the clock "
        "that was given, in ns",
    )  # fmt: skip
    yield at_most(
        "latest-age", max(stream.ages_s), age_s, "s",
        "nothing moves on a force that is older than this",
    )  # fmt: skip
    # Between stamps, so that the first and last look do not count.
    rate = (len(times_s) - 1) / max(times_s[-1] - times_s[0], 1e-9)
    yield judge(
        "sample-rate",
        abs(rate / sensor.rate_hz - 1) <= RATE_WITHIN,
        rate,
        sensor.rate_hz,
        "Hz",
        f"{rate:.4g} Hz were measured, {sensor.rate_hz:g} Hz are stated: are samples lost or doubled?",
    )
    yield at_most(
        "sample-gap", float(steps.max()), age_s, "s",
        "between two samples more time passed than anything may move for",
    )  # fmt: skip


def _forces(sensor: ForceSensor, samples: list[Wrench], noise_n: float | None) -> Part:
    faulty = [one for one in samples if one.fault]
    yield at_most(
        "no-fault", len(faulty), 0, "",
        f"{len(faulty)} samples are faulty, such as {faulty[0].fault if faulty else ''!r}; see to the device",
    )  # fmt: skip
    good = np.array([one.force_n for one in samples if not one.fault])
    if len(good) < MIN_SAMPLES:
        return
    beyond = np.abs(good) / np.array(sensor.range_n)
    yield verdict(
        "force-in-range", bool(np.isfinite(good).all() and (beyond <= 1).all()),
        f"of a stated range of {sensor.range_n} N it reads {np.abs(good).max(axis=0)} N; a sample "
        "beyond it is a fault, not a force",
    )  # fmt: skip
    yield verdict(
        "not-frozen", bool(np.ptp(good, axis=0).any()),
        "every sample is the same to the last bit; is the device measuring?",
    )  # fmt: skip
    for axis, noise in zip("xyz", good.std(axis=0, ddof=1).tolist(), strict=True):
        code = f"noise-{axis}"
        if noise_n is None:
            yield measurement(code, noise, "N")
        else:
            yield at_most(
                code, noise, noise_n, "N", "too noisy: filter in the device, or ask for a higher threshold"
            )


POLL_S = 0.01


@dataclass
class ForceStream:
    """Samples that a sensor gave over a time, and how it gave them.

    Attributes:
        samples: of all drains, in order.
        repeats: how many came a second time.
        unordered: drains that were not oldest first, or began before the last one's end.
        lags_s: at each drain that gave any, how old its newest sample was.
        ages_s: of `latest`, at each look.
        latest_s, drain_s: how long each call took.
        latest_old: how often `latest` was older than what was drained before.
        latest_lost: how often `latest` was in no drain.
    """

    samples: list[Wrench] = field(default_factory=list)
    repeats: int = 0
    unordered: int = 0
    lags_s: list[float] = field(default_factory=list)
    ages_s: list[float] = field(default_factory=list)
    latest_s: list[float] = field(default_factory=list)
    drain_s: list[float] = field(default_factory=list)
    latest_old: int = 0
    latest_lost: int = 0


def listen(sensor: ForceSensor, clock: Clock, time_s: float) -> ForceStream:
    """Listen for a time, asking for the newest sample and for all that are new."""
    sensor.drain()  # what came before is of no interest, and may be too much
    clock.sleep(POLL_S)
    stream, start_s = ForceStream(), seconds(clock)
    counts: Counter[Wrench] = Counter()
    while (now_s := seconds(clock)) - start_s < time_s:
        newest = sensor.latest()
        call_s = seconds(clock)
        drained = sensor.drain()
        stream.latest_s.append(call_s - now_s)
        stream.drain_s.append(seconds(clock) - call_s)
        stream.ages_s.append(call_s - newest.time_ns / NS_PER_S)
        _take(stream, counts, newest, drained, call_s)
        clock.sleep(POLL_S)
    return stream


def _take(
    stream: ForceStream, counts: Counter[Wrench], newest: Wrench, drained: Sequence[Wrench], now_s: float
) -> None:
    last = stream.samples[-1].time_ns if stream.samples else None
    times = [one.time_ns for one in drained]
    first_time = [one for one in drained if _key(one) not in counts]
    stream.repeats += len(drained) - len(first_time)
    stream.unordered += times != sorted(times) or (last is not None and bool(times) and times[0] < last)
    stream.latest_old += last is not None and newest.time_ns < last
    counts.update(_key(one) for one in first_time)
    stream.latest_lost += last is not None and _key(newest) not in counts
    stream.samples += first_time
    if drained:
        stream.lags_s.append(now_s - max(times) / NS_PER_S)


def _key(sample: Wrench) -> Wrench:
    """A sample that compares, also where it is faulty and its numbers are none."""
    return Wrench(sample.time_ns, (0.0, 0.0, 0.0), fault=sample.fault) if sample.fault else sample
