"""The mirror's view through the membrane: dimple, ball, and housing, in unpolarized grey light.

Parallel lines of sight rise at an angle, refract at the flat underside, and meet the deformed upper surface:
the ball where it touches, else the housing or the ball's side after refraction. The housing is dark overhead
and lit all around, so that refraction shows the dimple. Brightness values are assumed. With
`probe_in_mirror=False` only the membrane's deformation is drawn. Re-entry into the membrane is neglected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.interpolate import RegularGridInterpolator

from palpate.core import Bool, Contact, Float32, ndarray
from palpate.mechanics.axisymmetric.disc_table import TabulatedPress
from palpate.sensors.palm.fringe_view import cache_within
from palpate.sensors.palm.palm_press import pressed
from palpate.sensors.palm.palm_spec import PalmSpec

LID, WALL = 0.06, 0.4
"""Brightness of the dark lid and the lit walls over a white body's. Assumed."""

EDGE_ON = 0.35
"""Brightness of a surface at grazing over normal view. Assumed."""

STEPS = 48  # heights at which a line of sight is tested against the surface
REACH = 3.2  # radius beyond which the surface is flat, in ball radii
PATCHES_BYTES = 100_000_000
TRACES_BYTES = 20_000_000

Grey = Float32[ndarray, "h w"]


@cache_within(TRACES_BYTES)
def trace_mirror(spec: PalmSpec, depth_m: float, x_m: float, y_m: float) -> Grey:
    """Trace every pixel of the mirror's image (cached, read-only)."""
    x, y = _underside(spec)
    grey = _inside_rim(spec, _traced(spec, *_ball_surface(spec, depth_m), x - x_m, y - y_m))
    grey.setflags(write=False)
    return grey


def trace_contact(spec: PalmSpec, contact: Contact) -> Grey:
    """Trace the mirror's image under any probe from the contact's grid."""
    x, y = _underside(spec)
    reach = (min(float(contact.displacement_m.min()), 0.0), float(contact.displacement_m.max()))
    traced = _traced(spec, GridSurface(contact), reach, x - contact.pose.x_m, y - contact.pose.y_m)
    return _inside_rim(spec, traced)


def shift_mirror(spec: PalmSpec, depth_m: float, x_m: float, y_m: float) -> Grey:
    """Return the mirror's image by the fast method: one traced patch, shifted to the contact."""
    patch = patch_of(spec.unlit, depth_m)
    wide, high = spec.mirror.pitches_m
    half = (np.array(patch.grey.shape[::-1]) - 1) / 2
    cx, cy = spec.mirror.middle_px
    place = np.array([cx - 0.5 + x_m / wide, cy - 0.5 + y_m * math.sin(spec.mirror_elevation_rad) / high])
    move = np.column_stack([np.eye(2), place - half])
    grey = cv2.warpAffine(
        patch.grey,
        move,
        spec.mirror.size_px,
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=patch.flat,
    )
    return _inside_rim(spec, grey)


def contact_px(spec: PalmSpec, x_m: float, y_m: float, depth_m: float = 0.0) -> tuple[float, float]:
    """Return the pixel (x, y) from the region's corner at which the mirror shows a point on the upper
    surface.
    """
    lean, up = _inside_direction(spec)
    entry = y_m + (spec.thickness_m - depth_m) * lean / up
    wide, high = spec.mirror.pitches_m
    right, down = x_m / wide, entry * math.sin(spec.mirror_elevation_rad) / high
    (cx, cy), c, s = spec.mirror.middle_px, math.cos(spec.mirror.turn_rad), math.sin(spec.mirror.turn_rad)
    shift = spec.mirror.shift_px
    return cx + c * right - s * down + shift[0], cy + s * right + c * down + shift[1]


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """Traced surroundings of a contact, and the brightness of the flat surface."""

    grey: Grey
    flat: float

    @property
    def nbytes(self) -> int:
        return self.grey.nbytes


@cache_within(PATCHES_BYTES)
def patch_of(spec: PalmSpec, depth_m: float) -> Patch:
    """Trace the patch of one depth (cached)."""
    (wide, high), sine = spec.mirror.pitches_m, math.sin(spec.mirror_elevation_rad)
    reach = REACH * spec.indenter_radius_m + spec.thickness_m
    across, down = int(np.ceil(reach / wide)), int(np.ceil(reach * sine / high))
    x, y = np.meshgrid(np.arange(-across, across + 1) * wide, np.arange(-down, down + 1) * high / sine)
    nowhere = np.zeros((1, 1))
    flat = _traced(spec, *_ball_surface(spec, 0.0), nowhere, nowhere)[0, 0]
    return Patch(_traced(spec, *_ball_surface(spec, depth_m), x, y), float(flat))


