"""Motion of one press: over a place, onto the skin, into it, aside and away."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace

import numpy as np

from palpate.core import InputError, Position, Wrench, own_plans_of
from palpate.devices import Clearance, ForceBias, ForceReached, Guard, Reason, Tripped
from palpate.recordings.run_reader import ZERO_MOVED
from palpate.rig.force_checks import touch_gently
from palpate.rig.label_force import allowed_n, moved_n, slope_n_s
from palpate.rig.mean_force import SIGMAS, AirForce, contact_n, guarded_mean
from palpate.rig.plans.recording_plan import PlannedPress, RecordingPlan
from palpate.rig.rig import Rig
from palpate.rig.run_progress import TOUCH, ZERO, Recorder

MM = 1e-3
BELOW_TOUCH_MM = 0.2  # of a contact that is said by a force
HIGHER_MM = 5.0  # than the clearance, after contact there
LOOKS = 16  # that are remembered, for a force that comes late
FREE = 2.0  # contact thresholds, below which the probe counts as free
MAX_DRIFT_N = 0.5  # of the zero, from one press to the next
AIR_S = 0.3  # of listening higher up
CHECK_LIFT_MM = 0.6  # of the first approach, to see that the force is that of the air
ASIDE_STEP_MM = 1.0  # longest move aside of a first approach: what a broken link can run on
LEVEL_M = 1e-6
_NO_ROOM = (
    f"the upper soft limit leaves less than {CHECK_LIFT_MM:g} mm above the clearance, and a lift by as much "
    "proves that the probe hangs in the air: lower clearance_mm, or raise the limit (least_mm, z)"
)


class PressMotion:
    """Moves over a place, onto the skin, into it, aside and away, each within the guard.

    Attributes:
        contact_m: height of contact in this press, along the stage's z; None before [m].
        approach: number of this press among all approaches, from 1.
    """

    def __init__(
        self, rig: Rig, plan: RecordingPlan, guard: Guard, bias: ForceBias, recorder: Recorder
    ) -> None:
        self._rig = rig
        self._plan = plan
        self._guard = guard
        self._bias = bias
        self._recorder = recorder
        self.contact_m: float | None = None
        self.approach = 0
        self._zero_samples = 0
        self.distrust_position()

    def begin(self, press: PlannedPress) -> None:
        """A new approach: whatever was known of the contact is forgotten."""
        self.contact_m = None
        self._place = press.place
        self.approach += 1

    def lift(self) -> None:
        """Straight up to the clearance, if the probe is below it; the contact is over."""
        self.contact_m = None
        self._guard.lift()

    def lift_free(self, touches: bool) -> None:
        """Lift further than the clearance, within the limits, if there is contact still.

        A skin that stands higher than expected is touched at the clearance. A force that is old, faulty or
        wrong only lifts the probe higher than it need be, or not.

        Args:
            touches: there is, whatever the force says, whose zero may have been taken in contact.
        """
        with suppress(Tripped):
            known = self._bias.noise_n > 0  # a zero was measured
            force_n = self._guard.force_n[2] if known else 0.0
            touches = touches or abs(force_n) > FREE * self._plan.threshold_N
        if touches:
            self._set_clearance(HIGHER_MM)
            self.lift()

    def _set_clearance(self, higher_mm: float) -> None:
        self._higher_m = higher_mm * MM
        # Until a press has shown the way of z, a lift may lead into the skin.
        speed_mm_s = self._plan.travel_mm_s if self._position_proven else self._plan.seek_mm_s
        self._guard.clearance = Clearance(self._clearance_m, speed_mm_s * MM)

    @property
    def _clearance_m(self) -> float:
        expected_m = self._rig.origin_m[2] - self._plan.clearance_mm * MM
        return min(expected_m, max(expected_m - self._higher_m, self._rig.limits.least_m[2]))

    def over(self, x_m: float, y_m: float) -> None:
        """Lift, and go over a place at the clearance [m], aside and down to it by guarded searches.

        The skin may be higher at another place, and in a first approach the stage's position may be wrong.
        """
        self.lift()
        x, y, _ = _at(self._rig, x_m, y_m, 0.0)
        seek_m_s = aside_m_s = self._plan.seek_mm_s * MM
        if self._position_proven:
            fastest_m_s = self._rig.limits.fastest_m_s(self._rig.stage.travel)
            aside_m_s = max(seek_m_s, min(self._plan.travel_mm_s * MM, fastest_m_s))
        else:
            self._prove_air()
        z = min(self._guard.position_m()[2], self._clearance_m)
        self._search((x, y, z), ASIDE_STEP_MM * MM, aside_m_s)
        if z < self._clearance_m - LEVEL_M:
            self._search((x, y, self._clearance_m), None, seek_m_s)

    def distrust_position(self) -> None:
        """Make the next approach a first one, down to the clearance of the plan, however high it was lifted.

        The stage may have been pushed, its tool changed, or an attempt may have ended in contact.
        """
        self._position_proven = False
        self._set_clearance(0.0)

    def _prove_position(self) -> None:
        """Lift at travel speed from now on: the skin was found where z leads into it."""
        self._position_proven = True
        self._set_clearance(self._higher_m / MM)

    def _search(self, target: Position, step_m: float | None, speed_m_s: float) -> None:
        """Move, and end on any contact."""
        felt = ForceReached(max(self._plan.threshold_N, 1.5 * SIGMAS * self._bias.noise_n), any_way=True)
        x, y, _ = self._guard.position_m()
        if self._guard.towards(target, speed_m_s, felt, step_m):
            above_mm = (self._clearance_m - self._guard.position_m()[2]) / MM
            self._rise(HIGHER_MM)  # the clearance may lie in the skin
            # Aside too: with two axes exchanged that is the way out.
            self._guard.away((x, y, self._guard.position_m()[2]), self._plan.seek_mm_s * MM)
            raise Tripped(
                Reason.TOUCHED_EARLY,
                f"the probe met something on its way to a place, {above_mm:.2f} mm above the clearance: the "
                "skin is higher there than clearance_mm allows, or the stage's position or origin_mm is "
                "wrong. Raise clearance_mm, home the stage, or give --position touch-off",
            )

    def _prove_air(self) -> None:
        """Lift a little, slowly, to see that the force stays the same; then take the zero.

        At the upper soft limit the probe is lowered first, by a guarded search, so that it can be lifted.
        """
        x, y, z = self._guard.position_m()
        lowered_m = self._rig.limits.least_m[2] + CHECK_LIFT_MM * MM
        if z < lowered_m - LEVEL_M:
            self._guard.tare(self._rig.force.rate_hz)
            self._search((x, y, lowered_m), None, self._plan.seek_mm_s * MM)
        before = self._mean_raw()
        lifted_mm = self._rise(CHECK_LIFT_MM)
        after = self._mean_raw()
        changed = math.dist(before.force_n, after.force_n)
        # Not the plan's threshold, which is for single samples: on a soft skin a lift changes less than that.
        if changed > contact_n(before, after):
            self._rise(HIGHER_MM)
            raise Tripped(
                Reason.TOUCHED_EARLY,
                f"the force changed by {changed:.2f} N on a lift of {lifted_mm:.2f} mm before the "
                "first approach: the probe was in contact. Lift it, and check the stage's position",
            )
        self._guard.tare(self._rig.force.rate_hz)  # first, as it names a fault more precisely
        self._check_noise(before.noise_n)

    def _rise(self, by_mm: float) -> float:
        """Lift slowly from where the probe is, within the limits; by how much [mm]."""
        x, y, z = self._guard.position_m()
        higher = max(z - by_mm * MM, self._rig.limits.least_m[2])
        self._guard.away((x, y, higher), self._plan.seek_mm_s * MM)
        return (z - higher) / MM

    def _mean_raw(self) -> AirForce:
        """Mean force at a stand, without the zero."""
        return guarded_mean(self._guard, self._rig.force.rate_hz, self._rig.mounting, AIR_S)

    def measure_bias(self) -> None:
        """Measure the force sensor's zero, standing in the air.

        A zero far from the last one means that the probe touches something.
        """
        before = replace(self._bias)
        known = self._bias.noise_n > 0
        threshold = self._plan.threshold_N
        self._zero_samples = len(self._guard.tare(self._rig.force.rate_hz))
        self._recorder.event("tare", force_n=self._bias.force_n, noise_n=self._bias.noise_n)
        moved = abs(self._bias.force_n[2] - before.force_n[2])
        if known and moved > max(MAX_DRIFT_N, 2 * threshold):
            self._bias.force_n, self._bias.torque_nm = before.force_n, before.torque_nm
            raise Tripped(
                Reason.TOUCHED_EARLY,
                f"in the air the force stands {moved:.2f} N from where it stood before the last press: does "
                "the probe touch something?",
            )
        self._check_noise(self._bias.noise_n)

    def _check_noise(self, noise_n: float) -> None:
        least_n = SIGMAS * noise_n
        if self._plan.threshold_N < least_n:
            raise Tripped(
                Reason.FORCE_NOISE,
                f"the contact threshold of {self._plan.threshold_N:g} N lies within {SIGMAS:g} times the "
                f"noise of {noise_n:.4f} N; set it to {least_n:.3f} N or more, or reduce the noise",
            )

    def check_zero(self) -> float:
        """Take a zero after a press, in the air: how far it moved since the one before the press [N]."""
        before, limit_n = replace(self._bias), self._rig.limits.force_n
        heard: list[Wrench] = []
        try:
            with self._guard.samples.subscribed(heard.extend):
                count = len(self._guard.tare(self._rig.force.rate_hz))
        except Tripped as e:
            slope = slope_n_s(heard, before)
            if e.reason is Reason.FORCE_NOISE and slope:
                still = allowed_n(before, before, self._zero_samples, limit_n)
                if self._comes_back_higher(still):  # a skin that is touched gives way
                    raise self._touches_at_clearance(f"changed by {slope:+.3g} N/s") from e
                raise Tripped(
                    Reason.FORCE_DRIFT,
                    f"after the press the force drifts by {slope:+.3g} N/s in the air: the forces of this "
                    f"press are not to be believed; let the sensor warm up, and look at its cable ({e})",
                ) from e
            raise
        moved, allowed = (
            moved_n(before, self._bias),
            allowed_n(before, self._bias, min(count, self._zero_samples), limit_n),
        )
        self._recorder.event(ZERO_MOVED, moved_N=moved, allowed_N=allowed, approach=self.approach)
        if moved > allowed:
            self._bias.force_n, self._bias.torque_nm = before.force_n, before.torque_nm
            if self._comes_back_higher(allowed):
                raise self._touches_at_clearance(f"stood {moved:.2f} N from its zero")
            raise Tripped(
                Reason.FORCE_DRIFT,
                f"the force sensor's zero moved by {moved:.3f} N while it pressed, and {allowed:.3f} N are "
                "allowed: the forces of this press are not to be believed; let the sensor warm up, and look "
                "at its cable and whether the tool is fixed",
            )
        return moved

    @staticmethod
    def _touches_at_clearance(what: str) -> Tripped:
        return Tripped(
            Reason.TOUCHED_EARLY,
            f"after the press the force {what} at the clearance, and not higher up: does the probe touch "
            "something there?",
        )

    def _comes_back_higher(self, allowed: float) -> bool:
        """Whether the force is near its zero again when the probe is lifted further: it was a contact."""
        with suppress(Tripped):
            self.lift_free(True)
            samples = self._guard.wait(AIR_S, judged=False)
            good = [self._bias.force(one) for one in samples if not one.fault]
            means = [sum(axis) / len(axis) for axis in zip(*good, strict=True)]
            return bool(means) and max(map(abs, means)) <= allowed
        return False

    def try_sensor(self, press: PlannedPress, new_tool: bool = True) -> None:
        """Touch gently, to see that force rises under a touch and falls after it, before anything presses.

        Args:
            press: with the indenter that is mounted.
            new_tool: nothing is known of the stiffness that it meets.
        """
        self.distrust_position()
        self.over(press.place.x_mm * MM, press.place.y_mm * MM)
        if new_tool:
            self._guard.new_tool(self._rig.stiffness.get(press.indenter))
        self.measure_bias()
        felt = touch_gently(self._rig, self._plan, self._guard)
        self._prove_position()
        self._recorder.event(TOUCH, place=press.place.name, **asdict(felt))

    def seek(self) -> None:
        """Go down until the force says contact; that place is the press's zero."""
        plan = self._plan
        x, y, _ = self._guard.position_m()
        if self._guard.force_n[2] > plan.threshold_N:
            raise Tripped(Reason.TOUCHED_EARLY, "the probe is in contact at the clearance already")
        lowest = (x, y, self._rig.origin_m[2] + plan.seek_mm * MM)
        step = plan.seek_step_mm * MM
        if not self._guard.towards(lowest, plan.seek_mm_s * MM, ForceReached(plan.threshold_N), step):
            raise Tripped(
                Reason.NO_CONTACT,
                f"no contact down to {plan.seek_mm:g} mm below the expected surface at "
                f"{self._place.name}; is the layer there, and the force sensor's sign right?",
            )
        self._found_contact(self._guard.position_m()[2])
        self._prove_position()

    def _found_contact(self, z_m: float) -> None:
        """Let the press's depths count from this height, along the stage's z [m]."""
        self.contact_m, place = z_m, self._place
        z_mm = 1e3 * (z_m - self._rig.origin_m[2])
        self._recorder.event(ZERO, place=place.name, x_mm=place.x_mm, y_mm=place.y_mm, z_mm=z_mm)

    @contextmanager
    def contact_due(self, depth_m: float) -> Iterator[None]:
        """Expect contact where the search for it would end, within a ``with`` block that goes on to a depth.

        The press's zero is where the stage was when the force passed the threshold, between two looks.
        """
        plan, z0 = self._plan, self._rig.origin_m[2]
        felt_ns: int | None = None
        ways: deque[tuple[int, float]] = deque(maxlen=LOOKS)

        def feel(samples: Sequence[Wrench]) -> None:
            nonlocal felt_ns
            if felt_ns is None:
                strong = (one for one in samples if not one.fault)
                felt_ns = next(
                    (one.time_ns for one in strong if self._bias.force(one)[2] > plan.threshold_N), None
                )

        def look(at: Position, time_ns: int) -> None:
            ways.append((time_ns, at[2]))
            if self.contact_m is None and felt_ns is not None:
                times_ns, heights_m = zip(*ways, strict=True)
                self._found_contact(float(np.interp(felt_ns, times_ns, heights_m)))
            if felt_ns is None and at[2] > z0 + plan.seek_mm * MM:
                raise Tripped(
                    Reason.NO_CONTACT,
                    f"nothing was felt at {self._place.name} down to {plan.seek_mm:g} mm below the expected "
                    f"surface, of {depth_m / MM:g} mm to go; is the layer there, and does the force sensor "
                    "feel anything?",
                )

        with self._guard.samples.subscribed(feel), self._guard.positions.subscribed(look):
            yield

    def to_depth(self, depth_m: float, speed_m_s: float) -> None:
        """Go to a depth below the zero, down or up [m]."""
        if self.contact_m is None:
            raise Tripped(Reason.PLAN, "a plan that presses before it has found contact")
        x, y, z = self._guard.position_m()
        target = (x, y, self.contact_m + depth_m)
        (self._guard.towards if target[2] > z else self._guard.away)(target, speed_m_s)

    def aside(self, x_m: float, y_m: float, speed_m_s: float) -> None:
        """Shift aside at the same depth, to so far from the place [m]."""
        z = self._guard.position_m()[2]
        x, y, _ = _at(self._rig, self._place.x_mm * MM + x_m, self._place.y_mm * MM + y_m, 0.0)
        self._guard.towards((x, y, z), speed_m_s)


