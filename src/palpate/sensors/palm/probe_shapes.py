"""Probe shapes beyond the ball: parsing, gap to the membrane, and silhouette.

A probe of several balls is a rigid holder; tilting turns the holder.

Non-axisymmetric probes that have a finite-strain table for a palm's membrane.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from palpate.core import Field, Float, Float32, InputError, Probe, RangeError, ndarray
from palpate.mechanics.layers import contact_solver
from palpate.mechanics.probe_table import ProbeTable, probe_table_for, probe_tables
from palpate.sensors.palm.palm_spec import PalmSpec

EDGE_SLOPE_RAD = math.radians(30)  # slope of both sides of the edge, small enough for small strain
ROUNDED = 0.1  # edge radius of a punch over its radius
SIDE = 0.8  # brightness cosine of the sides of edges, punches, and cylinders (assumed)

SIZES = {
    "sphere": "DIAMETER_MM",
    "punch": "DIAMETER_MM",
    "edge": "LENGTH_MM[:TURN_DEG]",
    "cylinder": "DIAMETER_MM:LENGTH_MM[:TURN_DEG]",
    "two-points": "DIAMETER_MM:APART_MM[:TURN_DEG]",
}
MIN_SIZES = {"sphere": 1, "punch": 1, "edge": 1, "cylinder": 2, "two-points": 2}
POINTS = "points:DIAMETER_MM:X_MM,Y_MM[,HEIGHT_MM];..."
LEANING = "@TILT_DEG[:TOWARDS_DEG]"
MAX_TILT_DEG = math.degrees(contact_solver.MAX_TILT)

Place = tuple[float, float, float]


def parse_probe(text: str) -> Probe:
    """Parse a probe: ``sphere:10``, ``cylinder:6:12:45``, ``points:8:-7,0;7,3,0.2``, ``punch:6@5:90``.

    ``@`` adds a tilt of up to 30 degrees, towards the probe's turn or a direction given after a colon; edges,
    cylinders, and two points tilt along their length only.

    Example:
        >>> parse_probe("sphere:10").radius_m
        0.005
        >>> parse_probe("points:8:-7,0;7,3,0.2").places_m
        ((-0.007, 0.0, 0.0), (0.007, 0.003, 0.0002))
    """
    words, at, leaning = text.partition("@")
    shape, *sizes = words.split(":")
    shape = "punch" if shape == "flat" else shape
    probe = _points(text, sizes) if shape == "points" else _shaped(text, shape, sizes)
    return _leaning(text, probe, leaning) if at else probe


def _unknown(text: str) -> InputError:
    allowed = ", ".join([*(f"{name}:{sizes}" for name, sizes in SIZES.items()), POINTS])
    return InputError(f"indenter {text!r} is none of {allowed}, each with {LEANING} where it leans")


def _numbers(words: list[str]) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError:
        return []


def _shaped(text: str, shape: str, words: list[str]) -> Probe:
    sizes = _numbers(words)
    if shape not in SIZES or not MIN_SIZES[shape] <= len(sizes) <= SIZES[shape].count(":") + 1:
        raise _unknown(text)
    lengths = sizes[: MIN_SIZES[shape]]
    if not all(math.isfinite(size) for size in sizes) or min(lengths) <= 0:
        raise InputError(f"indenter {text!r}: its sizes must be positive, in mm", code="not-positive")
    turn = math.radians(sizes[MIN_SIZES[shape]]) if len(sizes) > MIN_SIZES[shape] else 0.0
    if shape == "edge":
        return Probe(shape, 0.0, lengths[0] * 1e-3, turn)
    return Probe(shape, lengths[0] / 2e3, lengths[1] * 1e-3 if len(lengths) > 1 else 0.0, turn)


def _points(text: str, words: list[str]) -> Probe:
    if len(words) != 2:
        raise _unknown(text)
    diameter = _numbers(words[:1])
    places = [_numbers(place.split(",")) for place in words[1].split(";")]
    if not diameter or not all(len(place) in (2, 3) for place in places):
        raise _unknown(text)
    if not all(map(math.isfinite, [*diameter, *(number for place in places for number in place)])):
        raise InputError(f"indenter {text!r}: its sizes and places must be finite, in mm", code="not-finite")
    if not diameter[0] > 0:
        raise InputError(f"indenter {text!r}: its sizes must be positive, in mm", code="not-positive")
    lifted = [(*place, 0.0)[:3] for place in places]
    return points_probe(diameter[0] / 2e3, [(x / 1e3, y / 1e3, up / 1e3) for x, y, up in lifted])


def points_probe(radius_m: float, places_m: list[Place]) -> Probe:
    """Return balls of one radius at (x, y, height); heights are relative to the lowest."""
    if len({place[:2] for place in places_m}) != len(places_m) or not places_m:
        raise InputError(f"balls at {places_m} m; give different places", code="sphere-positions")
    lowest = min(up for _, _, up in places_m)
    return Probe("points", radius_m, places_m=tuple((x, y, up - lowest) for x, y, up in places_m))


def _leaning(text: str, probe: Probe, words: str) -> Probe:
    angles = _numbers(words.split(":"))
    most = 2 if probe.shape in ("sphere", "punch", "points") else 1
    if not 1 <= len(angles) <= most:
        raise _unknown(text)
    if not all(map(math.isfinite, angles)) or abs(angles[0]) > MAX_TILT_DEG + 1e-9:
        raise InputError(f"indenter {text!r}: give up to ±{MAX_TILT_DEG:g} degrees", code="tilt-range")
    turn = math.radians(angles[1]) if len(angles) > 1 else probe.turn_rad
    return upright_ball(replace(probe, turn_rad=turn, tilt_rad=math.radians(angles[0])))


def upright_ball(probe: Probe) -> Probe:
    """Return the probe, a ball without turn and tilt."""
    return Probe("sphere", probe.radius_m) if probe.shape == "sphere" else probe


def as_pair(probe: Probe) -> Probe:
    """Return the probe, two upright balls symmetric about the axis as "two-points"."""
    if probe.shape != "points" or len(probe.places_m) != 2 or probe.tilt_rad != 0.0:
        return probe
    (x, y, up), (other_x, other_y, other_up) = probe.places_m
    if (x + other_x, y + other_y) != (0.0, 0.0) or up != other_up:
        return probe
    return Probe("two-points", probe.radius_m, 2 * math.hypot(other_x, other_y), math.atan2(other_y, other_x))


def parts_of(probe: Probe) -> tuple[tuple[Probe, Place], ...]:
    """Return the probe's parts with (x, y, height over the lowest) [m]; several points are separate balls."""
    if probe.shape not in ("two-points", "points"):
        return ((probe, (0.0, 0.0, 0.0)),)
    c, s = math.cos(probe.turn_rad), math.sin(probe.turn_rad)
    half = probe.length_m / 2
    places = probe.places_m or ((-half * c, -half * s, 0.0), (half * c, half * s, 0.0))
    cos, sin = math.cos(probe.tilt_rad), math.sin(probe.tilt_rad)
    moved = []
    for x, y, up in places:
        along, aside = c * x + s * y, c * y - s * x
        leant, raised = cos * along + sin * up, cos * up - sin * along
        moved.append((c * leant - s * aside, s * leant + c * aside, raised))
    lowest = min(up for _, _, up in moved)
    return tuple((Probe("sphere", probe.radius_m), (x, y, up - lowest)) for x, y, up in moved)


