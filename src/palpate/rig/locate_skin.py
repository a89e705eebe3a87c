"""Location of the layer in the stage's frame, from where a ball touched it: centre, height, tilt, width.

Inside the rim the ball rests on the layer's plane. Beyond it, it rests on the rim's edge, lower by as much as
a sphere falls away at the distance between its axis and the edge; so from how low it came, that distance
follows. Contact is said by a force, a little after first touch; that little is the same on both sides, and
drops out of the centre where the layer lies nearly in the middle already. Done twice, it does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from palpate.core import Position, RecordingError
from palpate.recordings.run_reader import Run
from palpate.rig.plans.plan_files import plan_from
from palpate.rig.plans.press_places import WAYS, Around
from palpate.rig.run_progress import PLAN, ZERO, fields_of

MM = 1e-3


@dataclass(frozen=True, slots=True)
class SkinPlacement:
    """Place of a layer.

    Attributes:
        origin_mm: its centre at its surface, in the stage's frame: the `origin_mm` of a rig's file [mm].
        moved_mm: that, from the origin that the rig was opened with [mm].
        tilt_mrad: how much lower it lies per metre along x and y [mm/m].
        diameter_mm: along x and y [mm]; larger than it is by what lies between first touch and the threshold.
        step_mm: of the search for contact: none of this is known better [mm].
        off_plane_mm: the furthest of the five inside places from a plane [mm].
    """

    origin_mm: tuple[float, float, float]
    moved_mm: tuple[float, float, float]
    tilt_mrad: tuple[float, float]
    diameter_mm: tuple[float, float]
    step_mm: float
    off_plane_mm: float


def goes_around(run: Run) -> bool:
    """Whether a run is of a plan that touches a layer inside and beyond its rim."""
    plans = fields_of(run, PLAN)
    return bool(plans) and isinstance(plan_from(plans[0]["plan"]).places, Around)  # type: ignore[arg-type]


def locate_skin(run: Run) -> SkinPlacement:
    """The layer that a run of the plan "layer" has touched.

    Raises:
        RecordingError: the run has another plan, or not all places were touched.
    """
    plans = fields_of(run, PLAN)
    plan = plan_from(plans[0]["plan"]) if plans else None  # type: ignore[arg-type]
    if plan is None or not isinstance(plan.places, Around):
        raise RecordingError(
            f"{run.path} does not go around a layer; record one with --plan layer, or with a plan "
            'whose places are of the kind "around"'
        )
    touches = {str(zero["place"]): _touched(zero) for zero in fields_of(run, ZERO)}
    missing = [place.name for place in plan.places.places() if place.name not in touches]
    if missing:
        raise RecordingError(f"{run.path} has not touched {', '.join(missing)} yet; record it to its end")
    inside = np.array([touches[name] for name in ("middle", *(f"inside{way}" for way in WAYS))])
    plane, off = _plane(inside)
    rims = {way: _rim_mm(touches[f"rim{way}"], plane, plan.places.sizes_mm()[1] / 2) for way in WAYS}
    x, y = (rims["+x"] - rims["-x"]) / 2, (rims["+y"] - rims["-y"]) / 2
    moved = (x, y, float(plane @ (1.0, x, y)))
    return SkinPlacement(
        origin_mm=_from_stage(run, moved),
        moved_mm=moved,
        tilt_mrad=(1e3 * float(plane[1]), 1e3 * float(plane[2])),
        diameter_mm=(rims["+x"] + rims["-x"], rims["+y"] + rims["-y"]),
        step_mm=plan.seek_step_mm,
        off_plane_mm=off,
    )


def _touched(zero: dict[str, object]) -> tuple[float, float, float]:
    x, y, z = (float(zero[name]) for name in ("x_mm", "y_mm", "z_mm"))  # type: ignore[arg-type]
    return x, y, z


def _plane(at: np.ndarray) -> tuple[np.ndarray, float]:
    """Z = a + b x + c y through the places inside, and the furthest from it."""
    columns = np.column_stack([np.ones(len(at)), at[:, 0], at[:, 1]])
    plane, *_ = np.linalg.lstsq(columns, at[:, 2], rcond=None)
    return plane, float(np.abs(columns @ plane - at[:, 2]).max())


def _rim_mm(at: tuple[float, float, float], plane: np.ndarray, radius_mm: float) -> float:
    """Distance of the rim from the origin, on the way to a place beyond it."""
    x, y, z = at
    away = math.hypot(x, y)
    beyond = 0.0
    for _ in range(20):  # since the rim's height depends on where it is, and the tilt is slight
        share = (away - beyond) / away
        dropped = min(max(z - float(plane @ (1.0, share * x, share * y)), 0.0), radius_mm)
        beyond = math.sqrt(dropped * (2 * radius_mm - dropped))
    return away - beyond


def _from_stage(run: Run, moved_mm: Position) -> Position:
    rigs = fields_of(run, "rig")
    origin = rigs[-1].get("origin_m", (0.0, 0.0, 0.0)) if rigs else (0.0, 0.0, 0.0)
    x, y, z = (round(o / MM + m, 4) for o, m in zip(origin, moved_mm, strict=True))  # type: ignore[call-overload]
    return x, y, z
