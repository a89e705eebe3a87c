"""The edge-on view: crossed polarisers, the pressed membrane between them, its round rim a lens.

Through the rim a column of the image looks along a straight ray inside the membrane that passes the
contact's axis at some offset s. An axisymmetric field depends on nothing else, so one picture of (s, z)
serves a contact anywhere (the fast way); what it misses is where the membrane ends along each ray. What is
frozen into the membrane does not move with the contact: the fast way adds it to the picture by the light's
first and second slopes over it, and leaves out its cube.

A ray that meets the membrane's upper surface on its way, in the dimple beside the ball or in the bulge around
it, does so at a grazing angle: it is thrown back or bent far off. Such rays are drawn dark, as are those that
the ball stops.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ParamSpec, TypeVar

import numpy as np
from cachetools import LRUCache, cached

from palpate.core import Float, Float32, Pose, Probe, ndarray
from palpate.optics.axisymmetric_march import Rays, march_axisymmetric
from palpate.optics.colour import Spectrum, assumed_camera
from palpate.optics.polariscope import plane_amplitude, with_leak
from palpate.optics.wall_refraction import ColumnRays, round_rim
from palpate.sensors.palm.palm_press import field_at, field_under
from palpate.sensors.palm.palm_rim import applied_rim
from palpate.sensors.palm.palm_spec import PalmSpec, View
from palpate.sensors.palm.probe_shapes import silhouette
from palpate.sensors.palm.uneven_membrane import (
    EVEN,
    ResidualMap,
    frozen_at,
    modulus_ratio,
    thickness_at,
)

P = ParamSpec("P")
T = TypeVar("T")


def cache_within(most_bytes: int) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Keep what a function returned, the least recently used going first; arguments must be hashable.

    What it returns tells its size in memory as `nbytes`. What takes more than the bound by itself displaces
    all others and is kept alone.
    """

    def size(result: Any) -> int:
        return min(result.nbytes, most_bytes)

    return cached(LRUCache(most_bytes, getsizeof=size), lock=threading.Lock())


SLICES = 96  # twice as many change 999 of 1000 pixels by less than a grey level of 255
FINE_PITCHES = 0.5  # step of s near the contact, in pixels inside the membrane
FINE_TO_RADII = 1.6  # ball radii up to which the step is fine
COARSE = 8  # how much longer it is beyond
LOOKS = 1001  # columns at which `sees` looks, equally spaced in the angle at which they meet the rim
GRAZED = 1e-5  # share of its way in air from which a ray counts as having met the surface
RATIO_STEP = 0.02  # of stress near the rim, between whose kept pictures the fast way mixes
ORDER_STEP = 0.02  # of residual birefringence, between the pictures its slopes are taken of
PICTURES_BYTES = 300_000_000
MARCHES_BYTES = 50_000_000

Numbers = Float[ndarray, "..."]
Light = Float32[ndarray, "h w 3"]
"""Behind the analyser in three channels, 1 being all of the lamp's light; the polarisers' leak is in it."""


def columns(spec: PalmSpec, view: View) -> ColumnRays:
    """The ray inside the membrane of each column."""
    return round_rim(view.x_m, spec.radius_m, spec.rim_index)


@lru_cache(maxsize=8)
def columns_kept(spec: PalmSpec) -> ColumnRays:
    """Those of the fringe view, not traced again."""
    return columns(spec, spec.fringes)


def sees(spec: PalmSpec, x_m: float, y_m: float, within_m: float = 0.0) -> bool:
    """Whether any ray of the view passes a place of the membrane, or goes by within a distance [m].

    The rim is a lens. Its outermost rays meet it grazing at (R, 0) and (-R, 0) and run inward, at R / n from
    the axis where they are nearest: all of the half towards the camera is seen, and of the other what lies
    between these two, |x| < R + y sqrt(n^2 - 1), with a strip beside each near the far wall, where rays
    cross. Contacts elsewhere show only what of their stress reaches there.
    """
    wide = spec.radius_m * np.sin(np.linspace(-np.pi / 2, np.pi / 2, LOOKS)[1:-1])
    offset, _, _ = round_rim(wide, spec.radius_m, spec.rim_index).about(x_m, y_m)
    return bool(offset.min() <= 0 <= offset.max() or np.abs(offset).min() < within_m)


@cache_within(MARCHES_BYTES)
def march_fringes(spec: PalmSpec, depth_m: float, x_m: float, y_m: float, slices: int = SLICES) -> Light:
    """Light of every ray, marched from wall to wall; it is kept, and so cannot be written to."""
    here, ratio = _found_by(spec, Pose(x_m, y_m, depth_m))
    return _all_marched(_stressed(here, ratio), Pose(x_m, y_m, depth_m), None, slices)


@cache_within(MARCHES_BYTES)
def march_punch(spec: PalmSpec, probe: Probe, pose: Pose, slices: int = SLICES) -> Light:
    """The same under an upright punch by its table, in a membrane as it is where it is pressed."""
    return _all_marched(spec, pose, probe, slices)


