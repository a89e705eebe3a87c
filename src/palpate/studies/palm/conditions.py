"""Conditions that no model has learnt from, recorded on the virtual rig, and what becomes of the scores."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from palpate.recordings.reader import Run
from palpate.rig.plans import Dwell, Listed, Stepped
from palpate.rig.virtual.variation import Variation
from palpate.sensors.palm import PalmSpec
from palpate.sensors.palm.wear import Wear, worn
from palpate.studies.palm.headline import CAMPAIGN
from palpate.studies.palm.scale import MODELS, Scale
from palpate.studies.palm.workshop import Workshop, noisier, ways

NOISES = (0.5, 1.0, 2.0, 4.0)
PRESSES = (100.0, 1000.0, 3000.0, 10_000.0, 30_000.0)

Change = Callable[[PalmSpec], tuple[PalmSpec, Variation]]


def _spec(**fields: Any) -> Change:
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
        grid: at the grid's own places, instead of the ones off it.
    """

    name: str
    said: str
    change: Change = field(default_factory=_spec)
    campaign: int = CAMPAIGN
    grid: bool = False


CONDITIONS: tuple[Condition, ...] = (
    Condition("unchanged", "as calibrated"),
    Condition("again", "the grid's own places, in cycles not seen", campaign=2000, grid=True),
    Condition("stiffer", "a membrane 10 % stiffer", _scaled("youngs_modulus_pa", 1.1)),
    Condition("softer", "a membrane 10 % softer", _scaled("youngs_modulus_pa", 0.9)),
    Condition("brighter", "the lamp 5 % brighter", _spec(lamp_gain=1.05)),
    Condition("dimmer", "the lamp 20 % dimmer", _spec(lamp_gain=0.8)),
    Condition("warmer", "the lamp warmer by 30 mired", _spec(lamp_mired=30.0)),
    Condition("room-light", "room light of 5 % of the lamp's", _spec(ambient=0.05)),
    Condition("hazy", "a membrane with 10 % haze", _spec(wear=Wear(haze=0.1))),
    Condition("scratched", "a membrane with 8 scratches", _spec(wear=Wear(scratches=8))),
    Condition("yellowed", "a yellowed membrane (absorbance 0.1 at 450 nm)", _spec(wear=Wear(yellowing=0.1))),
    Condition("occluded", "the probe out of the mirror's sight", _spec(probe_in_mirror=False)),
    Condition("opaque", "an opaque underside", _spec(opaque_underside=True)),
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
        Condition(f"pressed-{presses:g}", f"after {presses:g} presses", _spec(wear=worn(presses)))
        for presses in PRESSES
    )
    return [
        {"presses": presses, "models": _models(shop, one)}
        for presses, one in zip(PRESSES, every, strict=True)
    ]


def _models(shop: Workshop, one: Condition) -> dict[str, Any]:
    spec, variation = one.change(shop.spec)
    plan = _plan(shop.scale, shop.seed, one)
    run = shop.recorded(one.name, plan, spec, variation, shop.seed + one.campaign)
    return {model: shop.scored(way, run, one.said) for model, way in ways(MODELS, shop.scale).items()}


def _plan(scale: Scale, seed: int, one: Condition) -> Stepped:
    if one.grid:
        changed = {"cycles": 1, "frames": 1, "step_mm": scale.coarse_step_mm}
        return scale.protocol().model_copy(update=changed)
    return scale.new_places(seed, coarse=True)


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
