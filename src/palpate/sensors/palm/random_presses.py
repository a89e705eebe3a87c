"""Draw random presses and contacts of virtual palms with labels, for training.

Each press has a frame of the untouched membrane under the hanging probe and frames at several depths; units
and views vary by `PressLaw`. Other loads are pressed by linear layers on the design (tabled edges and
cylinders by their table), so that the force law does not reveal the load kind.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from palpate.core import (
    Contact,
    Float,
    Float32,
    InputError,
    Int,
    Pose,
    Probe,
    RangeError,
    UInt8,
    in_parallel,
    ndarray,
)
from palpate.mechanics.probe_contact import resultant_of
from palpate.sensors.palm.membrane_faults import pressed_at
from palpate.sensors.palm.palm_press import (
    depth_of_force,
    greatest_aside,
    has_table,
    press,
    press_layers,
    pulled,
)
from palpate.sensors.palm.palm_render import render
from palpate.sensors.palm.palm_spec import PalmSpec
from palpate.sensors.palm.palm_variation import PRESS_LAW, PressLaw
from palpate.sensors.palm.probe_shapes import has_probe_table, parts_of, points_probe, reaches_of

DEPTHS = 96  # distinct depths over all units; images are shared between them
DEPTH_MM = (0.06, 5.3)
HANGS = 3  # heights per unit

TARGETS = ("depth_mm", "x_mm", "y_mm", "force_N")


@dataclass(frozen=True, slots=True)
class Presses:
    """Rendered presses and labels.

    Attributes:
        images: sRGB frames, fringes left and mirror right.
        hanging: Frame of each press with the probe above the membrane.
        press: Press number of each image.
        values: Depth below detected contact, x, y [mm], and normal force [N].
    """

    images: UInt8[ndarray, "n h w 3"]
    hanging: UInt8[ndarray, "p h w 3"]
    press: Int[ndarray, " n"]
    values: Float32[ndarray, "n 4"]


def draw_presses(
    spec: PalmSpec,
    count: int,
    depths_each: int,
    rng: np.random.Generator,
    progress: Callable[[int, int], None] = lambda done, total: None,
    *,
    processes: int = 1,
    law: PressLaw = PRESS_LAW,
) -> Presses:
    """Draw presses at positions uniform over the area that the ball may touch.

    Args:
        spec: Palm whose two regions fill the frame, as from `cropped`.
        count: Number of presses.
        depths_each: Frames per press.
        rng: Source of randomness.
        progress: Callback with the number of frames done and in total.
        processes: Number of processes; the result does not depend on it.
        law: Distribution of units and presses.
    """
    if count < 1 or depths_each < 1:
        raise InputError(f"{count} presses of {depths_each} depths; give 1 or more", code="press-count")
    width, height = spec.frame_px
    images = np.empty((count * depths_each, height, width, 3), np.uint8)
    hanging = np.empty((count, height, width, 3), np.uint8)
    values = np.empty((count * depths_each, len(TARGETS)), np.float32)
    levels, done, total = _levels(spec, count, depths_each, rng, law), 0, count * (1 + depths_each)
    for level, (drawn, found) in zip(levels, in_parallel(_draw, levels, processes=processes), strict=True):
        if level.depth_mm < 0:
            hanging[level.rows] = drawn
        else:
            images[level.rows] = drawn
            values[level.rows] = found
        done += len(level.rows)
        progress(done, total)
    return Presses(images, hanging, np.repeat(np.arange(count), depths_each), values)


@dataclass(frozen=True, slots=True)
class _DrawnPress:
    """One press: position [m], fields of the spec, and detected contact."""

    place_m: tuple[float, float]
    view: dict[str, Any]
    threshold_n: float
    late_mm: float


@dataclass(frozen=True, slots=True)
class _Level:
    """All frames of one depth of one unit (negative: above the surface), rendered by one process with its
    own rng.
    """

    spec: PalmSpec
    depth_mm: float
    rows: Int[ndarray, " n"]
    presses: list[_DrawnPress]
    rng: np.random.Generator


def _levels(
    spec: PalmSpec, count: int, depths_each: int, rng: np.random.Generator, law: PressLaw
) -> list[_Level]:
    copies = min(law.copies, count)
    palms = [law.copy(spec, rng) for _ in range(copies)]
    presses = [
        _DrawnPress((float(x), float(y)), law.view(spec, rng), *law.zero(rng))
        for x, y in _places(spec, count, rng)
    ]
    each = max(1, DEPTHS // copies)
    hangs = rng.integers(HANGS, size=count)
    which = rng.integers(each, size=(count, depths_each))
    made = []
    for k, skin in enumerate(palms):
        own = np.arange(k, count, copies)
        for hang in range(HANGS):
            rows, height_mm = own[hangs[own] == hang], float(rng.uniform(*law.hang_mm))
            if len(rows):
                made.append(_Level(skin, -height_mm, rows, [presses[i] for i in rows], rng.spawn(1)[0]))
        low, high = DEPTH_MM
        depths_mm = low + (high - low) * (np.arange(each) + rng.uniform(size=each)) / each
        stiffer = rng.uniform(*law.stiffening, size=each)
        for i, depth_mm in enumerate(depths_mm):
            press_of, frame = np.nonzero(which[own] == i)
            if len(press_of):
                rows = own[press_of] * depths_each + frame
                fresh = replace(skin, youngs_modulus_pa=skin.youngs_modulus_pa * float(stiffer[i]))
                its = [presses[own[p]] for p in press_of]
                made.append(_Level(fresh, float(depth_mm), rows, its, rng.spawn(1)[0]))
    return made


def _draw(level: _Level) -> tuple[UInt8[ndarray, "n h w 3"], Float[ndarray, "n 4"]]:
    """Images, and labels in the order of `TARGETS`."""
    images, values = [], []
    for one in level.presses:
        seen = replace(level.spec, **one.view)
        contact = press(seen, Pose(*one.place_m, 1e-3 * level.depth_mm))
        images.append(render(contact, seen, level.rng).image)
        zero_mm = 1e3 * depth_of_force(seen, one.threshold_n, *one.place_m) + one.late_mm
        x_m, y_m = one.place_m
        values.append((level.depth_mm - zero_mm, 1e3 * x_m, 1e3 * y_m, contact.force_n))
    return np.stack(images), np.array(values, np.float64)


def _places(spec: PalmSpec, count: int, rng: np.random.Generator) -> Float[ndarray, "n 2"]:
    reach = spec.radius_m - spec.indenter_radius_m
    away, angle = reach * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    return away[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


LOAD_DEPTH_MM = (0.4, 1.5)
HELD = 0.8  # maximum combined lateral load and moment over the friction limit
TILT_DEG = 10.0
PUNCHES_MM = (6, 8, 10)
MIN_APART_M = 12e-3  # between balls
INSIDE_M = 0.5e-3  # clearance between a probe's reach and the rim
MAX_TRIES = 1000  # attempts to place several balls

SIZES_M = {
    "sphere": ((4e-3, 0.0), (6e-3, 0.0), (7e-3, 0.0)),
    "punch": ((3e-3, 0.0), (4e-3, 0.0), (5e-3, 0.0)),
    "edge": ((0.0, 8e-3), (0.0, 10e-3), (0.0, 12e-3)),
    "cylinder": ((3e-3, 8e-3), (3e-3, 10e-3), (3e-3, 12e-3)),
    "two-points": ((3e-3, 8e-3), (3e-3, 10e-3), (3e-3, 12e-3)),
}
"""(radius, length) of each shape [m]."""
SHAPES = tuple(SIZES_M)
BALLS = 4  # maximum number of balls
PLACE = ("depth_mm", "x_mm", "y_mm")
EACH = 4  # values per ball


def _each_named(count: int) -> tuple[str, ...]:
    parts = ("depth{}_mm", "x{}_mm", "y{}_mm", "force{}_N")
    return tuple(part.format(i + 1) for i in range(count) for part in parts)


NAMES = {
    "lateral": (*PLACE, "force_x_N", "force_y_N", "force_N", "moment_z_Nmm"),
    "inclined": (
        *PLACE,
        "diameter_mm",
        "tilt_deg",
        "towards_deg",
        "force_N",
        "moment_x_Nmm",
        "moment_y_Nmm",
    ),
    "shapes": (*PLACE, "shape", "turn_deg", "force_N"),
    "two-contacts": (*_each_named(2), "force_N"),
    "grasp": ("count", *_each_named(BALLS), "force_N", "moment_x_Nmm", "moment_y_Nmm"),
}
"""Value names of each kind. Forces act on the membrane; moments are about the probe's position on the rest
surface, for a grasp about the membrane's centre. ``shape`` is the index in `SHAPES`. Balls are numbered from
the left; missing ones are NaN."""


@dataclass(frozen=True, slots=True)
class Loads:
    """Rendered contacts and labels.

    Attributes:
        names: Names of the values.
        images: sRGB frames, fringes left and mirror right.
        hanging: Untouched membrane under each image's lamp, without a probe.
        press: Press number of each image.
        values: Labels in the order of the names.
    """

    kind: str
    names: tuple[str, ...]
    images: UInt8[ndarray, "n h w 3"]
    hanging: UInt8[ndarray, "n h w 3"]
    press: Int[ndarray, " n"]
    values: Float32[ndarray, "n v"]


class Drawn(NamedTuple):
    """One contact and its values."""

    contact: Contact
    values: tuple[float, ...]


def draw_loads(
    spec: PalmSpec,
    kind: str,
    count: int,
    rng: np.random.Generator,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Loads:
    """Draw contacts of one kind at positions where the whole probe is inside the rim.

    Args:
        spec: Palm whose two regions fill the frame, as from `cropped`.
        kind: ``"lateral"`` (ball with lateral force and moment), ``"inclined"`` (punch tilted by up to 10
            degrees), ``"shapes"``, ``"two-contacts"`` (two balls, at least 12 mm apart), or ``"grasp"``
            (three or four balls).
        count: Number of contacts, one image each.
        rng: Source of randomness.
        progress: Callback with the number of contacts done and in total.
    """
    if kind not in NAMES:
        raise InputError(f"no load {kind!r}; there are {', '.join(NAMES)}", code="unknown-name")
    if count < 1:
        raise InputError(f"{count} contacts; 1 or more are drawn", code="press-count")
    width, height = spec.frame_px
    images, hanging = (np.empty((count, height, width, 3), np.uint8) for _ in range(2))
    values = np.empty((count, len(NAMES[kind])), np.float32)
    for i in range(count):
        drawn = DRAW[kind](spec, rng)
        lit = replace(spec, lamp_gain=spec.lamp_gain * PRESS_LAW.lamp_now(rng))
        hanging[i] = render(_untouched(spec, drawn.contact), lit, rng).image
        images[i] = render(drawn.contact, lit, rng).image
        values[i] = drawn.values
        progress(i + 1, count)
    return Loads(kind, NAMES[kind], images, hanging, np.arange(count), values)


def lateral(spec: PalmSpec, rng: np.random.Generator) -> Drawn:
    """Draw the palm's ball under a lateral force and a moment within the friction limit."""
    probe = Probe("sphere", spec.indenter_radius_m)
    pose = _pose(spec, probe, rng)
    pressed = press_layers(spec, pose, probe)
    force, moment = greatest_aside(pressed)
    load, mixed, way = HELD * math.sqrt(rng.uniform()), rng.uniform(0, math.pi / 2), rng.uniform(0, math.tau)
    aside, twist = load * math.cos(mixed) * force, load * math.sin(mixed) * moment
    twist *= float(rng.choice((-1.0, 1.0)))
    contact = pulled(pressed, (aside * math.cos(way), aside * math.sin(way)), twist)
    return Drawn(contact, (*_place(pose), *contact.lateral_n, contact.force_n, 1e3 * contact.moment_nm))


