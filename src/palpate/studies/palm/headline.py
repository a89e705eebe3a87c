"""The five models on places that they have not learnt from: the source's tables 2 and 3, and its figures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from palpate.estimators.certified import read_card
from palpate.estimators.networks import model_kind
from palpate.recordings.run_reader import Run
from palpate.studies.palm.scale import MODELS
from palpate.studies.palm.scores import scores_of
from palpate.studies.palm.workshop import Way, Workshop, ways

POINTS = 400  # of a figure, at most
CAMPAIGN = 1000  # added to the seed for the places off the grid


def record_both(shop: Workshop) -> dict[str, Any]:
    """The protocol at the grid's places, and a campaign of its own at places off the grid."""
    protocol = shop.recorded("protocol", shop.scale.protocol())
    new = shop.recorded("new-places", shop.scale.new_places(shop.seed), seed=shop.seed + CAMPAIGN)
    return {name: _told(run) for name, run in (("protocol", protocol), ("new-places", new))}


def _told(run: Run) -> dict[str, Any]:
    table = run.labels
    pressed = table[~table["reference"].astype(bool)]
    return {
        "frames": len(pressed),
        "places": int(pressed["location"].nunique()),
        "presses": int(pressed["press"].nunique()),
        "depth_mm": [float(pressed["depth_mm"].min()), float(pressed["depth_mm"].max())],
        "force_N": [float(pressed["force_N"].min()), float(pressed["force_N"].max())],
        "force_sd_N": float(pressed["force_N"].std()),
        "lateral_sd_N": [float(pressed[c].std()) for c in ("force_x_N", "force_y_N")],
        "hash": run.hash,
    }


def headline(shop: Workshop, model: str) -> dict[str, Any]:
    """One model: its scores on held-out places of the grid and on the campaign off it, and its points."""
    way = ways(MODELS, shop.scale)[model]
    table, card = shop.held_out(way), read_card(shop.calibrated(way))
    new = shop.estimated(way, Run.open(shop.folder / "runs" / "new-places"), "new places")
    columns = model_kind(model).targets
    return {
        "calibration": card.id,
        "seconds": card.seconds,
        "rows_learnt": card.split.rows_learnt,
        "options": card.options,
        "grid": scores_of(table, columns),
        "new": scores_of(new, columns),
        "new_valid": float(new["valid"].mean()),
        "points": _points(table, columns),
    }


def _points(table: pd.DataFrame, columns: tuple[str, ...]) -> dict[str, list[float]]:
    """Truth and estimate of some frames, spread evenly."""
    rows = np.unique(np.linspace(0, len(table) - 1, min(POINTS, len(table))).astype(int))
    names = [name for c in columns for name in (c, f"estimate:{c}", f"half_width:{c}")]
    names += [c for c in ("x_mm", "y_mm") if c not in columns]
    return {name: [round(float(v), 5) for v in table[name].iloc[rows]] for name in names}


def one_frame(shop: Workshop) -> dict[str, Any]:
    """The two-stage network on one held-out frame: what it is told, and what it says (figure 14)."""
    way = ways(MODELS, shop.scale)["palm-two-stage"]
    table = shop.held_out(way)
    errors = (table["estimate:depth_mm"] - table["depth_mm"]).abs()
    typical = int((errors - errors.median()).abs().argmin())
    row = table.iloc[typical]
    columns = ("depth_mm", "x_mm", "y_mm", "force_N")
    run = Run.open(shop.folder / "runs" / "protocol")
    pressed = np.flatnonzero(~run.labels["reference"].astype(bool).to_numpy())
    return {
        "frame": int(pressed[int(row["row"])]),
        "shot": str(row["shot"]),
        "true": {c: float(row[c]) for c in columns},
        "estimated": {c: float(row[f"estimate:{c}"]) for c in columns},
        "half_width": {c: float(row[f"half_width:{c}"]) for c in columns},
    }


def small_way(shop: Workshop, name: str, **changes: Any) -> Way:
    """The architecture that is trained many times over, on recorded presses alone."""
    return Way(name, "palm-compact", **{"options": dict(shop.scale.small), **changes})
