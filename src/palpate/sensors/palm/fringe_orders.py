"""Fringe orders of the edge-on view to first order, N = C / lambda |integral of (s_xx - s_zz, 2 s_xz) dy|.

Where the principal axes rotate along the ray, N counts the fringes to a few per cent.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from palpate.core import Contact, Float, ndarray
from palpate.mechanics.axisymmetric.shape_table import is_punched
from palpate.mechanics.probe_contact import is_tabled_probe, probe_law
from palpate.optics.march import AxisymmetricField
from palpate.optics.stress_optic import fringe_order
from palpate.sensors.palm.fringe_view import sees
from palpate.sensors.palm.membrane_faults import pressed_at
from palpate.sensors.palm.palm_press import field_at, pressed
from palpate.sensors.palm.palm_render import is_ball
from palpate.sensors.palm.palm_spec import PalmSpec
from palpate.sensors.palm.press_corrections import applied_rim, rim_effect, rim_reach
from palpate.sensors.palm.probe_shapes import probe_table_of
from palpate.sensors.palm.probe_stress import laid_of, summed_along

WAVELENGTH_M = 550e-9
NEAR = 6.0  # contact radii
HALF_RAY = 96  # points on the half ray, equal steps of its angle from the axis


class Orders(NamedTuple):
    """Fringe order at 550 nm over the cross-section through the contact's axis."""

    offset_m: Float[ndarray, " s"]
    depth_m: Float[ndarray, " z"]
    order: Float[ndarray, "z s"]

    @property
    def greatest(self) -> float:
        """99.9th percentile, which excludes the table's sharpest corner."""
        return float(np.quantile(self.order, 0.999))


def edge_on(spec: PalmSpec, depth_m: float, points: int = 121) -> Orders:
    """Return the orders within two ball radii and the thickness, or six contact radii under a light touch."""
    R = spec.indenter_radius_m
    return _orders(spec, field_at(spec, depth_m), R, pressed(spec, depth_m).contact_radius * R, points)


def _orders(
    spec: PalmSpec, field: AxisymmetricField, R: float, contact_radius_m: float, points: int = 121
) -> Orders:
    reach = NEAR * contact_radius_m or np.inf
    s = np.linspace(0, min(2 * R, reach), points)
    z = np.linspace(0, min(spec.thickness_m, reach), points)
    return Orders(s, z, _order(spec, *integrated(field, s, z)))


def integrated(
    field: AxisymmetricField, offset_m: Float[ndarray, " s"], depth_m: Float[ndarray, " z"]
) -> tuple[Float[ndarray, "z s"], Float[ndarray, "z s"]]:
    """Return the integrals of s_xx - s_zz and of 2 s_xz along whole rays [Pa m]."""
    s, z = np.meshgrid(offset_m, depth_m)
    scale = np.hypot(s, z) + 0.05 * field.thickness_m
    step = np.pi / 2 / HALF_RAY
    angle = ((np.arange(HALF_RAY) + 0.5) * step)[:, None, None]
    y, dy = scale * np.tan(angle), scale / np.cos(angle) ** 2 * step
    r = np.hypot(s, y)
    top = np.interp(r, field.r_m, field.surface_m)
    inside = (z >= top) & (r <= field.r_m[-1])
    zeta = np.clip((z - top) / (field.thickness_m - top), 0, 1)
    read = RegularGridInterpolator((field.zeta, field.r_m), np.moveaxis(field.stress_pa, 0, -1))
    stress = read(np.stack([zeta, np.minimum(r, field.r_m[-1])], axis=-1)) * inside[..., None]
    rr, tt, zz, rz = np.moveaxis(stress, -1, 0)
    cosine = s / np.maximum(r, 1e-12)
    along = rr * cosine**2 + tt * (1 - cosine**2) - zz
    return 2 * (along * dy).sum(axis=0), 2 * (2 * rz * cosine * dy).sum(axis=0)


