"""A stage moved by hand: lift by force, homing, jogs, and the force sensor's zero in the air.

Whether the probe touches is not asked of a bias, which nobody knows yet, but of a motion: in the air the
force stays what it is while the probe is lifted, and in contact it does not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, runtime_checkable

from palpate.core import (
    NS_PER_S,
    Clock,
    DeviceError,
    ForceSensor,
    InputError,
    Position,
    RangeError,
    Stage,
)
from palpate.devices import ForceReached, Limits, Mounting, OperatorControl, Reason, Tripped
from palpate.devices.force_bias import Force, ForceBias
from palpate.devices.motion_guard import MotionGuard
from palpate.rig.commissioning.felt_way import CLEAR_M, feel_way
from palpate.rig.mean_force import (
    CHANGED_N,
    POLL_S,
    SIGMAS,
    AirForce,
    Hand,
    LiveSamples,
    await_push,
    contact_n,
    discard,
    fresh_samples,
    guarded_mean,
)

STEP_M = 0.2e-3  # of a lift; the force is measured after each
SAME_M = 1e-6  # between two positions that are the same
FLAT_M = 0.6e-3  # of lifting without a change of force, which proves the air
MAX_LIFT_M = 20e-3
HOP_M = 0.5e-3  # of a motion that no force bounds: where this process dies, the stage ends such a hop
LIFT_SPEED_M_S = 2e-3
RISE_N = 1.0  # by which compression may rise on the way away: beyond, z is turned round
UNSEEN_N = 0.1  # greatest change of force that may stay unseen before a jog
LATE_S = 2.0  # beyond the time that a move should take, three times over
MAX_JOG_M = 50e-3
MAX_JOG_M_S = 10e-3
MAX_UNGUARDED_M_S = 2e-3
JOG_N = 1.0  # change of force at which a jog stops
SEARCH_STEP_M = 0.05e-3  # step of a touch-off; the force is measured after each
SEARCH_SPEED_M_S = 1e-3
SEARCH_REACH_M = 5e-3  # greatest distance from the skin at which a touch-off begins
SEARCH_N = 0.3  # change of force that stops a step of a touch-off on its way
TOUCH_OFF_LIFT_M = 2e-3  # height above the skin at which a touch-off ends
AGREE_M = 0.3e-3  # difference of two searches for the skin
FALLS = 0.25  # least share by which a force falls on the way back, of a linear fall
MAX_CHANGE_N = 10.0  # change of force in a lift without limits of the rig


@runtime_checkable
class Homing(Protocol):
    """Stage whose place can be lost: `retreat` and `approach` move it along z before its place is known."""

    def home(self) -> None: ...
    def stop(self) -> None: ...
    def unlock(self) -> None: ...
    def retreat(self, distance_m: float, speed_m_s: float) -> None: ...
    def approach(self, distance_m: float, speed_m_s: float) -> None: ...
    def reference(self, position_m: Position) -> None: ...


def lift_clear(
    hand: Hand, limits: Limits | None = None, *, reach_m: float = math.inf, rise_n: float = RISE_N
) -> AirForce:
    """Lift the probe in steps until the force no longer changes: it hangs in the air.

    Args:
        hand: the stage is moved along its z alone, away from the skin; its place need not be known.
        limits: soft limits that it keeps to, where the stage's place is known.
        reach_m: way at which it ends, whatever the force [m].
        rise_n: by which compression may rise, and any force of a lift that begins in the air [N].

    Raises:
        Tripped: a soft limit, before it is passed; compression rises, the force changes by more than the
            rig's limit, goes on changing over `MAX_LIFT_M`, or cannot be believed.
        DeviceError: the stage fails, or its controller refuses to go higher.
    """
    at = start = hand.felt()
    most_n = MAX_CHANGE_N if limits is None else limits.force_n
    lifted_m, reference, flat_m = 0.0, at, 0.0
    while flat_m < FLAT_M - 1e-9 and lifted_m < reach_m - 1e-9:
        if lifted_m > MAX_LIFT_M:
            raise Tripped(
                Reason.FORCE_NOISE,
                f"the force still changes after a lift of {lifted_m * 1e3:.1f} mm: the probe is not free, or "
                "the sensor drifts; look at the rig",
            )
        if limits is not None:
            x, y, z = hand.stage.position_m()
            limits.check_target((x, y, z - STEP_M))
        step_m = min(STEP_M, reach_m - lifted_m)
        retreat(hand, step_m, LIFT_SPEED_M_S, start=start, lifted_m=lifted_m, rise_n=rise_n, most_n=most_n)
        lifted_m, flat_m = lifted_m + step_m, flat_m + step_m
        at = hand.felt()
        if math.dist(at.force_n, reference.force_n) > contact_n(at, reference):
            reference, flat_m = at, 0.0
        elif lifted_m == step_m:  # it began in the air, where nothing changes the force but a skin above it
            most_n = min(most_n, rise_n)
    return replace(at, lifted_mm=lifted_m * 1e3)


def touch_off(hand: Hand, surface_m: Position, *, pushed: bool = True) -> AirForce:
    """Find the skin below the probe by two guarded searches, and take the stage's position from them.

    The operator states that the probe hangs above the skin's center, `SEARCH_REACH_M` at most, and shows by
    a push that the force sensor responds (`await_push`). The probe is lifted until the force is flat, goes
    down in steps of `SEARCH_STEP_M` until the force changes, and is lifted by `TOUCH_OFF_LIFT_M`, where the
    force must be that of the air again.

    Args:
        surface_m: Position of the skin's center at its surface [m].
        pushed: Whether a push is required. A virtual force sensor cannot be pushed.

    Raises:
        Tripped: no response to a push, no air, no contact, or a force that does not return to that of the
            air.
        DeviceError: the stage has no need of it, or fails.
    """
    stage = hand.stage
    if not isinstance(stage, Homing):
        raise DeviceError("this stage always knows its position; leave --position touch-off out")
    if pushed and hand.mounting.to_skin(await_push(hand.force, hand.clock, hand.mounting.normal))[2] < 0:
        raise Tripped(
            Reason.FORCE_REVERSED,
            "the push towards the stage was felt as a pull, so nothing moved: correct the sign of z in the "
            "axes of the force sensor in the rig's file, or push as the skin will",
        )
    lift_clear(hand)
    air = hand.felt_raw()
    _search(hand, air, SEARCH_REACH_M)
    left = _lift_off(hand, air)
    again_m = _search(hand, left, TOUCH_OFF_LIFT_M + 2 * AGREE_M)
    if abs(again_m - TOUCH_OFF_LIFT_M) > AGREE_M:  # the first was a knock, or the second
        retreat(hand, TOUCH_OFF_LIFT_M, LIFT_SPEED_M_S)
        raise Tripped(
            Reason.FORCE_NOISE,
            f"two searches for the skin differ by {abs(again_m - TOUCH_OFF_LIFT_M) * 1e3:.2f} mm, and "
            f"{AGREE_M * 1e3:g} mm are allowed: something knocked the probe, or it is loose; repeat",
        )
    left = _lift_off(hand, left)
    x, y, z = surface_m
    stage.reference((x, y, z - TOUCH_OFF_LIFT_M))
    return replace(left, lifted_mm=TOUCH_OFF_LIFT_M * 1e3)


def _search(hand: Hand, air: AirForce, reach_m: float) -> float:
    """Go down in steps until the force differs from that of the air; the way [m]."""
    lowered_m = 0.0
    while True:
        if lowered_m > reach_m:  # perhaps deep in a skin that the sensor does not feel
            retreat(hand, lowered_m, LIFT_SPEED_M_S, most_n=math.inf)
            raise Tripped(
                Reason.NO_CONTACT,
                f"no contact within {reach_m * 1e3:g} mm below the probe, which was lifted again; hang it "
                "above the skin's center, nearer than that, and press the force sensor by hand",
            )
        _search_step(hand, air)
        lowered_m += SEARCH_STEP_M
        at = hand.felt_raw()
        if math.dist(at.force_n, air.force_n) > contact_n(at, air):
            return lowered_m


def _lift_off(hand: Hand, air: AirForce) -> AirForce:
    """Lift by `TOUCH_OFF_LIFT_M` from the skin, to the force of the air."""
    retreat(hand, TOUCH_OFF_LIFT_M, LIFT_SPEED_M_S)
    left = hand.felt_raw()
    if math.dist(left.force_n, air.force_n) > contact_n(left, air):
        raise Tripped(
            Reason.FORCE_DRIFT,
            f"after a touch-off the force did not return to that of the air, {TOUCH_OFF_LIFT_M * 1e3:g} mm "
            "above the contact: the sensor drifts, or something else touches; let it warm up, then repeat",
        )
    return left


def _search_step(hand: Hand, air: AirForce) -> None:
    """Go down by one step, stopped on the way by a change of force."""

    def look() -> None:
        for one in fresh_samples(hand.force):
            if math.dist(one.force_n, air.force_n) > SEARCH_N:
                hand.stage.stop()

    discard(hand.force)
    hand.stage.approach(SEARCH_STEP_M, SEARCH_SPEED_M_S)  # type: ignore[attr-defined]
    _await(hand.stage, hand.clock, SEARCH_STEP_M / SEARCH_SPEED_M_S, look)


def zero(hand: Hand, limits: Limits | None = None) -> AirForce:
    """Measure the force in the air; nothing is set in the device.

    The probe is lifted by `FLAT_M`, which shows that it touched nothing.

    Raises:
        Tripped: it touched something.
    """
    found = lift_clear(hand, limits)
    if found.lifted_mm > FLAT_M * 1e3 + 1e-6:
        raise Tripped(
            Reason.TOUCHED_EARLY,
            f"the probe was in contact: the force changed while it was lifted by {found.lifted_mm:.1f} mm. "
            "It was lifted until the force stayed the same; repeat",
        )
    return found


def has_room_to_lift(stage: Stage, limits: Limits) -> bool:
    """Whether the soft limits let the probe be lifted by `FLAT_M`, which proves the air."""
    return stage.position_m()[2] - FLAT_M >= limits.least_m[2]


def guard_from_air(hand: Hand, limits: Limits, stop_n: float) -> MotionGuard:
    """Return a guard whose zero is the air, with the stage back where it stood.

    A guard that is zeroed where the probe stands allows `stop_n` more in each motion: repeated, they would
    press without a bound. At the upper soft limit, where nothing can be lifted, the probe is lowered instead.

    Raises:
        Tripped: the probe was in contact, and is lifted; or a limit of the way back.
    """
    stage, force, mounting, clock = hand
    at = stage.position_m()
    guard = MotionGuard(
        stage, force, replace(limits, force_n=stop_n), ForceBias(mounting), clock, OperatorControl()
    )
    room = has_room_to_lift(stage, limits)
    seen = zero(hand, limits) if room else hand.felt_raw()
    if (unseen_n := contact_n(seen, seen)) > UNSEEN_N:
        raise Tripped(
            Reason.FORCE_NOISE,
            f"a contact of {unseen_n:.2f} N would stay unseen in the noise of {seen.noise_n:.2f} N, and "
            f"{UNSEEN_N:g} N are allowed before a jog: shield the sensor, or average its samples",
        )
    guard.tare(force.rate_hz)  # learns its noise too, without which a stuck sensor is believed
    slow_m_s = min(LIFT_SPEED_M_S, limits.fastest_m_s(stage.travel))
    if not room:
        _prove_air_below(hand, guard, limits, slow_m_s)
    if math.dist(stage.position_m(), at) > SAME_M:
        _lower_to(hand, guard, at, slow_m_s)
    return guard


def _lower_to(hand: Hand, guard: MotionGuard, at: Position, speed_m_s: float) -> None:
    """Undo the lift that proved the air, to the force of the air.

    Raises:
        Tripped: there is contact where there was none before the lift.
    """
    air, higher = hand.felt_through(guard), guard.position_m()
    feel_way(guard, at, speed_m_s, hand)
    now = hand.felt_through(guard)
    if math.dist(now.force_n, air.force_n) > contact_n(now, air):
        guard.away(higher, speed_m_s, judged=False)
        hand.distrust_position()
        raise Tripped(
            Reason.TOUCHED_EARLY,
            "the probe touches something where it touched nothing before a lift and back: the stage loses "
            "steps, or something moved; look at the rig",
        )


def _prove_air_below(hand: Hand, guard: MotionGuard, limits: Limits, speed_m_s: float) -> None:
    """Go from the upper soft limit down by `FLAT_M`: where the force stays the same, the probe is free.

    Raises:
        Tripped: it changed; the probe is back where it began.
    """
    x, y, z = hand.stage.position_m()
    highest = limits.least_m[2]
    guard.towards((x, y, highest), speed_m_s)
    air = guarded_mean(guard, hand.force.rate_hz, Mounting())
    felt = ForceReached(max(CHANGED_N, 1.5 * SIGMAS * air.noise_n), any_way=True)
    touched = guard.towards((x, y, highest + FLAT_M), speed_m_s, felt, SEARCH_STEP_M)
    now = guarded_mean(guard, hand.force.rate_hz, Mounting())
    if touched or math.dist(now.force_n, air.force_n) > contact_n(now, air):
        guard.away((x, y, min(z, highest + FLAT_M)), speed_m_s)
        raise Tripped(
            Reason.TOUCHED_EARLY,
            f"the probe met something less than {FLAT_M * 1e3:g} mm below the upper soft limit, which leaves "
            "no room to lift it: raise the limit (least_mm, z), or correct the stage's position",
        )


def jog(
    stage: Stage,
    force: ForceSensor | None,
    mounting: Mounting,
    limits: Limits,
    clock: Clock,
    *,
    axis: str,
    distance_m: float,
    speed_m_s: float,
    stop_n: float = JOG_N,
) -> None:
    """Move one axis by so far, stopped by any change of force from that of the air.

    Other than away, the probe is first lifted by `FLAT_M`, which proves the air, and lowered again; where
    contact ends the way, it goes back to the air (`feel_way`). Away from the skin the force may fall by as
    much as the rig allows until it is flat: it may stand in the skin. No jog is faster than the speed at
    which the probe may move towards the skin, since z may be turned round.

    Args:
        axis: x, y or z of the skin's frame; z leads into it.
        distance_m: with its sign [m].
        speed_m_s: at most `MAX_JOG_M_S`, and `MAX_UNGUARDED_M_S` without a force sensor [m/s].
        stop_n: change of force, any direction, that ends it [N].

    Raises:
        RangeError, InputError: a distance, speed or axis that is not allowed; nothing moved.
        Tripped: a limit; the stage stands.
    """
    target = _jog_target(stage, limits, axis, distance_m, speed_m_s, guarded=force is not None)
    if not (math.isfinite(stop_n) and 0 < stop_n <= limits.force_n):
        raise RangeError(
            f"a jog stopped at {stop_n:g} N; the rig's limit of {limits.force_n:g} N is the greatest allowed",
            code="force-limit",
        )
    if force is None:
        hop_to(stage, clock, target, speed_m_s)
    elif axis == "z" and distance_m < 0:
        hand = Hand(stage, force, mounting, clock)
        found = lift_clear(hand, limits, reach_m=-distance_m, rise_n=stop_n)
        left_m = -distance_m - found.lifted_mm * 1e-3
        if left_m > SAME_M:  # in the air, any change ends it: z may be turned round
            speed_m_s = min(speed_m_s, limits.fastest_m_s(stage.travel))
            lifted_m = found.lifted_mm * 1e-3
            retreat(hand, left_m, speed_m_s, start=found, lifted_m=lifted_m, rise_n=stop_n, most_n=stop_n)
    else:
        limits.check_speed(speed_m_s, stage.travel)  # before anything moves
        hand = Hand(stage, force, mounting, clock)
        feel_way(guard_from_air(hand, limits, stop_n), target, speed_m_s, hand)


def move_watched(
    stage: Stage,
    force: ForceSensor,
    clock: Clock,
    target: Position,
    speed_m_s: float,
    from_n: Force,
    stop_n: float,
) -> bool:
    """Move, and stop where the force, in the sensor's own axes, differs from `from_n` by `stop_n`.

    Returns:
        Whether it was stopped so.

    Raises:
        Tripped: a faulty sample, or none for half a second; the stage stands.
    """
    felt = False
    far_m = math.dist(stage.position_m(), target)
    discard(force)
    live = LiveSamples(force, clock)

    def look() -> None:
        nonlocal felt
        felt = any(math.dist(one.force_n, from_n) > stop_n for one in live.take()) or felt
        if felt:
            stage.stop()

    stage.move_to(target, speed_m_s)
    _await(stage, clock, far_m / speed_m_s, look)
    return felt


def _jog_target(
    stage: Stage, limits: Limits, axis: str, distance_m: float, speed_m_s: float, *, guarded: bool
) -> tuple[float, float, float]:
    if axis not in ("x", "y", "z"):
        raise InputError(
            f"there is no axis {axis!r}; give x, y or z, and z leads into the skin", code="axis-unknown"
        )
    if not 0 < abs(distance_m) <= MAX_JOG_M:
        raise RangeError(
            f"a jog by {distance_m * 1e3:g} mm; {MAX_JOG_M * 1e3:g} mm are the most, and 0 mm is none",
            code="jog-length",
        )
    fastest = MAX_JOG_M_S if guarded else MAX_UNGUARDED_M_S
    if not 0 < speed_m_s <= fastest:
        raise RangeError(
            f"a jog at {speed_m_s * 1e3:g} mm/s; {fastest * 1e3:g} mm/s are the most"
            + ("" if guarded else " where no force sensor guards it"),
            code="jog-speed",
        )
    x, y, z = (a + distance_m * (axis == name) for name, a in zip("xyz", stage.position_m(), strict=True))
    limits.check_target((x, y, z))
    return x, y, z


def retreat(
    hand: Hand,
    distance_m: float,
    speed_m_s: float,
    *,
    start: AirForce | None = None,
    lifted_m: float = 0.0,
    rise_n: float = RISE_N,
    most_n: float = MAX_CHANGE_N,
) -> None:
    """Move away from the skin, and stop where compression rises or the force changes by too much.

    Then it goes back, so that repeating it presses no harder: z may be turned round.

    Args:
        start: Force at the start of the whole lift, of which this may be a step, in the skin's axes.
        lifted_m: Way of that lift before [m].
        rise_n: Allowed rise of compression since then [N].
        most_n: Allowed change of force since then, of any sign: z or the sensor may be turned round [N].
    """
    start = start or hand.felt()
    from_n, noise_n = start.force_n, SIGMAS * start.noise_n
    live = LiveSamples(hand.force, hand.clock)

    def look() -> None:
        # A sensor that feels nothing ends no lift out of a skin that it may not feel.
        for one in fresh_samples(hand.force) if math.isinf(most_n) else live.take():
            _check_lift(hand.mounting.to_skin(one.force_n), from_n, rise_n + noise_n, most_n + noise_n)

    count = math.ceil(distance_m / HOP_M - 1e-6)
    begun_m, done_m = _height(hand), lifted_m
    try:
        for _ in range(count):
            done_m += distance_m / count
            _shift(hand, -distance_m / count, speed_m_s, look)
    except Tripped as e:
        if e.reason is not Reason.FORCE_LIMIT:
            raise
        ended_m = _height(hand)
        if begun_m is not None and ended_m is not None:  # otherwise the last hop counts as a whole one
            done_m = lifted_m + begun_m - ended_m
        told = _go_back(hand, done_m, start, began_in_air=most_n <= rise_n)
        raise Tripped(e.reason, f"{e}{told}", e.numbers) from e


def _height(hand: Hand) -> float | None:
    """Place along z [m]; None where it is not known."""
    try:
        return hand.stage.position_m()[2]
    except DeviceError:
        return None


def _shift(hand: Hand, by_m: float, speed_m_s: float, look: Callable[[], None]) -> None:
    """Move along z, also before the stage's place is known."""
    stage = hand.stage
    if not isinstance(stage, Homing):
        x, y, z = stage.position_m()
        stage.move_to((x, y, z + by_m), speed_m_s)
    elif by_m > 0:
        stage.approach(by_m, speed_m_s)
    else:
        stage.retreat(-by_m, speed_m_s)
    _await(stage, hand.clock, by_m / speed_m_s, look)


