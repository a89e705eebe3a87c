"""A contact to the camera's frame: the edge-on fringes above, the mirror's view below.

Two ways. The exact one marches every ray from wall to wall and traces every pixel of the mirror. The fast one
marches each depth once and moves the picture to the contact; what it leaves out is that rays off the
contact's axis end at the membrane's round wall and not at the table's.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, UInt8, UInt16
from numpy import ndarray

from palpate.core.contact import Contact, Probe
from palpate.core.frame import Frame
from palpate.optics.camera import Camera, develop, raw_codes
from palpate.optics.illumination import LedStrip, backlight
from palpate.sensors.palm import fringes, mirror, volume
from palpate.sensors.palm.shapes import reach_of, silhouette
from palpate.sensors.palm.spec import PalmSpec

BACKGROUND = 0.004
"""Of the housing outside both regions, over the lamp at its brightest. Assumed."""

BEHIND_ANALYSER = 0.5  # an ideal polariser passes half of unpolarised light

PROBE_LIGHT = 0.1
"""Light on the probe's side towards the camera, over what there is in the housing. Assumed."""

Linear = Float32[ndarray, "h w 3"]
Below = Float32[ndarray, "u v 3"]
Whole = Float32[ndarray, "height width 3"]


class Views(NamedTuple):
    """Both regions of one frame, 8-bit sRGB."""

    fringes: UInt8[ndarray, "h w 3"]
    mirror: UInt8[ndarray, "u v 3"]


def render(contact: Contact, spec: PalmSpec, rng: np.random.Generator, *, exact: bool = False) -> Frame:
    """The camera's frame of a contact.

    Args:
        contact: of the spec's ball, whose depth and place are drawn; or any that `press` makes.
        spec: the palm.
        rng: for the camera's noise, the only source of chance.
        exact: march and trace everything anew, instead of moving the depth's own picture to the place.

    Returns:
        8-bit sRGB ``[h w 3]`` of the whole frame, dark outside the two regions.

    Raises:
        RangeError: its depth lies beyond the table.
    """
    return expose(render_clean(contact, spec, exact=exact), spec, rng)


def expose(seen: tuple[Linear, Below], spec: PalmSpec, rng: np.random.Generator) -> Frame:
    """A frame of what `render_clean` gave: both regions in the housing, with the camera's noise."""
    codes = _codes(_housed(seen, spec), spec, rng)
    return Frame(developed(codes, spec), exposure_s=spec.exposure_s, sensor=spec.name)


def render_raw(
    contact: Contact, spec: PalmSpec, rng: np.random.Generator, *, exact: bool = False
) -> UInt16[ndarray, "h w 3"]:
    """The same frame as the converter writes it, not balanced: 12 bits a channel in the default camera."""
    return _codes(_housed(render_clean(contact, spec, exact=exact), spec), spec, rng)


def _housed(seen: tuple[Linear, Below], spec: PalmSpec) -> Whole:
    """Both regions where they lie in the frame."""
    clean = np.full((spec.frame_px[1], spec.frame_px[0], 3), BACKGROUND, np.float32)
    for view, light in zip((spec.fringes, spec.mirror), seen, strict=True):
        x, y, w, h = view.box_px
        clean[y : y + h, x : x + w] = light
    return clean


def render_views(contact: Contact, spec: PalmSpec, rng: np.random.Generator, *, exact: bool = False) -> Views:
    """Both regions alone, as `render` would draw them, in less time."""
    seen = render_clean(contact, spec, exact=exact)
    return Views(*(developed(_codes(light, spec, rng), spec) for light in seen))


