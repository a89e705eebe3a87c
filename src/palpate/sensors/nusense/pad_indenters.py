"""Indenters of NUSense: parsing, and gap to the pad."""

from __future__ import annotations

import math

import numpy as np

from palpate.core import Field, Float, InputError, Probe, ndarray
from palpate.mechanics.layers import indenters

EDGE_RADIUS_M = 2e-3  # edge radius of the long tip (assumed)
ROUNDED = 0.1  # rim radius of a flat tip over its radius (assumed)

WORDS = {
    "sphere": "sphere:DIAMETER_MM",
    "punch": "punch:DIAMETER_MM",
    "edge": "edge:LENGTH_MM[:TURN_DEG]",
    "two-points": "two-points:DIAMETER_MM:APART_MM[:TURN_DEG]",
}
COUNTS = {"sphere": (1, 1), "punch": (1, 1), "edge": (1, 2), "two-points": (2, 3)}
NAMES = {"round": "sphere:10", "flat": "punch:10"}
MAX_MM = 60.0

Axis = Float[ndarray, " _"]


def parse_indenter(words: str) -> Probe:
    """Parse an indenter: ``round`` and ``flat`` (tips of 5 mm radius), ``edge:30:60``, ``two-points:4:12``.

    Example:
        >>> parse_indenter("round").radius_m
        0.005
    """
    shape, *sizes = NAMES.get(words, words).split(":")
    low, high = COUNTS.get(shape, (1, 0))
    try:
        numbers = [float(size) for size in sizes]
    except ValueError:
        numbers = []
    turns = len(numbers) == high and high > low
    lengths = numbers[:-1] if turns else numbers
    if not (low <= len(numbers) <= high and all(0 < n <= MAX_MM for n in lengths)) or not all(
        math.isfinite(n) for n in numbers
    ):
        raise InputError(
            f"indenter {words!r}; NUSense knows {', '.join([*NAMES, *WORDS.values()])}, sizes above 0 to "
            f"{MAX_MM:g} mm",
            code="unknown-name",
        )
    turn = math.radians(numbers[-1]) if turns else 0.0
    if shape == "edge":
        return Probe("cylinder", EDGE_RADIUS_M, 1e-3 * numbers[0], turn)
    return Probe(shape, 0.5e-3 * numbers[0], 1e-3 * lengths[1] if len(lengths) > 1 else 0.0, turn)


def gap_under(probe: Probe, x_m: Axis, y_m: Axis) -> Field:
    """Return the height of a probe over the flat pad at first touch, with its axis at 0 [m]."""
    if probe.tilt_rad:
        raise InputError(
            "an indenter that leans on NUSense is not modelled; hold it upright", code="inclined-indenter"
        )
    R = probe.radius_m
    if probe.shape == "sphere":
        return indenters.sphere(x_m, y_m, R)
    if probe.shape == "punch":
        return indenters.flat_punch(x_m, y_m, R, ROUNDED * R)
    if probe.shape == "cylinder":
        return indenters.lying_cylinder(x_m, y_m, R, probe.length_m, probe.turn_rad)
    if probe.shape == "two-points":
        dx, dy = (probe.length_m / 2 * f(probe.turn_rad) for f in (math.cos, math.sin))
        return indenters.balls(x_m, y_m, R, [(-dx, -dy, 0.0), (dx, dy, 0.0)])
    raise InputError(
        f"NUSense does not know a probe of the shape {probe.shape!r}; {', '.join(WORDS)} it does"
    )


def reaches(probe: Probe, depth_m: float) -> tuple[float, float]:
    """Return half the sides of a box around any contact at a depth [m]."""
    if probe.shape == "punch":
        return probe.radius_m, probe.radius_m
    wide = math.sqrt(2 * probe.radius_m * min(depth_m, probe.radius_m))
    x, y = (abs(probe.length_m / 2 * f(probe.turn_rad)) for f in (math.cos, math.sin))
    return wide + x, wide + y


def steepness(probe: Probe) -> float:
    """Return the exponent of force over depth in the lightest touch."""
    return {"punch": 1.0, "cylinder": 1.1}.get(probe.shape, 1.5)


def is_round(probe: Probe) -> bool:
    """Return whether a probe is rotationally symmetric."""
    return bool(np.isclose(probe.length_m, 0.0))
