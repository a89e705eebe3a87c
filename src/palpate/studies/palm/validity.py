"""Whether a calibration stands by the frames that it should, and by no others."""

from __future__ import annotations

from typing import Any

import numpy as np

from palpate.calibration.uncertainty import coverage_interval
from palpate.estimators.certified import Estimator
from palpate.recordings.labels import own_column
from palpate.recordings.run_reader import Run
from palpate.studies.palm.conditions import Condition, only, recorded
from palpate.studies.palm.loads import record_loads
from palpate.studies.palm.scale import MODELS
from palpate.studies.palm.workshop import Way, Workshop, ways

FOREIGN: tuple[Condition, ...] = (
    Condition("lamp-dim", "the lamp 30 % dimmer", only(lamp_gain=0.7)),
    Condition("lamp-bright", "the lamp 30 % brighter", only(lamp_gain=1.3)),
    Condition("lamp-warm", "the lamp warmer by 60 mired", only(lamp_mired=60.0)),
    Condition("lamp-cold", "the lamp colder by 60 mired", only(lamp_mired=-60.0)),
    Condition("room-bright", "room light of 20 % of the lamp's", only(ambient=0.2)),
    Condition("no-membrane", "no membrane", only(membrane=False)),
)


def validity(shop: Workshop) -> list[dict[str, Any]]:
    """Shares of frames that each calibration says are not of its kind, or out of its range."""
    every = ways(MODELS, shop.scale)
    new = Run.open(shop.folder / "runs" / "new-places")
    found = [
        _row("held-out places of the grid", True, {m: _held_out(shop, way) for m, way in every.items()}),
        _row("places off the grid", True, {m: _flags(shop, w, new) for m, w in every.items()}),
    ]
    for kind, said in (("two-contacts", "two contacts at once"), ("grasp", "three or four contacts at once")):
        run = record_loads(shop, kind)
        found.append(_row(said, False, {m: _flags(shop, way, run) for m, way in every.items()}))
    for one in FOREIGN:
        run = recorded(shop, one)
        found.append(_row(one.said, False, {m: _flags(shop, way, run) for m, way in every.items()}))
    return found


def _row(said: str, good: bool, flags: dict[str, np.ndarray]) -> dict[str, Any]:
    return {"said": said, "good": good, "models": {m: _rate(flagged) for m, flagged in flags.items()}}


def _rate(flagged: np.ndarray) -> dict[str, float]:
    low, high = coverage_interval(int(flagged.sum()), len(flagged))
    return {"flagged": float(flagged.mean()), "low": low, "high": high, "n": len(flagged)}


def _flags(shop: Workshop, way: Way, run: Run) -> np.ndarray:
    return ~shop.estimated(way, run, run.path.name)["valid"].to_numpy(bool)


def _held_out(shop: Workshop, way: Way) -> np.ndarray:
    """Of the rows that the calibration was scored by, each with its own press's untouched frame."""
    estimator = Estimator.open(shop.calibrated(way))
    run = Run.open(shop.folder / "runs" / way.run)
    table = run.labels
    reference = table["reference"].astype(bool).to_numpy()
    pressed, untouched = np.flatnonzero(~reference), np.flatnonzero(reference)
    zero_of = dict(zip(table["press"].iloc[untouched], untouched.tolist(), strict=True))
    flagged = []
    for row in pressed[own_column(shop.held_out(way), "row").to_numpy(int)]:
        zero = estimator.zero(run.frame(zero_of[table["press"].iloc[row]]).image)
        readings = estimator.read(run.frame(int(row)), zero)
        flagged.append(not all(reading.valid for reading in readings.values()))
    return np.array(flagged)
