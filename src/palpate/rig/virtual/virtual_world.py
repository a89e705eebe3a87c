"""World of the virtual devices: the stage's motion, the skin under the probe, and its memory of presses.

Nothing runs by itself. Whoever asks brings the world up to the clock's time, at the force sensor's rate, so
that it is the same in real time and faster. Depth is below the skin's own surface, at first touch: the truth
that labels below a force threshold differ from.

The elastic force is the sensor's own law, as far as it holds; with every change dF of it a share g_i dF is
added that fades with time t_i (a Prony series: the modulus is the relaxed one). A probe is never pulled:
below zero the force is zero. That the contact of a skin that lags behind is smaller on the way back (Ting) is
left out. When the probe has left, a dent remains: each branch has come to some depth, of which its share
remains and fades with its own time. The next touch is of the dented skin, and begins without memory.

World whose stage is driven along z by a linear rig: the tip is where motor and load have brought it.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from palpate.core import (
    NS_PER_S,
    Clock,
    EarlierPress,
    Float,
    ForceLaw,
    Pose,
    Position,
    Probe,
    Sensor,
    Specimen,
    Travel,
    force_law,
    ndarray,
)
from palpate.mechanics.axisymmetric.axisymmetric_fem import CreepingPress
from palpate.rig.virtual.disturbances import Approach, Fault, Faults, Variation, approach_of, shift_of
from palpate.rig.virtual.linear_rig import LinearDrive, LinearRig, Motion, standing

Series = Float[ndarray, " n"]


class ViscoelasticSkin:
    """Remembers what the fading branches still hold."""

    def __init__(self, law: ForceLaw, relaxation: tuple[tuple[float, float], ...]) -> None:
        self.law = law
        self._branches = relaxation
        self._memory = np.zeros(len(relaxation))
        self._reached_m = np.zeros(len(relaxation))
        self._last = 0.0

    def force(self, depth_m: Series, step_s: float, ratio: Series | float = 1.0) -> tuple[Series, Series]:
        """Force on the probe, and the elastic part of it, at samples `step_s` apart [N].

        Args:
            depth_m: below first touch.
            step_s: from sample to sample.
            ratio: elastic force over the law's, of the place.
        """
        elastic = ratio * np.interp(depth_m, self.law.depth_m, self.law.force_n, left=0.0)
        change = np.diff(elastic, prepend=self._last)
        total = elastic.copy()
        for i, (share, time_s) in enumerate(self._branches):
            fades = math.exp(-step_s / time_s)
            # A change is spread over its step, so that half of the step's fading has happened to it.
            gain = share * math.exp(-step_s / 2 / time_s)
            memory = _fading(gain * change, fades, self._memory[i])
            self._memory[i] = memory[-1]
            total += memory[1:]
            reached = (1.0 - fades) * np.maximum(depth_m, 0.0)
            self._reached_m[i] = _fading(reached, fades, self._reached_m[i])[-1]
        if len(elastic):
            self._last = float(elastic[-1])
        return np.maximum(total, 0.0), elastic

    def leave(self) -> tuple[float, ...]:
        """The probe has left: the dent that each branch holds [m]; memory begins anew."""
        whole = 1.0 + sum(share for share, _ in self._branches)
        dents = zip(self._branches, self._reached_m, strict=True)
        left = tuple(float(share / whole * reached) for (share, _), reached in dents)
        self._memory[:], self._reached_m[:], self._last = 0.0, 0.0, 0.0
        return left

    def radius_at(self, depth_m: float) -> float:
        """Radius of the contact [m]."""
        return float(np.interp(depth_m, self.law.depth_m, self.law.radius_m, left=0.0))

    def lateral_at(self, depth_m: float) -> float:
        """Force for a small shift along the skin [N/m]."""
        return float(np.interp(depth_m, self.law.depth_m, self.law.lateral_n_m, left=0.0))


def _fading(added: Series, fades: float, before: float) -> Float[ndarray, " m"]:
    """What is held before, and after each sample, of what is added at it and fades by a factor from each."""
    return np.array(list(accumulate(added, lambda held, new: fades * held + new, initial=before)))


class CreepingSpecimen(ViscoelasticSkin):
    """A viscous specimen under the probe, which begins anew with every touch; no dent of it is left."""

    def __init__(self, law: ForceLaw, press: CreepingPress) -> None:
        super().__init__(law, ())
        self._press = press

    def force(self, depth_m: Series, step_s: float, ratio: Series | float = 1.0) -> tuple[Series, Series]:
        """Force on the probe, and that of the relaxed specimen, at samples `step_s` apart [N]."""
        relaxed = ratio * np.interp(depth_m, self.law.depth_m, self.law.force_n, left=0.0)
        return np.array([self._press.to(float(d), step_s) for d in depth_m]), relaxed

    def leave(self) -> tuple[float, ...]:
        """The probe has left."""
        self._press.leave()
        return ()


KEPT_S = 3.0  # of what was, for frames that are asked for late
FRICTION = 0.5  # between probe and skin, of a lateral load
LIFTED_M = 0.2e-3  # above the skin, from where the next touch is another approach
MAX_FRESH = 1_000_000  # samples that wait for the force sensor
HALF = 0.5  # way between two samples
FAR_M = 1.0  # to where the layer goes that is not there

NEAR_M = 1e-3  # at least, to which a dent reaches
MAX_DENTS = 32  # that are remembered


@dataclass(frozen=True, slots=True)
class Touch:
    """State of the contact at one instant.

    Attributes:
        time_s: on the world's clock [s].
        depth_m: below first touch; negative in the air.
        x_m, y_m: of the probe on the skin.
        force_n: along x, y, z, positive z in compression.
        pulled_n: what of the lateral force a shift of the probe has made; the rest is its lean, and the
            skin's own push at this place.
        shift_m: of the probe along x and y since it touched.
        stiffening: normal force over that of the relaxed skin at this depth.
        approach: what is particular to it.
        known: whether the skin's law reaches so deep; the force means nothing where it does not.
    """

    time_s: float
    depth_m: float
    x_m: float
    y_m: float
    force_n: tuple[float, float, float]
    pulled_n: tuple[float, float]
    stiffening: float
    approach: Approach
    known: bool = True
    shift_m: tuple[float, float] = (0.0, 0.0)


class Dent(NamedTuple):
    """Dent that a press has left: where, when, and how deep each branch of memory and the probe came [m]."""

    x_m: float
    y_m: float
    time_s: float
    left_m: tuple[float, ...]
    depth_m: float


class World:
    """World of one sensor and one probe on one stage."""

    def __init__(
        self,
        sensor: Sensor,
        clock: Clock,
        travel: Travel,
        origin_m: Position,
        variation: Variation,
        rate_hz: float,
        seed: int,
        faults: Sequence[Fault],
        askew_m: Position = (0.0, 0.0, 0.0),
    ) -> None:
        self.sensor = sensor
        self.outline = sensor.outline
        self.clock = clock
        self.travel = travel
        self.variation = variation
        self.rate_hz = rate_hz
        self.seed = seed
        self.lock = threading.RLock()
        self.faults = Faults(faults, clock.now_ns())
        # Where the layer lies, which need not be where the rig believes it to be.
        self._origin = tuple(o + a for o, a in zip(origin_m, askew_m, strict=True))
        self.mount(sensor.default_probe)
        self._own_radius_m = self.probe.radius_m
        self._pressed_m = 0.0
        self._step_s = 1.0 / rate_hz
        self._count = math.floor(self.now_s * rate_hz)
        start = (origin_m[0], origin_m[1], max(travel.least_m[2], origin_m[2] - 5e-3))
        self._motions: deque[Motion] = deque([standing(start, self.now_s)])
        self._played = np.array(start)
        self._visits: dict[tuple[int, int], int] = {}
        self._approach = approach_of(variation, seed, 0.0, 0.0, 0)
        self._presses = 0
        self._hook()
        self._lifted = True
        self._dents: deque[Dent] = deque(maxlen=MAX_DENTS)
        self._stuck_at: tuple[float, float] | None = None
        self.touches: deque[Touch] = deque()
        self._fresh: deque[Touch] = deque(maxlen=MAX_FRESH)

    def mount(self, indenter: str) -> bool:
        """Change what touches the skin, in the air; no person has to."""
        self.probe: Probe = self.sensor.probe(indenter)
        self.specimen: Specimen | None = self.sensor.specimen(indenter)
        law = force_law(self.sensor, self.probe, self.specimen)
        creeping = getattr(self.sensor, "creeping", None)
        press: CreepingPress | None = creeping and creeping(self.probe, self.specimen)
        self._skin = (
            CreepingSpecimen(law, press) if press else ViscoelasticSkin(law, self.variation.relaxation)
        )
        return True

    def known_m(self, indenter: str, lateral: bool) -> float:
        """Depth to which the skin has a law under an indenter, with a lateral load or without [m]."""
        sensor = self.sensor
        return sensor.known_depth_m(sensor.probe(indenter), sensor.specimen(indenter), lateral=lateral)

    def earlier(self, time_s: float) -> tuple[EarlierPress, ...]:
        """The presses that are over at a time, of those that are remembered."""
        with self.lock:  # whoever asks for force in another thread adds to them
            dents = list(self._dents)
        return tuple(
            EarlierPress(Pose(dent.x_m, dent.y_m, dent.depth_m), time_s - dent.time_s)
            for dent in dents
            if dent.time_s < time_s
        )

    def radius_at(self, depth_m: float) -> float:
        """Radius of the contact at a depth [m]."""
        return self._skin.radius_at(depth_m)

    @property
    def now_s(self) -> float:
        """The clock's time [s]."""
        return self.clock.now_ns() / NS_PER_S

    @property
    def motion(self) -> Motion:
        """The last move that was asked for."""
        return self._motions[-1]

    def move(self, motion: Motion) -> None:
        """Begin another move, or end one otherwise than was planned."""
        self.advance()
        if motion.begun_s == self.motion.begun_s and len(self._motions) > 1:
            self._motions.pop()
        self._motions.append(motion)

    def stand_at(self) -> Position:
        """Place that the stage reports now [m]."""
        return self.motion.place_m(self.now_s)

    def advance(self) -> None:
        """Bring everything up to the clock's time."""
        with self.lock:
            until = math.floor(self.now_s * self.rate_hz)
            if until <= self._count:  # as at most looks of a guard, which come more often than samples
                return
            times = np.arange(self._count + 1, until + 1) * self._step_s
            self._count = until
            fresh: list[Touch] = []
            for part in np.array_split(times, math.ceil(len(times) / 4096)):
                fresh += self._felt(part)
            self.touches.extend(fresh)
            self._fresh.extend(fresh)
            while self.touches and self.touches[0].time_s < self.now_s - KEPT_S:
                self.touches.popleft()
            while len(self._motions) > 1 and self._motions[1].begun_s < self.now_s - KEPT_S:
                self._motions.popleft()

    def fresh(self) -> list[Touch]:
        """Instants that the force sensor has not taken in yet, oldest first."""
        with self.lock:
            taken = list(self._fresh)
            self._fresh.clear()
        return taken

    def touch_at(self, time_s: float) -> Touch | None:
        """State at a time, between samples along a straight line; None before the first."""
        self.advance()
        with self.lock:
            if not self.touches:
                return None
            place = (time_s - self.touches[0].time_s) * self.rate_hz
            index = min(max(math.floor(place), 0), len(self.touches) - 1)
            before, after = self.touches[index], self.touches[min(index + 1, len(self.touches) - 1)]
        return _between(before, after, min(max(place - index, 0.0), 1.0))

    def _felt(self, times: Series) -> list[Touch]:
        played = self._play(times)
        touches: list[Touch] = []
        relative = played - np.array(self._origin)
        over = relative[:, 2] - self._beyond_the_rim(relative)
        depth = over - self._approach.height_m
        if self._lifted and (depth > -LIFTED_M).any():
            self._begin_approach(relative[-1], float(times[-1]))
            depth = over - self._approach.height_m
        gone = self.faults.since("layer-gone")
        if gone is not None:
            depth = np.where(times * NS_PER_S >= gone, -FAR_M, depth)
        greatest = self._skin.law.greatest_m
        known = depth <= greatest
        aside = self._approach.aside_m
        x, y = relative[:, 0] + aside[0], relative[:, 1] + aside[1]
        here = self._skin.law.at_places(x, y, np.minimum(depth, greatest))
        normal, elastic = self._skin.force(np.minimum(depth, greatest), self._step_s, here.ratio)
        if depth[-1] < -LIFTED_M and not self._lifted:
            self._lifted, self._stuck_at = True, None
            left_m, pressed_m = self._skin.leave(), max(self._pressed_m, 0.0)
            self._dents.append(Dent(*self._place(relative), float(times[-1]), left_m, pressed_m))
            if pressed_m > 0:
                self._presses, self._pressed_m = self._presses + 1, 0.0
                self._hook()
        self._pressed_m = max(self._pressed_m, float(depth.max()))
        pulled, shift = self._pulled(relative, depth, normal)
        lateral = pulled + normal[:, None] * (np.array(self._approach.lean) + here.lateral_ratio)
        for i, time_s in enumerate(times.tolist()):
            stiff = float(normal[i] / elastic[i]) if elastic[i] > 0 else 1.0
            touches.append(
                Touch(
                    time_s,
                    float(depth[i]),
                    float(x[i]),
                    float(y[i]),
                    (float(lateral[i, 0]), float(lateral[i, 1]), float(normal[i])),
                    (float(pulled[i, 0]), float(pulled[i, 1])),
                    stiff,
                    self._approach,
                    bool(known[i]),
                    (float(shift[i, 0]), float(shift[i, 1])),
                )
            )
        return touches

    def _beyond_the_rim(self, relative: Float[ndarray, "n 3"]) -> Series:
        """Descent of a round probe that touches the rim's edge beside it; far where it passes it."""
        R = self._own_radius_m
        beyond = self.outline.beyond_m(relative[:, 0], relative[:, 1])
        if not beyond.any():
            return beyond
        return np.where(beyond < R, R - np.sqrt(np.clip(R**2 - beyond**2, 0.0, None)), FAR_M)

    def _play(self, times: Series) -> Float[ndarray, "n 3"]:
        """The stage's own places, less what the backlash swallows; each move runs one way along each axis."""
        half = self.variation.backlash_m / 2
        targets = self._targets(times)
        played = np.empty_like(targets)
        at = self._played
        for i, place in enumerate(targets):
            at = np.clip(at, place - half, place + half)
            played[i] = at
        self._played = at
        return played

    def _targets(self, times: Series) -> Float[ndarray, "n 3"]:
        """Places that the stage was sent along, at times [m]."""
        targets = np.empty((len(times), 3))
        left = np.ones(len(times), dtype=bool)
        for motion in reversed(self._motions):  # the last ones first: there are seldom more than two
            during = left & (times >= motion.begun_s)
            if during.any():
                targets[during] = motion.at(times[during])
                left &= ~during
            if not left.any():
                break
        targets[left] = self._motions[0].start_m
        return targets

    @staticmethod
    def _place(relative: ndarray) -> tuple[float, float]:
        return float(relative[-1, 0]), float(relative[-1, 1])

    def _dent_at(self, x_m: float, y_m: float, time_s: float) -> float:
        """Dent that earlier presses near a place have left."""
        R, depth_m = max(self._own_radius_m, NEAR_M), 0.0
        for dent in self._dents:
            near = math.exp(-((x_m - dent.x_m) ** 2 + (y_m - dent.y_m) ** 2) / R**2)
            for (_, fades_s), left_m in zip(self.variation.relaxation, dent.left_m, strict=True):
                depth_m += near * left_m * math.exp(-(time_s - dent.time_s) / fades_s)
        return depth_m

    def _hook(self) -> None:
        """Place where the camera sees the sensor until the next press is over."""
        if self.variation.shift_px > 0:
            shift_px = shift_of(self.variation, self.seed, self._presses)
            self._approach = replace(self._approach, shift_px=shift_px)

    def _begin_approach(self, relative: ndarray, time_s: float) -> None:
        x, y = float(relative[0]), float(relative[1])
        spot = (round(x * 1e6), round(y * 1e6))
        visit = self._visits.get(spot, 0)
        self._visits[spot] = visit + 1
        approach = approach_of(self.variation, self.seed, x, y, visit)
        self._approach = replace(
            approach,
            height_m=approach.height_m + self._dent_at(x, y, time_s),
            shift_px=self._approach.shift_px,
        )
        self._lifted, self._stuck_at = False, None

    def _pulled(
        self, relative: ndarray, depth: Series, normal: Series
    ) -> tuple[Float[ndarray, "n 2"], Float[ndarray, "n 2"]]:
        """Force and shift of a probe that sticks: Cattaneo's and Mindlin's law, as on a half-space."""
        none = np.zeros((len(normal), 2))
        if self._stuck_at is None:
            if not (normal > 0).any():
                return none, none
            self._stuck_at = self._place(relative)
        shift = relative[:, :2] - np.array(self._stuck_at)
        size = np.hypot(shift[:, 0], shift[:, 1])
        if not (size > self.variation.backlash_m + 1e-9).any():
            return none, none
        triples = zip(size.tolist(), depth.tolist(), normal.tolist(), strict=True)
        pull = np.array([self._pull(*one) for one in triples])
        return np.asarray((pull / np.maximum(size, 1e-12))[:, None] * shift), shift

    def _pull(self, shift_m: float, depth_m: float, normal_n: float) -> float:
        stiff = self._skin.lateral_at(depth_m)
        if normal_n <= 0 or stiff <= 0:
            return 0.0
        most = FRICTION * normal_n
        free = min(stiff * shift_m * 2 / (3 * most), 1.0)
        return most * (1.0 - (1.0 - free) ** 1.5)


