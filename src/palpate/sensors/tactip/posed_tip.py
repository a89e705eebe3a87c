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

from palpate.core import Float, ndarray
from palpate.mechanics.axisymmetric.tip_table import tip_table
from palpate.sensors.tactip.tip_view import InnerSkin, PinView, Share, TipOptics, rotations

POSE = ("depth_mm", "tilt_x_deg", "tilt_y_deg", "shear_x_mm", "shear_y_mm", "twist_deg")
"""Columns of a pose."""

Poses = Float[ndarray, "t 6"]
Places = Float[ndarray, "p 2"]
Moved = Float[ndarray, "t p 2"]


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

    @property
    def optics(self) -> TipOptics:
        """Lever, camera and lens."""
        return TipOptics(self.lever_mm, self.camera_mm, self.distortion, self.edge_rad)


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
        table = tip_table(self.tip)
        skin = InnerSkin.of(table.press(math.inf), table.radius_m)
        view = PinView.of(skin, terms.optics, self.gel_index)
        at = (self.rest_px - self.middle_px) / self.edge_px
        polar = view.polar_of(np.hypot(*at.T))
        roots = np.stack(_sphere(polar, np.arctan2(at[:, 1], at[:, 0])), axis=-1)
        rest = np.array([[self.rest_depth_mm, 0, 0, 0, 0, 0]], np.float64)
        untouched, moved = (_seen(skin, view, terms, roots, one) for one in (rest, poses))
        return self.rest_px + self.edge_px * (moved - untouched)


def _seen(skin: InnerSkin, view: PinView, q: TipTerms, roots: Float[ndarray, "p 3"], poses: Poses) -> Moved:
    """Where pins are seen at poses."""
    turn, moved_m, twist = _plate(skin, q, poses)
    rotation = rotations(turn)
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
    skin: InnerSkin, q: TipTerms, poses: Poses
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
