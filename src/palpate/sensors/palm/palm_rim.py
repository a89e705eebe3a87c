"""What the membrane's free rim does to a press of the palm's ball, from solutions in three dimensions.

The press table was solved in the middle of its disc. Nearer to the rim the membrane gives way: the normal
force is less, by a ratio k(c, d) of offset c and depth d, and the membrane pushes the ball outwards, by a
share s(c, d) of the centred force. Both are read from `sphere_table.edge_correction_held`, for the tables'
discs alone; beyond the places and depths that were solved those of the nearest solved press hold.

Of the picture, all stress is taken times k, as if the coefficient C were. Its shape stays that of a press in
the middle.
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

SOLVED_RADIUS = 5.7  # of the discs, in ball radii
ALIKE = (
    0.1  # share by which a thickness may differ from one that was solved and have its rim's effect. Assumed.
)

Series = Float[ndarray, " n"]


class RimEffect(NamedTuple):
    """What the rim does to one press, over the same press in the middle.

    Attributes:
        force_ratio: normal force, and with it pressure and stress, over those of the centred press.
        push_ratio: force of the membrane on the ball, outwards, over the centred press's normal force.
        solved: whether place and depth lie within what was solved; beyond, the nearest solved press holds.
    """

    force_ratio: float
    push_ratio: float
    solved: bool


NO_EFFECT = RimEffect(1.0, 0.0, solved=True)


def rim_reach(spec: PalmSpec) -> EdgeReach | None:
    """How far out and how deep the rim's effect was solved, in ball radii; None for other proportions."""
    R = spec.indenter_radius_m
    if not math.isclose(spec.radius_m, SOLVED_RADIUS * R, rel_tol=SAME):
        return None
    try:
        return edge_reach(_thickness(spec))
    except RangeError:
        return None


def rim_effect(spec: PalmSpec, pose: Pose) -> RimEffect:
    """Effect of the rim on a press of the spec's ball, whether the spec applies it or not.

    Args:
        spec: the palm; its Poisson's ratio and friction are taken for the solutions', 0.49 and none.
        pose: where and how deep.
    """
    reach, R = _checked_reach(spec), spec.indenter_radius_m
    offset, depth = math.hypot(pose.x_m, pose.y_m) / R, pose.depth_m / R
    ratio, push = edge_correction_held(np.array([offset]), np.array([depth]), _thickness(spec))
    solved = offset <= reach.offset * (1 + SLACK) and depth <= reach.depth * (1 + SLACK)
    return RimEffect(float(ratio[0]), float(push[0]), solved)


def applied_rim(spec: PalmSpec, pose: Pose) -> RimEffect:
    """The same as far as the spec applies it: none where it only states it, or nothing is pressed."""
    if spec.rim != "applied" or not pose.depth_m > 0:
        return NO_EFFECT
    return rim_effect(spec, pose)


def lateral_of(effect: RimEffect, pose: Pose, centred_n: float) -> tuple[float, float]:
    """Force of the ball on the membrane along x and y: towards the axis, against the push [N].

    Args:
        effect: of the rim.
        pose: where.
        centred_n: normal force of the same press in the middle [N].
    """
    away = math.hypot(pose.x_m, pose.y_m)
    if away == 0 or effect.push_ratio == 0:
        return 0.0, 0.0
    inwards = -effect.push_ratio * centred_n / away
    return inwards * pose.x_m, inwards * pose.y_m


def rim_by_place(spec: PalmSpec) -> Callable[[ndarray, ndarray, ndarray], PlaceEffect] | None:
    """What places do to the ball's force law, by the rim and an uneven modulus; None where they do nothing."""
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
    """In ball radii: that of the nearest solved disc within a tenth of it, or its own, to rounding."""
    own = round(spec.thickness_m / spec.indenter_radius_m, 6)
    near = [solved for solved in (2.0, 4.0) if abs(own / solved - 1) <= ALIKE]
    return near[0] if near else own