def check_plan(rig: Rig, plan: RecordingPlan) -> None:
    """Refuse a plan that leaves the soft limits, or is too fast, before anything moves.

    Raises:
        Tripped: says which; or the force sensor is too slow to guard.
        RangeError: the limit of force lies above what the sensor measures.
        InputError: places or an indenter that do not suit the rig's sensor; the message names its own plans.
    """
    rig.limits.check_sensor(rig.force)
    with _plan_named(rig, plan):
        for indenter in plan.indenters:
            rig.known_m(
                indenter, False
            )  # before any bound: an indenter of another sensor is the better reason
        _check_places(rig, plan)
        _check_known(rig, plan)
    rig.limits.check_range(rig.force.range_n[rig.mounting.normal])
    for speed in (plan.seek_mm_s, plan.press_mm_s, getattr(plan, "speed_mm_s", plan.press_mm_s)):
        rig.limits.check_speed(speed * MM, rig.stage.travel)


@contextmanager
def _plan_named(rig: Rig, plan: RecordingPlan) -> Iterator[None]:
    """Say which plan does not suit the rig's sensor, and which are its own."""
    try:
        yield
    except InputError as e:
        own = "" if rig.design is None else f"; its own plans are {', '.join(own_plans_of(rig.design))}"
        raise type(e)(
            f"the plan {plan.name!r} does not suit the sensor of {rig.name}: {e}{own}", code=e.code
        ) from e


