"""A pad with a cut: its effect on the tiles' motion, on a press, and on the view.

The probe's tractions are those on the whole pad at a depth reduced by the cut's compliance (work of the
pressure on the added motion over the force).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from palpate.core import Contact, Float, Pose, PressHistory, Probe, ndarray
from palpate.mechanics.torn_layers import CutOpening, SurfaceCut, cut_opening, rest_gap_m
from palpate.sensors.nusense.nusense_spec import NuSenseSpec, Tear
from palpate.sensors.nusense.pad_contact import pad_contact
from palpate.sensors.nusense.pad_view import (
    PadWindow,
    TornRest,
    clean_view,
    pad_window,
    places_by_lag,
    rest_places,
)
from palpate.sensors.nusense.pattern_motion import PatternMotion, pattern_motion

YIELDS = 2  # corrections of the depth, each a twentieth of the previous one
ITERATIONS = 30  # iterations of the inverse map on one side of the cut


@dataclass(frozen=True, slots=True, eq=False)
class TornMotion:
    """Motion of the tiles of a torn pad: that of the whole pad plus the cut's opening."""

    whole: PatternMotion
    opening: CutOpening

    def at(self, x_m: ndarray, y_m: ndarray, side: int = 0) -> Float[ndarray, "3 n"]:
        """Displacement of tiles by resting position [m]; `side` forces one side of the cut (1 or -1)."""
        return self.whole.at(x_m, y_m) + self.opening.at(x_m, y_m, side)


def surface_cut(tear: Tear) -> SurfaceCut:
    """Return the cut of a tear."""
    return SurfaceCut(*tear.at_m, tear.turn_rad, tear.length_m, tear.depth_m, tear.gap_m)


def opening_under(spec: NuSenseSpec, tear: Tear, contact: Contact) -> CutOpening:
    """Return the cut's opening under a contact's relaxed tractions."""
    area = (contact.x_m[1] - contact.x_m[0]) * (contact.y_m[1] - contact.y_m[0])
    on = contact.pressure_pa > 0
    x, y = np.meshgrid(contact.x_m, contact.y_m)
    forces = np.zeros((3, int(on.sum())))
    forces[2] = contact.pressure_pa[on]
    if contact.shear_pa is not None:
        forces[:2] = contact.shear_pa[:, on]
    forces *= area / contact.history.stiffening
    layers = spec.layers
    places = np.column_stack([x[on], y[on]])
    return cut_opening(layers.stack, surface_cut(tear), layers.pattern_depth_m, places, forces)


def torn_contact(spec: NuSenseSpec, tear: Tear, probe: Probe, pose: Pose, history: PressHistory) -> Contact:
    """Return the contact of a probe on a torn pad."""
    contact = pad_contact(spec.layers.stack, spec.friction, probe, pose, history)
    for _ in range(YIELDS):
        if contact.force_n == 0:
            break
        yields = opening_under(spec, tear, contact).pressing_j * history.stiffening / contact.force_n
        shallower = replace(pose, depth_m=max(pose.depth_m - yields, 0.0))
        contact = pad_contact(spec.layers.stack, spec.friction, probe, shallower, history)
    return replace(contact, pose=pose)


def torn_motion(spec: NuSenseSpec, tear: Tear, above: int, contact: Contact) -> TornMotion:
    """Return the motion of the tiles, `above` layers deep, under a contact."""
    return TornMotion(pattern_motion(spec.layers.stack, above, contact), opening_under(spec, tear, contact))


def torn_view(
    spec: NuSenseSpec, tear: Tear, motion: TornMotion | None, shift_px: tuple[float, float]
) -> Float[ndarray, "h w 3"]:
    """Return the frame without noise: tiles on both sides of the cut, and the opening if it reaches their
    lower face.
    """
    window = pad_window(spec, shift_px)
    if motion is None:
        sides = [window.pixels_m, window.pixels_m]
    else:
        sides = [_side_places(spec, window, motion, shift_px, side) for side in (1, -1)]
    cut, pixel = surface_cut(tear), spec.camera_m / spec.lens.focal_px[0]
    seen = tear.depth_m > spec.layers.pattern_depth_m
    shares = []
    for side, places in zip((1, -1), sides, strict=True):
        across, along = cut.local(*places)
        half = rest_gap_m(cut, along) / 2 if seen else 0.0
        shares.append(np.clip((side * across - half) / pixel + 0.5, 0.0, 1.0))
    rest = np.where(shares[0] >= shares[1], sides[0], sides[1])
    behind = np.clip(1 - shares[0] - shares[1], 0.0, 1.0)
    return clean_view(spec, None, shift_px, TornRest(rest, behind.astype(np.float32), tear.behind))


def _side_places(
    spec: NuSenseSpec, window: PadWindow, motion: TornMotion, shift_px: tuple[float, float], side: int
) -> Float[ndarray, "2 h w"]:
    """Resting positions that pixels show if all tiles were on one side of the cut [m]."""
    seen = np.moveaxis(window.nodes_m, -1, 0)
    start = rest_places(spec, motion.whole, shift_px)
    rows, columns = seen.shape[1:]
    pick = np.linspace(0, start.shape[1] - 1, rows).round().astype(int)
    place = start[:, pick][:, :, np.linspace(0, start.shape[2] - 1, columns).round().astype(int)]
    for _ in range(ITERATIONS):
        moved = motion.at(place[0].ravel(), place[1].ravel(), side).reshape(3, rows, columns)
        following = seen * (1 - moved[2] / spec.camera_m) - moved[:2]
        step = float(np.abs(following - place).max())
        place = (place + following) / 2 if step > 1e-4 else following
        if step < 1e-7:
            break
    lag = place - seen
    return places_by_lag(window, lag)
