"""Effect of the membrane's free rim on a press of the palm's ball, from three-dimensional solutions.

Near the rim the normal force falls by a ratio k(c, d) of offset and depth, and the membrane pushes the ball
outwards by a fraction s(c, d) of the centred force. Beyond the solved range the nearest solved press holds.
In the image all stress is multiplied by k; its shape stays that of a centred press.

Press a contact that is too narrow for the palm's grid on a finer grid of its own.

The press is solved in the unrotated probe's frame on a box around the overlap of probe and membrane. Each
cell's force is then distributed to the four surrounding cells of the palm's grid, which preserves force and
moment; the displacement is that of these forces.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from palpate.core import Bool, Float, PlaceEffect, Pose, Probe, RangeError, ndarray
from palpate.mechanics.axisymmetric.disc_table import SAME
from palpate.mechanics.axisymmetric.shape_table import (
    SLACK,
    EdgeReach,
    edge_correction_held,
    edge_reach,
)
from palpate.mechanics.layers.contact_solver import StackContact, press_stack
from palpate.mechanics.layers.influence import cells, laid_onto, normal_influence
from palpate.mechanics.layers.stack import Stack
from palpate.sensors.palm.membrane_faults import modulus_ratios
from palpate.sensors.palm.palm_spec import PalmSpec
from palpate.sensors.palm.probe_shapes import gap_of, parts_of, reaches_of

ACROSS = 64  # minimum cells per side of the box
PER_CELL = 4  # minimum cells per cell of the palm's grid
MAX_CELLS = 1 << 20  # maximum cells of the box
SAMPLES = 201  # samples per side in the search for the overlap
SHRUNK = 0.9  # relative size from which a box counts as converged
MAX_ZOOMS = 20

Axis = Float[ndarray, " n"]
Box = list[tuple[float, float]]


def press_narrow(
    stack: Stack, probe: Probe, pose: Pose, x_m: Float[ndarray, " nx"], y_m: Float[ndarray, " ny"]
) -> StackContact:
    """Press a probe whose contact is narrower than a few cells of a grid.

    Args:
        stack: Layers that are pressed.
        probe, pose: Indenter and its pose, depth above 0.
        x_m, y_m: Columns and rows of the grid of the returned contact [m].

    Returns:
        Contact with force, area, and misfit of the fine grid, and pressure, displacement, and touching cells
        of the given one.
    """
    narrow = _solved(stack, replace(probe, turn_rad=0.0), pose.depth_m, float(x_m[1] - x_m[0]) / PER_CELL)
    force_n = narrow.pressure_pa * cells(narrow.x_m, narrow.y_m).area_m2
    c, s = math.cos(probe.turn_rad), math.sin(probe.turn_rad)
    u, v = narrow.x_m[None, :], narrow.y_m[:, None]
    coarse = cells(x_m, y_m)
    laid_n = laid_onto(force_n, pose.x_m + c * u - s * v, pose.y_m + s * u + c * v, x_m, y_m)
    pressure_pa = laid_n / coarse.area_m2
    return replace(
        narrow,
        x_m=x_m,
        y_m=y_m,
        pressure_pa=pressure_pa,
        displacement_m=normal_influence(stack, coarse).apply(0, pressure_pa),
        touching=pressure_pa > 0.0,
    )


def _solved(stack: Stack, probe: Probe, depth_m: float, cell_m: float) -> StackContact:
    """Press a probe at the origin, halving the cells until they resolve the contact."""
    x, y = (_centres(low, high, cell_m) for low, high in _overlap(probe, depth_m))
    try:
        return press_stack(stack, gap_of(probe, x, y, (0.0, 0.0)), x, y, depth_m=depth_m)
    except RangeError:
        if 4 * len(x) * len(y) > MAX_CELLS:
            raise
    return _solved(stack, probe, depth_m, cell_m / 2)


def _overlap(probe: Probe, depth_m: float) -> Box:
    """Bounds along x and y where a probe at the origin is below the flat surface [m]."""
    boxes = [
        [(low + at, high + at) for (low, high), at in zip(_zoomed(part, depth_m - up), place, strict=True)]
        for part, (*place, up) in parts_of(probe)
        if up < depth_m
    ]
    spans = zip(*boxes, strict=True)
    return [(min(low for low, _ in span), max(high for _, high in span)) for span in spans]


def _zoomed(part: Probe, depth_m: float) -> Box:
    """Bounds of one body, narrowed from its whole reach to the overlap."""
    box = [(-reach, reach) for reach in reaches_of(part)]
    for _ in range(MAX_ZOOMS):
        x, y = (np.linspace(low, high, SAMPLES) for low, high in box)
        gap = gap_of(part, x, y, (0.0, 0.0))
        inside = gap - gap.min() < depth_m
        found = [_span(x, np.any(inside, axis=0)), _span(y, np.any(inside, axis=1))]
        fits = all(_length(new) > SHRUNK * _length(old) for new, old in zip(found, box, strict=True))
        box = found
        if fits:
            return box
    raise RangeError(f"no contact of a {part.shape} was found at a depth of {depth_m:g} m; press deeper")


def _span(axis: Axis, inside: Bool[ndarray, " n"]) -> tuple[float, float]:
    """Bounds of the inside part of an axis, with a sample on either side."""
    at = np.flatnonzero(inside)
    step = float(axis[1] - axis[0])
    return float(axis[at[0]]) - step, float(axis[at[-1]]) + step


def _length(span: tuple[float, float]) -> float:
    return span[1] - span[0]


def _centres(low: float, high: float, cell_m: float) -> Axis:
    """Centres of equal cells over a span, with one beyond either end."""
    count = max(ACROSS, math.ceil((high - low) / cell_m))
    step = (high - low) / count
    return (low + high) / 2 + (np.arange(count + 2) - (count + 1) / 2) * step


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
