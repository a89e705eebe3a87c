"""The first prototype beside the folded path: camera below the membrane, light from its rim.

Along the axis the stress of a round contact has its principal axes along and around the radius at every
depth, so a vertical ray's slices do not turn and the light is in closed form: sin^2(2 (theta - psi)) sin^2(pi
N), with N(r) = C / lambda times the integral of s_rr - s_tt through the thickness. Light that enters through
the rim and is scattered up has lost some of its polarisation, and is weaker in the middle; how much is
assumed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from palpate.core import Contact, Float, ndarray
from palpate.sensors.palm import fringe_view
from palpate.sensors.palm.fringe_orders import WAVELENGTH_M, edge_on
from palpate.sensors.palm.palm_press import field_at
from palpate.sensors.palm.palm_render import lamp, render_clean
from palpate.sensors.palm.palm_spec import PalmSpec

POLARISED = 0.4
"""Share of the scattered light that is still polarised. Assumed: one wall's diffuse scattering."""

MIDDLE_OVER_RIM = 0.35
"""Light at the middle over that at the rim. Assumed: the report says only that it was uneven."""


class Quality(NamedTuple):
    """Measures of how readable fringes are.

    Attributes:
        greatest_order: the most fringe orders on any ray, at 550 nm.
        density_per_mm: the steepest change of order across the view [1/mm].
        contrast: (brightest - darkest) / (brightest + darkest) near the contact.
        uniformity: least over greatest light that an unstressed, uncrossed membrane would send, within a
            quarter of its diameter of the contact.
    """

    greatest_order: float
    density_per_mm: float
    contrast: float
    uniformity: float


@dataclass(frozen=True, slots=True)
class FromBelow:
    """View of the prototype's camera: x to the right, y down the image.

    Attributes:
        x_m, y_m: of the pixels on the membrane [m].
        order: fringe order at 550 nm ``[h w]``.
        light: linear RGB ``[h w 3]``, 1 where all of the rim's light passes.
    """

    x_m: Float[ndarray, " w"]
    y_m: Float[ndarray, " h"]
    order: Float[ndarray, "h w"]
    light: Float[ndarray, "h w 3"]


def from_below(contact: Contact, spec: PalmSpec, pixels: int = 300) -> FromBelow:
    """The prototype's picture of a contact of the palm's ball, pressed straight down, without noise.

    Args:
        spec: the palm; its views and mirror play no part.
        pixels: along each side of the picture.
    """
    axis = (np.arange(pixels) + 0.5 - pixels / 2) * spec.diameter_m / pixels
    x, y = np.meshgrid(axis - contact.pose.x_m, axis - contact.pose.y_m)
    radius, summed = through_thickness(spec, contact.pose.depth_m)
    retardation = np.interp(np.hypot(x, y), radius, summed, right=0.0)
    seen = fringe_view.spectrum(spec.bands)
    C = spec.stress_optic.at(seen.wavelength_m)
    turn = np.sin(2 * (np.arctan2(y, x) - spec.polariser_rad)) ** 2
    phases = np.pi * C[:, None, None] / seen.wavelength_m[:, None, None] * retardation
    crossed = turn[..., None] * np.einsum("kyx,kc->yxc", np.sin(phases) ** 2, seen.weight)
    leak = (1 - POLARISED) / 2  # of the light that is not polarised, the analyser passes half
    lit = _rim_light(spec, axis)
    light = lit[..., None] * (POLARISED * ((1 - spec.extinction) * crossed + spec.extinction) + leak)
    at = spec.stress_optic.at(np.array([WAVELENGTH_M]))[0]
    return FromBelow(axis, axis, np.abs(at * retardation) / WAVELENGTH_M, light)


def through_thickness(spec: PalmSpec, depth_m: float) -> tuple[Float[ndarray, " n"], Float[ndarray, " n"]]:
    """The integral of s_rr - s_tt over the depth [Pa m], at each distance from the contact's axis [m]."""
    field = field_at(spec, depth_m)
    rr, tt, _, _ = field.stress_pa
    height = field.thickness_m - field.surface_m
    return field.r_m, np.trapezoid(rr - tt, field.zeta, axis=0) * height


def quality_below(contact: Contact, spec: PalmSpec) -> Quality:
    """Quality of the prototype's picture."""
    seen = from_below(contact, spec)
    steps = np.hypot(*np.gradient(seen.order, seen.y_m * 1e3, seen.x_m * 1e3))
    lit = _rim_light(spec, seen.x_m)
    inside = lit > 0
    away = np.hypot(*np.meshgrid(seen.x_m - contact.pose.x_m, seen.y_m - contact.pose.y_m))
    near = away < spec.diameter_m / 4
    grey = seen.light[inside & near].mean(axis=-1)
    around = lit[inside & near]
    return Quality(
        float(seen.order.max()), float(steps.max()), _contrast(grey), float(around.min() / around.max())
    )


def quality_edge_on(contact: Contact, spec: PalmSpec) -> Quality:
    """Quality of the folded path's picture."""
    light, _ = render_clean(contact, spec)
    depth = contact.pose.depth_m
    orders = edge_on(spec, depth)
    x, z = spec.fringes.x_m, spec.fringes.down_m
    rows = (z > depth) & (z < spec.thickness_m)
    near = np.abs(x - contact.pose.x_m * spec.rim_index) < spec.diameter_m / 4
    grey = light[np.ix_(rows, near)].mean(axis=-1)
    lit = lamp(spec)[np.ix_(rows, near & fringe_view.columns_kept(spec).visible)]
    slope = np.hypot(*np.gradient(orders.order, orders.depth_m * 1e3, orders.offset_m * 1e3))
    steepest = float(np.quantile(slope, 0.999))  # a table's sharpest corner is not a fringe
    return Quality(orders.greatest, steepest, _contrast(grey.ravel()), float(lit.min() / lit.max()))


def _contrast(grey: Float[ndarray, " n"]) -> float:
    dark, bright = np.quantile(grey, [0.01, 0.99])
    return float((bright - dark) / (bright + dark))


def _rim_light(spec: PalmSpec, axis_m: Float[ndarray, " n"]) -> Float[ndarray, "n n"]:
    """Light from all round the rim: least in the middle; none beyond the membrane."""
    share = (axis_m**2 + axis_m[:, None] ** 2) / spec.radius_m**2
    return np.where(share <= 1, MIDDLE_OVER_RIM + (1 - MIDDLE_OVER_RIM) * share, 0.0)