def _check_places(rig: Rig, plan: RecordingPlan) -> None:
    lowest = (plan.deepest_mm + plan.seek_mm) * MM
    for place in plan.places.places():
        for dx, dy in _aside_mm(plan):
            x, y = (place.x_mm + dx) * MM, (place.y_mm + dy) * MM
            for z in (-plan.clearance_mm * MM, lowest):
                rig.limits.check_target(_at(rig, x, y, z))
    if rig.origin_m[2] - (plan.clearance_mm + CHECK_LIFT_MM) * MM < rig.limits.least_m[2] - LEVEL_M:
        raise Tripped(Reason.SOFT_LIMIT, _NO_ROOM)


def _check_known(rig: Rig, plan: RecordingPlan) -> None:
    """Depths count from where a force says contact; the little that lies below first touch is added."""
    for indenter in plan.indenters:
        for lateral, deepest_mm in ((False, plan.pressed_mm), (True, _deepest_aside_mm(plan))):
            known_mm = rig.known_m(indenter, lateral) / MM
            if deepest_mm > 0 and deepest_mm + BELOW_TOUCH_MM > known_mm:
                way = f"{indenter} shifted aside" if lateral else indenter
                raise Tripped(
                    Reason.PLAN,
                    f"{deepest_mm:g} mm under {way}: {rig.name} knows its skin to {known_mm:g} mm below "
                    f"first touch; press to {known_mm - BELOW_TOUCH_MM:g} mm",
                )


def _deepest_aside_mm(plan: RecordingPlan) -> float:
    lateral = getattr(plan, "lateral", None)
    return max(lateral.depths_mm) if lateral else 0.0


def _at(rig: Rig, x_m: float, y_m: float, z_m: float) -> Position:
    x0, y0, z0 = rig.origin_m
    return x0 + x_m, y0 + y_m, z0 + z_m


def _aside_mm(plan: RecordingPlan) -> list[tuple[float, float]]:
    lateral = getattr(plan, "lateral", None)
    return [(0.0, 0.0), *(lateral.to_mm if lateral else ())]
