"""A virtual rig, put together round any sensor.

Virtual force sensor and camera beside a real stage, or a simulator of its firmware: they follow its place.

So a stage is tried with a whole plan before there is a skin, a force sensor or a camera. Each device has a
world of its own, which asks the stage for its place whenever it is asked itself, and takes it to have gone
straight from one place to the next. Two devices of the same seed feel and see the same skin.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from palpate.core import (
    DEFAULT_SENSOR,
    Clock,
    DeviceError,
    Float,
    InputError,
    ManualClock,
    Position,
    Sensor,
    Stage,
    Travel,
    ndarray,
)
from palpate.core.provenance import Provenance
from palpate.core.sensor import for_rig, frame_faults, sensor as sensor_of, variation_of
from palpate.devices.motion_limits import Limits
from palpate.rig.rig import VIRTUAL, Region, Rig
from palpate.rig.virtual.disturbances import Fault, Variation
from palpate.rig.virtual.virtual_sensors import TRANSPORT_S, VirtualCamera, VirtualForce
from palpate.rig.virtual.virtual_stage import VirtualStage
from palpate.rig.virtual.virtual_world import KEPT_S, Touch, World

ORIGIN_M: Position = (0.0, 0.0, 0.0)
TRAVEL = Travel(
    least_m=(-40e-3, -40e-3, -30e-3),
    greatest_m=(40e-3, 40e-3, 12e-3),
    top_speed_m_s=50e-3,
    acceleration_m_s2=0.5,
    latency_s=0.004,
)
"""Travel of a small belt-free stage. Assumed."""
CARRYING = replace(TRAVEL, greatest_m=(40e-3, 40e-3, 20e-3))
"""Travel of a stage that carries the sensor, onto specimens softer than it is. Assumed."""

FORCE_HZ = 200.0
FORCE_N = 35.0  # allowed
REAL_TIME_AGE_S = 0.5
"""Age of the oldest force for a move in real time: it is measured when it is asked for, on a machine that
may have other work."""
TRUTHS = ("true_depth_mm", "true_force_N")
AREA = "true_area_mm2"
"""Label of the contact's area, beside the others of a sensor that is pressed onto specimens."""


def virtual_rig(
    sensor: Sensor | str = DEFAULT_SENSOR,
    *,
    clock: Clock | None = None,
    seed: int = 0,
    variation: Variation | None = None,
    faults: Sequence[Fault] = (),
    limits: Limits | None = None,
    age_s: float | None = None,
    force_hz: float = FORCE_HZ,
    askew_m: Position = (0.0, 0.0, 0.0),
) -> Rig:
    """A stage, a force sensor and a camera around one sensor.

    Args:
        sensor: a name, whose sensor is filmed at the size that it states for a rig; or a sensor as it is.
        clock: time; one that runs as fast as it is asked to, where left out.
        seed: of all that varies.
        variation: how presses differ; by default as the sensor says.
        faults: what goes wrong, and when.
        limits: of motion; by default the whole travel and 35 N.
        age_s: of the oldest force that is moved on, where no limits are given; None for the usual one.
        force_hz: samples of force a second.
        askew_m: where the skin lies, from where the rig believes it to be.
    """
    name = f"{VIRTUAL}{sensor if isinstance(sensor, str) else sensor.name}"
    design = for_rig(sensor_of(sensor)) if isinstance(sensor, str) else sensor
    violations = frame_faults(design)
    if violations:
        raise InputError(
            f"{name} cannot be driven, it breaks its contract: {'; '.join(violations)}",
            code="contract-broken",
        )
    clock = clock or ManualClock()
    vary = default_variation(design, name) if variation is None else variation
    travel = TRAVEL if design.moves == "probe" else CARRYING
    world = World(design, clock, travel, ORIGIN_M, vary, force_hz, seed, faults, askew_m)
    truths = TRUTHS if design.moves == "probe" else (*TRUTHS, AREA)
    return Rig(
        name=name,
        sensor=f"virtual {design.name}",
        force=VirtualForce(world),  # first: it lets time pass
        stage=VirtualStage(world),
        camera=VirtualCamera(world),
        limits=limits or _limits(travel, age_s),
        origin_m=ORIGIN_M,
        clock=clock,
        regions=tuple(Region(*one) for one in design.regions().items()),
        licence="CC0-1.0",
        origin="recorded on palpate's virtual rig",
        provenance=Provenance.SIMULATED,
        seed=seed,
        truth=lambda time_ns: truth_at(world, truths, time_ns)[1],
        truths=truths,
        mount=world.mount,
        known_m=world.known_m,
        design=design,
        noise_n=vary.sample_noise_n,
    )


