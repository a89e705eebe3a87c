"""What a force sensor hands out while it is watched, and what is wrong with how it does."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from palpate.core.clock import NS_PER_S, Clock
from palpate.core.protocols import ForceSensor, Wrench
from palpate.rig.check.finding import seconds

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