def _go_back(hand: Hand, lifted_m: float, start: AirForce, *, began_in_air: bool) -> str:
    """Undo a lift that pressed, in steps, while the force falls on the way; what came of it.

    A sensor that fails during a lift changes the force as well: then the probe stays, higher than it was.
    """
    now = hand.felt()
    if not began_in_air and now.force_n[2] < start.force_n[2]:
        return ""  # it left a skin that was pressed
    rose_n = left_n = math.dist(now.force_n, start.force_n)

    def look() -> None:
        for one in fresh_samples(hand.force):
            if math.dist(hand.mounting.to_skin(one.force_n), start.force_n) > left_n + RISE_N:
                raise Tripped(Reason.FORCE_LIMIT, f"the force rose by {RISE_N:g} N")

    back_m, known = 0.0, _height(hand) is not None
    told = ""
    try:
        while left_n > contact_n(now, start) and back_m < lifted_m - SAME_M and not told:
            step_m = min(SEARCH_STEP_M, lifted_m - back_m)
            _shift(hand, step_m, SEARCH_SPEED_M_S, look)
            back_m, now = back_m + step_m, hand.felt()
            left_n = math.dist(now.force_n, start.force_n)
            if left_n > rose_n * (1.0 - FALLS * back_m / lifted_m) + contact_n(now, start):
                told = "the force did not fall: look at the sensor and at z"
        more_m = lifted_m - back_m if known else min(CLEAR_M, lifted_m - back_m)  # of air that it came by
        if more_m > SAME_M and not told:
            _shift(hand, more_m, SEARCH_SPEED_M_S, look)
            back_m += more_m
    except Tripped as e:
        told = str(e)
    except BaseException:  # as Ctrl-C: it stands pressed
        hand.distrust_position()
        raise
    if told:
        hand.distrust_position()
        return f"; after {back_m * 1e3:.2f} mm of the way back {told}"
    return f"; the probe went back by {back_m * 1e3:.2f} mm"