def _all_marched(spec: PalmSpec, pose: Pose, punch: Probe | None, slices: int) -> Light:
    """Light of every ray, under a punch or the spec's ball."""
    view = spec.fringes.sampled(*spec.rays_per_pixel)
    width, height = view.size_px
    light = np.full((height, width, 3), spec.extinction, np.float32)
    rays = columns(spec, view)
    offset, start, end = (part[rays.visible] for part in rays.about(pose.x_m, pose.y_m))
    frozen = frozen_at(spec, rays.impact_m[rays.visible], view.down_m[:, None])
    frozen_pa = _stress_of(spec, *frozen)
    path = offset, start, end
    light[:, rays.visible] = _marched(spec, pose.depth_m, view.down_m, *path, frozen_pa, slices, punch)
    light = mean_of(light, *spec.rays_per_pixel)
    light.setflags(write=False)
    return light


def shift_fringes(spec: PalmSpec, depth_m: float, x_m: float, y_m: float) -> Light:
    """Light by the fast way: columns of the kept picture, at each column's offset from the contact's axis."""
    here, ratio = _found_by(spec.unlit, Pose(x_m, y_m, depth_m))
    rays = columns_kept(here)
    offset, _, _ = rays.about(x_m, y_m)
    light = _seen_at(here, depth_m, ratio, offset)
    light[:, ~rays.visible] = spec.extinction
    return light


def _found_by(spec: PalmSpec, pose: Pose) -> tuple[PalmSpec, float]:
    """An even membrane as a press finds it here, and the ratio of its stress to that of one in the middle."""
    here = replace(spec, thickness_m=thickness_at(spec, pose.x_m, pose.y_m), gel=EVEN)
    return here, applied_rim(here, pose).force_ratio * modulus_ratio(spec, pose.x_m, pose.y_m)


def _stress_of(spec: PalmSpec, along: Numbers, aside: Numbers) -> tuple[Numbers, Numbers]:
    """Stress that would make a birefringence of two components."""
    C = spec.stress_optic.coefficient_per_pa
    return along / C, aside / C


def _seen_at(spec: PalmSpec, depth_m: float, stress_ratio: float, offset_m: Float[ndarray, " w"]) -> Light:
    """Columns of a depth's picture, all its stress times a ratio: mixed of the two nearest that are kept."""
    steps = (1.0 - stress_ratio) / RATIO_STEP
    whole = math.floor(steps)
    light = _with_residual(_stressed(spec, 1.0 - RATIO_STEP * whole), depth_m, offset_m)
    if (share := np.float32(steps - whole)) > 0:
        lower = _with_residual(_stressed(spec, 1.0 - RATIO_STEP * (whole + 1)), depth_m, offset_m)
        light += share * (lower - light)
    return light


def _with_residual(spec: PalmSpec, depth_m: float, offset_m: Float[ndarray, " w"]) -> Light:
    """Columns of a depth's picture, with what is frozen into each column's own ray, to the second order."""
    kept = replace(spec, frozen_birefringence=0.0, frozen_axis_rad=0.0, residual=ResidualMap())
    light = picture_of(kept, depth_m).at(offset_m)
    if spec.frozen_birefringence == 0.0 and spec.residual.birefringence == 0.0:
        return light
    rays, z, e = columns_kept(spec.unlit), spec.fringes.down_m[:, None], ORDER_STEP
    long = 2 * rays.half_chord_m / spec.stress_optic.reference_wavelength_m / e
    u, v = ((part * long)[..., None].astype(np.float32) for part in frozen_at(spec, rays.impact_m, z))
    coarse = replace(kept, rays_per_pixel=(1, 1))  # of slopes times little, fewer rays and slices do
    middle, right, left, down, up, both, neither = (
        picture_of(coarse, depth_m, (e * a, e * b), SLICES // 2).at(offset_m)
        for a, b in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1))
    )
    straight = 2 * middle
    bent_u, bent_v = right + left - straight, down + up - straight
    twist = both + neither - straight - bent_u - bent_v
    light = light + (u * (right - left + u * bent_u) + v * (down - up + v * bent_v) + u * v * twist) / 2
    return np.maximum(light, 0.0)


def _stressed(spec: PalmSpec, ratio: float) -> PalmSpec:
    """A spec under which light meets a stress taken times a ratio: the phase knows only C times it."""
    law = spec.stress_optic
    if ratio == 1.0:
        return spec
    return replace(spec, stress_optic=replace(law, coefficient_per_pa=law.coefficient_per_pa * ratio))


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """Light of the rays at signed offsets s from the contact's axis."""

    offset_m: Float[ndarray, " s"]
    light: Float32[ndarray, "h s 3"]

    @property
    def nbytes(self) -> int:
        """Size in memory [bytes]."""
        return self.light.nbytes

    def at(self, offset_m: Float[ndarray, " w"]) -> Light:
        """Interpolated between its columns; beyond them as at the last, which no stress reaches."""
        s = self.offset_m
        i = np.clip(np.searchsorted(s, offset_m) - 1, 0, len(s) - 2)
        share = np.clip((offset_m - s[i]) / (s[i + 1] - s[i]), 0, 1).astype(np.float32)
        light, after = self.light.take(i, axis=1), self.light.take(i + 1, axis=1)
        flat, beyond = light.reshape(len(light), -1), after.reshape(len(light), -1)  # long rows add faster
        beyond -= flat
        beyond *= np.repeat(share, 3)
        flat += beyond
        return light


