"""Simulated hand that presses a probe into a virtual sensor: no stage, no plan, random positions and forces.

Each press ramps up to a random force, holds it for about a second with tremor (8 to 12 Hz) and slow drift
(one to a few percent), and lets go. All sizes are assumed. The motion is a fixed function of time. The skin
has no memory, and a slip moves the contact and reduces the force without a lateral load.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from palpate.core import NS_PER_S, Clock, Float, InputError, MonotonicClock, Sensor, ndarray
from palpate.core.sensor import draw_ahead, for_live, sensor as sensor_of
from palpate.rig.virtual.disturbances import Fault
from palpate.rig.virtual.virtual_bench import (
    CARRYING,
    FORCE_HZ,
    ORIGIN_M,
    TRAVEL,
    TRUTHS,
    default_variation,
    truth_at,
)
from palpate.rig.virtual.virtual_sensors import VirtualCamera, VirtualForce
from palpate.rig.virtual.virtual_world import Series, World

AIR_M = 3e-3  # above the skin: where the probe waits
APPROACH_S = 0.35  # from there to the skin, and back
SLIP_S = 0.05  # that a slip takes
SEATINGS = 5  # standard deviations of the skin's height, above the deepest that its law knows
MAX_TRIES = 1000  # for a random place
NO_SLIP = (2.0, 0.0, 0.0, 0.0)
REMEMBERED_S = 60.0  # of what the hand did
MAX_N = 10.0  # of a hand that holds still
FIRST_S = 1.0  # untouched, before the first press


@dataclass(frozen=True, slots=True)
class HandHabits:
    """Sizes of what a hand does. Assumed.

    Attributes:
        force_n: least and greatest force that is aimed at; None for 4 to 80 % of the greatest that the
            skin's law knows, and 10 N at most [N].
        ramp_s: from first touch to the plateau, and back [s].
        hold_s: of a plateau [s].
        pause_s: in the air between two presses [s].
        tremor: standard deviation of the tremor's force, over the force held.
        tremor_hz: of the tremor.
        wander: by how much the held force moves over a plateau, standard deviation over the force held.
        slips: share of presses that slip while they hold.
        slip_m: greatest way of a slip along the skin [m].
        slip_ease: share of the force that a slip eases at most.
        weights_n: known weights that are laid on instead: no tremor, no wandering, only these forces [N].
        spot_m: (x, y, radius): where alone it presses; None for all of the skin's outline [m].
    """

    force_n: tuple[float, float] | None = None
    ramp_s: tuple[float, float] = (0.3, 1.0)
    hold_s: tuple[float, float] = (0.8, 1.4)
    pause_s: tuple[float, float] = (0.5, 1.0)
    tremor: float = 0.008
    tremor_hz: tuple[float, float] = (8.0, 12.0)
    wander: float = 0.01
    slips: float = 0.1
    slip_m: float = 0.3e-3
    slip_ease: float = 0.1
    weights_n: tuple[float, ...] = ()
    spot_m: tuple[float, float, float] | None = None


USUAL = HandHabits()
TREMBLING = HandHabits(tremor=0.12, wander=0.05)
"""A hand that cannot hold still: its plateaus are no labels."""
FEELING = HandHabits(
    force_n=(4.7, 4.95), ramp_s=(1.0, 1.6), hold_s=(0.3, 0.5), slips=0.0, spot_m=(0.0, 0.0, 0.0)
)
"""A hand that feels how soft a body is: head-on, slowly, and beyond the 4.5 N up to which a press is compared
with those of known bodies."""


@dataclass(frozen=True, slots=True)
class HandPress:
    """Press of a hand, known before it begins.

    Attributes:
        begins_s: when the probe leaves its height in the air, on the world's clock [s].
        x_m, y_m: place on the skin.
        force_n: that is held.
        up_s, hold_s, down_s: of ramp, plateau and release [s].
        tremor_n, wander_n: amplitudes of both while it holds [N].
        tremor_hz, phase_rad: of the tremor.
        slip: (share of the plateau after which it slips, dx, dy [m], share of the force that it eases).
        from_m: place over which it hung before [m].
    """

    begins_s: float
    x_m: float
    y_m: float
    force_n: float
    up_s: float
    hold_s: float
    down_s: float
    tremor_n: float = 0.0
    wander_n: float = 0.0
    tremor_hz: float = 10.0
    phase_rad: float = 0.0
    slip: tuple[float, float, float, float] = NO_SLIP
    from_m: tuple[float, float] = (0.0, 0.0)

    @property
    def touches_s(self) -> float:
        """Time of first touch [s]."""
        return self.begins_s + APPROACH_S

    @property
    def holds_s(self) -> tuple[float, float]:
        """Begin and end of the plateau [s]."""
        return self.touches_s + self.up_s, self.touches_s + self.up_s + self.hold_s

    @property
    def ends_s(self) -> float:
        """Time when the probe is at its height in the air again [s]."""
        return self.holds_s[1] + self.down_s + APPROACH_S

    def force_at(self, time_s: Series) -> Series:
        """Force that the hand gives, 0 in the air [N]."""
        first, last = self.holds_s
        up = _eased((time_s - self.touches_s) / self.up_s)
        down = 1.0 - _eased((time_s - last) / self.down_s)
        held = np.clip((time_s - first) / self.hold_s, 0.0, 1.0)
        slipped = self._slipped(time_s)
        level = self.force_n * (1.0 - self.slip[3] * slipped)
        level = level + self.wander_n * math.sqrt(2) * np.sin(math.pi * (held - 0.5) + self.phase_rad)
        shake = math.sqrt(2) * self.tremor_n * np.sin(2 * math.pi * self.tremor_hz * time_s + self.phase_rad)
        return np.asarray(np.maximum(up * down * (level + shake), 0.0))

    def place_at(self, time_s: Series) -> tuple[Series, Series]:
        """Place over the skin: brought there in the air, and changed by a slip [m]."""
        slipped, way = self._slipped(time_s), 1.0 - _eased(2 * (time_s - self.begins_s) / APPROACH_S)
        x = self.x_m + self.slip[1] * slipped + (self.from_m[0] - self.x_m) * way
        y = self.y_m + self.slip[2] * slipped + (self.from_m[1] - self.y_m) * way
        return x, y

    @property
    def left_at(self) -> tuple[float, float]:
        """Place over which it hangs in the end [m]."""
        went = float(self.slip[0] < 1.0)
        return self.x_m + went * self.slip[1], self.y_m + went * self.slip[2]

    def height_at(self, time_s: Series) -> Series:
        """Height over the skin on the way to it and from it; 0 while it touches [m]."""
        coming = 1.0 - _eased(2 * (time_s - self.begins_s) / APPROACH_S - 1.0)
        going = _eased((time_s - (self.ends_s - APPROACH_S)) / APPROACH_S)
        return np.asarray(AIR_M * np.maximum(coming, going))

    def _slipped(self, time_s: Series) -> Series:
        first, _ = self.holds_s
        return _eased((time_s - first - self.slip[0] * self.hold_s) / SLIP_S)


def _eased(share: Series) -> Series:
    """0 to 1 without a jump of speed."""
    t = np.clip(share, 0.0, 1.0)
    return np.asarray(t * t * (3 - 2 * t))


def another_hand() -> int:
    """Seed of a hand that has not pressed yet, drawn from the system's entropy.

    A calibration that is tried on the presses it has learnt from reads them far better than others.
    """
    return int(np.random.SeedSequence().generate_state(1)[0])


def _usual_range(known_n: float) -> tuple[float, float]:
    """Forces that a hand aims at on a skin that is known to so many newtons."""
    greatest = min(0.8 * known_n, MAX_N)
    return greatest / 20, greatest


class HandWorld(World):
    """World in which a hand, not a stage, brings the probe to its place.

    Args:
        sensor: at the size that is filmed.
        clock: time.
        habits: of the hand.
        seed: of the hand and of all that varies between presses.
        faults: what goes wrong, and when.
        indenter: what touches, as the sensor names it; its own where empty.
    """

    def __init__(
        self,
        sensor: Sensor,
        clock: Clock,
        habits: HandHabits,
        seed: int,
        faults: tuple[Fault, ...] = (),
        indenter: str = "",
    ) -> None:
        vary = replace(default_variation(sensor, sensor.name), backlash_m=0.0, relaxation=())
        travel = TRAVEL if sensor.moves == "probe" else CARRYING
        super().__init__(sensor, clock, travel, ORIGIN_M, vary, FORCE_HZ, seed, faults)
        if indenter:
            self.mount(indenter)
        self.habits = habits
        law = self._skin.law
        self.known_n = float(law.force_n[-1])
        self.force_range_n = habits.force_n or _usual_range(float(law.force_n[-1]))
        if not 0 < self.force_range_n[0] <= self.force_range_n[1] <= law.force_n[-1]:
            raise InputError(
                f"a hand that presses with {self.force_range_n} N; the skin of {sensor.name} is known from 0 "
                f"to {law.force_n[-1]:.3g} N: give a least and a greatest force within",
                code="force-range",
            )
        self._margin_m = self.probe.radius_m if self.outline.contains(0.0, 0.0, self.probe.radius_m) else 0.0
        self._given: deque[HandPress] = deque()
        self._last_at = (0.0, 0.0)
        self._decisions = 0
        self._next_s: float | None = self.now_s + FIRST_S

    @property
    def presses(self) -> tuple[HandPress, ...]:
        """The last presses and the next one, as far as they are remembered."""
        with self.lock:
            return tuple(self._given)

    @property
    def rests(self) -> bool:
        """Whether no press will begin of itself."""
        return self._next_s is None

    def rest(self) -> None:
        """End the press under way, and begin none until `press`."""
        with self.lock:
            self.advance()
            if self._given and self._given[-1].begins_s > self.now_s:
                self._given.pop()
                self._decisions -= 1
            self._next_s = None

    def press(self, after_s: float = 0.0) -> None:
        """Go on with one press after another, the next after so long [s]."""
        with self.lock:
            self.advance()
            if self._next_s is None:
                free_s = max([self.now_s, *(one.ends_s for one in self._given)])
                self._next_s = free_s + max(after_s, 1 / self.rate_hz)

    @property
    def deepest_m(self) -> float:
        """Depth that its presses stay above, but for a skin that lies much higher than usual [m]."""
        law, habits = self._skin.law, self.habits
        most_n = self.force_range_n[1] * (1 + math.sqrt(2) * (habits.tremor + habits.wander))
        depth = float(np.interp(most_n, law.force_n, law.depth_m))
        return min(depth + SEATINGS * self.variation.seating_m, law.greatest_m)

    def _targets(self, times: Series) -> Float[ndarray, "n 3"]:
        self._give_until(float(times[-1]))
        places = np.tile((*self._last_at, -AIR_M), (len(times), 1))
        for one in self._given:
            during = (times >= one.begins_s) & (times < one.ends_s)
            if during.any():
                places[during] = self._places(one, times[during])
            places[times >= one.ends_s, :2] = one.left_at
        return places

    def _places(self, one: HandPress, times: Series) -> Float[ndarray, "n 3"]:
        """Places of the probe in a press: as deep as the force that the hand gives takes it."""
        law = self._skin.law
        x, y = one.place_at(times)
        force = one.force_at(times)
        depth = np.interp(force, law.force_n, law.depth_m)
        ratio = law.at_places(x, y, depth).ratio
        most = law.greatest_m - SEATINGS * self.variation.seating_m
        depth = np.minimum(np.interp(force / np.maximum(ratio, 0.1), law.force_n, law.depth_m), most)
        return np.stack([x, y, depth - one.height_at(times)], axis=1)

    def _pulled(
        self, relative: ndarray, depth: Series, normal: Series
    ) -> tuple[Float[ndarray, "n 2"], Float[ndarray, "n 2"]]:
        """No lateral load: the probe does not stick."""
        none = np.zeros((len(normal), 2))
        return none, none

    def _give_until(self, time_s: float) -> None:
        """Decide on presses that begin up to a time."""
        while self._next_s is not None and self._next_s <= time_s:
            one = self._decided(self._next_s)
            self._given.append(one)
            rng = np.random.default_rng([self.seed & 0xFFFFFFFF, 0x4B, self._decisions])
            self._next_s = one.ends_s + float(rng.uniform(*self.habits.pause_s))
        while len(self._given) > 1 and self._given[0].ends_s < time_s - REMEMBERED_S:
            self._last_at = self._given.popleft().left_at

    def _decided(self, begins_s: float) -> HandPress:
        habits = self.habits
        rng = np.random.default_rng([self.seed & 0xFFFFFFFF, 0x4A, self._decisions])
        self._decisions += 1
        x, y = self._place_by(rng)
        least, greatest = self.force_range_n
        laid = bool(habits.weights_n)
        force = float(rng.choice(habits.weights_n)) if laid else float(rng.uniform(least, greatest))
        steady = replace(habits, tremor=0.0, wander=0.0, slips=0.0) if laid else habits
        turn, far = float(rng.uniform(0, 2 * math.pi)), float(rng.uniform(0.2, 1.0)) * steady.slip_m
        slip = NO_SLIP
        ease = float(rng.uniform(0, steady.slip_ease))
        when = float(rng.uniform(0.2, 0.7))
        if rng.uniform() < steady.slips:
            slip = (when, far * math.cos(turn), far * math.sin(turn), ease)
        return HandPress(
            begins_s,
            x,
            y,
            force,
            up_s=float(rng.uniform(*habits.ramp_s)),
            hold_s=float(rng.uniform(*habits.hold_s)),
            down_s=float(rng.uniform(*habits.ramp_s)),
            tremor_n=steady.tremor * force,
            wander_n=steady.wander * force,
            tremor_hz=float(rng.uniform(*habits.tremor_hz)),
            phase_rad=float(rng.uniform(0, 2 * math.pi)),
            slip=slip,
            from_m=self._given[-1].left_at if self._given else (0.0, 0.0),
        )

    def _place_by(self, rng: np.random.Generator) -> tuple[float, float]:
        """Random place on which the probe lies wholly inside the outline."""
        x0, y0, reach = self.habits.spot_m or (0.0, 0.0, self.outline.radius_m)
        for _ in range(MAX_TRIES):
            x, y = (float(c) for c in rng.uniform(-reach, reach, 2))
            inside = self.outline.contains(x0 + x, y0 + y, self._margin_m + self.habits.slip_m * (x != 0))
            if math.hypot(x, y) <= reach and (inside or reach == 0):
                return x0 + x, y0 + y
        raise InputError(
            f"a hand found no place within {1e3 * reach:.3g} mm of ({1e3 * x0:.3g}, {1e3 * y0:.3g}) mm on "
            f"{self.sensor.name}, whose outline reaches {1e3 * self.outline.radius_m:.3g} mm; give a "
            "spot on it"
        )


class VirtualHand:
    """A hand, the virtual sensor that it presses, and the force sensor beneath.

    Args:
        sensor: a name, whose sensor is filmed and drawn as it states for live frames; or a sensor as it is.
        seed: of the hand and of all that varies between presses.
        clock: time; the machine's own where left out, a `ManualClock` to go faster.
        habits: of the hand; by default `USUAL`, or `FEELING` where it carries the sensor onto a
            body that is named.
        indenter: what the skin is pressed onto, or by, as the sensor names it, such as "S1=7.6" of a TacTip;
            its own where empty.
        pressing: whether it presses from the start; else it waits in the air for `press`.
        faults: what goes wrong, and when.

    Attributes:
        camera: frames of what the hand does.
        force: samples of what it gives, 200 a second, with the bias of a sensor that was not tared.

    Raises:
        InputError: no such sensor, or forces beyond what its skin's law knows.

    Example:
        >>> from palpate.core import ManualClock
        >>> hand = VirtualHand("tactip", clock=ManualClock())
        >>> time_ns, frame = hand.camera.grab()
        >>> frame.image.shape
        (300, 300)
        >>> hand.close()
    """

    def __init__(
        self,
        sensor: str | Sensor = "palm",
        *,
        seed: int = 0,
        clock: Clock | None = None,
        habits: HandHabits | None = None,
        indenter: str = "",
        pressing: bool = True,
        faults: tuple[Fault, ...] = (),
    ) -> None:
        self.design = for_live(sensor_of(sensor)) if isinstance(sensor, str) else sensor
        self.clock = clock or MonotonicClock()
        feels = bool(indenter) and self.design.moves == "sensor"
        habits = habits or (FEELING if feels else USUAL)
        self.world = HandWorld(self.design, self.clock, habits, seed, faults, indenter)
        if not pressing:
            self.world.rest()
        self.force = VirtualForce(self.world)
        self.camera = VirtualCamera(self.world)

    @property
    def force_range_n(self) -> tuple[float, float]:
        """Least and greatest force that the hand aims at [N]."""
        return self.world.force_range_n

    def rest(self) -> None:
        """End the press under way, and wait in the air, so that the sensor is untouched."""
        self.world.rest()

    def press(self, after_s: float = 0.0) -> None:
        """Go on pressing, after so long [s]."""
        self.world.press(after_s)

    def draw_ahead(self) -> None:
        """Let the sensor draw beforehand what its frames are made of, so that none is late for that."""
        height_m = AIR_M + SEATINGS * self.world.variation.seating_m
        draw_ahead(self.design, height_m, self.world.deepest_m)

    def truth(self, time_ns: int) -> dict[str, float]:
        """Truth at the middle of the exposure of a frame that arrived at a time [ns].

        Returns:
            ``true_depth_mm`` and ``true_force_N``, 0 in the air, with ``true_x_mm`` and ``true_y_mm``.
        """
        touch, values = truth_at(self.world, TRUTHS, time_ns)
        x, y = (touch.x_m, touch.y_m) if touch else (0.0, 0.0)
        return values | {"true_x_mm": 1e3 * x, "true_y_mm": 1e3 * y}

    def force_at(self, time_s: float) -> float:
        """True normal force at a time of the last seconds on the hand's clock [N], for a fake scale."""
        touch = self.world.touch_at(time_s)
        return 0.0 if touch is None else touch.force_n[2]

    def held(self, time_ns: int) -> HandPress | None:
        """Press whose plateau a time lies in, of those that are remembered [ns]."""
        at_s = time_ns / NS_PER_S
        found = (p for p in self.world.presses if p.holds_s[0] <= at_s < p.holds_s[1])
        return next(found, None)

    def close(self) -> None:
        """Let go of camera and force sensor. Closing again does nothing."""
        self.camera.close()
        self.force.close()
