"""Pictures of a copy's presses, measured and drawn, in the form in which the estimate compares them.

An untouched frame shows, where nothing moves, what the copy's terms do not know of: dirt under the mirror's
view, which dims, and reflections, which add. Both are taken from it once, and drawn over every picture of a
press. A camera that exposes by itself changes all of the frame: the housing beside both regions tells by how
much, since no press changes it.

A pixel whose light jumps, as an edge passes the middle of one of its rays, tells nothing by slopes. Once it
is known where edges lie (of ball and dimple, of the skin, of the mirror's opening) pixels near them, and what
is seen of the ball over the skin, are left out.
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

BLUR_PX = 1.0  # by which pictures are softened before they are compared
BLOCK_PX = 9  # side of blocks of pixels that err together
BRIGHTEST = 1.08  # of the copy's own light: what an untouched mirror shows beyond it is added
DARKEST = 0.3  # of the brightest in the mirror's view, below which dirt cannot be told
BESIDE_PX = 3  # from both regions, where the housing shows the exposure
SAME_EXPOSURE = 0.03  # change of it that is taken for none
HANGS_WITHIN = 1.6  # ball radii of where it presses, in which the mirror may show it over the untouched skin
ENOUGH = 100  # pixels of the housing that tell it

EDGE_PX = 1.0  # from an edge, within which pixels are left out

Pixels = Float[ndarray, " n"]
Lights = tuple[ndarray, ndarray]
"""Linear light of both regions, fringes and mirror."""


Kept = tuple[ndarray, ndarray]
"""Pixels of both regions that are compared: 1, and 0 for those that are not."""


class Backdrop(NamedTuple):
    """What an untouched frame shows beyond its copy: shares that dirt leaves of the mirror's light, and light
    that is added in both regions.
    """

    left: Float[ndarray, "h w 3"]
    added: Lights

    def over(self, seen: Lights) -> Lights:
        """Light of a picture behind it."""
        fringes, mirror = seen
        return np.maximum(fringes + self.added[0], 0.0), mirror * self.left + self.added[1]


@dataclass(frozen=True, eq=False)
class SeenPress:
    """A press as the estimate takes it.

    Attributes:
        pixels: of both regions, over white.
        change: of them since the skin was untouched, had that been exposed as long.
        exposure: logarithm of the exposure over the untouched frame's, as the housing shows it.
        block: to which each belongs.
        light, rest: of both regions, and of the untouched ones.
        press: as it was given.
    """

    pixels: Pixels
    change: Pixels
    exposure: float
    block: Int[ndarray, " n"]
    light: Lights
    rest: Lights
    press: PicturedPress

    def kept(self, kept: Kept | None) -> Pixels:
        """Its pixels, those that are left out as 0."""
        return self.pixels if kept is None else _as_pixels(self.light, kept)


def pictured(known: PalmCopy, pose: Pose, *, exact: bool = False) -> Pixels:
    """Both regions of a press as a copy shows them, without noise, sRGB over white, softened, one row."""
    return _as_pixels(_light(known, pose, exact))


def shown(
    known: PalmCopy, local: Local, backdrop: Backdrop | None, *, exact: bool = True, kept: Kept | None = None
) -> Pixels:
    """The same of a press with its own unknowns, behind what the untouched frame shows."""
    seen = _light(known.under(local), pose_of(local), exact)
    if backdrop is not None:
        seen = backdrop.over(seen)
    gain = math.exp(local[3])
    return _as_pixels((gain * seen[0], gain * seen[1]), kept)


def away_from_edges(known: PalmCopy, local: Local) -> Kept:
    """Pixels of a press that lie in the skin or in the mirror's opening, and not near an edge of them."""
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
    """Place and depth of a press's unknowns."""
    return Pose(float(local[0]), float(local[1]), math.exp(local[2]))


def backdrop_of(known: PalmCopy, rests: Sequence[Lights], places: Sequence[tuple[float, float]]) -> Backdrop:
    """What untouched frames, at one exposure, show beyond a copy.

    Args:
        known: the copy.
        rests: light of the untouched regions.
        places: over which the probe may hang in each, and hide what is there [m].
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
    """Light of a copy's untouched membrane, no probe in sight."""
    hidden = replace(known.spec, probe_in_mirror=False, probe_edge_on=False)
    return _light(replace(known, spec=hidden), Pose(0.0, 0.0, -1e-3), False)


def _free_of_probe(spec: PalmSpec, x_m: float, y_m: float) -> Bool[ndarray, "h w"]:
    """Pixels of the mirror's region that a ball hanging over a place does not cover."""
    cx, cy = contact_px(spec, x_m, y_m)
    width, height = spec.mirror.size_px
    across, down = np.meshgrid(np.arange(width) + 0.5 - cx, np.arange(height) + 0.5 - cy)
    wide, high = spec.mirror.pitches_m
    return np.asarray(np.hypot(across * wide, down * high) > HANGS_WITHIN * spec.indenter_radius_m)


def seen_press(spec: PalmSpec, one: PicturedPress) -> SeenPress:
    """A press's pictures, checked."""
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
    """Linear light of both regions of a frame."""
    return _regions(spec, _linear(image))


def lamp_of(known: PalmCopy, rests: Sequence[Lights]) -> float:
    """Logarithm of the lamp's light over that of a copy, with the exposure, as untouched frames show it."""
    bare = _bare(known)[1]
    told = bare > DARKEST * bare.max()
    share = np.mean([rest[1] for rest in rests], axis=0)[told] / bare[told]
    return math.log(max(float(np.median(share)), 1e-3))


def exposure_change(
    spec: PalmSpec, image: UInt8[ndarray, "h w 3"], reference: UInt8[ndarray, "h w 3"]
) -> float:
    """By how much longer a frame was exposed than the untouched one, as the housing beside its regions shows.

    1 where it shows no change, or too little of it is seen.
    """
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
    """A picture as a row, its hard edges softened, so that it changes smoothly as they move."""
    return cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT).ravel()


def _encoded(linear: ndarray) -> ndarray:
    """SRGB's curve without its rounding (IEC 61966-2-1)."""
    v = np.clip(linear, 0.0, 1.0).astype(np.float64)
    return np.where(v <= 0.0031308, 12.92 * v, 1.055 * np.maximum(v, 1e-9) ** (1 / 2.4) - 0.055)


def _linear(image: UInt8[ndarray, "h w 3"]) -> ndarray:
    """Its inverse, of 8-bit codes."""
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
