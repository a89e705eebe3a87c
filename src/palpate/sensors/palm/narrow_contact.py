"""Press a contact that is too narrow for the palm's grid on a finer grid of its own.

The press is solved in the unrotated probe's frame on a box around the overlap of probe and membrane. Each
cell's force is then distributed to the four surrounding cells of the palm's grid, which preserves force and
moment; the displacement is that of these forces.
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
