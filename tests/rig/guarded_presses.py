"""Presses of a virtual rig under its guard, without camera or run: what was read, what was true, where it
stood."""

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from palpate.core import NS_PER_S, ManualClock, Wrench
from palpate.core.sensor import sensor as sensor_of
from palpate.devices import ForceBias, MotionGuard, OperatorControl, Tripped
from palpate.devices.force_trust import StiffnessRange
from palpate.rig.plans import Listed, StepHold
from palpate.rig.plans.press_places import Place
from palpate.rig.plans.recording_plan import PlannedPress, RecordingPlan
from palpate.rig.press_motion import PressMotion
from palpate.rig.run_progress import Recorder
from palpate.rig.virtual import Fault, Variation, virtual_rig
from palpate.rig.virtual.virtual_sensors import BIAS_N

MM = 1e-3
CENTRE = Place("centre", 0.0, 0.0)
SIGMAS = 5.0


class NoRecorder(Recorder):
    """Takes events, and keeps none."""

    def __init__(self) -> None: ...

    def event(self, kind: str, **fields: Any) -> None: ...


@dataclass
class Seen:
    """Samples as they came, and the true state of the contact at the sensor's instants."""

    samples: list[tuple[int, Wrench]] = field(default_factory=list)
    touches: list[Any] = field(default_factory=list)


class PressBench:
    """A virtual rig whose presses are driven one by one."""

    def __init__(
        self,
        sensor: Any = "palm",
        plan: RecordingPlan | None = None,
        *,
        variation: Variation | None = None,
        seed: int = 0,
        faults: Sequence[Fault] = (),
        force_hz: float = 200.0,
        indenter: str | None = None,
    ) -> None:
        self.clock = ManualClock(100 * NS_PER_S)
        self.rig = virtual_rig(
            sensor, clock=self.clock, seed=seed, variation=variation, faults=faults, force_hz=force_hz
        )
        self.world = self.rig.force._world
        self.plan = plan or StepHold(places=Listed(kind="listed", at_mm=((0.0, 0.0),)), taps=0)
        self.indenter = indenter or sensor_of(sensor).default_probe if isinstance(sensor, str) else ""
        if self.indenter:
            self.rig.mount(self.indenter)
        self.bias = ForceBias(self.rig.mounting)
        self.guard = MotionGuard(
            self.rig.stage, self.rig.force, self.rig.limits, self.bias, self.clock, OperatorControl()
        )
        self.motion = PressMotion(self.rig, self.plan, self.guard, self.bias, NoRecorder())
        self.seen = Seen()
        self.message = ""
        self.guard.samples.subscribe(self._hear)

    def _hear(self, samples: Sequence[Wrench]) -> None:
        now_ns = self.clock.now_ns()
        self.seen.samples += [(now_ns, one) for one in samples]
        last = self.seen.touches[-1].time_s if self.seen.touches else -math.inf
        fresh: list[Any] = []
        for touch in reversed(self.world.touches):
            if touch.time_s <= last:
                break
            fresh.append(touch)
        self.seen.touches += reversed(fresh)

    @property
    def sigma_n(self) -> float:
        """Standard deviation of one sample along z [N]."""
        vary = self.world.variation
        return math.hypot(vary.force_noise_n, vary.force_step_n / math.sqrt(12))

    def fault(self, kind: str) -> int:
        """A fault from now on; its time [ns]."""
        now_ns = self.clock.now_ns()
        self.world.faults._from_ns[kind] = now_ns
        return now_ns

    def touch(self) -> None:
        """The gentle touch."""
        self.motion.try_sensor(PlannedPress(CENTRE, 1, self.indenter))

    def approach(self, place: Place = CENTRE) -> None:
        """Over a place, and its zero."""
        self.motion.begin(PlannedPress(place, 1, self.indenter))
        self.motion.over(place.x_mm * MM, place.y_mm * MM)
        self.motion.measure_bias()

    def seek(self) -> None:
        self.motion.seek()

    def depth(self, depth_m: float, speed_m_s: float = 2e-3) -> None:
        self.motion.to_depth(depth_m, speed_m_s)

    def sweep(self, until_n: float, depth_m: float, speed_m_s: float = 5e-3) -> None:
        """Down to a force, and back, as a ramp does it."""
        x, y, z = self.guard.position_m()
        lowest = self.rig.origin_m[2] + depth_m
        self.guard.towards((x, y, lowest), speed_m_s, lambda f: f[2] >= until_n, step_m=lowest - z)
        self.guard.away((x, y, z), speed_m_s)

    def stepped(
        self, depth_m: float, step_m: float, hold_s: float, back: bool = False, place: Place = CENTRE
    ) -> None:
        """A press in steps with a stand at each, and the way back in steps or in one go."""
        self.approach(place)
        self.seek()
        depths = np.arange(1, round(depth_m / step_m) + 1) * step_m
        for one in depths:
            self.depth(float(one))
            self.guard.wait(hold_s)
        for one in depths[-2::-1] if back else ():
            self.depth(float(one))
            self.guard.wait(hold_s)
        self.motion.lift()

    def swept(self, until_n: float, depth_m: float, speed_m_s: float = 5e-3, place: Place = CENTRE) -> None:
        self.approach(place)
        self.sweep(until_n, depth_m, speed_m_s)
        self.guard.wait(0.3)
        self.motion.lift()


