"""Does a stage keep what `core.Stage` promises? Small moves inside a box in free air say so."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from palpate.core.clock import Clock
from palpate.core.protocols import Stage, Travel
from palpate.rig.check.finding import Finding, Part, at_most, closing, gathered, held
from palpate.rig.check.motion import Box, UnsafeError, Walker, spread_m
from palpate.rig.check.refusals import refusing, refusing_second
from palpate.rig.check.stopping import stopping, stopping_elsewhere, stopping_still

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
    close: bool = True,
) -> list[Finding]:
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
        close: close it at the end, and check that.

    Returns:
        The findings, in the order they were made.

    Raises:
        RangeError: the box leaves the travel or is too small for the speed, or no such speed; nothing moved.

    Example:
        >>> from palpate.rig.virtual import virtual_palm
        >>> rig = virtual_palm()
        >>> box = ((-2e-3, -2e-3, -7e-3), (2e-3, 2e-3, -3e-3))
        >>> all(one.ok for one in check_stage(rig.stage, clock=rig.clock, region_m=box))
        True
    """
    found = [*gathered("the protocol", _shape(stage))]
    if not (isinstance(stage, Stage) and all(one.ok for one in found)):
        return found
    walker = Walker(stage, clock, region_m, speed_m_s, within_m, watch)
    found += _moved(walker)
    if close:
        found += gathered("close", closing(stage, lambda: stage.move_to(walker.centre, speed_m_s), "move_to"))
    return found


def _shape(stage: object) -> Part:
    shaped = isinstance(stage, Stage)
    yield held("has the protocol's methods", shaped, "see palpate.core.Stage for what a stage must have")
    if not isinstance(stage, Stage):
        return
    travel = stage.travel
    wrong = list(_wrong(travel)) if isinstance(travel, Travel) else ["it is no palpate.core.Travel"]
    yield held("has a sane travel", not wrong, f"{'; '.join(wrong)}: {travel}")


def _wrong(travel: Travel) -> Iterator[str]:
    for axis, low, high in zip("xyz", travel.least_m, travel.greatest_m, strict=True):
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            yield f"{axis} from {low} to {high} m"
        elif high - low > 10.0:
            yield f"{axis} spans {high - low:g} m; are these millimetres?"
    for name in ("top_speed_m_s", "acceleration_m_s2"):
        value = getattr(travel, name)
        if not (math.isfinite(value) and value > 0):
            yield f"{name} is {value}; it must be above 0"
    if not (math.isfinite(travel.latency_s) and travel.latency_s >= 0):
        yield f"latency_s is {travel.latency_s}; it must be 0 or more"


def _moved(walker: Walker) -> Iterator[Finding]:
    """All parts that may move, ended by the first that leaves the stage unsafe."""
    parts = (
        ("standing", _standing),
        ("moving", _moving),
        ("a second move", refusing_second),
        ("stop", stopping),
        ("stop from another thread", stopping_elsewhere),
        ("stop at a stand", stopping_still),
        ("refusing", refusing),
    )
    try:
        for what, part in parts:
            yield from _kept_safe(what, part(walker), walker)
    except UnsafeError as e:
        yield held("stays safe", False, f"{e}; nothing was moved after that")


def _kept_safe(what: str, part: Part, walker: Walker) -> Part:
    """As `gathered`, but whatever goes wrong the stage stands at the end, or `UnsafeError` leaves."""
    unsafe: list[UnsafeError] = []

    def watched() -> Part:
        try:
            yield from part
        except UnsafeError as e:
            unsafe.append(e)

    yield from gathered(what, watched())
    walker.halt()
    if unsafe:
        raise unsafe[0]


def _standing(walker: Walker) -> Part:
    first = walker.stage.position_m()
    inside = walker.inside(first)
    yield held(
        "stands in the box at the start",
        inside,
        f"it is at {first} m; move it into the box by hand before the check, nothing was moved",
    )
    if not inside:
        raise UnsafeError("it does not stand in the box")
    yield at_most(
        "holds its position at a stand",
        spread_m(walker.rest(0.1)),
        walker.within_m,
        "m",
        "its position changes while it stands",
    )
    yield held("says that it stands", not walker.stage.moving(), "moving() is True before any move")


def _moving(walker: Walker) -> Part:
    walker.go(walker.centre)
    first = walker.go(walker.low(2))
    yield held(
        "says that it moves",
        first.moved,
        "moving() was False right after move_to, which would be taken for having arrived",
    )
    if not first.moved and first.missed_m > walker.within_m:
        raise UnsafeError("it cannot be told when it moves")
    sideways = [place for axis in (0, 1) for place in (walker.low(axis), walker.high(axis), walker.centre)]
    aslant = [walker.low(0), walker.high(2), walker.centre]
    traces = [first, *(walker.go(place) for place in (walker.high(2), walker.centre, *sideways, *aslant))]
    shortest = min(trace.took_s for trace in traces)
    yield at_most(
        "returns at once from move_to",
        max(trace.call_s for trace in traces),
        min(AT_ONCE_S, shortest / 2),
        "s",
        "move_to must begin the motion and return; moving() tells when it is over",
    )
    late = sum(not trace.ended for trace in traces)
    yield at_most(
        "says when it stands", late, 0, "", f"{late} moves never ended; moving() must become False at the end"
    )
    yield at_most(
        "goes where it is sent",
        max(trace.missed_m for trace in traces),
        walker.within_m,
        "m",
        "it stands elsewhere: are steps lost, or are signs, units or scale wrong?",
    )
    yield at_most(
        "goes on, never back, on its way",
        max(trace.backwards_m for trace in traces),
        walker.within_m,
        "m",
        "its position steps back while it moves on",
    )
    yield held(
        "tells its position on its way",
        min(trace.seen_between for trace in traces) >= 3,
        "position_m() must be where it is now, also while it moves",
    )
    yield at_most(
        "goes straight",
        max(trace.aside_m for trace in traces),
        walker.within_m,
        "m",
        "it leaves the straight line between start and target",
    )
    fastest = max(math.dist(trace.start_m, trace.target_m) / max(trace.took_s, 1e-9) for trace in traces)
    yield at_most(
        "is no faster than asked",
        fastest,
        FASTER * walker.speed_m_s,
        "m/s",
        "its overshoot after a stop is calculated from the speed that was asked for",
    )