def render_clean(contact: Contact, spec: PalmSpec, *, exact: bool = False) -> tuple[Linear, Below]:
    """What the camera would see of both regions without noise: linear RGB, 1 at the bare lamp's brightest.

    The spec's ball without lateral load takes one of the two ways; any other contact is marched through its
    own stress, whatever `exact` says.
    """
    if is_ball(contact, spec):
        edge_on, below = (fringes.exact, mirror.exact) if exact else (fringes.shifted, mirror.shifted)
        depth_m, *place = contact.pose.depth_m, contact.pose.x_m, contact.pose.y_m
        light, grey = edge_on(spec, max(depth_m, 0.0), *place), below(spec, depth_m, *place)
    else:
        light, grey = volume.exact(spec, contact), mirror.of_contact(spec, contact)
    light *= _lamp(spec.lamp, spec.corner_loss, spec.membrane_transmission, spec.unlit)
    _draw_probe(light, contact, spec)
    light *= np.float32(spec.lamp_gain)
    grey = grey * np.float32(BEHIND_ANALYSER * spec.lamp_gain)
    return light, np.repeat(grey[..., None], 3, axis=-1)


def is_ball(contact: Contact, spec: PalmSpec) -> bool:
    """Whether the finite-strain table has this contact."""
    return contact.probe == Probe("sphere", spec.indenter_radius_m) and contact.lateral_n == (0.0, 0.0)


def lamp(spec: PalmSpec) -> Linear:
    """The lamp as seen through membrane and rim, the camera's vignetting with it."""
    return spec.lamp_gain * _lamp(spec.lamp, spec.corner_loss, spec.membrane_transmission, spec.unlit)


def developed(codes: UInt16[ndarray, "h w 3"], spec: PalmSpec) -> UInt8[ndarray, "h w 3"]:
    """Raw codes to 8-bit sRGB, by a table of what `develop` makes of each code."""
    table = _developed(spec.camera, spec.bands)
    image = np.empty(codes.shape, np.uint8)
    for channel in range(3):
        image[..., channel] = table[:, channel].take(codes[..., channel])
    return image


def _codes(light: Linear, spec: PalmSpec, rng: np.random.Generator) -> UInt16[ndarray, "h w 3"]:
    return raw_codes(light, fringes.spectrum(spec.bands).sensitivity, spec.camera, rng)


@lru_cache(maxsize=4)
def _developed(camera: Camera, bands: int) -> UInt8[ndarray, "n 3"]:
    every = np.repeat(np.arange(2**camera.bits, dtype=np.uint16)[:, None, None], 3, axis=2)
    return np.ascontiguousarray(develop(every, fringes.spectrum(bands).sensitivity, camera)[:, 0])


@lru_cache(maxsize=8)
def _lamp(strip: LedStrip, corner_loss: float, transmission: float, spec: PalmSpec) -> Linear:
    view, rim = spec.fringes, fringes.columns_kept(spec)
    through = np.where(rim.visible, rim.transmission * transmission, 1.0)
    light = backlight(strip, view.x_m, view.down_m, corner_loss) * through.astype(np.float32)
    return np.repeat(light[..., None], 3, axis=-1)


def _draw_probe(light: Linear, contact: Contact, spec: PalmSpec) -> None:
    """What the lit housing shows of the probe: past the rim above the rest surface, through it below."""
    glow = np.float32(BEHIND_ANALYSER * PROBE_LIGHT * spec.inside_light * spec.ball_albedo)
    x, z = spec.fringes.x_m, spec.fringes.down_m
    rays, pose, reach = fringes.columns_kept(spec.unlit), contact.pose, reach_of(contact.probe)
    through = np.where(rays.visible, rays.about(pose.x_m, pose.y_m)[0], np.inf)
    rest = int(np.searchsorted(z, 0.0, side="right"))
    for rows, beside in ((slice(rest), x - pose.x_m), (slice(rest, None), through)):
        near = np.flatnonzero(np.abs(beside) <= reach)
        if pose.depth_m == 0 or not len(near):
            continue
        part = light[rows, near[0] : near[-1] + 1]
        facing = silhouette(contact.probe, pose.depth_m, beside[near[0] : near[-1] + 1], z[rows])[..., None]
        if rows.stop is not None:  # below the rest surface no ray passes the probe anyway
            part *= facing == 0
        part += glow * facing
