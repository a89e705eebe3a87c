"""Image of the pins under a flat rigid plate: skin of a head-on press, pin lengths, gel, window, and
distorted lens.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import RectBivariateSpline

from palpate.core import Float, ndarray
from palpate.mechanics.axisymmetric.tip_table import HeadOnPress
from palpate.sensors.tactip.tactip_camera import slopes

SPACING = 45  # tabulated depths of the skin
MAX_POLAR_RAD = 1.35  # maximum polar angle of pin roots

Share = Float[ndarray, "..."]


class TipOptics(NamedTuple):
    """Pins and camera.

    Attributes:
        lever_mm: Length of the pins.
        camera_mm: Height of the pinhole above the apex.
        distortion: Lens distortion at the edge of the pin field; negative for barrel distortion.
        edge_rad: Polar angle of the outermost pins' roots.
    """

    lever_mm: float
    camera_mm: float
    distortion: float
    edge_rad: float


@dataclass(frozen=True)
class InnerSkin:
    """Inside of the skin under a rigid plate, over approach [m] and polar angle [rad]."""

    radius: RectBivariateSpline
    height: RectBivariateSpline
    dome_m: float
    deepest_m: float
    widest_rad: float

    @classmethod
    def of(cls, press: HeadOnPress, dome_m: float) -> InnerSkin:
        """Build from a press and the dome's radius [m]."""
        deepest = float(press.approach_m[-1])
        approach = np.linspace(0, deepest, SPACING)
        inside = press.at("inside_m", np.minimum(press.force_at(approach), press.force_n[-1]))
        polar = press.polar_rad
        r, z = (RectBivariateSpline(approach, polar, inside[..., i]) for i in (0, 1))
        return cls(r, z, dome_m, deepest, float(polar[-1]))

    def markers(self, approach_m: Share, polar: Share, lever_m: float) -> tuple[Share, Share]:
        """Distance from the contact's axis and height of the pins' ends [m]."""
        polar = np.clip(polar, 0, self.widest_rad)
        dr, dz = (one.ev(approach_m, polar, dy=1) for one in (self.radius, self.height))
        size = np.hypot(dr, dz)
        r, z = (one.ev(approach_m, polar) for one in (self.radius, self.height))
        return r - lever_m * dz / size, z + lever_m * dr / size


@dataclass(frozen=True)
class PinView:
    """Camera: position in the pin field, 1 at its edge."""

    camera_m: float
    base_m: float
    gel_index: float
    distortion: float
    edge: float
    polar: Float[ndarray, " n"]
    seen: Float[ndarray, " n"]

    @classmethod
    def of(cls, skin: InnerSkin, optics: TipOptics, gel_index: float) -> PinView:
        polar = np.linspace(0, MAX_POLAR_RAD, 300)
        r, z = skin.markers(np.zeros_like(polar), polar, 1e-3 * optics.lever_mm)
        camera_m, lens = 1e-3 * optics.camera_mm, optics.distortion
        bare = cls(camera_m, skin.dome_m, gel_index, lens, 1.0, polar, polar)
        tangent = bare.tangent(r, z)
        edge = float(np.interp(optics.edge_rad, polar, tangent))
        whole = cls(camera_m, skin.dome_m, gel_index, lens, edge, polar, polar)
        return cls(camera_m, skin.dome_m, gel_index, lens, edge, polar, whole.lens(tangent))

    def tangent(self, r: Share, z: Share) -> Share:
        return np.asarray(slopes(r, self.base_m - z, self.camera_m - self.base_m, self.gel_index))

    def lens(self, tangent: Share) -> Share:
        u = tangent / self.edge
        return np.asarray(u * (1 + self.distortion * u**2) / (1 + self.distortion))

    def polar_of(self, seen: Share) -> Share:
        """Polar angle of the roots of pins at a distance from the middle at rest."""
        return np.asarray(np.interp(seen, self.seen, self.polar))

    def image(self, places_m: Float[ndarray, "t p 3"]) -> Float[ndarray, "t p 2"]:
        """Image positions from the lens's axis."""
        r = np.hypot(places_m[..., 0], places_m[..., 1])
        scale = self.lens(self.tangent(r, places_m[..., 2])) / np.maximum(r, 1e-9)
        return places_m[..., :2] * scale[..., None]


