"""Virtual TacTip units drawn from an assumed distribution, and their frames.

Frames include what the design's rendering omits: lens distortion and blur, misplaced pins, axis offset,
glare.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from palpate.core import Float, RangeError, UInt8, ndarray
from palpate.mechanics.axisymmetric.tip_table import TipBetween
from palpate.sensors.tactip.tactip_camera import projected, rendered
from palpate.sensors.tactip.tactip_press import head_on, lattice
from palpate.sensors.tactip.tactip_spec import TacTipSpec

GLARE_PX = 14.0  # standard deviation of a reflection


@dataclass(frozen=True, slots=True)
class TipSpread:
    """Spread of units about their design: standard deviations, or uniform ranges. All assumed.

    Attributes:
        stiffness_share: Logarithm of all forces.
        distortion: Lens distortion at the edge of the pin field.
        pin_m: Position of each pin's root, per axis.
        axis_m: Offset of the camera from the dome's axis, per axis.
        seat_rad, press_rad: Tilt of the usual plate, and of each press, per axis.
        slip_px: Shift between two frames of a press, per axis.
        blur_px, noise, glare: Minimum and maximum of blur [px], pixel noise, and reflection [grey levels].
    """

    stiffness_share: float = 0.15
    lever_m: float = 0.2e-3
    camera_m: float = 2e-3
    distortion: float = 0.025
    pin_m: float = 0.08e-3
    axis_m: float = 0.3e-3
    seat_rad: float = 0.006
    press_rad: float = 0.004
    slip_px: float = 0.15
    blur_px: tuple[float, float] = (0.3, 1.0)
    noise: tuple[float, float] = (1.0, 4.0)
    glare: tuple[float, float] = (0.0, 40.0)


@dataclass(frozen=True, eq=False)
class VirtualTip:
    """A virtual TacTip unit and its camera.

    Attributes:
        force_ratio: Forces over the tip's.
        roots_rad: Polar angle and azimuth of the pins' roots.
        axis_m: Offset of the dome's axis from the camera's.
        scale_px: Focal length [px].
        distortion: Lens distortion at the tangent `edge` of the outermost pins.
    """

    spec: TacTipSpec
    tip: TipBetween
    force_ratio: float
    roots_rad: Float[ndarray, "2 p"]
    axis_m: Float[ndarray, " 2"]
    seat_rad: Float[ndarray, " 2"]
    press_rad: float
    slip_px: float
    scale_px: float
    distortion: float
    edge: float
    blur_px: float
    noise: float
    glare: float
    glare_at_px: tuple[float, float]

    @property
    def deepest_m(self) -> float:
        return float(self.tip.press.approach_m[-1])

    def force_n(self, depth_m: float) -> float:
        """Force on a rigid plate [N]."""
        return self.force_ratio * float(self.tip.press.force_at(np.array([depth_m]))[0])

    def depth_m(self, force_n: float) -> float:
        """Depth on a rigid plate at a force [m]."""
        own = force_n / self.force_ratio
        if not 0 <= own <= self.tip.press.force_n[-1]:
            most = self.force_ratio * self.tip.press.force_n[-1]
            raise RangeError(f"a force of {force_n} N; this tip is known to {most:.3g} N", code="force-range")
        return float(self.tip.press.at("approach_m", np.array([own]))[0])

    def places_px(
        self, depth_m: float, lean_rad: tuple[float, float] = (0.0, 0.0)
    ) -> tuple[Float[ndarray, "p 2"], Float[ndarray, " p"]]:
        """Positions and radii of the markers [px], with the contact tilted towards +x and +y."""
        press, pins, radius_m = self.tip.press, self.spec.pins, self.tip.radius_m
        force = float(press.force_at(np.array([depth_m]))[0])
        skin = head_on(press, radius_m, force, (lean_rad[0], -lean_rad[1]))
        places, normals = skin.at(*self.roots_rad)
        markers = places + pins.length_m * normals + np.append(self.axis_m, 0.0)
        tangent, share = projected(markers, self.spec.camera, radius_m)
        u2 = np.sum((tangent / self.edge) ** 2, axis=1, keepdims=True)
        seen = tangent * (1 + self.distortion * u2) / (1 + self.distortion)
        return (
            self.spec.camera.size_px - 1
        ) / 2 + self.scale_px * seen, self.scale_px * share * pins.radius_m

    def frames(
        self, depth_m: float, rng: np.random.Generator, lean_rad: tuple[float, float] | None = None
    ) -> tuple[UInt8[ndarray, "h w"], UInt8[ndarray, "h w"]]:
        """Frames of the untouched tip, and on a rigid plate with a random or given tilt."""
        if lean_rad is None:
            x, y = self.seat_rad + self.press_rad * rng.standard_normal(2)
            lean_rad = float(x), float(y)
        shift = rng.normal(0, 0.7, 2)
        slip = self.slip_px * rng.standard_normal(2)
        rest, size = self.places_px(0.0)
        moved, size_moved = self.places_px(depth_m, lean_rad)
        return self._drawn(rest + shift, size, rng), self._drawn(moved + shift + slip, size_moved, rng)

    def _drawn(
        self, places: Float[ndarray, "p 2"], size: Float[ndarray, " p"], rng: np.random.Generator
    ) -> UInt8[ndarray, "h w"]:
        image = rendered(places, size, replace(self.spec.camera, noise=0.0), rng).astype(np.float64)
        y, x = np.indices(image.shape)
        away = (x - self.glare_at_px[0]) ** 2 + (y - self.glare_at_px[1]) ** 2
        image = cv2.GaussianBlur(image, (0, 0), self.blur_px) + self.glare * np.exp(-away / (2 * GLARE_PX**2))
        image += self.noise * rng.standard_normal(image.shape)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def drawn_tip(
    design: TacTipSpec, tip: TipBetween, rng: np.random.Generator, spread: TipSpread | None = None
) -> VirtualTip:
    """Draw one unit of a design.

    Args:
        design: Design; its tip sets the force scale at 3 mm.
        tip: Deformation of the unit.
        rng: Source of randomness.
        spread: Spread of units; None for the default.
    """
    s, z = TipSpread() if spread is None else spread, rng.standard_normal(9)
    camera = replace(design.camera, height_m=design.camera.height_m + s.camera_m * float(z[0]))
    lever_m = max(design.pins.length_m + s.lever_m * float(z[1]), 0.0)
    spec = replace(design, camera=camera, pins=replace(design.pins, length_m=lever_m))
    polar, azimuth = lattice(spec.pins, spec.inner_radius_m)
    flat = spec.inner_radius_m * np.sin(polar) * np.stack([np.cos(azimuth), np.sin(azimuth)])
    flat = flat + s.pin_m * rng.standard_normal(flat.shape)
    roots = np.stack([np.arcsin(np.hypot(*flat) / spec.inner_radius_m), np.arctan2(flat[1], flat[0])])
    stated = np.array([3e-3])
    usual = float(design.table.press(math.inf).force_at(stated)[0] / tip.press.force_at(stated)[0])
    turn, away = rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.9) * camera.disc_px
    middle = (camera.size_px - 1) / 2
    plain = VirtualTip(
        spec, tip, usual * math.exp(s.stiffness_share * float(z[2])), roots,
        s.axis_m * z[3:5], s.seat_rad * z[5:7], s.press_rad, s.slip_px, 1.0, 0.0, 1.0,
        float(rng.uniform(*s.blur_px)), float(rng.uniform(*s.noise)), float(rng.uniform(*s.glare)),
        (middle + float(away * np.cos(turn)), middle + float(away * np.sin(turn))),
    )  # fmt: skip
    seen, _ = plain.places_px(0.0)
    edge = float(np.hypot(*(seen - middle).T).max())
    return replace(plain, scale_px=camera.disc_px / edge, edge=edge, distortion=s.distortion * float(z[7]))