def _between(before: Touch, after: Touch, share: float) -> Touch:
    """Interpolate within one approach; from one to the next nothing is in between."""
    if before.approach is not after.approach:
        return before if share < HALF else after
    names = ("depth_m", "x_m", "y_m", "stiffening")
    mixed = {n: getattr(before, n) * (1 - share) + getattr(after, n) * share for n in names}
    fx, fy, fz = (b * (1 - share) + a * share for b, a in zip(before.force_n, after.force_n, strict=True))
    px, py = (b * (1 - share) + a * share for b, a in zip(before.pulled_n, after.pulled_n, strict=True))
    sx, sy = (b * (1 - share) + a * share for b, a in zip(before.shift_m, after.shift_m, strict=True))
    return replace(before, **mixed, force_n=(fx, fy, fz), pulled_n=(px, py), shift_m=(sx, sy))


def halted(motion: Motion, time_s: float) -> Motion:
    """The same move, slowing down from a time on."""
    return replace(motion, stopped_s=min(motion.stopped_s, time_s))


class DrivenWorld(World):
    """World in which moves of the stage are what its rig is asked for, not what it does.

    A program asks for a place at every sample of force, and the control keeps to it until the next. The
    encoder sees the support itself, so the stage has no backlash beside it.

    Args:
        rig: that drives the tip.
        sensor, clock, travel, origin_m, variation, rate_hz, seed: see `World`.

    Raises:
        InputError: no whole number of the control's ticks lies between two samples.
    """

    def __init__(
        self,
        rig: LinearRig,
        sensor: Sensor,
        clock: Clock,
        travel: Travel,
        origin_m: Position,
        variation: Variation,
        rate_hz: float,
        seed: int,
    ) -> None:
        self.rig = rig
        self._ticks = rig.ticks_in(rate_hz)
        vary = replace(variation, backlash_m=0.0)
        super().__init__(sensor, clock, travel, origin_m, vary, rate_hz, seed, faults=())
        self._drive = LinearDrive(rig, self.motion.start_m[2])
        self._track: list[tuple[float, float]] = []

    def encoder_m(self, times: Series) -> Series:
        """Places as the encoder has them at samples' times [m]."""
        at_s, places = np.array(self._track).T
        return self.rig.read_m(np.interp(times, at_s, places))

    def _targets(self, times: Series) -> Float[ndarray, "n 3"]:
        """Places of the tip at times [m]."""
        targets = super()._targets(times - self._step_s)  # what was asked for until then
        asked_m, law = np.repeat(targets[:, 2], self._ticks), self._skin.law
        places = self._drive.follow(asked_m, law.depth_m, law.force_n, self._surface_m(targets[-1]))
        targets[:, 2] = places[self._ticks - 1 :: self._ticks]
        self._track += zip(times.tolist(), targets[:, 2].tolist(), strict=True)
        return targets

    def _surface_m(self, target: Float[ndarray, " 3"]) -> float:
        """Place at which the tip touches, or will in this approach [m]."""
        approach = self._approach
        if self._lifted:
            x, y = float(target[0] - self._origin[0]), float(target[1] - self._origin[1])
            visit = self._visits.get((round(x * 1e6), round(y * 1e6)), 0)
            approach = approach_of(self.variation, self.seed, x, y, visit)
        return self._origin[2] + approach.height_m