def contact_summary(contact: Contact, spec: PalmSpec) -> dict[str, Any]:
    """Return force, contact, pressure, and fringes of a contact, each named with its unit.

    `rim_force_percent` and `rim_push_N` are the rim's effect, None where it was not solved; `rim_applied`
    states whether the contact includes it, `rim_solved` whether its position and depth were solved.
    `peak_pressure_Pa` is None under a sharp edge, where it is unbounded.
    """
    spec = pressed_at(spec, contact.pose.x_m, contact.pose.y_m)
    return {
        "force_N": contact.force_n,
        "lateral_x_N": contact.lateral_n[0],
        "lateral_y_N": contact.lateral_n[1],
        "moment_z_Nmm": contact.moment_nm * 1e3,
        "contact_radius_mm": contact.radius_m * 1e3,
        "peak_pressure_Pa": _peak_pressure(contact, spec),
        "fringe_order_max": greatest_order(contact, spec),
        "youngs_modulus_Pa": spec.youngs_modulus_pa,
        "thickness_mm": spec.thickness_m * 1e3,
        **_rim_facts(contact, spec),
        "seen_edge_on": sees(spec, contact.pose.x_m, contact.pose.y_m, contact.radius_m),
        "model": contact.model,
    }


def greatest_order(contact: Contact, spec: PalmSpec) -> float:
    """Return the maximum fringe order edge-on at 550 nm, to first order (99.9th percentile)."""
    if contact.force_n <= 0:
        return 0.0
    spec = pressed_at(spec, contact.pose.x_m, contact.pose.y_m)
    if is_ball(contact, spec):
        return edge_on(spec, contact.pose.depth_m).greatest * applied_rim(spec, contact.pose).force_ratio
    if is_punched(contact) and contact.shear_pa is None:
        under = field_at(spec, contact.pose.depth_m, contact.probe)
        return _orders(spec, under, contact.probe.radius_m, contact.radius_m).greatest
    laid = laid_of(spec, contact)
    x, difference, shear = summed_along(laid)
    sunk = np.interp(x, contact.x_m, contact.displacement_m.max(axis=0), left=0.0, right=0.0)
    order = _order(spec, difference, 2 * shear)
    return float(np.quantile(order[laid.planes_m[:, None] >= sunk], 0.999))  # on rays that no surface blocks


def _order(spec: PalmSpec, difference: ndarray, shear: ndarray) -> Float[ndarray, "z s"]:
    C = float(spec.stress_optic.at(np.array([WAVELENGTH_M]))[0])
    return fringe_order(difference, shear, C, WAVELENGTH_M)


def _rim_facts(contact: Contact, spec: PalmSpec) -> dict[str, Any]:
    applied = spec.rim == "applied"
    known = contact.pose.depth_m >= 0 and is_ball(contact, spec) and rim_reach(spec) is not None
    if not known:
        return {"rim_force_percent": None, "rim_push_N": None, "rim_applied": False, "rim_solved": False}
    effect = rim_effect(spec, contact.pose)
    centred_n = contact.force_n / effect.force_ratio if applied else contact.force_n
    return {
        "rim_force_percent": 100 * (effect.force_ratio - 1),
        "rim_push_N": effect.push_ratio * centred_n,
        "rim_applied": applied,
        "rim_solved": effect.solved,
    }


def _peak_pressure(contact: Contact, spec: PalmSpec) -> float | None:
    if is_tabled_probe(contact):
        depth = np.array([contact.pose.depth_m / spec.thickness_m])
        greatest = probe_law(probe_table_of(spec, contact.probe), np.maximum(depth, 0.0))[2, 0]
        return float(greatest * spec.youngs_modulus_pa)
    if contact.probe.shape == "edge" and contact.probe.radius_m == 0:
        return None
    if is_ball(contact, spec) and contact.force_n > 0:
        press, effect = pressed(spec, contact.pose.depth_m), applied_rim(spec, contact.pose)
        return float(press.peak_pressure * spec.youngs_modulus_pa * effect.force_ratio)
    if is_punched(contact):
        press = pressed(spec, contact.pose.depth_m, contact.probe)
        return float(press.peak_pressure * spec.youngs_modulus_pa)
    return float(contact.pressure_pa.max())