def inclined(spec: PalmSpec, rng: np.random.Generator) -> Drawn:
    """Draw a tilted punch."""
    diameter = float(rng.choice(PUNCHES_MM))
    tilt, towards = rng.uniform(0, TILT_DEG), rng.uniform(0, 360)
    probe = Probe("punch", diameter / 2e3, 0.0, math.radians(towards), math.radians(tilt))
    pose = _pose(spec, probe, rng)
    contact = press_layers(spec, pose, probe).contact
    wrench = resultant_of(contact, (pose.x_m, pose.y_m))
    moments = (1e3 * wrench.moment_x_nm, 1e3 * wrench.moment_y_nm)
    return Drawn(contact, (*_place(pose), diameter, tilt, towards, contact.force_n, *moments))


def shapes(spec: PalmSpec, rng: np.random.Generator) -> Drawn:
    """Draw one shape of one of three sizes at a random turn."""
    which, size = int(rng.integers(len(SHAPES))), int(rng.integers(3))
    turn = rng.uniform(0, 180)
    radius, length = SIZES_M[SHAPES[which]][size]
    probe = Probe(SHAPES[which], radius, length, math.radians(turn) if length else 0.0)
    pose = _pose(spec, probe, rng)
    tabled = has_probe_table(pressed_at(spec, pose.x_m, pose.y_m), probe)
    contact = press(spec, pose, probe) if tabled else press_layers(spec, pose, probe).contact
    turned = turn if probe.length_m else 0.0
    return Drawn(contact, (*_place(pose), which, turned, contact.force_n))