def hop_to(stage: Stage, clock: Clock, target: Position, speed_m_s: float) -> None:
    """Move in short hops, one in flight at a time."""
    start = stage.position_m()
    count = math.ceil(math.dist(start, target) / HOP_M - 1e-6)
    for k in range(1, count + 1):
        x, y, z = (a + (b - a) * k / count for a, b in zip(start, target, strict=True))
        stage.move_to((x, y, z), speed_m_s)
        _await(stage, clock, HOP_M / speed_m_s, lambda: None)


def _check_lift(force_n: Force, start_n: Force, rise_n: float, most_n: float) -> None:
    turned = "is z of the stage or of the force sensor turned round?"
    if (rose_n := force_n[2] - start_n[2]) > rise_n:
        raise Tripped(
            Reason.FORCE_LIMIT,
            f"compression rose by {rose_n:.2f} N on the way away from the skin; {rise_n:.2f} N are allowed: "
            f"{turned}",
        )
    if (changed_n := math.dist(force_n, start_n)) > most_n:
        raise Tripped(
            Reason.FORCE_LIMIT,
            f"the force changed by {changed_n:.2f} N on the way away from the skin; {most_n:.2f} N are "
            f"allowed: {turned} If the probe was pressed as hard, repeat",
        )


def _await(stage: Stage, clock: Clock, due_s: float, look: Callable[[], None]) -> None:
    """Wait for a move to end; whatever is raised meanwhile stops the stage."""
    end_ns = clock.now_ns() + round((LATE_S + 3 * abs(due_s)) * NS_PER_S)
    try:
        while stage.moving():
            clock.sleep(POLL_S)
            look()
            _check_due(clock, end_ns)
    except BaseException:
        stage.stop()
        raise


def _check_due(clock: Clock, end_ns: int) -> None:
    if clock.now_ns() > end_ns:
        raise Tripped(Reason.STAGE_LATE, f"the stage still moves {LATE_S:g} s after it was due")
