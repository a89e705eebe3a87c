"""A TacTip on a flat rigid plate at any pose: the head-on press, turned by tilt and moved by shear and twist.

The head-on skin (`tip_table`) is rotated about the dome's centre. Of shear and twist each point takes a
fraction that is 1 at the contact, falls to 0 beyond it, and grows with depth as slip ends. Pins are normal to
the skin, seen through gel, window, and a lens with radial distortion. Only the head-on press is mechanics;
the kinematic terms `TipTerms` are fitted to taps, as are `shear_per_tilt_x` and `_y`, which have no model.

Image of the pins under a flat rigid plate: skin of a head-on press, pin lengths, gel, window, and
distorted lens.

Inverse of the camera's view: from image positions of untouched pins to their roots on the skin.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.interpolate import RectBivariateSpline

from palpate.core import Float, InputError, Int, Lens, ndarray
from palpate.estimators.compliance.contact_area import pin_field
from palpate.estimators.lattice.ring_layout import ring_of
from palpate.mechanics.axisymmetric.tip_table import HeadOnPress, tip_table
from palpate.sensors.tactip.tactip_camera import projected, slopes
from palpate.sensors.tactip.tactip_press import head_on, pixels_per_tangent
from palpate.sensors.tactip.tactip_spec import TacTipSpec

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


NODES = 400
REACH = 0.98  # maximum distance of pins over the skin's inner radius

ImagePlaces = Float[ndarray, "p 2"]


def skin_places_m(spec: TacTipSpec, places_px: ImagePlaces, lens: Lens | None = None) -> ImagePlaces:
    """Return the roots of untouched pins projected along the tip's axis from their image positions [m].

    Args:
        spec: Tip, with the camera's height; without a lens also its scale.
        places_px: Marker positions.
        lens: Lens in air aligned with the tip's axis; None for the spec's camera.
    """
    if lens is None:
        middle = (spec.camera.size_px - 1) / 2
        tangent = (places_px - middle) / pixels_per_tangent(spec)
    else:
        rays = lens.rays(places_px)
        tangent = rays[:, :2] / rays[:, 2:]
    size = np.hypot(*tangent.T)
    root, seen = _ways_out(spec)
    if not (size <= seen[-1]).all():
        ends = float(np.nan_to_num(size, nan=np.inf).max()), float(seen[-1])
        widest, most = (math.degrees(math.atan(end)) for end in ends)
        raise InputError(
            f"a pin is seen {widest:.3g} degrees off the axis; on this dome none is beyond {most:.3g}: "
            "give the lens of this camera, and the sensor's own spec",
            code="lens-differs",
        )
    share = np.interp(size, seen, root) / np.maximum(size, 1e-12)
    return tangent * share[:, None]


def untouched_area_m2(
    spec: TacTipSpec, places_px: ImagePlaces, cells: Int[ndarray, "p 2"] | None, lens: Lens | None = None
) -> float:
    """Return A_c0, the area pi r^2 of the circle through the outermost pins' roots, along the axis [m^2].

    Args:
        spec, lens: See `skin_places_m`.
        places_px: Pins of an untouched frame; NaN for lost ones.
        cells: Lattice cells from `find_pins`.
    """
    if cells is None:
        raise InputError("pins without lattice; use `find_pins` on a reference frame", code="no-lattice")
    rings = int(ring_of(cells).max())
    if rings != spec.pins.rings:
        raise InputError(
            f"{rings} rings of pins are seen, and this sensor has {spec.pins.rings}; give the sensor's own "
            "spec, and an untouched frame that shows all rings",
            code="pin-count",
        )
    seen = np.isfinite(places_px).all(axis=1)
    return pin_field(skin_places_m(spec, places_px[seen], lens), cells[seen]).area


def _ways_out(spec: TacTipSpec) -> tuple[Float[ndarray, " n"], Float[ndarray, " n"]]:
    """Distances of roots from the axis [m], and tangents at which their markers appear."""
    root = np.linspace(0.0, REACH * spec.inner_radius_m, NODES)
    skin = head_on(spec.table.press(math.inf), spec.table.radius_m, 0.0, (0.0, 0.0))
    places, normals = skin.at(np.arcsin(root / spec.inner_radius_m), np.zeros(NODES))
    tangent, _ = projected(places + spec.pins.length_m * normals, spec.camera, spec.table.radius_m)
    seen = tangent[:, 0] - tangent[0, 0]
    end = int(np.argmax(np.diff(seen) <= 0)) or NODES - 1
    return root[: end + 1], seen[: end + 1]
