"""A TacTip on a flat rigid plate at any pose: the head-on press, turned by tilt, carried by shear and twist.

The skin's shape is that of the head-on press (`tip_table`) at the pose's depth, turned about the centre of
the dome to where the plate touches. What sticks to the plate goes with it: of shear and twist each place of
the skin takes a share that is 1 at the contact and falls to 0 beyond it, and that grows with depth as the
contact stops slipping. Pins are levers along the deformed skin's normal, seen through the gel, window and a
lens with radial distortion. The turn, the shares and the couplings are kinematic, with `TipTerms` to be
fitted to taps; only the head-on press is mechanics.

Beyond what plate and dome explain there is one coupling without a model, `shear_per_tilt_x` and `_y`: taps of
a real tip were carried by a share that changes with the sign of the tilt.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import RectBivariateSpline

from palpate.core import Float, ndarray
from palpate.mechanics.axisymmetric.tip_table import tip_table
from palpate.sensors.tactip.tactip_camera import slopes

POSE = ("depth_mm", "tilt_x_deg", "tilt_y_deg", "shear_x_mm", "shear_y_mm", "twist_deg")
"""Columns of a pose."""
SPACING = 45  # depths between which the skin is read
MAX_POLAR_RAD = 1.35  # of pins' roots

Poses = Float[ndarray, "t 6"]
Places = Float[ndarray, "p 2"]
Moved = Float[ndarray, "t p 2"]
Share = Float[ndarray, "..."]


class TipTerms(NamedTuple):
    """What makes one tip and its camera, in the order in which they are fitted.

    Attributes:
        lever_mm: length of the pins below the skin's inside.
        camera_mm: height of the pinhole above the apex.
        depth_zero_mm: stated depth at which the apex touches.
        distortion: of the lens, at the edge of the field of pins; negative for barrel distortion.
        edge_rad: polar angle of the outermost pins' roots.
        tilt_xx, tilt_xy, tilt_yx, tilt_yy: turn of the contact about the dome's centre, along the image's x
            and y, for the tilts stated [rad/rad].
        shear_xx, shear_xy, shear_yx, shear_yy: motion of the plate in the image's axes over that stated.
        depth_per_tilt: change of depth with the square of the turn [mm/rad^2].
        shear_per_turn: of the plate over the turn, in radii of the dome [1/rad].
        turn_per_shear: turn over the plate's motion in radii of the dome [rad].
        shear_per_tilt_x, shear_per_tilt_y: relative change of the plate's motion with the tilts [1/rad].
        twist: turn of the plate over that stated.
        shear_by_twist: turn of the direction of shear over the twist.
        slip_mm, slip_power: depth by which the contact holds, and how abruptly.
        shear_rad, shear_per_contact, shear_fade_rad: polar angle about the contact where the share of shear
            is half: the constant, its part of the contact's own angle, and the width over which it fades.
        twist_rad, twist_per_contact, twist_fade_rad: the same of twist.
        shear_far: share of shear that the whole tip takes.
        seat_x_rad, seat_y_rad: turn of the contact where the plate is said to be upright.
    """

    lever_mm: float = 0.5
    camera_mm: float = 45.0
    depth_zero_mm: float = 0.3
    distortion: float = 0.0
    edge_rad: float = 1.0
    tilt_xx: float = 0.0
    tilt_xy: float = 0.0
    tilt_yx: float = 0.0
    tilt_yy: float = 0.0
    shear_xx: float = 0.0
    shear_xy: float = 0.0
    shear_yx: float = 0.0
    shear_yy: float = 0.0
    depth_per_tilt: float = 0.0
    shear_per_turn: float = 0.0
    turn_per_shear: float = 0.0
    shear_per_tilt_x: float = 0.0
    shear_per_tilt_y: float = 0.0
    twist: float = 0.0
    shear_by_twist: float = 0.0
    slip_mm: float = 1.5
    slip_power: float = 1.5
    shear_rad: float = 0.2
    shear_per_contact: float = 0.5
    shear_fade_rad: float = 0.35
    twist_rad: float = 0.0
    twist_per_contact: float = 0.5
    twist_fade_rad: float = 0.3
    shear_far: float = 0.0
    seat_x_rad: float = 0.0
    seat_y_rad: float = 0.0


@dataclass(frozen=True)
class PosedTip:
    """A tip's table with the pins of one sensor, by their places in the image at rest.

    Attributes:
        rest_px: pins (x, y) in a shallow upright tap [px].
        rest_depth_mm: that tap's stated depth.
        tip: name of the tip's table.
        gel_index: refractive index of the gel.
    """

    rest_px: Places
    rest_depth_mm: float
    tip: str = "base"
    gel_index: float = 1.41

    @property
    def middle_px(self) -> Float[ndarray, " 2"]:
        """Middle of the field of pins [px]."""
        return np.asarray(np.median(self.rest_px, axis=0))

    @property
    def edge_px(self) -> float:
        """Radius of the field of pins: the mean of the outermost [px]."""
        away = np.sort(np.hypot(*(self.rest_px - self.middle_px).T))
        return float(away[-max(1, len(away) // 16) :].mean())

    def places_px(self, terms: TipTerms, poses: Poses) -> Moved:
        """Places of the pins at poses, `POSE` in its units [px]; deeper than the table, as at its end."""
        skin = _Skin.of(self.tip)
        view = _View.of(skin, terms, self.gel_index)
        at = (self.rest_px - self.middle_px) / self.edge_px
        polar = view.polar_of(np.hypot(*at.T))
        roots = np.stack(_sphere(polar, np.arctan2(at[:, 1], at[:, 0])), axis=-1)
        rest = np.array([[self.rest_depth_mm, 0, 0, 0, 0, 0]], np.float64)
        untouched, moved = (_seen(skin, view, terms, roots, one) for one in (rest, poses))
        return self.rest_px + self.edge_px * (moved - untouched)


@dataclass(frozen=True)
class _Skin:
    """The inside of the skin under a rigid plate, over approach [m] and polar angle [rad]."""

    radius: RectBivariateSpline
    height: RectBivariateSpline
    dome_m: float
    deepest_m: float
    widest_rad: float

    @classmethod
    def of(cls, tip: str) -> _Skin:
        table = tip_table(tip)
        press = table.press(math.inf)
        deepest = float(press.approach_m[-1])
        approach = np.linspace(0, deepest, SPACING)
        inside = press.at("inside_m", press.force_at(approach))
        polar = press.polar_rad
        r, z = (RectBivariateSpline(approach, polar, inside[..., i]) for i in (0, 1))
        return cls(r, z, table.radius_m, deepest, float(polar[-1]))

    def markers(self, approach_m: Share, polar: Share, lever_m: float) -> tuple[Share, Share]:
        """Distance from the contact's axis and height of the pins' ends [m]."""
        polar = np.clip(polar, 0, self.widest_rad)
        dr, dz = (one.ev(approach_m, polar, dy=1) for one in (self.radius, self.height))
        size = np.hypot(dr, dz)
        r, z = (one.ev(approach_m, polar) for one in (self.radius, self.height))
        return r - lever_m * dz / size, z + lever_m * dr / size


@dataclass(frozen=True)
class _View:
    """The camera: where in the field of pins a place of the tip is seen, 1 being the field's edge."""

    camera_m: float
    base_m: float
    gel_index: float
    distortion: float
    edge: float
    polar: Float[ndarray, " n"]
    seen: Float[ndarray, " n"]

    @classmethod
    def of(cls, skin: _Skin, terms: TipTerms, gel_index: float) -> _View:
        polar = np.linspace(0, MAX_POLAR_RAD, 300)
        r, z = skin.markers(np.zeros_like(polar), polar, 1e-3 * terms.lever_mm)
        bare = cls(1e-3 * terms.camera_mm, skin.dome_m, gel_index, terms.distortion, 1.0, polar, polar)
        tangent = bare.tangent(r, z)
        edge = float(np.interp(terms.edge_rad, polar, tangent))
        whole = cls(bare.camera_m, bare.base_m, gel_index, terms.distortion, edge, polar, polar)
        return cls(bare.camera_m, bare.base_m, gel_index, terms.distortion, edge, polar, whole.lens(tangent))

    def tangent(self, r: Share, z: Share) -> Share:
        return np.asarray(slopes(r, self.base_m - z, self.camera_m - self.base_m, self.gel_index))

    def lens(self, tangent: Share) -> Share:
        u = tangent / self.edge
        return np.asarray(u * (1 + self.distortion * u**2) / (1 + self.distortion))

    def polar_of(self, seen: Float[ndarray, " p"]) -> Float[ndarray, " p"]:
        """Polar angle of the roots of pins that are seen so far from the middle at rest."""
        return np.interp(seen, self.seen, self.polar)

    def image(self, places_m: Float[ndarray, "t p 3"]) -> Moved:
        r = np.hypot(places_m[..., 0], places_m[..., 1])
        scale = self.lens(self.tangent(r, places_m[..., 2])) / np.maximum(r, 1e-9)
        return places_m[..., :2] * scale[..., None]