def two_contacts(spec: PalmSpec, rng: np.random.Generator) -> Drawn:
    """Draw two balls."""
    contact, each = _several(spec, 2, rng)
    return Drawn(contact, (*each, contact.force_n))


def grasp(spec: PalmSpec, rng: np.random.Generator) -> Drawn:
    """Draw three or four balls."""
    count = int(rng.integers(3, BALLS + 1))
    contact, each = _several(spec, count, rng)
    wrench = resultant_of(contact)
    missing = (math.nan,) * (EACH * (BALLS - count))
    moments = (1e3 * wrench.moment_x_nm, 1e3 * wrench.moment_y_nm)
    return Drawn(contact, (count, *each, *missing, contact.force_n, *moments))


DRAW: dict[str, Callable[[PalmSpec, np.random.Generator], Drawn]] = {
    "lateral": lateral,
    "inclined": inclined,
    "shapes": shapes,
    "two-contacts": two_contacts,
    "grasp": grasp,
}


def _untouched(spec: PalmSpec, contact: Contact) -> Contact:
    if has_table(spec):  # whose picture of it is drawn once
        return press(spec, Pose(0.0, 0.0, 0.0))
    nothing = 0 * contact.pressure_pa
    return replace(
        contact,
        pressure_pa=nothing,
        displacement_m=nothing,
        touching=nothing > 0,
        force_n=0.0,
        radius_m=0.0,
        pose=replace(contact.pose, depth_m=0.0),
        shear_pa=None,
        lateral_n=(0.0, 0.0),
        moment_nm=0.0,
    )


