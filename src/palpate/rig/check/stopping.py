"""Does a stage stop when it is told to, how far does it run on, and may any thread tell it?"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from contextlib import suppress

from palpate.core.errors import DeviceError
from palpate.core.protocols import Position
from palpate.rig.check.finding import Part, at_most, held, refusal, seconds
from palpate.rig.check.motion import Walker, spread_m

PATIENCE_S = 1.0  # beyond the slowing down: a few answers of a controller
STAND_S = 0.2  # for how long it must go on standing
HUNG_S = 30.0  # of the machine's time, after which a call in another thread counts as one that never returns


def stopping(walker: Walker) -> Part:
    """From full speed, along each axis."""
    for axis in range(3):
        walker.go(walker.low(axis))
        target = walker.high(axis)
        walker.go(target, share=0.5)
        begun = seconds(walker.clock)
        at = walker.here()
        looked_s = seconds(walker.clock) - begun
        walker.stage.stop()
        took_s = seconds(walker.clock) - begun
        yield from _stopped(walker, "xyz"[axis], at, target, looked_s, took_s)


def _stopped(
    walker: Walker, axis: str, at: Position, target: Position, looked_s: float, took_s: float
) -> Part:
    travel, speed = walker.travel, walker.speed_m_s
    stands = not walker.stage.moving()
    places = walker.rest(STAND_S)
    yield held(
        f"stands when stop returns, along {axis}",
        stands and spread_m(places) <= walker.within_m,
        "stop() must return only once the stage stands, and moving() is False then",
    )
    yield at_most(
        f"runs on by its stated overshoot at most, along {axis}",
        math.dist(at, places[-1]),
        # Looking takes time too, during which it goes on.
        travel.overshoot_m(speed) + speed * looked_s + walker.within_m,
        "m",
        "v^2 / 2a + v latency is what guarded motion relies on: state a longer latency_s or a lower "
        "acceleration_m_s2 in travel, or stop sooner",
    )
    yield at_most(
        f"stop returns in time, along {axis}",
        took_s,
        speed / travel.acceleration_m_s2 + travel.latency_s + looked_s + PATIENCE_S,
        "s",
        "stop() takes too long to return; an operator's emergency stop waits for it",
    )
    yield held(
        f"stops short of the target, along {axis}",
        math.dist(places[-1], target) > walker.margin_m,
        "it went on to its target: stop() did not end the move",
    )


def stopping_elsewhere(walker: Walker) -> Part:
    """By another thread, while this one goes on asking for the position."""
    walker.go(walker.low(0))
    target = walker.high(0)
    walker.go(target, share=0.5)
    at = walker.here()
    returned, raised = _called_elsewhere(walker.stage.stop, walker.stage.position_m)
    places = walker.rest(STAND_S)
    yield held(
        "stops from another thread",
        returned
        and raised is None
        and not walker.stage.moving()
        and spread_m(places) <= walker.within_m
        and math.dist(places[-1], target) > walker.margin_m,
        f"stop() in another thread at {at} m {'raised ' + repr(raised) if raised else 'did not stop it'}; "
        "stop() must be safe from any thread, also while others ask for the position",
    )
    after = walker.go(walker.centre)
    yield at_most(
        "moves again after a stop",
        after.missed_m,
        walker.within_m,
        "m",
        "after a stop its position is known, the old move is forgotten, and a new one goes where it is sent",
    )


def _called_elsewhere(
    call: Callable[[], object], meanwhile: Callable[[], object]
) -> tuple[bool, Exception | None]:
    """Whether a call in another thread returned, and what it raised."""
    raised: list[Exception] = []

    def run() -> None:
        error = refusal(call)
        if error is not None:
            raised.append(error)

    thread = threading.Thread(target=run, name="conformance check", daemon=True)
    thread.start()
    end_s = time.monotonic() + HUNG_S
    while thread.is_alive() and time.monotonic() < end_s:
        with suppress(DeviceError):  # a call that a stop cuts off may say so
            meanwhile()
        thread.join(0.002)
    return not thread.is_alive(), raised[0] if raised else None


def stopping_still(walker: Walker) -> Part:
    """Twice at a stand: nothing happens."""
    walker.go(walker.centre)
    before = walker.here()
    errors = [refusal(walker.stage.stop) for _ in range(2)]
    raised = next((error for error in errors if error is not None), None)
    yield held(
        "may be stopped at a stand",
        raised is None,
        f"stop() at a stand raised {type(raised).__name__}: {raised}; let it do nothing",
    )
    yield at_most(
        "stays where it is when stopped at a stand",
        spread_m([before, *walker.rest(STAND_S)]),
        walker.within_m,
        "m",
        "stop() at a stand moved it",
    )
    yield at_most(
        "moves again after a stop at a stand",
        walker.go(walker.low(1)).missed_m,
        walker.within_m,
        "m",
        "a stop at a stand must not spoil the next move",
    )
