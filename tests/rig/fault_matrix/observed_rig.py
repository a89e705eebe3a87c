"""Virtual rig that is watched from outside: its true motion, each stop with its way, and what passes on.

Any method of its devices can be replaced while a recording runs, so that a fault sets in at any moment.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Any

import numpy as np
from tests.rig.rigs import SPEC

from palpate.core import NS_PER_S, ManualClock, Position, Wrench
from palpate.devices import OperatorCommand, OperatorControl
from palpate.rig.plans import StepHold
from palpate.rig.plans.recording_plan import Burst, Depth, Done, PlannedPress, Step, Steps
from palpate.rig.run_progress import State, Status
from palpate.rig.virtual import Variation, virtual_rig
from palpate.rig.virtual.linear_rig import Motion
from palpate.rig.virtual.virtual_sensors import BIAS_N
from palpate.sensors.palm.palm_sensor import Palm

BEGUN_NS = 100 * NS_PER_S
SIGMAS = 5.0  # of one sample, by which the force read differs from the true one
PAUSED_LOOKS = 12  # until a pause is taken back
LEVEL_M = 1e-9
NEAR_M = 0.2e-3  # above the skin, from where a way aside counts

Replaced = Callable[..., Any]
"""What takes the place of a device's method: of the method itself and its arguments."""


class ObservedDevice:
    """Device of which any method can be replaced, and whose calls are told before they are made."""

    def __init__(self, inner: Any, told: Callable[[str], None]) -> None:
        self.inner, self.replaced, self._told = inner, dict[str, Replaced](), told

    def __getattr__(self, name: str) -> Any:
        real = getattr(self.inner, name)
        if not callable(real):
            return real

        def call(*args: Any, **kwargs: Any) -> Any:
            self._told(name)
            replaced = self.replaced.get(name)
            return real(*args, **kwargs) if replaced is None else replaced(real, *args, **kwargs)

        return call


class ToldPlan(StepHold):
    """A plan like any other, which tells each step before it is taken."""

    _tell: Callable[[PlannedPress, Step], None] = lambda press, step: None

    def steps(self, press: PlannedPress, done: Done) -> Steps:
        for step in super().steps(press, done):
            self._tell(press, step)
            yield step

    def telling(self, tell: Callable[[PlannedPress, Step], None]) -> ToldPlan:
        told = self.model_copy()
        told._tell = tell
        return told


class PatientOperator(OperatorControl):
    """Takes a pause back after some looks; time passes meanwhile."""

    def __init__(self, clock: ManualClock) -> None:
        super().__init__()
        self._clock, self._looks = clock, 0

    def wait_while_paused(self, seconds: float) -> bool:
        self._clock.sleep(seconds)
        self._looks += 1
        if self._looks % PAUSED_LOOKS == 0:
            self.resume()
        return self.command is OperatorCommand.PAUSE


@dataclass(frozen=True)
class Stopped:
    """A stop: the way from asking to the true stand, the move's speed, and whether the device obeyed."""

    way_m: float
    speed_m_s: float
    obeyed: bool

    def bound_m(self, acceleration_m_s2: float, latency_s: float) -> float:
        """v^2 / 2a + v latency [m]."""
        v = self.speed_m_s
        return v**2 / (2 * acceleration_m_s2) + v * latency_s


