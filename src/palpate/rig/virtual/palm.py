"""The virtual palm rig, put together."""

from __future__ import annotations

from collections.abc import Sequence

from palpate.core.clock import Clock, ManualClock
from palpate.core.protocols import Position, Travel
from palpate.rig.limits import Limits
from palpate.rig.rig import Region, Rig
from palpate.rig.virtual.camera import TRANSPORT_S, VirtualCamera
from palpate.rig.virtual.faults import Fault
from palpate.rig.virtual.force import VirtualForce
from palpate.rig.virtual.skin import law_of, own_ball
from palpate.rig.virtual.stage import VirtualStage
from palpate.rig.virtual.variation import Variation
from palpate.rig.virtual.world import World
from palpate.sensors import palm
from palpate.sensors.palm import PalmSpec
from palpate.sensors.palm.press import LINEAR_DEPTH_M

ORIGIN_M: Position = (0.0, 0.0, 0.0)
TRAVEL = Travel(
    least_m=(-40e-3, -40e-3, -30e-3),
    greatest_m=(40e-3, 40e-3, 12e-3),
    top_speed_m_s=50e-3,
    acceleration_m_s2=0.5,
    latency_s=0.004,
)
"""Of a small belt-free stage. Assumed."""

FRAME_PX = 128  # each side of both crops
FORCE_HZ = 200.0
FORCE_N = 35.0  # allowed
REAL_TIME_AGE_S = 0.5
"""Of the oldest force that is moved on in real time: it is measured when it is asked for, on a machine that
may have other work."""
TRUTHS = ("true_depth_mm", "true_force_N")


def virtual_palm(
    *,
    spec: PalmSpec | None = None,
    clock: Clock | None = None,
    seed: int = 0,
    variation: Variation | None = None,
    faults: Sequence[Fault] = (),
    limits: Limits | None = None,
    force_hz: float = FORCE_HZ,
    askew_m: Position = (0.0, 0.0, 0.0),
) -> Rig:
    """A stage, a force sensor and a camera around one palm.

    Args:
        spec: of the palm; by default both regions as squares of 128 px.
        clock: time; one that runs as fast as it is asked to, where left out.
        seed: of all that varies.
        variation: how presses differ.
        faults: what goes wrong, and when.
        limits: of motion; by default the whole travel and 35 N.
        force_hz: samples of force a second.
        askew_m: where the layer lies, from where the rig believes it to be.
    """
    spec = spec or palm.cropped(palm.palm(), FRAME_PX, "palm-rig")
    clock = clock or ManualClock()
    world = World(spec, clock, TRAVEL, ORIGIN_M, variation or Variation(), force_hz, seed, faults, askew_m)
    force = VirtualForce(world)
    camera = VirtualCamera(world)

    def truth(time_ns: int) -> dict[str, float]:
        """At the middle of the exposure that a frame's time tells of."""
        touch = world.touch_at(time_ns / 1e9 - TRANSPORT_S - spec.exposure_s / 2)
        if touch is None:
            return dict.fromkeys(TRUTHS, 0.0)
        return dict(zip(TRUTHS, (max(touch.depth_m, 0.0) * 1e3, touch.force_n[2]), strict=True))

    def fit(indenter: str) -> bool:
        world.fit(palm.parse_probe(indenter))
        return True

    def known_m(indenter: str, lateral: bool) -> float:
        probe = palm.parse_probe(indenter)
        return LINEAR_DEPTH_M if lateral or probe != own_ball(spec) else law_of(spec, probe).greatest_m

    return Rig(
        name="virtual:palm",
        sensor=f"virtual {spec.name}",
        stage=VirtualStage(world),
        force=force,
        camera=camera,
        limits=limits or Limits(TRAVEL.least_m, TRAVEL.greatest_m, force_n=FORCE_N),
        origin_m=ORIGIN_M,
        clock=clock,
        regions=(Region("fringes", spec.fringes.box_px), Region("mirror", spec.mirror.box_px)),
        licence="CC0-1.0",
        origin="recorded on palpate's virtual rig; virtual, not measured",
        seed=seed,
        truth=truth,
        truths=TRUTHS,
        fit=fit,
        known_m=known_m,
    )
