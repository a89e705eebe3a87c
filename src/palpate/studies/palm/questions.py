"""What the source leaves open: leakage by grouping, representation against architecture, the mirror."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from palpate.estimators.certified import read_card
from palpate.estimators.networks import model_kind
from palpate.recordings.run_reader import Run
from palpate.studies.palm.headline import CAMPAIGN, small_way
from palpate.studies.palm.scores import scores_of
from palpate.studies.palm.workshop import LOCATIONS, Way, Workshop, ways

SMALL = "small-network"
GROUPINGS = {
    "(row, column)": "group:location",
    "(row, column, cycle)": "group:location,cycle",
    "row of the table": "random",
}

SEEINGS: dict[str, dict[str, Any]] = {
    "visible": {},
    "occluded": {"probe_in_mirror": False},
    "opaque underside": {"opaque_underside": True},
}
"""How the mirror sees the probe: through the membrane, not at all with the skin's dimple left, or nothing."""


def leakage(shop: Workshop) -> list[dict[str, Any]]:
    """The same models on the same frames, held out by place, by place and cycle, and by row of the table."""
    found = []
    for grouping, split in GROUPINGS.items():
        tag = "" if split == LOCATIONS else f"-by-{split.partition(':')[2].replace(',', '-') or split}"
        small = small_way(shop, f"{SMALL}{tag}", split=split)
        mlp = replace(ways(("palm-mlp-delta",), shop.scale)["palm-mlp-delta"], split=split)
        for model, way in (("small network", small), ("MLP", replace(mlp, name=f"{mlp.name}{tag}"))):
            found.append({"grouping": grouping, "model": model, **_on_both(shop, way)})
    return found


def factorial(shop: Workshop) -> list[dict[str, Any]]:
    """Colour and difference, each with and without, in one architecture."""
    found = []
    for colour, channels in (("RGB", 3), ("grey", 1)):
        for seen, delta in (("raw", False), ("delta", True)):
            tag = "" if (colour, seen) == ("RGB", "delta") else f"-{colour.lower()}-{seen}"
            way = small_way(shop, f"{SMALL}{tag}", channels=channels, delta=delta)
            found.append({"colour": colour, "seen": seen, **_on_both(shop, way)})
    return found


def mirror(shop: Workshop) -> list[dict[str, Any]]:
    """One architecture, learning and tested with the probe in sight, out of sight, and nothing in sight.

    Each way of seeing is learnt from and tested on all of them: a model that was taught with the probe in
    sight, and is tested without, tells what it had relied on; one taught without tells what is left.
    """
    runs = {}
    for name, fields in SEEINGS.items():
        spec, tag = replace(shop.spec, **fields), name.replace(" ", "-")
        if fields:
            shop.recorded(f"protocol-{tag}", shop.scale.protocol(), spec=spec)
            plan = shop.scale.new_places(shop.seed)
            shop.recorded(f"new-places-{tag}", plan, spec=spec, seed=shop.seed + CAMPAIGN)
        runs[name] = f"-{tag}" if fields else ""
    found = []
    for taught, tag in runs.items():
        way = small_way(shop, f"{SMALL}{tag}", run=f"protocol{tag}")
        for tested, other in runs.items():
            run = Run.open(shop.folder / "runs" / f"new-places{other}")
            found.append({"taught": taught, "tested": tested, **shop.scored(way, run, tested)})
    return found


def _on_both(shop: Workshop, way: Way) -> dict[str, Any]:
    """Scores on held-out rows, and on places off the grid, which no split has touched."""
    table, columns = shop.held_out(way), model_kind(way.model).targets
    card = read_card(shop.calibrated(way))
    new = shop.scored(way, Run.open(shop.folder / "runs" / "new-places"), "new places")
    return {
        "held_out": scores_of(table, columns),
        "new": new["targets"],
        "clean": card.split.clean,
        "audit": card.split.audit,
    }
