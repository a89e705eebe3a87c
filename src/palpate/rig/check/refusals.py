"""Does a stage refuse what it cannot or must not do, and stand still then?"""

from __future__ import annotations

import math
from collections.abc import Iterator

from palpate.core.errors import DeviceError, RangeError
from palpate.core.protocols import Position
from palpate.rig.check.finding import Part, at_most, held, refusal, told
from palpate.rig.check.motion import Walker, spread_m

BEYOND_M = 1e-3  # the travel
SLOW_M_S = 0.5e-3  # for what must be refused, should it be taken
NEAR_M = 0.1e-3


def refusing_second(walker: Walker) -> Part:
    """A move while another is under way is refused, and the first goes on."""
    walker.go(walker.low(0))
    target = walker.high(0)
    walker.go(target, share=0.3)
    error = refusal(lambda: walker.stage.move_to(walker.centre, walker.speed_m_s))
    yield held(
        "refuses a second move with DeviceError",
        isinstance(error, DeviceError),
        f"move_to while it moves {told(error)}; one move at a time: raise DeviceError",
    )
    yield at_most(
        "goes on with the first move after refusing a second",
        walker.finish(target),
        walker.within_m,
        "m",
        "the refused move changed the one under way",
    )


def refusing(walker: Walker) -> Part:
    """Places and speeds that are not allowed; whatever is taken nevertheless is stopped at once."""
    walker.go(walker.centre)
    before = walker.here()
    slow = min(SLOW_M_S, walker.speed_m_s)
    asked = {
        "refuses places outside its travel": [(place, slow) for place in _outside(walker, before)],
        "refuses places that are no numbers": [(place, slow) for place in _no_places(before)],
        "refuses speeds it cannot run at": [(_near(before), speed) for speed in _no_speeds(walker)],
    }
    for name, moves in asked.items():
        errors = []
        for place, speed in moves:
            errors.append(refusal(lambda place=place, speed=speed: walker.stage.move_to(place, speed)))  # type: ignore[misc]
            walker.halt()
        taken = [move for move, error in zip(moves, errors, strict=True) if not isinstance(error, RangeError)]
        first = next((e for e in errors if not isinstance(e, RangeError)), None)
        yield at_most(
            name,
            len(taken),
            0,
            "",
            f"{len(taken)} of {len(moves)} were not refused with RangeError, such as move_to{taken[:1]}, "
            f"which {told(first)}; raise RangeError before anything moves",
        )
    yield at_most(
        "stands still when it refuses",
        spread_m([before, walker.here()]),
        walker.within_m,
        "m",
        "it moved although it was asked for what is not allowed",
    )


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
    return (
        math.nan,
        math.inf,
        -math.inf,
        0.0,
        -walker.speed_m_s,
        2 * walker.travel.top_speed_m_s,
    )


def _near(at: Position) -> Position:
    """Inside the box, away from the skin."""
    return at[0], at[1], at[2] - NEAR_M


def _with(at: Position, axis: int, value: float) -> Position:
    place = list(at)
    place[axis] = value
    x, y, z = place
    return x, y, z
