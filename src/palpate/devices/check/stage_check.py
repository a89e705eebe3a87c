"""Checks of a stage against `core.Stage`, by small moves inside a box in free air."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress

from palpate.core import Clock, DeviceError, Position, RangeError, Stage
from palpate.devices.check.interface_check import (
    CheckResult,
    Part,
    at_most,
    call_elsewhere,
    check_closing,
    describe,
    gather,
    refusal,
    seconds,
    stage_interface,
    verdict,
)
from palpate.devices.check.stage_motion import Box, UnsafeError, Walker, spread_m

WITHIN_M = 0.02e-3  # how exactly a stage must stand where it was sent, as everywhere in the rig
AT_ONCE_S = 0.25  # a serial line and a few answers; a driver that waits for the motion takes longer
FASTER = 1.05  # than asked, which the finite number of looks may make it seem


def check_stage(
    stage: object,
    *,
    clock: Clock,
    region_m: Box,
    speed_m_s: float = 2e-3,
    within_m: float = WITHIN_M,
    watch: Callable[[], None] = lambda: None,
    time_scale: float = 1.0,
    close: bool = True,
) -> list[CheckResult]:
    """Check a driver of a stage, by moving it a little.

    The stage must stand in the box already, homed and at rest. It is stopped, and nothing moves any more, as
    soon as it is seen outside the box or `watch` raises. A place outside the travel is asked for too, which a
    good driver refuses; a bad one begins to go there, slowly, and is stopped at once. So leave some
    millimetres of free air around the box as well.

    Args:
        stage: the driver's, a `core.Stage`.
        clock: that it lives by: `MonotonicClock` for a real one.
        region_m: least and greatest corner of the box, inside the travel [m]. All of it is free air.
        speed_m_s: of the moves.
        within_m: how exactly it must stand where it was sent [m].
        watch: called at every look while it moves; raises what ends the check, such as too much force.
        time_scale: seconds of the clock that a second of the stage takes: 2 for simulated firmware at half
            real time, which is then judged for what it does. 1 for whatever is real.
        close: close it at the end, and check that.

    Raises:
        RangeError: the box leaves the travel or is too small for the speed, or no such speed or scale;
            nothing moved.

    Example:
        >>> from palpate.rig.virtual import virtual_rig
        >>> rig = virtual_rig()
        >>> box = ((-2e-3, -2e-3, -7e-3), (2e-3, 2e-3, -3e-3))
        >>> all(one.ok for one in check_stage(rig.stage, clock=rig.clock, region_m=box))
        True
    """
    findings = [*gather("protocol", stage_interface(stage))]
    if not (isinstance(stage, Stage) and all(one.ok for one in findings)):
        return findings
    walker = Walker(stage, clock, region_m, speed_m_s, within_m, watch, time_scale)
    findings += _all_moves(walker)
    if close:
        findings += gather(
            "close", check_closing(stage, lambda: stage.move_to(walker.centre, speed_m_s), "move_to")
        )
    return findings


def _all_moves(walker: Walker) -> Iterator[CheckResult]:
    """All parts that may move, ended by the first that leaves the stage unsafe."""
    parts = (
        ("standing", _standing),
        ("moving", _moving),
        ("second-move", refusing_second),
        ("stop", stopping),
        ("stop-from-thread", stopping_elsewhere),
        ("stop-at-rest", stopping_still),
        ("refusing", refusing),
    )
    try:
        for what, part in parts:
            yield from _safely(what, part(walker), walker)
    except UnsafeError as e:
        yield verdict("stays-safe", False, f"{e}; nothing was moved after that")
    except BaseException:  # as Ctrl-C; a finding that nobody takes any more is one too
        with suppress(UnsafeError):
            walker.halt()
        raise


def _safely(what: str, part: Part, walker: Walker) -> Part:
    """Gather a part's results; whatever goes wrong the stage stands at the end, or `UnsafeError` leaves."""
    unsafe: list[UnsafeError] = []

    def guarded() -> Part:
        try:
            yield from part
        except UnsafeError as e:
            unsafe.append(e)

    yield from gather(what, guarded())
    walker.halt()
    if unsafe:
        raise unsafe[0]


def _standing(walker: Walker) -> Part:
    first = walker.stage.position_m()
    inside = walker.inside(first)
    yield verdict(
        "starts-in-box", inside,
        f"it is at {first} m; move it into the box by hand before the check, nothing was moved",
    )  # fmt: skip
    if not inside:
        raise UnsafeError("it does not stand in the box")
    yield at_most(
        "holds-position", spread_m(walker.rest(0.1)), walker.within_m, "m",
        "its position changes while it stands",
    )  # fmt: skip
    yield verdict("standing-reported", not walker.stage.moving(), "moving() is True before any move")