class ObservedRig:
    """A virtual palm's rig, its plan and its operator.

    Attributes:
        rig: with observed devices.
        truth: the devices' own world.
        due: asked at each call of a device and each step and status; where it says so, `begin` is called,
            once.
        step, presses, status: the last step, how many presses were begun, and the last status told.
        unwatched_m: ways towards the skin or along it while a call did not come back.
        began_ns: when `begin` was called; None before.
        shows_ns: when the fault first did something, of one that waits for its turn.
    """

    def __init__(self, plan: StepHold, seed: int, begun_ns: int = BEGUN_NS) -> None:
        self.clock = ManualClock(begun_ns)
        self.sound = virtual_rig(Palm(SPEC), clock=self.clock, seed=seed, variation=Variation())
        self.truth = self.sound.stage._world
        self.stage = ObservedDevice(self.sound.stage, lambda name: self._called("stage", name))
        self.force = ObservedDevice(self.sound.force, lambda name: self._called("force", name))
        self.camera = ObservedDevice(self.sound.camera, lambda name: self._called("camera", name))
        self.stage.replaced["stop"] = self._stopping
        self.force.replaced["drain"] = self._draining
        self.rig = replace(self.sound, stage=self.stage, force=self.force, camera=self.camera)
        self.control = PatientOperator(self.clock)
        self.plan = ToldPlan(**plan.model_dump()).telling(self._stepped)
        self.due: Callable[[ObservedRig, str], bool] = lambda rig, call: False
        self.begin: Callable[[], None] = lambda: None
        self.heard: Callable[[ObservedRig, str], None] = lambda rig, call: None
        self.began_ns: int | None = None
        self.shows_ns: int | None = None
        self.step: Step | None = None
        self._up, self._depth_m = False, 0.0
        self.unwatched_m: list[float] = []
        self.places: list[str] = []
        self.status: Status | None = None
        self.taps = False
        self.paused_at: Position | None = None
        self.read: list[tuple[int, Wrench]] = []
        self.stops: list[tuple[int, Stopped]] = []
        self.touches: list[Any] = []
        self._motions: dict[float, Motion] = {}
        self._move = self.truth.move
        self.truth.move = self._moved

    def watch(self, status: Status) -> None:
        """Hear of a status, as a page does."""
        self.status = status
        if status.state is State.PAUSED and self.paused_at is None:
            self.paused_at = self.place_m
        self._ask("status")

    def ask_begin(self) -> None:
        """Let the fault set in now, if it has not."""
        if self.began_ns is None:
            self.began_ns = self.clock.now_ns()
            self.begin()

    @property
    def place_m(self) -> Position:
        """True place of the stage [m]."""
        return self.truth.stand_at()

    @property
    def ends_m(self) -> tuple[Position, Position]:
        """Where the move that is under way began, and where it leads; the same place at a stand [m]."""
        if self.truth.now_s >= self.truth.motion.ends_s:
            return self.place_m, self.place_m
        return self.truth.motion.start_m, self.truth.motion.target_m

    @property
    def is_moving(self) -> bool:
        return self.ends_m[0] != self.ends_m[1]

    @property
    def share(self) -> float:
        """Share of the move that is done; 1 at a stand."""
        start_m, target_m = self.ends_m
        return 1.0 if start_m == target_m else math.dist(start_m, self.place_m) / math.dist(start_m, target_m)

    @property
    def leads_down_m(self) -> float:
        """How far the move that is under way leads towards the skin; negative away from it [m]."""
        start_m, target_m = self.ends_m
        return target_m[2] - start_m[2]

    def doing(self) -> str:
        """What the engine does, in the words of the matrix."""
        if self.status and self.status.state is State.PAUSED:
            return "pause"
        if self.step is None:
            return "taps" if self.taps else "touch"
        if isinstance(self.step, Burst):
            return "in the air" if self.step.shot.phase == "reference" else "hold"
        names = {"Over": "travel", "TareStep": "zero", "Seek": "seek", "Aside": "slide", "Pause": "hold"}
        return names.get(type(self.step).__name__, "retreat" if self._up else "press")

    def way_m(
        self, from_s: float, to_s: float, counts: Callable[[Motion], bool] = lambda motion: True
    ) -> float:
        """True way between two times, of the moves that count [m]."""
        self._note(self.truth.motion)
        begun = sorted(self._motions)
        way = 0.0
        for motion, ends_s in zip((self._motions[at] for at in begun), [*begun[1:], math.inf], strict=True):
            a, b = max(motion.begun_s, from_s), min(ends_s, motion.ends_s, to_s)
            if a < b and counts(motion):
                first, last = motion.at(np.array([a, b]))
                way += math.dist(first, last)
        return way

    @property
    def latency_s(self) -> float:
        """From asking for a stop to slowing down, as the stage states it [s]."""
        return self.rig.stage.travel.latency_s

    def settle(self) -> None:
        """Let what the stage was sent come to its end, once the recording is over."""
        if self.is_moving:
            self.clock.sleep(60.0)

    def block(self, seconds: float) -> None:
        """Let time pass in which nobody looks at anything [s]."""
        begun_s = self.truth.now_s
        self.clock.sleep(seconds)
        self.unwatched_m.append(self.into_m(begun_s, self.truth.now_s, in_air=False))

    def into_m(self, from_s: float, to_s: float = math.inf, in_air: bool = True) -> float:
        """True way towards the skin or along it, between two times [m]."""
        surface_m = self.rig.origin_m[2]
        clearance_m = surface_m - self.plan.clearance_mm * 1e-3

        def counts(motion: Motion) -> bool:
            if motion.target_m[2] < motion.start_m[2] - LEVEL_M:
                return False
            if motion.target_m[2] <= motion.start_m[2] + LEVEL_M:
                return motion.start_m[2] > surface_m - NEAR_M
            return in_air or motion.target_m[2] > clearance_m + LEVEL_M

        return self.way_m(from_s, to_s, counts)

    def shown_s(self, how: str) -> float | None:
        """First time at which the fault shows [s]; None where it never does."""
        assert self.began_ns is not None
        self._note_touches()
        if how == "limit":
            beyond = (t for t in self.touches if math.hypot(*t.force_n) > self.rig.limits.force_n)
            return next((float(touch.time_s) for touch in beyond), None)
        if how != "force":
            return (self.shows_ns or self.began_ns) / NS_PER_S
        vary = self.truth.variation
        far_n = SIGMAS * math.hypot(vary.force_noise_n, vary.force_step_n / math.sqrt(12))
        k, newest = 0, 0.0
        for touch in self.touches:
            while k < len(self.read) and self.read[k][0] <= round(touch.time_s * NS_PER_S):
                newest, k = self.read[k][1].force_n[2] - BIAS_N[2], k + 1
            if touch.time_s * NS_PER_S > self.began_ns and not abs(newest - touch.force_n[2]) <= far_n:
                return float(touch.time_s)
        return None

    def _stepped(self, press: PlannedPress, step: Step) -> None:
        self.step = step
        if isinstance(step, Depth):
            self._up, self._depth_m = step.depth_m < self._depth_m, step.depth_m
        name = f"{press.place.name}/{press.cycle}"
        if name not in self.places:
            self.places.append(name)
        self._ask("step")

    def _called(self, device: str, name: str) -> None:
        if (device, name) == ("camera", "drain") and self.step is None:
            self.taps = True
        self._ask(f"{device}.{name}")

    def _ask(self, call: str) -> None:
        self.heard(self, call)
        if self.began_ns is None and self.due(self, call):
            self.ask_begin()

    def _moved(self, motion: Motion) -> None:
        self._note(self.truth.motion)
        self._note(motion)
        self._move(motion)

    def _note(self, motion: Motion) -> None:
        self._motions[motion.begun_s] = motion  # one that was told to stop takes its own place

    def _stopping(self, real: Callable[[], None]) -> None:
        asked_s, moved = self.truth.now_s, self.is_moving
        speed, obeyed, at = self.truth.motion.speed_m_s, False, len(self.stops)
        self._note(self.truth.motion)
        self.stops.append((self.clock.now_ns(), Stopped(0.0, 0.0, True)))
        try:
            real()
            obeyed = True
        finally:
            ends_s = max(self.truth.motion.ends_s, asked_s)
            way_m = self.way_m(asked_s, ends_s) if moved else 0.0
            self.stops[at] = (self.stops[at][0], Stopped(way_m, speed if moved else 0.0, obeyed))

    def _draining(self, real: Callable[[], list[Wrench]]) -> list[Wrench]:
        samples, now_ns = real(), self.clock.now_ns()
        self.read += [(now_ns, one) for one in samples]
        self._note_touches()
        return samples

    def _note_touches(self) -> None:
        last = self.touches[-1].time_s if self.touches else -math.inf
        newer = takewhile(lambda touch: touch.time_s > last, reversed(self.truth.touches))
        self.touches += reversed(list(newer))
