"""Render the camera's frame of a contact: the edge-on fringes above, the mirror's view below.

The exact method marches every ray and traces every mirror pixel. The fast one renders each depth once and
shifts the image to the contact, ignoring where rays end at the membrane's round wall.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from palpate.core import Contact, Float32, Frame, InputError, Pose, Probe, UInt8, UInt16, ndarray
from palpate.mechanics.axisymmetric.shape_table import is_punched
from palpate.optics.colour import lamp_tint
from palpate.optics.image_chain import (
    CameraResponse,
    ImageChain,
    LedStrip,
    as_kept,
    backlight,
    develop,
    raw_codes,
    through_lens,
    uneven_light,
)
from palpate.optics.stress_optic import StressOpticLaw
from palpate.sensors.palm import fringe_rays, fringe_view, mirror_view
from palpate.sensors.palm.membrane_faults import (
    Film,
    MirrorDirt,
    ResidualMap,
    Wear,
    dirt_over,
    film,
    glare_in,
    passed_by,
    pressed_at,
    registered,
    scratches_over,
    spread,
)
from palpate.sensors.palm.palm_press import own_ball
from palpate.sensors.palm.palm_spec import PalmSpec
from palpate.sensors.palm.probe_shapes import parts_of, reaches_of, silhouette

BACKGROUND = 0.004
"""Light of the housing outside both regions, over the lamp's maximum. Assumed."""

UNSTRESSED = StressOpticLaw(1e-9)  # placeholder where no fringes are drawn

UNPRESSED_PA = 1e5  # placeholder where only the shape is drawn

BEHIND_ANALYSER = 0.5  # an ideal polariser passes half of unpolarised light

FAST_WITHIN = 0.4  # limit of the fast method, in membrane radii; rms error there is at most 0.01 of white

WITHIN = 0.7  # half side of the square with the mirror's scratch centers, in membrane radii

PROBE_LIGHT = 0.1
"""Light on the probe's camera side over that in the housing. Assumed."""

ROOM_FALL = 0.4
"""Relative decrease of room light from upper left to lower right. Assumed."""

Linear = Float32[ndarray, "h w 3"]
Below = Float32[ndarray, "u v 3"]
Grey = Float32[ndarray, "u v"]
Whole = Float32[ndarray, "height width 3"]


class Views(NamedTuple):
    """Both regions of one frame."""

    fringe_view: UInt8[ndarray, "h w 3"]
    mirror_view: UInt8[ndarray, "u v 3"]


def render(
    contact: Contact, spec: PalmSpec, rng: np.random.Generator, *, exact: bool | None = False
) -> Frame:
    """Render the camera's frame of a contact.

    Args:
        contact: Contact from `palm_press.press`.
        spec: Palm specification.
        rng: Source of the camera's noise.
        exact: Use the exact method; None chooses it where `fast_way_is_off`.

    Returns:
        8-bit sRGB frame ``[h w 3]``.
    """
    return expose(render_clean(contact, spec, exact=exact), spec, rng)


def expose(seen: tuple[Linear, Below], spec: PalmSpec, rng: np.random.Generator) -> Frame:
    """Return the noisy frame of both regions from `render_clean`."""
    codes = _codes(housed(seen, spec), spec, rng)
    return Frame(as_kept(developed(codes, spec), spec.chain), exposure_s=spec.exposure_s, sensor=spec.name)


def render_raw(
    contact: Contact, spec: PalmSpec, rng: np.random.Generator, *, exact: bool | None = False
) -> UInt16[ndarray, "h w 3"]:
    """Render raw camera codes without white balance (12 bits per channel by default)."""
    return _codes(housed(render_clean(contact, spec, exact=exact), spec), spec, rng)


def housed(seen: tuple[Linear, Below], spec: PalmSpec) -> Whole:
    """Place both regions in the housing and apply the lens."""
    clean = np.full((spec.frame_px[1], spec.frame_px[0], 3), BACKGROUND, np.float32)
    if spec.ambient:
        clean += np.float32(spec.ambient) * room_light(spec.frame_px)
    for view, light in zip((spec.fringes, spec.mirror), seen, strict=True):
        clean[view.window] = light
    clean = through_lens(clean, spec.chain)
    return clean if spec.auto_exposure is None else clean * np.float32(spec.auto_exposure.gain(clean))


def render_views(
    contact: Contact, spec: PalmSpec, rng: np.random.Generator, *, exact: bool | None = False
) -> Views:
    """Render both regions without the rest of the frame; faster unless the spec has lens, JPEG, or auto
    exposure.
    """
    if spec.chain != ImageChain() or spec.auto_exposure is not None:
        whole = render(contact, spec, rng, exact=exact).image
        return Views(*(np.ascontiguousarray(whole[view.window]) for view in (spec.fringes, spec.mirror)))
    seen = render_clean(contact, spec, exact=exact)
    return Views(*(developed(_codes(light, spec, rng), spec) for light in seen))


