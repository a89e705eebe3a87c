"""A TacTip on a flat rigid plate at any pose: the head-on press, turned by tilt and moved by shear and twist.

The head-on skin (`tip_table`) is rotated about the dome's centre. Of shear and twist each point takes a
fraction that is 1 at the contact, falls to 0 beyond it, and grows with depth as slip ends. Pins are normal to
the skin, seen through gel, window, and a lens with radial distortion. Only the head-on press is mechanics;
the kinematic terms `TipTerms` are fitted to taps, as are `shear_per_tilt_x` and `_y`, which have no model.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from palpate.core import Float, ndarray
from palpate.mechanics.axisymmetric.tip_table import tip_table
from palpate.sensors.tactip.tip_view import InnerSkin, PinView, Share, TipOptics, rotations

POSE = ("depth_mm", "tilt_x_deg", "tilt_y_deg", "shear_x_mm", "shear_y_mm", "twist_deg")
"""Components of a pose."""

Poses = Float[ndarray, "t 6"]
Places = Float[ndarray, "p 2"]
Moved = Float[ndarray, "t p 2"]


class TipTerms(NamedTuple):
    """Terms of one tip and its camera, in the order of the fit.

    Attributes:
        lever_mm: Length of the pins.
        camera_mm: Height of the pinhole above the apex.
        depth_zero_mm: Nominal depth at first touch.
        distortion: Lens distortion at the edge of the pin field; negative for barrel distortion.
        edge_rad: Polar angle of the outermost pins' roots.
        tilt_xx, tilt_xy, tilt_yx, tilt_yy: Rotation of the contact about the dome's centre along the image's
            x and y, per nominal tilt [rad/rad].
        shear_xx, shear_xy, shear_yx, shear_yy: Motion of the plate in image axes per nominal motion.
        depth_per_tilt: Change of depth per squared rotation [mm/rad^2].
        shear_per_turn: Motion of the plate in dome radii per rotation [1/rad].
        turn_per_shear: Rotation per motion of the plate in dome radii [rad].
        shear_per_tilt_x, shear_per_tilt_y: Relative change of the plate's motion per tilt [1/rad].
        twist: Rotation of the plate per nominal twist.
        shear_by_twist: Rotation of the shear's direction per twist.
        slip_mm, slip_power: Depth at which the contact sticks, and sharpness of the transition.
        shear_rad, shear_per_contact, shear_fade_rad: Polar angle at which the fraction of shear is half, as a
            constant plus a fraction of the contact angle, and the width of its transition.
        twist_rad, twist_per_contact, twist_fade_rad: The same of twist.
        shear_far: Fraction of shear that the whole tip takes.
        seat_x_rad, seat_y_rad: Mounting misalignment.
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
        return TipOptics(self.lever_mm, self.camera_mm, self.distortion, self.edge_rad)


@dataclass(frozen=True)
class PosedTip:
    """A tip's table with the pins of one sensor.

    Attributes:
        rest_px: Pins (x, y) in a shallow upright tap [px].
        rest_depth_mm: Nominal depth of that tap.
        tip: Name of the tip's table.
    """

    rest_px: Places
    rest_depth_mm: float
    tip: str = "base"
    gel_index: float = 1.41

    @property
    def middle_px(self) -> Float[ndarray, " 2"]:
        return np.asarray(np.median(self.rest_px, axis=0))

    @property
    def edge_px(self) -> float:
        """Mean distance of the outermost pins from the middle [px]."""
        away = np.sort(np.hypot(*(self.rest_px - self.middle_px).T))
        return float(away[-max(1, len(away) // 16) :].mean())

    def places_px(self, terms: TipTerms, poses: Poses) -> Moved:
        """Pin positions at poses in the units of `POSE` [px]; depth is limited to the table's."""
        skin = _inner_skin(self.tip)
        view = PinView.of(skin, terms.optics, self.gel_index)
        at = (self.rest_px - self.middle_px) / self.edge_px
        polar = view.polar_of(np.hypot(*at.T))
        roots = np.stack(_sphere(polar, np.arctan2(at[:, 1], at[:, 0])), axis=-1)
        rest = np.array([[self.rest_depth_mm, 0, 0, 0, 0, 0]], np.float64)
        untouched, moved = (_seen(skin, view, terms, roots, one) for one in (rest, poses))
        return self.rest_px + self.edge_px * (moved - untouched)


@cache
def _inner_skin(tip: str) -> InnerSkin:
    table = tip_table(tip)
    return InnerSkin.of(table.press(math.inf), table.radius_m)


def _seen(skin: InnerSkin, view: PinView, q: TipTerms, roots: Float[ndarray, "p 3"], poses: Poses) -> Moved:
    """Pin positions at poses, 1 at the field's edge."""
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
    # Shear acts before the twist about the contact's axis.
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
    """Rotation of the contact [rad], motion of the plate [m], and its twist [rad], in image axes."""
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
    return np.asarray(1 / (1 + np.exp(np.clip(beyond_rad / fade_rad, -60, 60))))


def _sphere(polar: Float[ndarray, " p"], azimuth: Float[ndarray, " p"]) -> tuple[ndarray, ndarray, ndarray]:
    return np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), -np.cos(polar)