def _moving(walker: Walker) -> Part:
    walker.go(walker.centre)
    first = walker.go(walker.low(2))
    yield verdict(
        "moving-reported", first.moved,
        "moving() was False right after move_to, which would be taken for having arrived",
    )  # fmt: skip
    if not first.moved and first.missed_m > walker.within_m:
        raise UnsafeError("it cannot be told when it moves")
    sideways = [place for axis in (0, 1) for place in (walker.low(axis), walker.high(axis), walker.centre)]
    aslant = [walker.low(0), walker.high(2), walker.centre]
    traces = [first, *(walker.go(place) for place in (walker.high(2), walker.centre, *sideways, *aslant))]
    shortest = min(trace.took_s for trace in traces)
    yield at_most(
        "move-returns",
        max(trace.call_s for trace in traces),
        min(AT_ONCE_S * walker.time_scale, shortest / 2),
        "s",
        "move_to must begin the motion and return; moving() tells when it is over",
    )
    late = sum(not trace.ended for trace in traces)
    yield at_most(
        "end-reported", late, 0, "", f"{late} moves never ended; moving() must become False at the end"
    )
    yield at_most(
        "target-reached", max(trace.missed_m for trace in traces), walker.within_m, "m",
        "it stands elsewhere: are steps lost, or are signs, units or scale wrong?",
    )  # fmt: skip
    yield at_most(
        "no-reversal", max(trace.backwards_m for trace in traces), walker.within_m, "m",
        "its position steps back while it moves on",
    )  # fmt: skip
    yield verdict(
        "position-on-path", min(trace.places_between for trace in traces) >= 3,
        "position_m() must be where it is now, also while it moves",
    )  # fmt: skip
    yield at_most(
        "straight-path", max(trace.aside_m for trace in traces), walker.within_m, "m",
        "it leaves the straight line between start and target",
    )  # fmt: skip
    scale = walker.time_scale
    fastest = max(scale * math.dist(t.start_m, t.target_m) / max(t.took_s, 1e-9) for t in traces)
    yield at_most(
        "speed-limit", fastest, FASTER * walker.speed_m_s, "m/s",
        "its overshoot after a stop is calculated from the speed that was asked for",
    )  # fmt: skip


PATIENCE_S = 1.0  # beyond the slowing down: a few answers of a controller
STAND_S = 0.2  # for how long it must go on standing


def stopping(walker: Walker) -> Part:
    """Stop from full speed, along each axis."""
    for axis in range(3):
        walker.go(walker.low(axis))
        target = walker.high(axis)
        walker.go(target, share=0.5)
        start_s = seconds(walker.clock)
        at = walker.here()
        looked_s = seconds(walker.clock) - start_s
        walker.stage.stop()
        took_s = seconds(walker.clock) - start_s
        yield from _after_stop(walker, "xyz"[axis], at, target, looked_s, took_s)


def _after_stop(
    walker: Walker, axis: str, at: Position, target: Position, looked_s: float, took_s: float
) -> Part:
    travel, speed = walker.travel, walker.speed_m_s
    stands = not walker.stage.moving()
    places = walker.rest(STAND_S)
    yield verdict(
        f"stands-after-stop-{axis}", stands and spread_m(places) <= walker.within_m,
        "stop() must return only once the stage stands, and moving() is False then",
    )  # fmt: skip
    yield at_most(
        f"overshoot-{axis}",
        math.dist(at, places[-1]),
        # Looking takes time too, during which it goes on.
        travel.overshoot_m(speed) + speed * looked_s / walker.time_scale + walker.within_m,
        "m",
        "v^2 / 2a + v latency is what guarded motion relies on: state a longer latency_s or a lower "
        "acceleration_m_s2 in travel, or stop sooner",
    )
    yield at_most(
        f"stop-time-{axis}",
        took_s,
        walker.time_scale * (speed / travel.acceleration_m_s2 + travel.latency_s + PATIENCE_S) + looked_s,
        "s",
        "stop() takes too long to return; an operator's emergency stop waits for it",
    )
    yield verdict(
        f"stops-short-{axis}", math.dist(places[-1], target) > walker.margin_m,
        "it went on to its target: stop() did not end the move",
    )  # fmt: skip


