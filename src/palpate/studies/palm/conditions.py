"""Conditions that no model has learnt from, recorded on the virtual rig, and what becomes of the scores."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from palpate.recordings.run_reader import Run
from palpate.rig.plans import Dwell, Listed, Stepped
from palpate.rig.virtual.variation import Variation
from palpate.sensors.palm import PalmSpec
from palpate.sensors.palm.wear import Wear, worn
from palpate.studies.palm.headline import CAMPAIGN
from palpate.studies.palm.scale import MODELS, Scale
from palpate.studies.palm.workshop import Workshop, noisier, ways

RING_MM = 23.0
NOISES = (0.5, 1.0, 2.0, 4.0)
PRESSES = (100.0, 1000.0, 3000.0, 10_000.0, 30_000.0)

Change = Callable[[PalmSpec], tuple[PalmSpec, Variation]]


def only(**fields: Any) -> Change:
    """The palm with some fields changed, and the rig's usual variation."""
    return lambda spec: (replace(spec, **fields), Variation())


def _scaled(name: str, by: float) -> Change:
    return lambda spec: (replace(spec, **{name: getattr(spec, name) * by}), Variation())


def _noise(times: float) -> Change:
    return lambda spec: noisier(spec, times)


@dataclass(frozen=True, slots=True)
class Condition:
    """Something that differs from the calibration.

    Attributes:
        name: of its recording.
        said: in words.
        change: of the palm and of what varies.
        campaign: added to the seed.
        where: "off" the grid, at the grid's "own" places, or "beyond" them.
    """

    name: str
    said: str
    change: Change = field(default_factory=only)
    campaign: int = CAMPAIGN
    where: Literal["off", "own", "beyond"] = "off"


CONDITIONS: tuple[Condition, ...] = (
    Condition("unchanged", "as calibrated"),
    Condition("again", "the grid's own places, in cycles not seen", campaign=2000, where="own"),
    Condition("beyond", "places beyond the grid, 23 mm from the middle", where="beyond"),
    Condition("stiffer", "a membrane 10 % stiffer", _scaled("youngs_modulus_pa", 1.1)),
    Condition("softer", "a membrane 10 % softer", _scaled("youngs_modulus_pa", 0.9)),
    Condition("brighter", "the lamp 5 % brighter", only(lamp_gain=1.05)),
    Condition("dimmer", "the lamp 20 % dimmer", only(lamp_gain=0.8)),
    Condition("warmer", "the lamp warmer by 30 mired", only(lamp_mired=30.0)),
    Condition("room-light", "room light of 5 % of the lamp's", only(ambient=0.05)),
    Condition("hazy", "a membrane with 10 % haze", only(wear=Wear(haze=0.1))),
    Condition("scratched", "a membrane with 8 scratches", only(wear=Wear(scratches=8))),
    Condition("yellowed", "a yellowed membrane (absorbance 0.1 at 450 nm)", only(wear=Wear(yellowing=0.1))),
    Condition("occluded", "the probe out of the mirror's sight", only(probe_in_mirror=False)),
    Condition("opaque", "an opaque underside", only(opaque_underside=True)),
)


def conditions(shop: Workshop) -> dict[str, Any]:
    """Every model's scores under each condition."""
    return {one.name: {"said": one.said, "models": _models(shop, one)} for one in CONDITIONS}


def noise(shop: Workshop) -> list[dict[str, Any]]:
    """Every model, taught at the rig's own noise, on places off the grid at so many times that noise."""
    every = (Condition(f"noise-{times:g}", f"{times:g} times the noise", _noise(times)) for times in NOISES)
    return [{"times": times, "models": _models(shop, one)} for times, one in zip(NOISES, every, strict=True)]


def durability(shop: Workshop) -> list[dict[str, Any]]:
    """Every model on a membrane that has been pressed so often, by the law of wear that is assumed."""
    every = (
        Condition(f"pressed-{presses:g}", f"after {presses:g} presses", only(wear=worn(presses)))
        for presses in PRESSES
    )
    return [
        {"presses": presses, "models": _models(shop, one)}
        for presses, one in zip(PRESSES, every, strict=True)
    ]


def recorded(shop: Workshop, one: Condition) -> Run:
    """A condition's recording."""
    spec, variation = one.change(shop.spec)
    plan = _plan(shop.scale, shop.seed, one)
    return shop.recorded(one.name, plan, spec, variation, shop.seed + one.campaign)


def _models(shop: Workshop, one: Condition) -> dict[str, Any]:
    run = recorded(shop, one)
    return {model: shop.scored(way, run, one.said) for model, way in ways(MODELS, shop.scale).items()}


def _plan(scale: Scale, seed: int, one: Condition) -> Stepped:
    plan = scale.new_places(seed, coarse=True)
    if one.where == "own":
        return plan.model_copy(update={"places": scale.protocol().places})
    if one.where == "beyond":
        return plan.model_copy(update={"places": Listed(kind="listed", at_mm=_ring(scale.places // 2))})
    return plan


def _ring(count: int) -> tuple[tuple[float, float], ...]:
    angles = [math.tau * (i + 0.5) / count for i in range(count)]
    return tuple((round(RING_MM * math.cos(a), 3), round(RING_MM * math.sin(a), 3)) for a in angles)


def sustained(shop: Workshop, seconds: float = 60.0) -> dict[str, Any]:
    """One press held: what every model says of depth and force while the skin relaxes."""
    plan = Stepped(
        name="palm-sustained",
        places=Listed(kind="listed", at_mm=((3.0, -4.0),)),
        cycles=1,
        frames=1,
        reference_frames=1,
        depth_mm=4.0,
        step_mm=1.0,
        dwell=Dwell(depths_mm=(4.0,), seconds=seconds, frames=60),
    )
    run = shop.recorded("sustained", plan, seed=shop.seed + 3000)
    return {"seconds": seconds, "models": _held(shop, run)}


def _held(shop: Workshop, run: Run) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for model, way in ways(MODELS, shop.scale).items():
        table = shop.estimated(way, run, "a press held")
        held = table[table["phase"] == "hold"]
        names = [c for c in ("depth_mm", "force_N") if f"estimate:{c}" in held]
        found[model] = {
            name: [round(float(v), 5) for v in held[name]] for c in names for name in (c, f"estimate:{c}")
        }
    return found
