"""Images of a unit's presses, measured and rendered, as the estimate compares them.

The untouched frame provides dirt (dims) and reflections (add) that the terms do not model; both are applied
to every rendered press. The housing outside both regions shows changes of exposure. Pixels near edges of
ball, dimple, membrane, or mirror opening have no useful derivatives and are masked.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from palpate.core import Bool, Float, ImageError, Int, Pose, RangeError, UInt8, ndarray
from palpate.sensors.palm.copies.palm_copy import Local, PalmCopy, PicturedPress
from palpate.sensors.palm.fringe_view import columns_kept
from palpate.sensors.palm.mirror_view import contact_px
from palpate.sensors.palm.palm_press import drawn_ball, pressed
from palpate.sensors.palm.palm_render import housed, render_clean
from palpate.sensors.palm.palm_spec import PalmSpec

BLUR_PX = 1.0  # blur of images before comparison
BLOCK_PX = 9  # side of blocks of correlated pixels
BRIGHTEST = 1.08  # limit of dirt's transmission; light beyond it is additive
DARKEST = 0.3  # minimum mirror brightness to measure dirt, over the maximum
BESIDE_PX = 3  # margin around both regions in the exposure measurement
SAME_EXPOSURE = 0.03  # log change of exposure that counts as none
HANGS_WITHIN = 1.6  # radius that a hanging ball may cover in the mirror, in ball radii
ENOUGH = 100  # minimum number of housing pixels

EDGE_PX = 1.0  # masked distance from an edge

Pixels = Float[ndarray, " n"]
Lights = tuple[ndarray, ndarray]
"""Linear light of fringes and mirror."""


Kept = tuple[ndarray, ndarray]
"""Masks of both regions, 1 for compared pixels."""


class Backdrop(NamedTuple):
    """Background of an untouched frame: transmission of dirt in the mirror, and light added
    in both regions.
    """

    left: Float[ndarray, "h w 3"]
    added: Lights

    def over(self, seen: Lights) -> Lights:
        fringes, mirror = seen
        return np.maximum(fringes + self.added[0], 0.0), mirror * self.left + self.added[1]


@dataclass(frozen=True, eq=False)
class SeenPress:
    """A press as used by the estimate.

    Attributes:
        pixels: Pixels of both regions over white.
        change: Change since the untouched frame at equal exposure.
        exposure: Log exposure over the untouched frame's.
        block: Block of each pixel.
        light, rest: Linear light of both regions under load and untouched.
    """

    pixels: Pixels
    change: Pixels
    exposure: float
    block: Int[ndarray, " n"]
    light: Lights
    rest: Lights
    press: PicturedPress

    def kept(self, kept: Kept | None) -> Pixels:
        """Pixels with masked ones set to 0."""
        return self.pixels if kept is None else _as_pixels(self.light, kept)


def pictured(known: PalmCopy, pose: Pose, *, exact: bool = False) -> Pixels:
    """Return both regions of a press as a unit shows them: noise-free sRGB over white, blurred, one row."""
    return _as_pixels(_light(known, pose, exact))


def shown(
    known: PalmCopy, local: Local, backdrop: Backdrop | None, *, exact: bool = True, kept: Kept | None = None
) -> Pixels:
    """Return the image of a press with its own unknowns, over the background."""
    seen = _light(known.under(local), pose_of(local), exact)
    if backdrop is not None:
        seen = backdrop.over(seen)
    gain = math.exp(local[3])
    return _as_pixels((gain * seen[0], gain * seen[1]), kept)


def away_from_edges(known: PalmCopy, local: Local) -> Kept:
    """Return masks of pixels in the membrane or the mirror's opening, away from edges."""
    spec, pose = known.under(local).looks, pose_of(local)
    rows, rays = spec.fringes.pitches_m[1], columns_kept(spec.unlit)
    here, R = pressed(spec, pose.depth_m), spec.indenter_radius_m
    offset = np.where(rays.visible, np.abs(rays.about(pose.x_m, pose.y_m)[0]), np.inf)
    top = np.interp(offset, here.r * R, np.asarray(here.surface) * R, right=0.0)
    z = spec.fringes.down_m[:, None]
    skin = (z > top + EDGE_PX * rows) & (z < spec.thickness_m - EDGE_PX * rows) & rays.visible
    x, y = np.meshgrid(spec.mirror.x_m, spec.mirror.down_m / math.sin(spec.mirror_elevation_rad))
    opening = np.hypot(x, y) < spec.radius_m - EDGE_PX * max(spec.mirror.pitches_m)
    return skin.astype(float), opening.astype(float)


def pose_of(local: Local) -> Pose:
    """Return the pose of a press's unknowns."""
    return Pose(float(local[0]), float(local[1]), math.exp(local[2]))


def backdrop_of(known: PalmCopy, rests: Sequence[Lights], places: Sequence[tuple[float, float]]) -> Backdrop:
    """Return the background of untouched frames at one exposure.

    Args:
        known: Unit.
        rests: Light of the untouched regions.
        places: Positions over which the probe may hide the background in each frame [m].
    """
    bare = _bare(known)
    free = np.stack([_free_of_probe(known.looks, *place) for place in places])[..., None]
    seen = free.sum(axis=0)
    fringes = np.mean([rest[0] for rest in rests], axis=0)
    mirror = np.sum([rest[1] * one for rest, one in zip(rests, free, strict=True)], axis=0)
    mirror = np.where(seen, mirror / np.maximum(seen, 1), bare[1])
    told = bare[1] > DARKEST * bare[1].max()
    left = np.where(told, np.clip(mirror / np.maximum(bare[1], 1e-9), 0.0, BRIGHTEST), 1.0)
    below = (known.spec.fringes.down_m > known.spec.fringes.pitches_m[1])[:, None, None]  # the skin's edge
    return Backdrop(left, (np.where(below, fringes - bare[0], 0.0), mirror - left * bare[1]))


