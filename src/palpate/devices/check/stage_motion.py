"""Small moves inside a box in free air, watched all the while, of which the checks of a stage are made."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from palpate.core import Clock, Float, Position, RangeError, Stage, ndarray
from palpate.devices.check.interface_check import seconds

Box = tuple[Position, Position]
"""Least and greatest corner [m]."""

POLL_S = 0.005
LATE_S = 1.0  # beyond what a move should take, before it counts as one that never ends
LATE_FACTOR = 2.0


class UnsafeError(Exception):
    """Nothing may move any more. It never leaves the checks."""


@dataclass(frozen=True, slots=True)
class Trace:
    """One move as it was seen.

    Attributes:
        start_m, target_m: from and to.
        call_s: how long `move_to` took.
        moved: whether it said that it moves, right after.
        times_s, places_m: at every look, until it said that it stands.
        ended: whether it came to an end by itself, in twice the time it should take and a second more.
    """

    start_m: Position
    target_m: Position
    call_s: float
    moved: bool
    times_s: Float[ndarray, " n"]
    places_m: Float[ndarray, "n 3"]
    ended: bool

    @property
    def took_s(self) -> float:
        """Time from the call until it said that it stands [s]."""
        return float(self.times_s[-1] - self.times_s[0])

    @property
    def missed_m(self) -> float:
        """Distance from the target at which it stands [m]."""
        return math.dist(self.places_m[-1], self.target_m)

    @property
    def backwards_m(self) -> float:
        """The longest step back along the way [m]."""
        return float(max(0.0, -np.diff(self._along()).min(initial=0.0)))

    @property
    def aside_m(self) -> float:
        """The greatest distance from the straight line [m]."""
        from_start = self.places_m - np.array(self.start_m)
        along = self._along()[:, None] * self._direction()
        return float(np.linalg.norm(from_start - along, axis=1).max())

    @property
    def places_between(self) -> int:
        """Number of places between start and target at which it was."""
        along, length = self._along(), math.dist(self.start_m, self.target_m)
        inside = along[(along > 0.02 * length) & (along < 0.98 * length)]
        return len(np.unique(inside))

    def _direction(self) -> Float[ndarray, " 3"]:
        way = np.array(self.target_m) - np.array(self.start_m)
        return np.asarray(way / np.linalg.norm(way))

    def _along(self) -> Float[ndarray, " n"]:
        return np.asarray((self.places_m - np.array(self.start_m)) @ self._direction())


class Walker:
    """Moves a stage inside a box and nowhere else.

    Args:
        stage: to be moved.
        clock: that the stage lives by.
        box: where it may be.
        speed_m_s: of the moves.
        within_m: how exactly it must stand where it says.
        watch: called at every look; raises where the motion has to end.
        time_scale: seconds of the clock that a second of the stage takes, 1 but for a simulation.

    Raises:
        RangeError: the box leaves the travel, or is too small for the speed; or no such scale.
    """

    def __init__(
        self,
        stage: Stage,
        clock: Clock,
        box: Box,
        speed_m_s: float,
        within_m: float,
        watch: Callable[[], None],
        time_scale: float = 1.0,
    ) -> None:
        if not (math.isfinite(time_scale) and time_scale > 0):
            raise RangeError(f"a time scale of {time_scale}; give a positive number, 2 for half real time")
        self.time_scale = time_scale
        self.stage, self.clock, self.speed_m_s, self.within_m = stage, clock, speed_m_s, within_m
        self._box, self._watch = box, watch
        travel = self.travel = stage.travel
        _check_speed(speed_m_s, within_m, travel.top_speed_m_s)
        self.margin_m = travel.overshoot_m(speed_m_s) + within_m
        least = 4 * self.margin_m + speed_m_s**2 / travel.acceleration_m_s2
        for axis, low, high, first, last in zip("xyz", *box, travel.least_m, travel.greatest_m, strict=True):
            if not (math.isfinite(low) and math.isfinite(high) and first <= low and high <= last):
                raise RangeError(
                    f"the box spans {axis} from {low * 1e3:g} to {high * 1e3:g} mm, and the stage's travel "
                    f"is {first * 1e3:g} to {last * 1e3:g} mm; state a box inside it",
                    code="box-outside-travel",
                )
            if high - low < least:
                raise RangeError(
                    f"the box is {(high - low) * 1e3:g} mm long along {axis}; at {speed_m_s * 1e3:g} mm/s, "
                    f"with room to stop, {least * 1e3:.3g} mm are needed: state a longer one or a "
                    "lower speed",
                    code="box-too-short",
                )

    def low(self, axis: int) -> Position:
        """The box's centre, but its low end along one axis, with room to stop [m]."""
        return self._corner(axis, 0)

    def high(self, axis: int) -> Position:
        """The box's centre, but its high end along one axis, with room to stop [m]."""
        return self._corner(axis, 1)

    @property
    def centre(self) -> Position:
        """The box's centre [m]."""
        x, y, z = (sum(pair) / 2 for pair in zip(*self._box, strict=True))
        return x, y, z

    def here(self) -> Position:
        """Position now [m]; the stage is stopped where that is outside the box."""
        place = self.stage.position_m()
        if not self.inside(place):
            self.stage.stop()
            raise UnsafeError(
                f"it was at {_mm(place)} mm, outside the box from {_mm(self._box[0])} to "
                f"{_mm(self._box[1])} mm, and was stopped: are the axes, signs and units right?"
            )
        return place

    def inside(self, place: Position) -> bool:
        """Tell whether a place is in the box, but for what the stage resolves."""
        return all(
            low - self.within_m <= at <= high + self.within_m
            for at, low, high in zip(place, *self._box, strict=True)
        )

    def go(self, target: Position, share: float = 1.0) -> Trace:
        """Send it, and follow it to its end; or, with a share below 1, through that part of the way."""
        start = self.here()
        length = math.dist(start, target)
        start_s = seconds(self.clock)
        self.stage.move_to(target, self.speed_m_s)
        return_s = seconds(self.clock)
        times, places = [start_s], [start]
        at_once = still = self.stage.moving()
        while still and times[-1] - start_s < self._due_s(length):
            self.clock.sleep(POLL_S)
            self.look()
            still = self.stage.moving()
            places.append(self.here())
            times.append(seconds(self.clock))
            if share < 1.0 and math.dist(start, places[-1]) >= share * length:
                break
        if not at_once:
            places.append(self.here())
            times.append(seconds(self.clock))
        if share >= 1.0 and still:
            self.stage.stop()
        return Trace(start, target, return_s - start_s, at_once, np.array(times), np.array(places), not still)

    def finish(self, target: Position) -> float:
        """Let the move under way come to its end; returns its distance from the target [m]."""
        end_s = seconds(self.clock) + self._due_s(math.dist(self.here(), target))
        while self.stage.moving() and seconds(self.clock) < end_s:
            self.clock.sleep(POLL_S)
            self.look()
            self.here()
        return math.dist(self.here(), target)

    def look(self) -> None:
        """Let the caller's watch look."""
        try:
            self._watch()
        except Exception as e:
            raise UnsafeError(str(e)) from e

    def rest(self, seconds_: float) -> list[Position]:
        """Positions that it states at some looks over a time [m]."""
        looks = max(2, math.ceil(seconds_ / (4 * POLL_S)))
        places = []
        for _ in range(looks):
            self.look()
            places.append(self.here())
            self.clock.sleep(seconds_ / looks)
        return places

    def halt(self) -> None:
        """Bring it to a stand, whatever was.

        Raises:
            UnsafeError: it cannot be.
        """
        try:
            self.stage.stop()
            stands = not self.stage.moving()
        except Exception as e:
            raise UnsafeError(f"stop() raised {type(e).__name__}: {e}") from e
        if not stands:
            raise UnsafeError("it says that it still moves after stop()")

    def _due_s(self, length_m: float) -> float:
        slowing_s = self.speed_m_s / self.travel.acceleration_m_s2
        return self.time_scale * (LATE_S + LATE_FACTOR * (length_m / self.speed_m_s + slowing_s))

    def _corner(self, axis: int, end: int) -> Position:
        place = list(self.centre)
        place[axis] = self._box[end][axis] + (1 if end == 0 else -1) * 2 * self.margin_m
        x, y, z = place
        return x, y, z


def spread_m(places: list[Position]) -> float:
    """The greatest distance of any place from the first [m]."""
    return max(math.dist(places[0], place) for place in places)


def _check_speed(speed_m_s: float, within_m: float, top_m_s: float) -> None:
    if not 0 < speed_m_s <= top_m_s:
        raise RangeError(
            f"a speed of {speed_m_s} m/s; give one above 0 and at most the stage's own {top_m_s:g} m/s",
            code="speed-range",
        )
    if not (math.isfinite(within_m) and within_m > 0):
        raise RangeError(
            f"within_m is {within_m} m; give how exactly the stage stands, above 0", code="not-positive"
        )


def _mm(place: Position) -> str:
    return "(" + ", ".join(f"{at * 1e3:.3f}" for at in place) + ")"