def gap_of(
    probe: Probe, x_m: Float[ndarray, " nx"], y_m: Float[ndarray, " ny"], centre_m: tuple[float, float]
) -> Field:
    """Return the height of the probe over the flat membrane at first touch, on a grid [m]."""
    R, L, turn = probe.radius_m, probe.length_m, probe.turn_rad
    match probe.shape:
        case "sphere":
            return contact_solver.sphere(x_m, y_m, R, centre_m)
        case "two-points" | "points":
            return contact_solver.balls(
                x_m,
                y_m,
                R,
                [(centre_m[0] + x, centre_m[1] + y, up) for _, (x, y, up) in parts_of(probe)],
            )
        case "punch":
            upright = contact_solver.flat_punch(x_m, y_m, R, ROUNDED * R, centre_m)
        case "edge":
            upright = contact_solver.wedge(x_m, y_m, EDGE_SLOPE_RAD, L, turn, centre_m)
        case "cylinder":
            upright = contact_solver.lying_cylinder(x_m, y_m, R, L, turn, centre_m)
        case _:
            raise InputError(f"no palm knows a {probe.shape!r}; there are {', '.join(SIZES)}, points")
    return upright if probe.tilt_rad == 0 else contact_solver.lean(upright, x_m, y_m, probe.tilt_rad, turn)