def _underside(spec: PalmSpec) -> tuple[ndarray, ndarray]:
    """Position at which each pixel's line of sight enters the underside [m]."""
    x, y = np.meshgrid(spec.mirror.x_m, spec.mirror.down_m / math.sin(spec.mirror_elevation_rad))
    return x, y


def veil(spec: PalmSpec) -> float:
    """Return the brightness of a surface that scatters the housing's light evenly."""
    return spec.inside_light * (LID + WALL) / 2


def inside_rim(spec: PalmSpec) -> Bool[ndarray, "h w"]:
    """Return the mask of lines of sight that enter the membrane or its opening."""
    x, y = _underside(spec)
    return np.asarray(x**2 + y**2 <= spec.radius_m**2)


def path_m(spec: PalmSpec) -> float:
    """Return the length of a line of sight from the underside to the flat upper surface [m]."""
    return spec.thickness_m / _inside_direction(spec)[1]


def _inside_direction(spec: PalmSpec) -> tuple[float, float]:
    """Direction inside the membrane: components towards -y and -z."""
    lean = math.cos(spec.mirror_elevation_rad) / (spec.refractive_index if spec.membrane else 1.0)
    return lean, math.sqrt(1 - lean**2)


def _ball_surface(spec: PalmSpec, depth_m: float) -> tuple[BallSurface, tuple[float, float]]:
    press, R = pressed(spec, max(depth_m, 0.0)), spec.indenter_radius_m
    return BallSurface(press, R, depth_m), (float(press.surface.min()) * R, float(press.surface.max()) * R)


@dataclass(frozen=True, slots=True)
class BallSurface:
    """Upper surface of the membrane under a ball, from the finite-strain table; negative depth is a ball
    above it. Positions are relative to the contact's axis [m].
    """

    press: TabulatedPress
    radius_m: float
    depth_m: float

    def at(self, x: ndarray, y: ndarray) -> ndarray:
        """Depth z."""
        return np.interp(np.hypot(x, y), self.press.r * self.radius_m, self._surface, right=0.0)

    def slopes(self, x: ndarray, y: ndarray) -> tuple[ndarray, ndarray]:
        r, knots = np.hypot(x, y), self.press.r * self.radius_m
        slope = np.interp(r, knots, np.gradient(self._surface, knots), right=0.0)
        away = np.maximum(r, 1e-12)
        return slope * x / away, slope * y / away

    def touching(self, x: ndarray, y: ndarray) -> ndarray:
        return np.asarray(np.hypot(x, y) < self.press.contact_radius * self.radius_m)

    def beside(self, place: ndarray, out: ndarray) -> ndarray:
        """Cosine at which a line of sight that has left the membrane meets the probe; 0 for a miss."""
        if self.depth_m == 0:
            return np.zeros(place.shape[1:])
        R = self.radius_m
        away = place - np.array([0, 0, self.depth_m - R]).reshape(3, *(1,) * (place.ndim - 1))
        b = (away * out).sum(0)
        hit2 = b**2 - (away**2).sum(0) + R**2
        return np.where(b < 0, np.sqrt(np.maximum(hit2, 0)) / R, 0)

    @property
    def _surface(self) -> ndarray:
        return np.asarray(self.press.surface, dtype=float) * self.radius_m


class GridSurface:
    """The same under any probe, from a contact's grid; the probe is visible only where it touches."""

    def __init__(self, contact: Contact) -> None:
        x, y = contact.x_m - contact.pose.x_m, contact.y_m - contact.pose.y_m
        down, right = np.gradient(contact.displacement_m, y, x)
        parts = (contact.displacement_m, right, down, contact.touching.astype(float))
        self._read = RegularGridInterpolator(
            (y, x), np.stack(parts, axis=-1), bounds_error=False, fill_value=0.0
        )

    def at(self, x: ndarray, y: ndarray) -> ndarray:
        return self._part(x, y, 0)

    def slopes(self, x: ndarray, y: ndarray) -> tuple[ndarray, ndarray]:
        return self._part(x, y, 1), self._part(x, y, 2)

    def touching(self, x: ndarray, y: ndarray) -> ndarray:
        return self._part(x, y, 3) > 0.5

    def beside(self, place: ndarray, out: ndarray) -> ndarray:
        return np.zeros(place.shape[1:])

    def _part(self, x: ndarray, y: ndarray, which: int) -> ndarray:
        return np.asarray(self._read(np.stack([y, x], axis=-1))[..., which])


