"""A contact too narrow for the palm's usual grid: solved on cells of its own, then laid onto that grid.

An edge that has just touched presses along a line, a ball at a point; the usual cells, sized for the whole
probe and the skin around it, do not resolve them. So the press is solved in the probe's own frame, unturned,
on a box that just holds where probe and undeformed skin overlap: contact is nowhere else. Its cells need not
be square. Each cell's force then goes to the four usual cells about it, by its distance from them, which
keeps the force and where it acts; the skin's displacement is that of these forces.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from palpate.core import Bool, Float, Pose, Probe, RangeError, ndarray
from palpate.mechanics.layers.contact_solver import StackContact, press_stack
from palpate.mechanics.layers.influence import normal_influence
from palpate.mechanics.layers.stack import Stack
from palpate.mechanics.layers.surface_grid import cells, laid_onto
from palpate.sensors.palm.probe_shapes import gap_of, parts_of, reaches_of

ACROSS = 64  # least number of cells of the box's side: 16 or so across an edge's contact
PER_CELL = 4  # least number of them along a usual cell, so that the forces lie evenly on those
MAX_CELLS = 1 << 20  # of the box, which points far apart need, as small as each is in a wide box
SAMPLES = 201  # along the side of a box, of which the part is searched that overlaps with the skin
SHRUNK = 0.9  # of its side: a box that shrinks by less fits
MAX_ZOOMS = 20

Axis = Float[ndarray, " n"]
Box = list[tuple[float, float]]


def press_narrow(
    stack: Stack, probe: Probe, pose: Pose, x_m: Float[ndarray, " nx"], y_m: Float[ndarray, " ny"]
) -> StackContact:
    """Press a probe whose contact is narrower than a few cells of a grid.

    Args:
        stack: what is pressed.
        probe, pose: what presses, where, and to which depth, above 0.
        x_m, y_m: columns and rows of the grid that the contact is given on, which holds all of it [m].

    Returns:
        The contact. Force, area and misfit are the narrow cells'; pressure, displacement and touching cells
        the grid's, where the contact covers two cells at least.
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
    """Press a probe at the origin on cells of at most a size, or of half of it and so on until they do."""
    x, y = (_centres(low, high, cell_m) for low, high in _overlap(probe, depth_m))
    try:
        return press_stack(stack, gap_of(probe, x, y, (0.0, 0.0)), x, y, depth_m=depth_m)
    except RangeError:
        if 4 * len(x) * len(y) > MAX_CELLS:
            raise
    return _solved(stack, probe, depth_m, cell_m / 2)


def _overlap(probe: Probe, depth_m: float) -> Box:
    """Least and greatest place along x and y at which a probe at the origin is below the flat skin [m]."""
    boxes = [
        [(low + at, high + at) for (low, high), at in zip(_zoomed(part, depth_m - up), place, strict=True)]
        for part, (*place, up) in parts_of(probe)
        if up < depth_m
    ]
    spans = zip(*boxes, strict=True)
    return [(min(low for low, _ in span), max(high for _, high in span)) for span in spans]


def _zoomed(part: Probe, depth_m: float) -> Box:
    """The same of one body, from all of its reach down to what overlaps."""
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
    """The part of an axis that is inside, with a sample on either side."""
    at = np.flatnonzero(inside)
    step = float(axis[1] - axis[0])
    return float(axis[at[0]]) - step, float(axis[at[-1]]) + step


def _length(span: tuple[float, float]) -> float:
    return span[1] - span[0]


def _centres(low: float, high: float, cell_m: float) -> Axis:
    """Centres of equal cells over a span, of at most a size, with one beyond either end."""
    count = max(ACROSS, math.ceil((high - low) / cell_m))
    step = (high - low) / count
    return (low + high) / 2 + (np.arange(count + 2) - (count + 1) / 2) * step