def _bare(known: PalmCopy) -> Lights:
    hidden = replace(known.spec, probe_in_mirror=False, probe_edge_on=False)
    return _light(replace(known, spec=hidden), Pose(0.0, 0.0, -1e-3), False)


def _free_of_probe(spec: PalmSpec, x_m: float, y_m: float) -> Bool[ndarray, "h w"]:
    """Pixels of the mirror that a hanging ball does not cover."""
    cx, cy = contact_px(spec, x_m, y_m)
    width, height = spec.mirror.size_px
    across, down = np.meshgrid(np.arange(width) + 0.5 - cx, np.arange(height) + 0.5 - cy)
    wide, high = spec.mirror.pitches_m
    return np.asarray(np.hypot(across * wide, down * high) > HANGS_WITHIN * spec.indenter_radius_m)


def seen_press(spec: PalmSpec, one: PicturedPress) -> SeenPress:
    """Prepare and check a press's images."""
    for image in (one.image, one.reference):
        if image.shape[:2] != spec.frame_px[::-1]:
            raise ImageError(
                f"a picture of {image.shape[1]} x {image.shape[0]} px; the copy's are {spec.frame_px[0]} x "
                f"{spec.frame_px[1]} px",
                code="image-size",
            )
    if one.force_n is not None and not (math.isfinite(one.force_n) and one.force_n > 0):
        raise RangeError(f"a known force of {one.force_n} N; give one above 0 N", code="force-range")
    if not (math.isfinite(one.force_share) and one.force_share > 0):
        raise RangeError(f"a force known to a share of {one.force_share}; it has to be above 0")
    longer = exposure_change(spec, one.image, one.reference)
    light, rest = (_regions(spec, _linear(image)) for image in (one.image, one.reference))
    pixels = _as_pixels(light)
    change = pixels - _as_pixels((longer * rest[0], longer * rest[1]))
    return SeenPress(pixels, change, math.log(longer), _blocks(spec), light, rest, one)


def regions_of(spec: PalmSpec, image: UInt8[ndarray, "h w 3"]) -> Lights:
    """Return the linear light of both regions of a frame."""
    return _regions(spec, _linear(image))


def lamp_of(known: PalmCopy, rests: Sequence[Lights]) -> float:
    """Return the logarithm of the lamp's light, including exposure, over that of a unit."""
    bare = _bare(known)[1]
    told = bare > DARKEST * bare.max()
    share = np.mean([rest[1] for rest in rests], axis=0)[told] / bare[told]
    return math.log(max(float(np.median(share)), 1e-3))


def exposure_change(
    spec: PalmSpec, image: UInt8[ndarray, "h w 3"], reference: UInt8[ndarray, "h w 3"]
) -> float:
    """Return the exposure over the untouched frame's, measured in the housing; 1 if it is not measurable."""
    beside = np.ones(image.shape[:2], bool)
    for view in (spec.fringes, spec.mirror):
        x, y, w, h = view.box_px
        left, top = max(x - BESIDE_PX, 0), max(y - BESIDE_PX, 0)
        beside[top : y + h + BESIDE_PX, left : x + w + BESIDE_PX] = False
    light = [float(_linear(one)[beside].mean()) if beside.any() else 0.0 for one in (image, reference)]
    if beside.sum() < ENOUGH or not min(light) > 0:
        return 1.0
    change = light[0] / light[1]
    return change if abs(math.log(change)) > SAME_EXPOSURE else 1.0


def _light(known: PalmCopy, pose: Pose, exact: bool) -> Lights:
    spec = known.looks
    frame = housed(render_clean(drawn_ball(spec, pose), spec, exact=exact), spec)
    return _regions(spec, frame)


def _regions(spec: PalmSpec, frame: ndarray) -> Lights:
    return frame[spec.fringes.window], frame[spec.mirror.window]


def _as_pixels(seen: Lights, kept: Kept | None = None) -> Pixels:
    if kept is None:
        return np.concatenate([_blurred(_encoded(light), BLUR_PX) for light in seen])
    parts = []
    for light, one in zip(seen, kept, strict=True):
        whole = np.repeat(one.ravel(), 3)
        share = np.repeat(_blurred(one, BLUR_PX), 3)
        parts.append(whole * _blurred(_encoded(light) * one[..., None], BLUR_PX) / np.maximum(share, 1e-3))
    return np.concatenate(parts)


def _blurred(image: ndarray, sigma_px: float) -> Pixels:
    """Blurred image as a row; blur makes moving edges differentiable."""
    return cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT).ravel()


def _encoded(linear: ndarray) -> ndarray:
    """Encode as sRGB without rounding (IEC 61966-2-1)."""
    v = np.clip(linear, 0.0, 1.0).astype(np.float64)
    return np.where(v <= 0.0031308, 12.92 * v, 1.055 * np.maximum(v, 1e-9) ** (1 / 2.4) - 0.055)


def _linear(image: UInt8[ndarray, "h w 3"]) -> ndarray:
    """Decode 8-bit sRGB."""
    v = image / 255.0
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def _blocks(spec: PalmSpec) -> Int[ndarray, " n"]:
    blocks, first = [], 0
    for view in (spec.fringes, spec.mirror):
        rows, columns = np.indices(view.size_px[::-1]) // BLOCK_PX
        block = first + rows * (columns.max() + 1) + columns
        blocks.append(np.repeat(block.ravel(), 3))
        first = int(block.max()) + 1
    return np.concatenate(blocks)
