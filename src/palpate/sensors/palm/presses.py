"""Many presses of the virtual palm, drawn for a network to learn from: places anywhere, labels as a rig's.

Like a rig's press, each has one frame of the untouched skin with the probe hanging over it, and then frames
at several depths. Lamp, hanging height and relaxation differ from press to press, and the camera's noise from
frame to frame; what differs on a rig besides (tilt, leaning, dents) is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray

from palpate.core.contact import Pose
from palpate.core.errors import InputError
from palpate.core.parallel import in_parallel
from palpate.core.shapes import Float, Float32, Int, UInt8
from palpate.sensors.palm.press import press, press_to_force
from palpate.sensors.palm.render import render
from palpate.sensors.palm.spec import PalmSpec

DEPTHS = 160  # distinct ones, between which pictures are shared
DEPTH_MM = (0.06, 5.3)
HANGS_MM = 1.0
HANGS_SD_MM = 0.02
LAMP_SD = 0.01
STIFFEST = 1.1  # a fresh press over a relaxed one
THRESHOLD_N = 0.05  # at which a rig says contact
LATE_MM = 0.008  # that it says so later: half a step of its search, less what noise makes it early

TARGETS = ("depth_mm", "x_mm", "y_mm", "force_N")


@dataclass(frozen=True, slots=True)
class Presses:
    """What was drawn.

    Attributes:
        images: sRGB ``[n h w 3]``, fringes left and mirror right.
        hanging: of each press, the skin with the probe over it ``[p h w 3]``.
        press: of each image ``[n]``.
        values: depth below the local zero, x and y [mm], normal force [N] ``[n 4]``.
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
) -> Presses:
    """Draw presses at places spread evenly over all that the ball may touch.

    Args:
        spec: of a frame that both regions fill, as `cropped` makes it.
        count: of presses.
        depths_each: frames of each.
        rng: the only source of chance.
        progress: told how many frames are drawn of how many.
        processes: how many draw, on this machine; what is drawn does not depend on it.

    Raises:
        InputError: no press, no depth, or no process.
    """
    if count < 1 or depths_each < 1:
        raise InputError(f"{count} presses of {depths_each} depths; 1 or more of each are drawn")
    width, height = spec.frame_px
    images = np.empty((count * depths_each, height, width, 3), np.uint8)
    hanging = np.empty((count, height, width, 3), np.uint8)
    values = np.empty((count * depths_each, len(TARGETS)), np.float32)
    zero_mm = 1e3 * press_to_force(spec, THRESHOLD_N).pose.depth_m + LATE_MM
    levels, done, total = _levels(spec, count, depths_each, rng), 0, count * (1 + depths_each)
    for level, (drawn, force_n) in zip(levels, in_parallel(_draw, levels, processes=processes), strict=True):
        if level.depth_mm < 0:
            hanging[level.rows] = drawn
        else:
            images[level.rows] = drawn
            x_mm, y_mm = 1e3 * level.places_m.T
            depth_mm = np.full_like(force_n, level.depth_mm - zero_mm)
            values[level.rows] = np.stack([depth_mm, x_mm, y_mm, force_n], axis=1)
        done += len(level.rows)
        progress(done, total)
    return Presses(images, hanging, np.repeat(np.arange(count), depths_each), values)


@dataclass(frozen=True, slots=True)
class _Level:
    """All frames of one depth, below the surface or, negative, above it.

    A depth's pictures are marched once and moved to its places, and that takes longer than all else. So a
    depth is what one process draws, with chance of its own.
    """

    spec: PalmSpec
    depth_mm: float
    rows: Int[ndarray, " n"]
    places_m: Float[ndarray, "n 2"]
    lamps: Float[ndarray, " n"]
    rng: np.random.Generator


def _levels(spec: PalmSpec, count: int, depths_each: int, rng: np.random.Generator) -> list[_Level]:
    depths_mm = np.linspace(*DEPTH_MM, DEPTHS)
    stiff = 1 + (STIFFEST - 1) * rng.uniform(size=DEPTHS)  # one a depth, so that pictures are shared
    places_m, lamps = _places(spec, count, rng), 1 + LAMP_SD * rng.standard_normal(count)
    steps = np.round(rng.standard_normal(count)).astype(int)
    which = rng.integers(DEPTHS, size=count * depths_each)

    def level(of: PalmSpec, depth_mm: float, rows: ndarray, presses: ndarray) -> _Level:
        return _Level(of, depth_mm, rows, places_m[presses], lamps[presses], rng.spawn(1)[0])

    made = []
    for step in np.unique(steps):
        rows = np.flatnonzero(steps == step)
        made.append(level(spec, -(HANGS_MM + HANGS_SD_MM * float(step)), rows, rows))
    for i in np.unique(which):
        rows = np.flatnonzero(which == i)
        skin = replace(spec, youngs_modulus_pa=spec.youngs_modulus_pa * float(stiff[i]))
        made.append(level(skin, float(depths_mm[i]), rows, rows // depths_each))
    return made


def _draw(level: _Level) -> tuple[UInt8[ndarray, "n h w 3"], Float[ndarray, " n"]]:
    """Images, and normal forces [N]."""
    images, forces_n = [], []
    for (x_m, y_m), lamp in zip(level.places_m.tolist(), level.lamps.tolist(), strict=True):
        lit = replace(level.spec, lamp_gain=level.spec.lamp_gain * lamp)
        contact = press(lit, Pose(x_m, y_m, 1e-3 * level.depth_mm))
        images.append(render(contact, lit, level.rng).image)
        forces_n.append(contact.force_n)
    return np.stack(images), np.array(forces_n, np.float64)


def _places(spec: PalmSpec, count: int, rng: np.random.Generator) -> Float[ndarray, "n 2"]:
    reach = spec.radius_m - spec.indenter_radius_m
    away, angle = reach * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    return away[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
