"""The numbers of a contact that one would read beside its picture."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from palpate.core.contact import Contact
from palpate.core.errors import RangeError
from palpate.mechanics.axisymmetric.sphere_table import edge_correction
from palpate.mechanics.layers.stack_field import field_below
from palpate.optics.stress_optic import fringe_order
from palpate.sensors.palm import orders
from palpate.sensors.palm.field import pressed, table_of
from palpate.sensors.palm.fringes import sees
from palpate.sensors.palm.press import stack_of
from palpate.sensors.palm.render import is_ball
from palpate.sensors.palm.spec import PalmSpec


def facts(contact: Contact, spec: PalmSpec) -> dict[str, Any]:
    """Force, contact, pressure and fringes, each named with its unit.

    `rim_force_percent` is by how much the force would differ had the press been solved where it is, and not
    in the middle; None where that is not known.
    """
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
        "rim_force_percent": _rim_percent(contact, spec),
        "seen_edge_on": sees(spec, contact.pose.x_m, contact.pose.y_m, contact.radius_m),
        "model": contact.model,
    }


def greatest_order(contact: Contact, spec: PalmSpec) -> float:
    """The most fringe orders on a ray edge-on, at 550 nm, to first order (its 99.9th percentile)."""
    if contact.force_n <= 0:
        return 0.0
    if is_ball(contact, spec):
        return orders.edge_on(spec, contact.pose.depth_m).greatest
    z = spec.thickness_m * np.linspace(0.02, 1, 40)
    shear = (None, None) if contact.shear_pa is None else tuple(contact.shear_pa)
    field = field_below(
        stack_of(spec),
        contact.pressure_pa,
        contact.x_m,
        contact.y_m,
        z,
        shear_x_pa=shear[0],
        shear_y_pa=shear[1],
    )
    dy = float(contact.y_m[1] - contact.y_m[0])
    difference = (field.stress("xx") - field.stress("zz")).sum(axis=1) * dy
    C = float(spec.stress_optic.at(np.array([orders.WAVELENGTH_M]))[0])
    order = fringe_order(difference, 2 * field.stress("xz").sum(axis=1) * dy, C, orders.WAVELENGTH_M)
    return float(np.quantile(order, 0.999))


def _rim_percent(contact: Contact, spec: PalmSpec) -> float | None:
    R, pose = spec.indenter_radius_m, contact.pose
    if pose.depth_m < 0 or not is_ball(contact, spec):
        return None
    if not math.isclose(spec.radius_m, table_of(spec).disc_radius * R):
        return None
    try:
        effect = edge_correction(math.hypot(pose.x_m, pose.y_m) / R, pose.depth_m / R, spec.thickness_m / R)
    except RangeError:
        return None
    return 100 * (effect.force_ratio - 1)


def _peak_pressure(contact: Contact, spec: PalmSpec) -> float:
    if is_ball(contact, spec) and contact.force_n > 0:
        return float(pressed(spec, contact.pose.depth_m).peak_pressure * spec.youngs_modulus_pa)
    return float(contact.pressure_pa.max())
