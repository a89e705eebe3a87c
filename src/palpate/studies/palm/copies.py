"""A user's own copy of the palm: what a calibration is worth on it as it is, and after a few presses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from palpate.calibration.adapt import adapt
from palpate.rig.plans import Stepped
from palpate.sensors.palm import PalmSpec
from palpate.studies.palm.scale import MODELS, Scale
from palpate.studies.palm.workshop import Workshop, ways

COPIED = ("palm-two-stage", "palm-compact")
LESSONS = (10, 20, 50)  # presses
COPY = 4000  # added to the seed for all that is recorded of the copy

STIFFER, DIMMER, WARMER_MIRED = 1.15, 0.9, 15.0
"""How the copy differs: silicone of another batch, and a lamp of another."""


def copy_of(spec: PalmSpec) -> PalmSpec:
    """Another palm of the same make."""
    return replace(
        spec,
        youngs_modulus_pa=STIFFER * spec.youngs_modulus_pa,
        lamp_gain=DIMMER * spec.lamp_gain,
        lamp_mired=WARMER_MIRED,
    )


def adaptation(shop: Workshop) -> list[dict[str, Any]]:
    """Scores on the copy after no, 10, 20 and 50 presses of it; "0" has the copy's own untouched frame."""
    spec = copy_of(shop.spec)
    test = shop.recorded("copy", shop.scale.new_places(shop.seed, coarse=True), spec, seed=shop.seed + COPY)
    found = []
    for model in COPIED:
        way = ways(MODELS, shop.scale)[model]
        found.append({"model": model, "presses": 0, **shop.scored(way, test, "a copy")})
        for presses in LESSONS:
            run = shop.recorded(f"copy-{presses}", _lesson(shop.scale, presses), spec, seed=shop.seed + COPY)
            out = shop.folder / "calibrations" / f"{model}-copy-{presses}"
            if not out.exists():
                adapt(shop.calibrated(way), run, out, shop.progress)
            found.append({"model": model, "presses": presses, **shop.scored_by(out, test, "a copy")})
    return found


def _lesson(scale: Scale, presses: int) -> Stepped:
    """Presses at places of their own."""
    plan = scale.new_places(1000 + presses, coarse=True)
    places = plan.places.model_copy(update={"count": presses})
    return plan.model_copy(update={"name": f"palm-lesson-{presses}", "places": places})