def _seen(skin: _Skin, view: _View, q: TipTerms, roots: Float[ndarray, "p 3"], poses: Poses) -> Moved:
    """Where pins are seen at poses."""
    turn, moved_m, twist = _plate(skin, q, poses)
    rotation = _rotations(turn)
    x, y, z = np.moveaxis(np.einsum("pi,tij->tpj", roots, rotation), -1, 0)
    polar, azimuth = np.arccos(np.clip(-z, -1, 1)), np.arctan2(y, x)
    depth_mm = poses[:, 0] - q.depth_zero_mm - q.depth_per_tilt * (turn**2).sum(axis=1)
    approach = np.clip(1e-3 * depth_mm, 0, skin.deepest_m)
    r, height = skin.markers(np.repeat(approach[:, None], len(roots), 1), polar, 1e-3 * q.lever_mm)
    contact = np.sqrt(2 * approach / skin.dome_m)[:, None]
    held = 1 - np.exp(-((1e3 * approach / q.slip_mm) ** q.slip_power))[:, None]
    sheared = held * _within(polar - q.shear_rad - q.shear_per_contact * contact, q.shear_fade_rad)
    sheared = (1 - q.shear_far) * sheared + q.shear_far * np.cos(np.minimum(polar, np.pi / 2))
    twisted = held * _within(polar - q.twist_rad - q.twist_per_contact * contact, q.twist_fade_rad)
    azimuth = azimuth + twisted * twist[:, None]
    aside = np.einsum("ti,tij->tj", np.pad(moved_m, ((0, 0), (0, 1))), rotation)[:, None, :2]
    at = np.stack([r * np.cos(azimuth), r * np.sin(azimuth)], axis=-1)
    # Shear acts on places before the twist about the contact's axis does.
    cosine, sine = np.cos(twisted * twist[:, None]), np.sin(twisted * twist[:, None])
    turned = np.stack(
        [aside[..., 0] * cosine - aside[..., 1] * sine, aside[..., 0] * sine + aside[..., 1] * cosine],
        axis=-1,
    )
    places = np.concatenate([at + sheared[..., None] * turned, height[..., None]], axis=-1)
    centre = np.array([0.0, 0.0, skin.dome_m])
    return view.image(np.einsum("tpj,tij->tpi", places - centre, rotation) + centre)


