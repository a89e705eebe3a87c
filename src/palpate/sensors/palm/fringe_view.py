"""Edge-on view of the pressed membrane between crossed polarisers, with the round rim as a lens.

Each column looks along a straight ray at some offset s from the contact's axis. An axisymmetric field depends
on (s, z) only, so the fast method shifts one image and ignores where the membrane ends along each ray.
Residual birefringence does not move with the contact: the fast method adds it by a second-order expansion.
Rays that graze the upper surface are dark, as are those that the ball blocks.
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
from palpate.optics.colour import Spectrum, assumed_camera
from palpate.optics.march import Rays, march_axisymmetric
from palpate.optics.polariscope import ColumnRays, plane_amplitude, round_rim, with_leak
from palpate.sensors.palm.membrane_faults import (
    EVEN,
    ResidualMap,
    frozen_at,
    modulus_ratio,
    thickness_at,
)
from palpate.sensors.palm.palm_press import field_at, own_ball
from palpate.sensors.palm.palm_spec import PalmSpec, View
from palpate.sensors.palm.press_corrections import applied_rim
from palpate.sensors.palm.probe_shapes import silhouette

P = ParamSpec("P")
T = TypeVar("T")


def cache_within(most_bytes: int) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Cache results up to a total `nbytes`, least recently used first; arguments must be hashable."""

    def size(result: Any) -> int:
        return min(result.nbytes, most_bytes)

    return cached(LRUCache(most_bytes, getsizeof=size), lock=threading.Lock())


SLICES = 96  # slices per ray
FINE_PITCHES = 0.5  # offset step near the contact, in pixels inside the membrane
FINE_TO_RADII = 1.6  # extent of the fine step, in ball radii
COARSE = 8  # ratio of the step beyond
LOOKS = 1001  # columns that `sees` tests, equally spaced in their angle at the rim
GRAZED = 1e-5  # fraction of path in air from which a ray counts as grazing
RATIO_STEP = 0.02  # step of the stress ratio between cached images
ORDER_STEP = 0.02  # step of residual birefringence of the expansion, in orders
PICTURES_BYTES = 300_000_000
MARCHES_BYTES = 50_000_000

Numbers = Float[ndarray, "..."]
Light = Float32[ndarray, "h w 3"]
"""Behind the analyser in three channels, 1 being all of the lamp's light; the polarisers' leak is in it."""


def columns(spec: PalmSpec, view: View) -> ColumnRays:
    """Return the ray inside the membrane of each column."""
    return round_rim(view.x_m, spec.radius_m, spec.rim_index)


@lru_cache(maxsize=8)
def columns_kept(spec: PalmSpec) -> ColumnRays:
    """Return the rays of the fringe view (cached)."""
    return columns(spec, spec.fringes)


def sees(spec: PalmSpec, x_m: float, y_m: float, within_m: float = 0.0) -> bool:
    """Return whether any ray passes a position of the membrane, or comes within a distance [m].

    The rim is a lens: the half towards the camera is visible, and of the other half |x| < R + y sqrt(n^2 -
    1), with a strip beside each side near the far wall.
    """
    wide = spec.radius_m * np.sin(np.linspace(-np.pi / 2, np.pi / 2, LOOKS)[1:-1])
    offset, _, _ = round_rim(wide, spec.radius_m, spec.rim_index).about(x_m, y_m)
    return bool(offset.min() <= 0 <= offset.max() or np.abs(offset).min() < within_m)


@cache_within(MARCHES_BYTES)
def march_fringes(
    spec: PalmSpec, depth_m: float, x_m: float, y_m: float, slices: int = SLICES, punch: Probe | None = None
) -> Light:
    """March every ray from wall to wall, under the ball or a tabled upright punch (cached, read-only)."""
    pose = Pose(x_m, y_m, depth_m)
    if punch is None:
        spec = _stressed(*_found_by(spec, pose))
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
    """Return the light by the fast method: columns of the cached image at their offsets from the contact's
    axis.
    """
    here, ratio = _found_by(spec.unlit, Pose(x_m, y_m, depth_m))
    rays = columns_kept(here)
    offset, _, _ = rays.about(x_m, y_m)
    light = _seen_at(here, depth_m, ratio, offset)
    light[:, ~rays.visible] = spec.extinction
    return light


def _found_by(spec: PalmSpec, pose: Pose) -> tuple[PalmSpec, float]:
    """Even membrane at the press, and its stress over that of a centred press."""
    here = replace(spec, thickness_m=thickness_at(spec, pose.x_m, pose.y_m), gel=EVEN)
    return here, applied_rim(here, pose).force_ratio * modulus_ratio(spec, pose.x_m, pose.y_m)


def _stress_of(spec: PalmSpec, along: Numbers, aside: Numbers) -> tuple[Numbers, Numbers]:
    """Stress equivalent to a birefringence of two components."""
    C = spec.stress_optic.coefficient_per_pa
    return along / C, aside / C


def _seen_at(spec: PalmSpec, depth_m: float, stress_ratio: float, offset_m: Float[ndarray, " w"]) -> Light:
    """Columns of a depth's image with scaled stress, interpolated between two cached images."""
    steps = (1.0 - stress_ratio) / RATIO_STEP
    whole = math.floor(steps)
    light = _with_residual(_stressed(spec, 1.0 - RATIO_STEP * whole), depth_m, offset_m)
    if (share := np.float32(steps - whole)) > 0:
        lower = _with_residual(_stressed(spec, 1.0 - RATIO_STEP * (whole + 1)), depth_m, offset_m)
        light += share * (lower - light)
    return light


def _with_residual(spec: PalmSpec, depth_m: float, offset_m: Float[ndarray, " w"]) -> Light:
    """Columns of a depth's image with residual birefringence to second order."""
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
    """Spec whose light meets a stress scaled by a ratio."""
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
        return self.light.nbytes

    def at(self, offset_m: Float[ndarray, " w"]) -> Light:
        """Interpolate between columns, constant beyond them."""
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
    """March the image of one depth as seen from the membrane's middle (cached), with given orders of residual
    birefringence.
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
    """Return the mean of blocks of rays."""
    if across == down == 1:
        return light
    h, w, c = light.shape
    return light.reshape(h // down, down, w // across, across, c).mean(axis=(1, 3))


@lru_cache(maxsize=8)
def spectrum(bands: int) -> Spectrum:
    """Return the assumed lamp and camera."""
    return assumed_camera(bands)


def _inner_pitch(spec: PalmSpec) -> float:
    """Column pitch inside the membrane [m]."""
    return spec.fringes.pitch_m / spec.rim_index


def _offsets(spec: PalmSpec) -> Float[ndarray, " s"]:
    """Signed offsets up to the membrane's radius, fine near the contact."""
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
    probe = own_ball(spec) if punch is None else punch
    field = field_at(spec, depth_m, probe)
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
    along, aside = (np.broadcast_to(part, (len(rows), columns))[rows] for part in parts)
    return along, aside
