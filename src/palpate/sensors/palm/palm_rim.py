"""Effect of the membrane's free rim on a press of the palm's ball, from three-dimensional solutions.

Near the rim the normal force falls by a ratio k(c, d) of offset and depth, and the membrane pushes the ball
outwards by a fraction s(c, d) of the centred force. Beyond the solved range the nearest solved press holds.
In the image all stress is multiplied by k; its shape stays that of a centred press.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from palpate.core import Float, PlaceEffect, Pose, RangeError, ndarray
from palpate.mechanics.axisymmetric.disc_table import SAME
from palpate.mechanics.axisymmetric.sphere_table import (
    SLACK,
    EdgeReach,
    edge_correction_held,
    edge_reach,
)
from palpate.sensors.palm.palm_spec import PalmSpec
from palpate.sensors.palm.uneven_membrane import modulus_ratios

SOLVED_RADIUS = 5.7  # disc radius of the solutions, in ball radii
ALIKE = 0.1  # relative difference of thickness within which a solution applies (assumed)

Series = Float[ndarray, " n"]


class RimEffect(NamedTuple):
    """Effect of the rim relative to the centred press.

    Attributes:
        force_ratio: Ratio of normal force, and with it of pressure and stress.
        push_ratio: Outward force on the ball over the centred normal force.
        solved: Whether position and depth lie within the solved range.
    """

    force_ratio: float
    push_ratio: float
    solved: bool


NO_EFFECT = RimEffect(1.0, 0.0, solved=True)


def rim_reach(spec: PalmSpec) -> EdgeReach | None:
    """Return the solved offsets and depths, in ball radii; None for other proportions."""
    R = spec.indenter_radius_m
    if not math.isclose(spec.radius_m, SOLVED_RADIUS * R, rel_tol=SAME):
        return None
    try:
        return edge_reach(_thickness(spec))
    except RangeError:
        return None


def rim_effect(spec: PalmSpec, pose: Pose) -> RimEffect:
    """Return the rim's effect on a press of the spec's ball, whether or not the spec applies it."""
    reach, R = _checked_reach(spec), spec.indenter_radius_m
    offset, depth = math.hypot(pose.x_m, pose.y_m) / R, pose.depth_m / R
    ratio, push = edge_correction_held(np.array([offset]), np.array([depth]), _thickness(spec))
    solved = offset <= reach.offset * (1 + SLACK) and depth <= reach.depth * (1 + SLACK)
    return RimEffect(float(ratio[0]), float(push[0]), solved)


def applied_rim(spec: PalmSpec, pose: Pose) -> RimEffect:
    """Return the rim's effect if the spec applies it and the ball presses, else no effect."""
    if spec.rim != "applied" or not pose.depth_m > 0:
        return NO_EFFECT
    return rim_effect(spec, pose)


def lateral_of(effect: RimEffect, pose: Pose, centred_n: float) -> tuple[float, float]:
    """Return the force of the ball on the membrane (x, y), towards the axis, for a centred normal force
    [N].
    """
    away = math.hypot(pose.x_m, pose.y_m)
    if away == 0 or effect.push_ratio == 0:
        return 0.0, 0.0
    inwards = -effect.push_ratio * centred_n / away
    return inwards * pose.x_m, inwards * pose.y_m


def rim_by_place(spec: PalmSpec) -> Callable[[ndarray, ndarray, ndarray], PlaceEffect] | None:
    """Return how rim and uneven modulus change the ball's force law by position; None if they do not."""
    if spec.gel.thickness:
        raise RangeError(
            f"a thickness that varies by {spec.gel.thickness} has no one force law; a rig presses membranes "
            "of even thickness: set the gel's thickness to 0"
        )
    if spec.rim != "applied":
        return partial(_by_modulus, spec) if spec.gel.modulus else None
    _checked_reach(spec)
    return partial(_at_places, spec)


def _by_modulus(spec: PalmSpec, x_m: Series, y_m: Series, depth_m: Series) -> PlaceEffect:
    return PlaceEffect(modulus_ratios(spec, x_m, y_m), np.zeros((len(x_m), 2)))


def _at_places(spec: PalmSpec, x_m: Series, y_m: Series, depth_m: Series) -> PlaceEffect:
    R, away = spec.indenter_radius_m, np.hypot(x_m, y_m)
    ratio, push = edge_correction_held(away / R, depth_m / R, _thickness(spec))
    inwards = -push / ratio / np.maximum(away, SAME * R)
    stiffer = modulus_ratios(spec, x_m, y_m)
    return PlaceEffect(ratio * stiffer, inwards[:, None] * np.stack([x_m, y_m], axis=1))


def _checked_reach(spec: PalmSpec) -> EdgeReach:
    if (reach := rim_reach(spec)) is not None:
        return reach
    R = spec.indenter_radius_m
    raise RangeError(
        f"near the rim of a membrane {spec.thickness_m * 1e3:g} mm thick and {spec.diameter_m * 1e3:g} mm "
        f"wide no press of a ball of {2e3 * R:g} mm was solved; solved were, under this ball, membranes "
        f"{2e3 * SOLVED_RADIUS * R:g} mm wide and {2e3 * R:g} or {4e3 * R:g} mm thick: choose these, or a "
        "spec whose rim is 'stated'",
        code="rim-not-solved",
    )


def _thickness(spec: PalmSpec) -> float:
    """Thickness in ball radii: of the nearest solved disc within `ALIKE`, else its own, rounded."""
    own = round(spec.thickness_m / spec.indenter_radius_m, 6)
    near = [solved for solved in (2.0, 4.0) if abs(own / solved - 1) <= ALIKE]
    return near[0] if near else own