def _plate(
    skin: _Skin, q: TipTerms, poses: Poses
) -> tuple[Float[ndarray, "t 2"], Float[ndarray, "t 2"], Float[ndarray, " t"]]:
    """Turn of the contact [rad], motion of the plate [m] and its twist [rad], in the image's axes."""
    tilts, twist = np.deg2rad(poses[:, 1:3]), np.deg2rad(poses[:, 5])
    turn = tilts @ np.array([[q.tilt_xx, q.tilt_xy], [q.tilt_yx, q.tilt_yy]]).T
    turn = turn + np.array([q.seat_x_rad, q.seat_y_rad])
    moved = 1e-3 * poses[:, 3:5] @ np.array([[q.shear_xx, q.shear_xy], [q.shear_yx, q.shear_yy]]).T
    angle = q.shear_by_twist * twist
    moved = np.stack(
        [
            moved[:, 0] * np.cos(angle) - moved[:, 1] * np.sin(angle),
            moved[:, 0] * np.sin(angle) + moved[:, 1] * np.cos(angle),
        ],
        axis=1,
    )
    moved = moved * (1 + tilts @ np.array([q.shear_per_tilt_x, q.shear_per_tilt_y]))[:, None]
    turn, moved = (
        turn + q.turn_per_shear * moved / skin.dome_m,
        moved + q.shear_per_turn * skin.dome_m * turn,
    )
    return turn, moved, q.twist * twist


def _within(beyond_rad: Share, fade_rad: float) -> Share:
    """1 well inside, 1/2 at 0, 0 well outside."""
    return np.asarray(1 / (1 + np.exp(np.clip(beyond_rad / fade_rad, -60, 60))))


def _sphere(polar: Float[ndarray, " p"], azimuth: Float[ndarray, " p"]) -> tuple[ndarray, ndarray, ndarray]:
    return np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), -np.cos(polar)


def _rotations(turn: Float[ndarray, "t 2"]) -> Float[ndarray, "t 3 3"]:
    """Rotations that take the apex by these angles towards +x and +y."""
    angle = np.hypot(*turn.T)
    x, y = (turn / np.maximum(angle, 1e-12)[:, None]).T
    zero = np.zeros_like(x)
    # The axis (-y, x, 0) turned the other way: the apex looks down.
    cross = -np.array([[zero, zero, x], [zero, zero, y], [-x, -y, zero]]).transpose(2, 0, 1)
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + s * cross + (1 - c) * cross @ cross)
