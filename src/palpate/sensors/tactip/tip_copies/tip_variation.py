"""How TacTips of one design differ: virtual copies drawn from a law of their own, and their frames.

The law is assumed. A copy's frames are drawn by the ray of every marker, refraction and all, with what the
design's render leaves out: a lens that distorts and blurs, pins that stand beside their lattice, an axis
beside the camera's, glare. Its tip is given: a table's, or one that was solved for the copy alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from palpate.core import Float, RangeError, UInt8, ndarray
from palpate.mechanics.axisymmetric.tip_family import TipBetween
from palpate.sensors.tactip.skin_and_markers import head_on, lattice
from palpate.sensors.tactip.tactip_camera import projected, rendered
from palpate.sensors.tactip.tactip_spec import TacTipSpec

GLARE_PX = 14.0  # standard deviation of a lamp's reflection


@dataclass(frozen=True, slots=True)
class TipSpread:
    """Standard deviations of copies about their design; ranges are even. All assumed.

    Attributes:
        stiffness_share: of the logarithm of all forces.
        lever_m, camera_m: of the pins' length and of the pinhole's height [m].
        distortion: of the lens, at the edge of the field of pins.
        pin_m: of each pin's root beside its lattice, either way [m].
        axis_m: of the camera beside the dome's axis, either way [m].
        seat_rad: of how the usual plate leans, either way [rad].
        press_rad: the same from press to press [rad].
        slip_px: of the whole field between two frames of a press, either way [px].
        blur_px, noise, glare: least and greatest of the lens's blur [px], of a pixel's noise and of a lamp's
            reflection beside the pins [grey levels].
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
    """A copy of a TacTip and its camera.

    Attributes:
        spec: with the copy's own lever and camera.
        tip: how it deforms.
        force_ratio: of its forces over the tip's.
        roots_rad: polar angle and azimuth of the pins' roots ``[2 p]``.
        axis_m: where the dome's axis stands beside the camera's, x and y [m].
        seat_rad: how the usual plate leans, x and y.
        press_rad, slip_px: see `TipSpread`.
        scale_px: the camera's focal length [px].
        distortion: of the lens, at `edge`.
        edge: tangent at which the outermost pins are seen.
        blur_px, noise, glare: see `TipSpread`.
        glare_at_px: where the reflection's middle is.
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
        """To which its tip is known [m]."""
        return float(self.tip.press.approach_m[-1])

    def force_n(self, depth_m: float) -> float:
        """On a rigid plate [N]."""
        return self.force_ratio * float(self.tip.press.force_at(np.array([depth_m]))[0])

    def depth_m(self, force_n: float) -> float:
        """At which a rigid plate has a force [m]."""
        own = force_n / self.force_ratio
        if not 0 <= own <= self.tip.press.force_n[-1]:
            most = self.force_ratio * self.tip.press.force_n[-1]
            raise RangeError(f"a force of {force_n} N; this tip is known to {most:.3g} N", code="force-range")
        return float(self.tip.press.at("approach_m", np.array([own]))[0])

    def places_px(
        self, depth_m: float, lean_rad: tuple[float, float] = (0.0, 0.0)
    ) -> tuple[Float[ndarray, "p 2"], Float[ndarray, " p"]]:
        """Places and radii of the markers [px]; the lean is of the contact, towards +x and +y."""
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
        """The untouched tip, and the same on a rigid plate that is seated by chance or leans as is said."""
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
    """One copy of a design.

    Args:
        design: what copies are made after; its own tip gives the usual forces.
        tip: how the copy deforms; its forces are scaled to the design's at a depth of 3 mm, and then drawn.
        rng: the only source of chance.
        spread: how far copies differ; None for the law as it is stated.
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