def render_clean(contact: Contact, spec: PalmSpec, *, exact: bool | None = False) -> tuple[Linear, Below]:
    """Render both regions without noise: linear RGB, 1 at the bare lamp's maximum.

    `exact` applies to the spec's ball without lateral load; other contacts are always marched.
    """
    views = spec.fringes, spec.mirror
    exact = fast_way_is_off(contact, spec) if exact is None else exact
    spec = replace(spec, fringes=spec.fringes.upright, mirror=spec.mirror.upright)
    light = _transmitted(contact, spec, exact)
    light *= _lamp(spec.lamp, spec.corner_loss, spec.membrane_transmission, spec.unlit)
    if spec.probe_edge_on:
        _draw_probe(light, contact, spec)
    light *= np.float32(spec.lamp_gain)
    grey = _reflected(contact, spec, exact) * np.float32(BEHIND_ANALYSER * spec.lamp_gain)
    below = np.repeat(grey[..., None], 3, axis=-1)
    if spec.wear.shows and spec.membrane:
        films = _films(spec.wear, spec.lamp, spec.corner_loss, spec.membrane_transmission, spec.unlit)
        for one, seen in zip(films, (light, below), strict=True):
            one.over(seen, spec.lamp_gain)
    if spec.dirt != MirrorDirt():
        below *= dirt_over(spec)[..., None]
    light, below = (registered(seen, view) for seen, view in zip((light, below), views, strict=True))
    if spec.glare.spots:
        for stream, (view, seen) in enumerate(zip(views, (light, below), strict=True)):
            seen += np.float32(spec.lamp_gain) * glare_in(spec.glare, view.upright, stream)[..., None]
    if spec.lamp_mired:
        for seen in (light, below):
            seen *= lamp_tint(spec.lamp_mired, fringe_view.spectrum(spec.bands))
    if spec.ambient:
        for view, seen in ((spec.fringes, light), (spec.mirror, below)):
            seen += np.float32(spec.ambient) * room_light(spec.frame_px)[view.window]
    return light, below


def fast_way_is_off(contact: Contact, spec: PalmSpec) -> bool:
    """Return whether a contact is so far from the middle that the fast method is inaccurate."""
    return math.hypot(contact.pose.x_m, contact.pose.y_m) > FAST_WITHIN * spec.radius_m


def _transmitted(contact: Contact, spec: PalmSpec, exact: bool) -> Linear:
    pose = contact.pose
    # Palms that differ in the mirror share one marched picture.
    spec = replace(
        spec, probe_in_mirror=True, opaque_underside=False, mirror=spec.fringes, mirror_elevation_rad=1.0
    )
    if not is_ball(contact, spec):
        spec = pressed_at(spec, pose.x_m, pose.y_m)
    if not spec.membrane:
        _check_air(contact, spec)
        return np.full((*spec.fringes.size_px[::-1], 3), spec.extinction, np.float32)
    if is_punched(contact) and contact.shear_pa is None:
        at = max(pose.depth_m, 0.0), pose.x_m, pose.y_m
        return fringe_view.march_fringes(spec.unlit, *at, punch=contact.probe).copy()
    if not is_ball(contact, spec):
        return fringe_rays.march_contact(spec, contact)
    depth_m = max(pose.depth_m, 0.0)
    if exact:
        return fringe_view.march_fringes(spec.unlit, depth_m, pose.x_m, pose.y_m).copy()
    return fringe_view.shift_fringes(spec, depth_m, pose.x_m, pose.y_m)


def _reflected(contact: Contact, spec: PalmSpec, exact: bool) -> Grey:
    pose = contact.pose
    if not spec.membrane:
        _check_air(contact, spec)
    spec = replace(  # palms that differ in what only polarised light shows share a trace
        pressed_at(spec, pose.x_m, pose.y_m),
        stress_optic=UNSTRESSED,
        youngs_modulus_pa=UNPRESSED_PA,
        polariser_rad=0.0,
        frozen_birefringence=0.0,
        residual=ResidualMap(),
    )
    if not is_ball(contact, spec):
        return mirror_view.trace_contact(spec, contact)
    below = mirror_view.trace_mirror if exact else mirror_view.shift_mirror
    return below(spec.unlit, pose.depth_m, pose.x_m, pose.y_m)


def _check_air(contact: Contact, spec: PalmSpec) -> None:
    pose = contact.pose
    if not (is_ball(contact, spec) and math.isfinite(pose.x_m + pose.y_m)):
        raise InputError(
            f"a {contact.probe.shape} at ({pose.x_m}, {pose.y_m}) m; without a membrane only the palm's own "
            "ball is drawn, without lateral load and at a finite place"
        )


def is_ball(contact: Contact, spec: PalmSpec) -> bool:
    """Return whether the contact is the spec's ball without lateral load."""
    return contact.probe == own_ball(spec) and contact.shear_pa is None


@lru_cache(maxsize=4)
def room_light(frame_px: tuple[int, int]) -> Float32[ndarray, "h w 1"]:
    """Return the room light over the frame: 1 in the upper left corner, decreasing to the lower right."""
    across, down = (np.linspace(0, ROOM_FALL / 2, size, dtype=np.float32) for size in frame_px)
    return np.asarray((1 - down[:, None] - across)[..., None])