def rotations(turn: Float[ndarray, "t 2"]) -> Float[ndarray, "t 3 3"]:
    """Return rotations that take the apex by these angles towards +x and +y."""
    angle = np.hypot(*turn.T)
    x, y = (turn / np.maximum(angle, 1e-12)[:, None]).T
    zero = np.zeros_like(x)
    # Negative axis, since the apex points down.
    cross = -np.array([[zero, zero, x], [zero, zero, y], [-x, -y, zero]]).transpose(2, 0, 1)
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + s * cross + (1 - c) * cross @ cross)


class PinRoots(NamedTuple):
    """Untouched pins on the dome.

    Attributes:
        out: Unit vectors from the dome's centre to their roots.
        rest: Image positions, 1 at the field's edge.
        lever_m: Length of the pins.
        aside_m: Offset of the dome's axis from the camera's, and 0.
    """

    out: Float[ndarray, "n p 3"]
    rest: Float[ndarray, "n p 2"]
    lever_m: float
    aside_m: Float[ndarray, " 3"]


def pin_roots(
    skin: InnerSkin,
    view: PinView,
    lever_mm: float,
    at: Float[ndarray, "n p 2"],
    axis_mm: Float[ndarray, " 2"],
) -> PinRoots:
    """Return the roots of untouched pins seen at `at` (1 at the field's edge), with the axis offset
    `axis_mm`.
    """
    aside, lever_m = np.array([*(1e-3 * axis_mm), 0.0]), 1e-3 * lever_mm
    still = np.zeros(at.shape[:2])

    def on_dome(seen: Float[ndarray, "n p 2"]) -> tuple[ndarray, ndarray]:
        polar = view.polar_of(np.hypot(seen[..., 0], seen[..., 1]))
        azimuth = np.arctan2(seen[..., 1], seen[..., 0])
        r, z = skin.markers(still, polar, lever_m)
        c, s = np.cos(azimuth), np.sin(azimuth)
        out = np.stack([np.sin(polar) * c, np.sin(polar) * s, -np.cos(polar)], axis=-1)
        return out, view.image(np.stack([r * c, r * s, z], axis=-1) + aside)

    apex = np.array([[[0.0, 0.0, lever_m + float(skin.height.ev(0.0, 0.0))]]])
    # First-order correction of the camera's axis offset.
    _, first = on_dome(at)
    out, rest = on_dome(2 * at - (first - view.image(apex + aside)))
    return PinRoots(out, rest, lever_m, aside)


def plate_motion(
    skin: InnerSkin,
    view: PinView,
    pins: PinRoots,
    depth_mm: Float[ndarray, " n"],
    turn_rad: Float[ndarray, "n 2"],
) -> Float[ndarray, "n p 2"]:
    """Return the motion of pins in the image under a rigid plate, 1 being the field's edge.

    Args:
        skin, view, pins: Tip.
        depth_mm: Depth of each press.
        turn_rad: Rotation of the contact about the dome's centre, towards +x and +y.
    """
    centre = np.array([0.0, 0.0, skin.dome_m])
    rotation = rotations(turn_rad)
    x, y, z = np.moveaxis(np.einsum("tpi,tij->tpj", pins.out, rotation), -1, 0)
    approach = np.clip(1e-3 * depth_mm, 0, skin.deepest_m)
    polar = np.arccos(np.clip(-z, -1, 1))
    r, height = skin.markers(np.repeat(approach[:, None], x.shape[1], 1), polar, pins.lever_m)
    out = np.maximum(np.hypot(x, y), 1e-12)
    local = np.stack([r * x / out, r * y / out, height], axis=-1)
    moved = np.einsum("tpj,tij->tpi", local - centre, rotation) + centre
    return np.asarray(view.image(moved + pins.aside_m) - pins.rest)