Surface = BallSurface | GridSurface


def _traced(spec: PalmSpec, surface: Surface, reach_m: tuple[float, float], x: ndarray, y: ndarray) -> Grey:
    """Brightness along lines of sight that enter the underside at (x, y) from the contact's axis."""
    if not spec.membrane:
        return _in_air(spec, surface, x, y)
    if spec.opaque_underside:
        return np.full(x.shape, LID * spec.inside_light, np.float32)
    (lean, up), h = _inside_direction(spec), spec.thickness_m
    z = _where_it_meets(surface, reach_m, x, y, h, lean / up)
    y_met = y - (h - z) * lean / up
    slopes = surface.slopes(x, y_met)
    out, passed = _refracted(slopes, lean, up, spec.refractive_index)
    outside = _outside(spec, surface, np.stack([x, y_met, z]), out)
    squarely = 1 / np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2)
    through = passed * outside + (1 - passed) * WALL
    covered = surface.touching(x, y_met) & spec.probe_in_mirror
    seen = np.where(covered, _probe(spec, squarely), through)
    return np.asarray(spec.inside_light * seen, dtype=np.float32)


def _in_air(spec: PalmSpec, surface: Surface, x: ndarray, y: ndarray) -> Grey:
    lean, up = _inside_direction(spec)
    place = np.stack([x, y, np.full(x.shape, spec.thickness_m)])
    out = np.stack([np.full(x.shape, part) for part in (0.0, -lean, -up)])
    return np.asarray(spec.inside_light * _outside(spec, surface, place, out), dtype=np.float32)


def _outside(spec: PalmSpec, surface: Surface, place: ndarray, out: ndarray) -> ndarray:
    """Brightness in the air: the probe's side or the housing."""
    housing = LID + (WALL - LID) * (1 - out[2] ** 2)
    if not spec.probe_in_mirror:
        return np.asarray(housing)
    facing = surface.beside(place, out)
    return np.where(facing > 0, _probe(spec, facing), housing)


def _probe(spec: PalmSpec, facing: ndarray) -> ndarray:
    return spec.ball_albedo * (EDGE_ON + (1 - EDGE_ON) * facing)


def _where_it_meets(
    surface: Surface, reach_m: tuple[float, float], x: ndarray, y: ndarray, h: float, tangent: float
) -> ndarray:
    """Depth z at which lines of sight first meet the surface [m]."""
    least, greatest = reach_m
    heights = np.linspace(greatest + 1e-9, least - 1e-9, STEPS)
    z = np.full(x.shape, heights[-1])
    met = np.zeros(x.shape, bool)
    before = np.full(x.shape, np.inf)
    for k, height in enumerate(heights):
        clear = height - surface.at(x, y - (h - height) * tangent)  # positive inside the membrane
        now = ~met & (clear <= 0)
        if now.any() and k:
            share = before[now] / np.maximum(before[now] - clear[now], 1e-15)
            z[now] = heights[k - 1] + share * (height - heights[k - 1])
        elif now.any():
            z[now] = height
        met |= now
        before = clear
    return z


def _refracted(slopes: tuple[ndarray, ndarray], lean: float, up: float, n: float) -> tuple[ndarray, ndarray]:
    """Direction ``[3 h w]`` beyond the surface, and the transmitted fraction of light (mean Fresnel)."""
    sx, sy = slopes
    normal = np.stack([sx, sy, -np.ones_like(sx)]) / np.sqrt(1 + sx**2 + sy**2)
    into = np.stack([np.zeros_like(sx), np.full_like(sx, -lean), np.full_like(sx, -up)])
    cos_in = np.clip((into * normal).sum(0), 0, 1)
    sin_out2 = n**2 * (1 - cos_in**2)
    cos_out = np.sqrt(np.maximum(1 - sin_out2, 0))
    direction = n * into + (cos_out - n * cos_in) * normal
    across = ((n * cos_in - cos_out) / np.maximum(n * cos_in + cos_out, 1e-12)) ** 2
    along = ((cos_in - n * cos_out) / np.maximum(cos_in + n * cos_out, 1e-12)) ** 2
    return direction, np.where(sin_out2 >= 1, 0.0, 1 - (across + along) / 2)


def _inside_rim(spec: PalmSpec, grey: Grey) -> Grey:
    return np.where(inside_rim(spec), grey, np.float32(0))