def _place(pose: Pose) -> tuple[float, float, float]:
    return 1e3 * pose.depth_m, 1e3 * pose.x_m, 1e3 * pose.y_m


def _pose(spec: PalmSpec, probe: Probe, rng: np.random.Generator) -> Pose:
    """A depth, and a position at which the probe's whole reach is inside the rim."""
    room = _room(spec, max(reaches_of(probe)))
    away, angle = room * math.sqrt(rng.uniform()), rng.uniform(0, math.tau)
    return Pose(away * math.cos(angle), away * math.sin(angle), 1e-3 * rng.uniform(*LOAD_DEPTH_MM))


def _room(spec: PalmSpec, reach_m: float) -> float:
    room = spec.radius_m - reach_m - INSIDE_M
    if not room > 0:
        raise RangeError(
            f"a probe that reaches {reach_m * 1e3:g} mm from its axis has no room on a membrane of "
            f"{spec.diameter_m * 1e3:g} mm; give a larger one"
        )
    return room


def _several(spec: PalmSpec, count: int, rng: np.random.Generator) -> tuple[Contact, tuple[float, ...]]:
    """Balls pressed together with depth, position, and force of each, from the left."""
    R = spec.indenter_radius_m
    at = np.array(sorted(_apart(count, _room(spec, R), rng)))
    depth = 1e-3 * rng.uniform(*LOAD_DEPTH_MM, count)
    x0, y0 = (at.min(axis=0) + at.max(axis=0)) / 2
    probe = points_probe(
        R, [(float(x - x0), float(y - y0), float(-d)) for (x, y), d in zip(at, depth, strict=True)]
    )
    pose = Pose(float(x0), float(y0), float(depth.max()))
    contact = press_layers(spec, pose, probe).contact
    return contact, tuple(_each(contact, [place for _, place in parts_of(probe)]))


def _each(contact: Contact, places: list[tuple[float, float, float]]) -> Iterator[float]:
    pose = contact.pose
    x, y = contact.x_m - pose.x_m, contact.y_m - pose.y_m
    cell = (x[1] - x[0]) * (y[1] - y[0])
    away = np.stack([(x - at[0]) ** 2 + (y[:, None] - at[1]) ** 2 for at in places])
    nearest = away.argmin(axis=0)
    for i, (a, b, up) in enumerate(places):
        yield from _place(Pose(pose.x_m + a, pose.y_m + b, pose.depth_m - up))
        yield float(contact.pressure_pa[nearest == i].sum() * cell)


def _apart(count: int, room_m: float, rng: np.random.Generator) -> list[tuple[float, float]]:
    """Uniform positions on a disc, redrawn until none are too near."""
    for _ in range(MAX_TRIES):
        away, angle = room_m * np.sqrt(rng.uniform(size=count)), rng.uniform(0, math.tau, count)
        at = np.stack([away * np.cos(angle), away * np.sin(angle)], axis=1)
        between = np.hypot(*(at[:, None] - at).T) + 1e9 * np.eye(count)
        if between.min() >= MIN_APART_M:
            return [(float(x), float(y)) for x, y in at]
    raise RangeError(
        f"no {count} places {MIN_APART_M * 1e3:g} mm apart were found within {room_m * 1e3:g} mm of the "
        "axis; give a larger membrane"
    )
