"""Indenters beyond the ball: from a word to a probe, and from a probe to the gap that the mechanics press."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray

from palpate.core.axes import Field
from palpate.core.contact import Probe
from palpate.core.errors import InputError
from palpate.mechanics import gap

EDGE_SLOPE_RAD = math.radians(30)
"""Of both sides of the edge against the skin: a blunt blade, gentle enough for small strain."""

ROUNDED = 0.1
"""Radius of a punch's rounded edge over its own radius."""

SIDE = 0.8
"""How squarely the sides of edges, punches and cylinders face the viewer. Assumed, for the picture's sake."""

SIZES = {
    "sphere": "DIAMETER_MM",
    "punch": "DIAMETER_MM",
    "edge": "LENGTH_MM[:TURN_DEG]",
    "cylinder": "DIAMETER_MM:LENGTH_MM[:TURN_DEG]",
    "two-points": "DIAMETER_MM:APART_MM[:TURN_DEG]",
}
LEAST = {"sphere": 1, "punch": 1, "edge": 1, "cylinder": 2, "two-points": 2}


def parse_probe(text: str) -> Probe:
    """A probe from words such as ``sphere:10``, ``cylinder:6:12:45``, ``two-points:5:8``.

    Raises:
        InputError: an unknown shape, or sizes that do not fit it.

    Example:
        >>> parse_probe("sphere:10")
        Probe(shape='sphere', radius_m=0.005, length_m=0.0, turn_rad=0.0)
    """
    shape, *words = text.split(":")
    shape = "punch" if shape == "flat" else shape
    allowed = ", ".join(f"{name}:{sizes}" for name, sizes in SIZES.items())
    try:
        sizes = [float(word) for word in words]
    except ValueError:
        sizes = []
    if shape not in SIZES or not LEAST[shape] <= len(sizes) <= SIZES[shape].count(":") + 1:
        raise InputError(f"indenter {text!r} is none of {allowed}")
    lengths = sizes[: LEAST[shape]]
    if not all(math.isfinite(size) for size in sizes) or min(lengths) <= 0:
        raise InputError(f"indenter {text!r}: its sizes must be positive, in mm")
    turn = math.radians(sizes[LEAST[shape]]) if len(sizes) > LEAST[shape] else 0.0
    if shape == "edge":
        return Probe(shape, 0.0, lengths[0] * 1e-3, turn)
    return Probe(shape, lengths[0] / 2e3, lengths[1] * 1e-3 if len(lengths) > 1 else 0.0, turn)


def gap_of(
    probe: Probe, x_m: Float[ndarray, " nx"], y_m: Float[ndarray, " ny"], centre_m: tuple[float, float]
) -> Field:
    """Height of the probe over the flat skin at first touch, on a grid [m].

    Raises:
        InputError: a shape that has no gap.
    """
    R, L, turn = probe.radius_m, probe.length_m, probe.turn_rad
    match probe.shape:
        case "sphere":
            return gap.sphere(x_m, y_m, R, centre_m)
        case "punch":
            return gap.flat_punch(x_m, y_m, R, ROUNDED * R, centre_m)
        case "edge":
            return gap.wedge(x_m, y_m, EDGE_SLOPE_RAD, L, turn, centre_m)
        case "cylinder":
            return gap.lying_cylinder(x_m, y_m, R, L, turn, centre_m)
        case "two-points":
            return gap.two_points(x_m, y_m, R, L, turn, centre_m)
        case _:
            raise InputError(f"no palm knows a {probe.shape!r}; there are {', '.join(SIZES)}")


def silhouette(
    probe: Probe, depth_m: float, across_m: Float[ndarray, " w"], z_m: Float[ndarray, " h"]
) -> Float32[ndarray, "h w"]:
    """How squarely a probe faces a viewer along y, 0 to 1; 0 beside it, and where there is none.

    Args:
        probe: what is looked at. Balls are shaded; the sides of all else face the viewer alike.
        depth_m: of its lowest point, negative in the air [m]; 0 for no probe.
        across_m: places beside its centre [m]; infinite ones are beside it.
        z_m: heights, into the skin [m].
    """
    facing = np.zeros((len(z_m), len(across_m)), np.float32)
    near = np.flatnonzero(np.abs(across_m) <= reach_of(probe))
    if depth_m == 0 or not len(near):
        return facing
    x, above = across_m[near], depth_m - z_m[:, None]
    if probe.shape in ("sphere", "two-points"):
        apart = probe.length_m / 2 * math.cos(probe.turn_rad)
        R2 = probe.radius_m**2
        left = [R2 - (x - side) ** 2 - (above - probe.radius_m) ** 2 for side in (-apart, apart)]
        facing[:, near] = np.sqrt(np.maximum(np.maximum(*left), 0) / R2)
        return facing
    y = np.linspace(-1, 1, 201) * reach_of(probe)
    lowest = gap_of(probe, x, y, (0.0, 0.0)).min(axis=0)
    top = 2 * probe.radius_m - lowest if probe.shape == "cylinder" else np.inf
    facing[:, near] = SIDE * ((above > lowest) & (above < top))
    return facing


def reach_of(probe: Probe) -> float:
    """How far from its centre the probe may touch [m]."""
    return probe.radius_m + probe.length_m / 2
