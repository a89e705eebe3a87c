"""Conditions that no model has learnt from, recorded on the virtual rig, and what becomes of the scores."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from palpate.recordings.reader import Run
from palpate.rig.plans import Dwell, Listed, Stepped
from palpate.rig.virtual.variation import Variation
from palpate.sensors.palm import PalmSpec
from palpate.studies.palm.headline import CAMPAIGN
from palpate.studies.palm.scale import MODELS, Scale
from palpate.studies.palm.workshop import Workshop, noisier, ways

NOISES = (0.5, 1.0, 2.0, 4.0)

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
    Condition("again", "the grid's places, in cycles not seen", campaign=2000, grid=True),
    Condition("stiffer", "a membrane 10 % stiffer", _scaled("youngs_modulus_pa", 1.1)),
    Condition("softer", "a membrane 10 % softer", _scaled("youngs_modulus_pa", 0.9)),
    Condition("brighter", "the lamp 5 % brighter", _spec(lamp_gain=1.05)),
    Condition("dimmer", "the lamp 20 % dimmer", _spec(lamp_gain=0.8)),
)


def conditions(shop: Workshop, found: Mapping[str, Condition]) -> dict[str, Any]:
    """Every model's scores under each condition."""
    return {name: {"said": one.said, "models": _models(shop, one)} for name, one in found.items()}


def noise(shop: Workshop) -> list[dict[str, Any]]:
    """Every model, taught at the rig's own noise, on places off the grid at so many times that noise."""
    found = []
    for times in NOISES:
        one = Condition(f"noise-{times:g}", f"{times:g} times the noise", _noise(times))
        found.append({"times": times, "models": _models(shop, one)})
    return found


def _models(shop: Workshop, one: Condition) -> dict[str, Any]:
    spec, variation = one.change(shop.spec)
    plan = _plan(shop.scale, shop.seed, one)
    run = shop.recorded(one.name, plan, spec, variation, shop.seed + one.campaign)
    return {model: shop.scored(way, run, one.said) for model, way in ways(MODELS, shop.scale).items()}


def _plan(scale: Scale, seed: int, one: Condition) -> Stepped:
    if one.grid:
        return scale.protocol().model_copy(update={"cycles": 1, "frames": 1})
    return scale.new_places(seed)


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