def lamp(spec: PalmSpec) -> Linear:
    """Return the lamp as seen through a new membrane and its rim, including vignetting."""
    return spec.lamp_gain * _lamp(spec.lamp, spec.corner_loss, spec.membrane_transmission, spec.unlit)


def developed(codes: UInt16[ndarray, "h w 3"], spec: PalmSpec) -> UInt8[ndarray, "h w 3"]:
    """Convert raw codes to 8-bit sRGB by a lookup table."""
    table = _developed(spec.camera, spec.bands)
    image = np.empty(codes.shape, np.uint8)
    for channel in range(3):
        image[..., channel] = table[:, channel].take(codes[..., channel])
    return image


def _codes(light: Linear, spec: PalmSpec, rng: np.random.Generator) -> UInt16[ndarray, "h w 3"]:
    return raw_codes(light, fringe_view.spectrum(spec.bands).sensitivity, spec.camera, rng)


@lru_cache(maxsize=4)
def _developed(camera: CameraResponse, bands: int) -> UInt8[ndarray, "n 3"]:
    every = np.repeat(np.arange(2**camera.bits, dtype=np.uint16)[:, None, None], 3, axis=2)
    return np.ascontiguousarray(develop(every, fringe_view.spectrum(bands).sensitivity, camera)[:, 0])


@lru_cache(maxsize=8)
def _lamp(strip: LedStrip, corner_loss: float, transmission: float, spec: PalmSpec) -> Linear:
    view, rim = spec.fringes, fringe_view.columns_kept(spec)
    through = np.where(rim.visible & spec.membrane, rim.transmission * transmission, 1.0)
    light = backlight(strip, view.x_m, view.down_m, corner_loss) * through.astype(np.float32)
    return np.repeat(light[..., None], 3, axis=-1)


@lru_cache(maxsize=4)
def _films(
    wear: Wear, strip: LedStrip, corner_loss: float, transmission: float, spec: PalmSpec
) -> tuple[Film, Film]:
    view, rim, R, h = spec.fringes, fringe_view.columns_kept(spec), spec.radius_m, spec.thickness_m
    seen = fringe_view.spectrum(spec.bands)
    x, z = view.x_m, view.down_m
    lens = uneven_light(len(z), len(x), corner_loss)
    veil = BEHIND_ANALYSER * lens * spread(_lamp(strip, 0.0, transmission, spec)[..., 0], view.pitches_m)
    edge_on = film(
        wear,
        scratches_over(wear, 0, x, z, ((-R, R), (0.0, h))),
        veil,
        passed_by(wear.yellowing, rim.half_chord_m / R, seen),
        ((z >= 0) & (z <= h))[:, None] & rim.visible,
    )
    wear = Wear() if spec.opaque_underside else wear  # which the mirror then does not look through
    x, y = spec.mirror.x_m, spec.mirror.down_m / math.sin(spec.mirror_elevation_rad)
    path = np.full(len(x), mirror_view.path_m(spec) / spec.diameter_m)
    below = film(
        wear,
        scratches_over(wear, 1, x, y, ((-WITHIN * R, WITHIN * R),) * 2),
        np.full((len(y), len(x)), BEHIND_ANALYSER * mirror_view.veil(spec)),
        passed_by(wear.yellowing, path, seen),
        mirror_view.inside_rim(spec),
        glow=1.0,
    )
    return edge_on, below


def _draw_probe(light: Linear, contact: Contact, spec: PalmSpec) -> None:
    if contact.pose.depth_m == 0:
        return
    for part, (x, y, up) in parts_of(contact.probe):
        pose = Pose(contact.pose.x_m + x, contact.pose.y_m + y, contact.pose.depth_m - up)
        _draw_part(light, part, pose, spec)


def _draw_part(light: Linear, probe: Probe, pose: Pose, spec: PalmSpec) -> None:
    """Draw one body: past the rim above the rest surface, through it below."""
    glow = np.float32(BEHIND_ANALYSER * PROBE_LIGHT * spec.inside_light * spec.ball_albedo)
    x, z = spec.fringes.x_m, spec.fringes.down_m
    rays, reach = fringe_view.columns_kept(spec.unlit), reaches_of(probe)[0]
    through = np.where(rays.visible, rays.about(pose.x_m, pose.y_m)[0], np.inf)
    rest = int(np.searchsorted(z, 0.0, side="right"))
    regions = ((slice(rest), x - pose.x_m), (slice(rest, None), through))
    for rows, beside in regions if spec.membrane else ((slice(len(z)), x - pose.x_m),):
        near = np.flatnonzero(np.abs(beside) <= reach)
        if not len(near):
            continue
        part = light[rows, near[0] : near[-1] + 1]
        facing = silhouette(probe, pose.depth_m, beside[near[0] : near[-1] + 1], z[rows])[..., None]
        if rows.stop is not None:  # below the rest surface no ray passes the probe anyway
            part *= facing == 0
        part += glow * facing