def stopping_elsewhere(walker: Walker) -> Part:
    """Stop from another thread, while this one goes on asking for the position."""
    walker.go(walker.low(0))
    target = walker.high(0)
    walker.go(target, share=0.5)
    at = walker.here()
    returned, error = call_elsewhere(walker.stage.stop, walker.stage.position_m)
    places = walker.rest(STAND_S)
    yield verdict(
        "stop-from-thread",
        returned
        and error is None
        and not walker.stage.moving()
        and spread_m(places) <= walker.within_m
        and math.dist(places[-1], target) > walker.margin_m,
        f"stop() in another thread at {at} m {'raised ' + repr(error) if error else 'did not stop it'}; "
        "stop() must be safe from any thread, also while others ask for the position",
    )
    after = walker.go(walker.centre)
    yield at_most(
        "moves-after-stop", after.missed_m, walker.within_m, "m",
        "after a stop its position is known, the old move is forgotten, and a new one goes where it is sent",
    )  # fmt: skip


def stopping_still(walker: Walker) -> Part:
    """Stop twice at a stand: nothing happens."""
    walker.go(walker.centre)
    before = walker.here()
    errors = [refusal(walker.stage.stop) for _ in range(2)]
    first = next((error for error in errors if error is not None), None)
    yield verdict(
        "stop-at-rest", first is None,
        f"stop() at a stand raised {type(first).__name__}: {first}; let it do nothing",
    )  # fmt: skip
    yield at_most(
        "still-after-stop-at-rest",
        spread_m([before, *walker.rest(STAND_S)]),
        walker.within_m,
        "m",
        "stop() at a stand moved it",
    )
    yield at_most(
        "moves-after-stop-at-rest", walker.go(walker.low(1)).missed_m, walker.within_m, "m",
        "a stop at a stand must not spoil the next move",
    )  # fmt: skip


BEYOND_M = 1e-3  # the travel
SLOW_M_S = 0.5e-3  # for what must be refused, should it be taken
NEAR_M = 0.1e-3


def refusing_second(walker: Walker) -> Part:
    """Ask for a second move while one is under way: it is refused, and the first goes on."""
    walker.go(walker.low(0))
    target = walker.high(0)
    walker.go(target, share=0.3)
    error = refusal(lambda: walker.stage.move_to(walker.centre, walker.speed_m_s))
    yield verdict(
        "second-move-refused", isinstance(error, DeviceError),
        f"move_to while it moves {describe(error)}; one move at a time: raise DeviceError",
    )  # fmt: skip
    yield at_most(
        "first-move-continues", walker.finish(target), walker.within_m, "m",
        "the refused move changed the one under way",
    )  # fmt: skip


def refusing(walker: Walker) -> Part:
    """Ask for places and speeds that are not allowed; whatever is accepted is stopped at once."""
    walker.go(walker.centre)
    before = walker.here()
    slow = min(SLOW_M_S, walker.speed_m_s)
    refusals = {
        "refuses-outside-travel": [(place, slow) for place in _outside(walker, before)],
        "refuses-nan": [(place, slow) for place in _no_places(before)],
        "refuses-speed": [(_beside(before), speed) for speed in _no_speeds(walker)],
    }
    for code, moves in refusals.items():
        errors = []
        for place, speed in moves:
            errors.append(refusal(lambda place=place, speed=speed: walker.stage.move_to(place, speed)))  # type: ignore[misc]
            walker.halt()
        accepted = [
            move for move, error in zip(moves, errors, strict=True) if not isinstance(error, RangeError)
        ]
        first = next((e for e in errors if not isinstance(e, RangeError)), None)
        yield at_most(
            code, len(accepted), 0, "",
            f"{len(accepted)} of {len(moves)} were not refused with RangeError, such as "
            f"move_to{accepted[:1]}, which {describe(first)}; raise RangeError before anything moves",
        )  # fmt: skip
    yield at_most(
        "still-when-refusing", spread_m([before, walker.here()]), walker.within_m, "m",
        "it moved although it was asked for what is not allowed",
    )  # fmt: skip


def _outside(walker: Walker, at: Position) -> Iterator[Position]:
    travel = walker.travel
    for axis in range(3):
        for limit in (travel.least_m[axis] - BEYOND_M, travel.greatest_m[axis] + BEYOND_M):
            yield _with(at, axis, limit)


def _no_places(at: Position) -> Iterator[Position]:
    for axis in range(3):
        for value in (math.nan, math.inf, -math.inf):
            yield _with(at, axis, value)


def _no_speeds(walker: Walker) -> tuple[float, ...]:
    return (math.nan, math.inf, -math.inf, 0.0, -walker.speed_m_s, 2 * walker.travel.top_speed_m_s)


def _beside(at: Position) -> Position:
    """Inside the box, away from the skin."""
    return at[0], at[1], at[2] - NEAR_M


def _with(at: Position, axis: int, value: float) -> Position:
    place = list(at)
    place[axis] = value
    x, y, z = place
    return x, y, z