def silhouette(
    probe: Probe, depth_m: float, across_m: Float[ndarray, " w"], z_m: Float[ndarray, " h"]
) -> Float32[ndarray, "h w"]:
    """Return the cosine at which a probe faces a viewer along y, 0 to 1; 0 beside it.

    Args:
        probe: Probe; balls are shaded, other sides are uniform.
        depth_m: Depth of its lowest point, negative in the air [m]; 0 for no probe.
        across_m: Positions relative to its centre [m], possibly infinite.
        z_m: Depths into the membrane [m].
    """
    facing = np.zeros((len(z_m), len(across_m)), np.float32)
    reach, _ = reaches_of(probe)
    near = np.flatnonzero(np.abs(across_m) <= reach)
    if depth_m == 0 or not len(near):
        return facing
    x, above = across_m[near], depth_m - z_m[:, None]
    if probe.shape in ("sphere", "two-points", "points"):
        R2 = probe.radius_m**2
        discs = [
            R2 - (x - side) ** 2 - (above - up - probe.radius_m) ** 2 for _, (side, _, up) in parts_of(probe)
        ]
        facing[:, near] = np.sqrt(np.maximum(np.maximum.reduce(discs), 0) / R2)
        return facing
    y = np.linspace(-1, 1, 201) * reach
    lowest = gap_of(probe, x, y, (0.0, 0.0)).min(axis=0)
    top = 2 * probe.radius_m - lowest if probe.shape == "cylinder" else np.inf
    facing[:, near] = SIDE * ((above > lowest) & (above < top))
    return facing


def reaches_of(probe: Probe) -> tuple[float, float]:
    """Return the maximum distances along x and y at which the probe may touch [m]."""
    if probe.shape in ("two-points", "points"):
        places = [place for _, place in parts_of(probe)]
        across, down = (max(abs(place[axis]) for place in places) for axis in (0, 1))
        return across + probe.radius_m, down + probe.radius_m
    one = probe.radius_m + probe.length_m / 2
    return one, one


def has_probe_table(spec: PalmSpec, probe: Probe) -> bool:
    """Return whether a table exists for the spec's membrane under a non-axisymmetric probe."""
    return _probe_table(spec, probe) is not None


def _probe_table(spec: PalmSpec, probe: Probe) -> ProbeTable | None:
    return probe_table_for(probe, spec.thickness_m, spec.radius_m, spec.friction, spec.poisson_ratio)


def probe_table_of(spec: PalmSpec, probe: Probe) -> ProbeTable:
    """Return the table of a non-axisymmetric probe."""
    if (table := _probe_table(spec, probe)) is None:
        raise RangeError(
            f"no table for a {probe.shape} on a membrane {spec.thickness_m * 1e3:g} mm thick; upright there "
            f"are those of: {probes_with_table(spec) or 'none'}"
        )
    return table


def probes_with_table(spec: PalmSpec) -> str:
    """Return the comma-separated probes that have tables for the spec's membrane."""
    mm, found = 1e3 * spec.thickness_m, []
    for t in probe_tables():
        sizes = [round(size * mm, 6) for size in (2 * t.radius, t.length) if size]
        words = ":".join([t.shape, *(f"{size:g}" for size in sizes)])
        if has_probe_table(spec, parse_probe(words)):
            found.append(words)
    return ", ".join(found)