@dataclass(frozen=True)
class Stop:
    """How a fault ended: its name, empty where nothing stopped; the way from the step at which the force read
    lay five standard deviations off the true one; and the largest true force from then on."""

    reason: str
    after_m: float
    ran_n: float


def stop_of(bench: PressBench, kind: str, go: Callable[[], None]) -> Stop:
    """Let a fault set in now, go on, and say how far it went."""
    begun_ns = bench.fault(kind)
    try:
        go()
        reason, ended_ns = "", bench.clock.now_ns()
    except Tripped as e:
        reason, ended_ns = e.reason.value, bench.clock.now_ns()
        bench.message = str(e)
    bench._hear([])
    off_s = _off_s(bench, begun_ns / NS_PER_S, ended_ns / NS_PER_S)
    if off_s is None:
        return Stop(reason, 0.0, 0.0)
    late = [one for one in bench.seen.touches if one.time_s >= off_s]
    # The stage's own way, less what backlash swallows.
    at = np.array([(one.x_m, one.y_m, one.depth_m) for one in late])
    after_m = float(np.abs(np.diff(at, axis=0)).max(axis=1).sum()) if len(at) > 1 else 0.0
    return Stop(reason, after_m, max(one.force_n[2] for one in late))


def _off_s(bench: PressBench, begun_s: float, ended_s: float) -> float | None:
    arrived = [(now_ns / NS_PER_S, one.force_n[2]) for now_ns, one in bench.seen.samples]
    zero_n = bench.bias.force_n[2]
    k, newest = 0, BIAS_N[2]
    for touch in bench.seen.touches:
        while k < len(arrived) and arrived[k][0] <= touch.time_s:
            newest, k = arrived[k][1], k + 1
        if (
            begun_s < touch.time_s <= ended_s
            and abs(newest - zero_n - touch.force_n[2]) > SIGMAS * bench.sigma_n
        ):
            return float(touch.time_s)
    return None


# A force sensor whose samples come late with current timestamps, or have another gain.


class ChangedForce:
    """A force sensor of which a function makes other samples."""

    def __init__(self, device: Any, change: Callable[[Wrench], Wrench]) -> None:
        self._device, self._change = device, change

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def drain(self) -> list[Wrench]:
        return [self._change(one) for one in self._device.drain()]

    def latest(self) -> Wrench:
        return self._change(self._device.latest())


class AlteredForce:
    """A force sensor whose samples come late, stamped when they come, and with another gain, bias included.

    `settle_s` is the time that passes until the first sample is there.
    """

    def __init__(
        self, device: Any, clock: Any, delay_s: float = 0.0, gain: float = 1.0, *, settle_s: float = 0.05
    ) -> None:
        self._device, self._clock, self._gain = device, clock, gain
        self._delay_ns = round(delay_s * NS_PER_S)
        self._kept: deque[Wrench] = deque()
        self._ready: list[Wrench] = []
        self._last: Wrench | None = None
        if settle_s > 0:  # so that there is a first sample
            clock.sleep(delay_s + settle_s)
            self._take_in()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def _take_in(self) -> None:
        self._kept += self._device.drain()
        while self._kept and self._kept[0].time_ns + self._delay_ns <= self._clock.now_ns():
            one = self._kept.popleft()
            x, y, z = (self._gain * value for value in one.force_n)
            self._last = replace(one, time_ns=one.time_ns + self._delay_ns, force_n=(x, y, z))
            self._ready.append(self._last)

    def latest(self) -> Wrench:
        self._take_in()
        assert self._last is not None
        return self._last

    def latest_or(self, sound: Any) -> Wrench:
        """The newest; that of the sound sensor while none has come, with the gain."""
        self._take_in()
        return self._last if self._last is not None else sound()

    def drain(self) -> list[Wrench]:
        self._take_in()
        ready, self._ready = self._ready, []
        return ready


FORCES_N = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)


def law_range(world: Any, factor: float, forces_n: tuple[float, ...] = FORCES_N) -> StiffnessRange:
    """Range of stiffness about a virtual skin's own law, by a factor to each side."""
    law = world._skin.law
    depth = np.linspace(law.depth_m[0], law.depth_m[-1], 2000)
    force = np.interp(depth, law.depth_m, law.force_n)
    known = tuple(one for one in forces_n if one < force[-1])
    at = np.interp(known, force, depth)
    slopes = np.interp(at, depth, np.gradient(force, depth))
    return StiffnessRange(known, tuple(slopes / factor), tuple(slopes * factor))