def truth_at(world: World, truths: tuple[str, ...], time_ns: int) -> tuple[Touch | None, dict[str, float]]:
    """Touch and labels at the middle of the exposure of a frame that arrived at a time [ns]."""
    touch = world.touch_at(time_ns / 1e9 - TRANSPORT_S - world.sensor.exposure_s / 2)
    if touch is None:
        return None, dict.fromkeys(truths, 0.0)
    area_mm2 = 1e6 * math.pi * world.radius_at(touch.depth_m) ** 2
    values = (max(touch.depth_m, 0.0) * 1e3, touch.force_n[2], area_mm2)
    return touch, dict(zip(truths, values, strict=False))


def _limits(travel: Travel, age_s: float | None) -> Limits:
    usual = Limits(travel.least_m, travel.greatest_m, force_n=FORCE_N)
    return usual if age_s is None else replace(usual, age_s=age_s)


def default_variation(sensor: Sensor, name: str) -> Variation:
    """How presses of a sensor differ, as it says itself.

    Raises:
        InputError: it says so in fields that there are not.
    """
    sizes: dict[str, Any] = dict(variation_of(sensor))
    try:
        return replace(Variation(), **sizes)
    except TypeError as e:
        raise InputError(f"{name}: variation() gives fields of the rig's Variation: {e}") from e


AIR_M = 5e-3  # above the skin: where the probe is taken to be before the stage knows its place


class FollowedWorld(World):
    """World whose probe is wherever a stage says that it is.

    Args:
        stage: that is asked; what it cannot answer, as before it is homed, leaves the probe where it was.
        design: name of the sensor's design.
        clock: time.
        origin_m: expected surface of the skin, in the stage's frame [m].
        seed: of all that varies.
        askew_m: where the skin lies, from where it is expected.
    """

    def __init__(
        self, stage: Stage, design: str, clock: Clock, origin_m: Position, seed: int, askew_m: Position
    ) -> None:
        sensor = for_rig(sensor_of(design))
        self._followed = stage
        self._track: deque[tuple[float, Position]] = deque()
        vary = replace(default_variation(sensor, design), backlash_m=0.0)  # the stage has its own
        super().__init__(
            sensor, clock, stage.travel, origin_m, vary, FORCE_HZ, seed, faults=(), askew_m=askew_m
        )
        x, y, z = origin_m
        self._track.append((self.now_s, (x, y, max(stage.travel.least_m[2], z - AIR_M))))

    def advance(self) -> None:
        """Bring everything up to the clock's time, the stage's place first."""
        with self.lock:
            self._look()
            super().advance()

    def _look(self) -> None:
        try:
            place = self._followed.position_m()
        except DeviceError:
            place = self._track[-1][1]
        self._track.append((self.now_s, place))
        while len(self._track) > 2 and self._track[1][0] < self.now_s - KEPT_S:
            self._track.popleft()

    def _targets(self, times: Float[ndarray, " n"]) -> Float[ndarray, "n 3"]:
        at_s = [time_s for time_s, _ in self._track]
        places = np.array([place for _, place in self._track])
        return np.stack([np.interp(times, at_s, places[:, axis]) for axis in range(3)], axis=1)