@cache_within(PICTURES_BYTES)
def picture_of(
    spec: PalmSpec, depth_m: float, frozen: tuple[float, float] = (0.0, 0.0), slices: int = SLICES
) -> Picture:
    """The picture of one depth, marched once: as seen from the membrane's middle, each pixel's rays averaged.

    With orders of residual birefringence on every ray, along the axes and along their diagonals, if asked.

    Under a press towards or away from the camera columns stand up to a fifth closer or wider, which their
    averaging does not follow.
    """
    across, down = spec.rays_per_pixel
    s = _offsets(spec)
    R = spec.radius_m
    reach = np.sqrt(np.maximum(R**2 - s**2, (1e-3 * R) ** 2))
    z = spec.fringes.sampled(1, down).down_m
    frozen_pa = _stress_of(
        spec, *(order * spec.stress_optic.reference_wavelength_m / (2 * reach) for order in frozen)
    )
    picture = Picture(s, mean_of(_marched(spec, depth_m, z, s, -reach, reach, frozen_pa, slices), 1, down))
    rays = ((np.arange(across) + 0.5) / across - 0.5) * _inner_pitch(spec)
    return Picture(s, np.stack([picture.at(s + ray) for ray in rays]).mean(axis=0))


def mean_of(light: Float32[ndarray, "rows columns 3"], across: int, down: int) -> Light:
    """Blocks of rays to pixels."""
    if across == down == 1:
        return light
    h, w, c = light.shape
    return light.reshape(h // down, down, w // across, across, c).mean(axis=(1, 3))


@lru_cache(maxsize=8)
def spectrum(bands: int) -> Spectrum:
    """The assumed lamp and camera."""
    return assumed_camera(bands)


def _inner_pitch(spec: PalmSpec) -> float:
    """Pitch of the columns inside the membrane, at its middle [m]."""
    return spec.fringes.pitch_m / spec.rim_index


def _offsets(spec: PalmSpec) -> Float[ndarray, " s"]:
    """Signed offsets up to the membrane's radius: fine near the contact, coarse beyond."""
    step, R = FINE_PITCHES * _inner_pitch(spec), spec.radius_m
    fine_to = min(FINE_TO_RADII * spec.indenter_radius_m, R)
    fine = np.linspace(0, fine_to, int(np.ceil(fine_to / step)) + 1)
    rest = np.linspace(fine_to, R, int(np.ceil((R - fine_to) / (COARSE * step))) + 1)
    half = np.concatenate([fine, rest[1:]])
    return np.concatenate([-half[:0:-1], half])


def _marched(
    spec: PalmSpec,
    depth_m: float,
    z: Float[ndarray, " h"],
    offset_m: Float[ndarray, " w"],
    start_m: Float[ndarray, " w"],
    end_m: Float[ndarray, " w"],
    frozen_pa: tuple[Numbers, Numbers],
    slices: int = SLICES,
    punch: Probe | None = None,
) -> Light:
    probe = Probe("sphere", spec.indenter_radius_m) if punch is None else punch
    field = field_at(spec, depth_m) if punch is None else field_under(spec, punch, depth_m)
    seen = spectrum(spec.bands)
    light = np.full((len(z), len(offset_m), 3), spec.extinction, np.float32)
    skin = (z >= field.surface_m.min()) & (z <= field.thickness_m)  # no other row meets any
    z = z[skin]
    rows = z[:, None]
    scale = np.sqrt(offset_m**2 + np.maximum(rows, 0) ** 2 + (0.2 * probe.radius_m) ** 2)
    made = march_axisymmetric(
        field,
        Rays(offset_m[None], rows, start_m[None], end_m[None], scale),
        spec.stress_optic.half_phase(seen.wavelength_m),
        seen.weight,
        plane_amplitude(spec.polariser_rad, spec.bands),
        slices,
        _of_rows(frozen_pa, skin, len(offset_m)),
    )
    lit = with_leak(made.light, spec.extinction)
    grazed = (made.skin_m > 0) & (made.skin_m < (1 - GRAZED) * (end_m - start_m))
    body = silhouette(probe, depth_m, offset_m, z)
    lit[grazed | ((body > 0) & (rows > 0))] = 0
    light[skin] = lit
    return light


def _of_rows(parts: tuple[Numbers, Numbers], rows: ndarray, columns: int) -> tuple[Numbers, Numbers]:
    """Both numbers of some rows of a picture."""
    along, aside = (np.broadcast_to(part, (len(rows), columns))[rows] for part in parts)
    return along, aside
