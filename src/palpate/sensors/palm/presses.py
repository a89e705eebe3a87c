"""Many presses of the virtual palm, drawn for a network to learn from: places anywhere, labels as a rig's.

Like a rig's press, each has one frame of the untouched skin with the probe hanging over it, and then frames
at several depths. Lamp, hanging height and relaxation differ from press to press, and the camera's noise from
frame to frame; what differs on a rig besides (tilt, leaning, dents) is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32, Int, UInt8
from numpy import ndarray

from palpate.core.contact import Pose
from palpate.core.errors import InputError
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
) -> Presses:
    """Draw presses at places spread evenly over all that the ball may touch.

    Args:
        spec: of a frame that both regions fill, as `cropped` makes it.
        count: of presses.
        depths_each: frames of each.
        rng: the only source of chance.
        progress: told how many presses are drawn of how many.

    Raises:
        InputError: no press, or no depth.
    """
    if count < 1 or depths_each < 1:
        raise InputError(f"{count} presses of {depths_each} depths; 1 or more of each are drawn")
    width, height = spec.frame_px
    images = np.empty((count * depths_each, height, width, 3), np.uint8)
    hanging = np.empty((count, height, width, 3), np.uint8)
    values = np.empty((count * depths_each, len(TARGETS)), np.float32)
    depths = np.linspace(*DEPTH_MM, DEPTHS)
    stiff = 1 + (STIFFEST - 1) * rng.uniform(size=DEPTHS)  # one a depth, so that pictures are shared
    zero_mm = 1e3 * press_to_force(spec, THRESHOLD_N).pose.depth_m + LATE_MM
    for i, (x_m, y_m) in enumerate(_places(spec, count, rng)):
        lit = replace(spec, lamp_gain=spec.lamp_gain * (1 + LAMP_SD * rng.standard_normal()))
        over = HANGS_MM + HANGS_SD_MM * round(rng.standard_normal())
        hanging[i] = render(press(lit, Pose(x_m, y_m, -1e-3 * over)), lit, rng).image
        for j, which in enumerate(rng.choice(DEPTHS, depths_each), start=i * depths_each):
            skin = replace(lit, youngs_modulus_pa=lit.youngs_modulus_pa * float(stiff[which]))
            contact = press(skin, Pose(x_m, y_m, 1e-3 * float(depths[which])))
            images[j] = render(contact, skin, rng).image
            values[j] = (depths[which] - zero_mm, 1e3 * x_m, 1e3 * y_m, contact.force_n)
        progress(i + 1, count)
    return Presses(images, hanging, np.repeat(np.arange(count), depths_each), values)


def _places(spec: PalmSpec, count: int, rng: np.random.Generator) -> list[tuple[float, float]]:
    reach = spec.radius_m - spec.indenter_radius_m
    away, angle = reach * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    return list(zip((away * np.cos(angle)).tolist(), (away * np.sin(angle)).tolist(), strict=True))
