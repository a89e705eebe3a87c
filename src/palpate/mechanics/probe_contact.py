"""A rigid non-axisymmetric probe on a bonded layer: linear layers for light presses, tables for deep ones.

Between `LIGHT` and three times that depth force, area, pressure, surface, and stress are blended; they differ
by 2 % in force there. In the probe's frame x points along its length, y across, z into the layer.

Resultant of a contact's tractions: three forces and three moments about one point.

Stress of a disc pressed across its diameter, in closed form.

Two opposite point loads P along y at (0, R) and (0, -R), plane stress, thickness t. With a = R - y, b = R +
y, p = x^2 + a^2, q = x^2 + b^2,

    s_xx = -2P/(pi t) (a x^2 / p^2 + b x^2 / q^2 - 1/2R)
    s_yy = -2P/(pi t) (a^3 / p^2 + b^3 / q^2 - 1/2R)
    s_xy =  2P/(pi t) (a^2 x / p^2 - b^2 x / q^2).

Reference: S. Timoshenko and J. N. Goodier, Theory of Elasticity, 3rd ed. (1970), art. 41.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from palpate.core import (
    Contact,
    ContactSolution,
    Field,
    Float,
    InputError,
    Mask,
    Pose,
    Probe,
    RangeError,
    ndarray,
)
from palpate.mechanics.layers.influence import Cells, cells, laid_onto, normal_influence
from palpate.mechanics.layers.stack import ElasticLayer, Stack
from palpate.mechanics.light_touch import MAX_LIGHT, RoundedBody, light_law, light_touch
from palpate.mechanics.probe_table import SAME, ProbeTable, own_frame

LIGHT = MAX_LIGHT / 3
"""Depth up to which linear layers alone are used [h]; up to `MAX_LIGHT` both are blended."""
TOUCHES = 0.02
"""Pressure over the maximum below which interpolated values do not count as contact."""

Knots = Float[ndarray, " n"]


def is_tabled_probe(contact: Contact) -> bool:
    """Return whether a contact is of a tabled non-axisymmetric probe."""
    return contact.solution is ContactSolution.PROBE_TABLE


def share_of_table(depth: Float[ndarray, "*n"] | float) -> Float[ndarray, "*n"]:
    """Return the table's fraction of a press at a depth [h]; the rest is linear layers."""
    way = np.clip((np.asarray(depth) - LIGHT) / (MAX_LIGHT - LIGHT), 0.0, 1.0)
    return np.asarray(way**2 * (3 - 2 * way))


def probe_law(table: ProbeTable, depth: Knots) -> Float[ndarray, "3 n"]:
    """Return force [E h^2], area [h^2], and maximum pressure [E] at depths of the table [h]."""
    share, light = share_of_table(depth), np.minimum(depth, MAX_LIGHT)
    deep = table.law_at(np.clip(depth, table.depth[0], table.greatest_depth))
    if np.all(share == 1.0):
        return deep
    return np.asarray(share * deep + (1 - share) * light_law(_body(table), table.poisson_ratio)(light))


def press_probe(
    table: ProbeTable,
    probe: Probe,
    pose: Pose,
    youngs_modulus_pa: float,
    thickness_m: float,
    radius_m: float,
    x_m: Float[ndarray, " nx"],
    y_m: Float[ndarray, " ny"],
) -> Contact:
    """Press a probe into a bonded layer.

    Args:
        table: Table from `probe_table_for`.
        probe: Probe, at any turn about z.
        pose: Position and depth, 0 to the table's.
        youngs_modulus_pa, thickness_m, radius_m: Modulus and size of the layer.
        x_m, y_m: Columns and rows of the contact's grid, which must contain it [m].

    Returns:
        Contact with the pressure normal to the surface, scaled to the force, and the radius of a disc of
        equal area.
    """
    h, E = thickness_m, youngs_modulus_pa
    if not 0.0 <= pose.depth_m <= table.greatest_depth * h * (1 + SAME):
        raise RangeError(
            f"depth {pose.depth_m * 1e3:.7g} mm of a {probe.shape} lies outside 0 to "
            f"{table.greatest_depth * h * 1e3:g} mm, where its table was solved; press less",
            code="outside-table",
        )
    depth = min(pose.depth_m / h, table.greatest_depth)
    share = float(share_of_table(depth))
    pressure, surface = np.zeros((2, len(y_m), len(x_m)))
    along, across = (place / h for place in own_frame(probe, pose, x_m[None, :], y_m[:, None]))
    if share > 0.0:
        at = table.at(depth)
        pressure += share * at.on_top(at.pressure, along, across)
        surface += share * at.on_top(at.surface, along, across) * at.share_at(along, across)
    if share < 1.0 and depth > 0.0:
        light = light_pressure(table, probe, pose, h, x_m, y_m)
        pressure += (1 - share) * light
        # The surface must not lie above the probe, which coarse cells do not ensure.
        sunk = _sunk(table, light, x_m / h, y_m / h)
        surface += (1 - share) * np.maximum(sunk, depth - _body(table).height(along, across))
    force, area, _ = probe_law(table, np.array([depth]))[:, 0]
    touching = pressure > TOUCHES * pressure.max()
    _check_within(touching, x_m, y_m, radius_m)
    return Contact(
        x_m=x_m,
        y_m=y_m,
        pressure_pa=pressure * E,
        displacement_m=surface * h,
        touching=touching,
        force_n=float(force) * E * h**2,
        radius_m=math.sqrt(area / math.pi) * h,
        probe=probe,
        pose=pose,
        solution=ContactSolution.PROBE_TABLE,
        model="finite-strain table in three dimensions: "
        f"rigid {probe.shape}, edges rounded by {table.rounding * h * 1e3:g} mm, "
        f"bonded neo-Hookean layer, nu {table.poisson_ratio:g}, no friction, "
        f"depth <= {table.greatest_depth * h * 1e3:g} mm; linear to {LIGHT * h * 1e3:g} mm",
    )


def light_pressure(
    table: ProbeTable,
    probe: Probe,
    pose: Pose,
    thickness_m: float,
    x_m: Float[ndarray, " nx"],
    y_m: Float[ndarray, " ny"],
) -> Field:
    """Return the pressure of linear layers under a light press [E].

    Args:
        table, probe, pose: Press to a depth above 0, up to `MAX_LIGHT`.
        thickness_m: Thickness of the layer [m].
        x_m, y_m: Columns and rows of a grid that contains the contact [m].
    """
    body, depth = _body(table), pose.depth_m / thickness_m
    touch = light_touch(body, table.poisson_ratio, depth)
    c, s = math.cos(probe.turn_rad), math.sin(probe.turn_rad)
    along, across = touch.x[None, :] * thickness_m, touch.y[:, None] * thickness_m
    places = pose.x_m + c * along - s * across, pose.y_m + s * along + c * across
    force = float(light_law(body, table.poisson_ratio)(np.array([depth]))[0, 0])
    laid = laid_onto(touch.pressure * (force / touch.pressure.sum()), *places, x_m, y_m)
    return np.asarray(laid * (thickness_m**2 / ((x_m[1] - x_m[0]) * (y_m[1] - y_m[0]))))


def _sunk(table: ProbeTable, pressure: Field, x: Float[ndarray, " nx"], y: Float[ndarray, " ny"]) -> Field:
    """Displacement of a linear layer's top under a pressure, in thicknesses."""
    grid = Cells(len(x), len(y), round(float(x[1] - x[0]), 9), round(float(y[1] - y[0]), 9))
    return normal_influence(Stack((ElasticLayer(1.0, 1.0, table.poisson_ratio),)), grid).apply(0, pressure)


def _body(table: ProbeTable) -> RoundedBody:
    return RoundedBody(table.shape, table.radius, table.length, table.rounding)


def _check_within(touching: Mask, x_m: ndarray, y_m: ndarray, radius_m: float) -> None:
    rows, columns = np.nonzero(touching)
    furthest = float(np.hypot(x_m[columns], y_m[rows]).max(initial=0.0))
    if furthest > radius_m:
        raise RangeError(
            f"the contact reaches {furthest * 1e3:.1f} mm from the membrane's axis, over its rim at "
            f"{radius_m * 1e3:g} mm; press nearer to the middle",
            code="contact-over-rim",
        )


class Resultant(NamedTuple):
    """Force and moment of the probe on the surface, in the sensor's frame.

    Attributes:
        force_x_n, force_y_n, force_z_n: Force, z into the surface [N].
        moment_x_nm, moment_y_nm, moment_z_nm: Right-handed moments about the point [N m].
    """

    force_x_n: float
    force_y_n: float
    force_z_n: float
    moment_x_nm: float
    moment_y_nm: float
    moment_z_nm: float


def resultant_of(contact: Contact, about_m: tuple[float, float] = (0.0, 0.0)) -> Resultant:
    """Return the resultant about a point (x, y) of the rest surface [m], by default the membrane's centre."""
    if not all(map(math.isfinite, about_m)):
        raise InputError(f"moments about {about_m} m; give two finite numbers in m, x and y")
    cell = cells(contact.x_m, contact.y_m).area_m2
    x, y = contact.x_m - about_m[0], (contact.y_m - about_m[1])[:, None]
    p = contact.pressure_pa
    q_x, q_y = np.zeros((2, *p.shape)) if contact.shear_pa is None else contact.shear_pa
    parts = (q_x, q_y, p, y * p, -x * p, x * q_y - y * q_x)
    return Resultant(*(float(part.sum()) * cell for part in parts))


Points = Float[ndarray, "*n"]


def disc_stress(x: Points, y: Points) -> tuple[Points, Points, Points]:
    """Return s_xx, s_yy, s_xy of a disc of radius 1 loaded at y = 1 and -1, in units of P / (pi R t).

    NaN outside the disc and at the loads; 1, -3, 0 at the centre.
    """
    a, b = 1 - y, 1 + y
    inside = (x**2 + y**2 <= 1) & (x**2 + (1 - np.abs(y)) ** 2 > 0)
    p, q = (np.where(inside, x**2 + s**2, np.nan) ** 2 for s in (a, b))
    return (
        np.asarray(1 - 2 * x**2 * (a / p + b / q)),
        np.asarray(1 - 2 * (a**3 / p + b**3 / q)),
        np.asarray(2 * x * (a**2 / p - b**2 / q)),
    )


def disc_difference(x: Points, y: Points) -> tuple[Points, Points]:
    """Return s1 - s2 over that of the centre, 8 P / (pi D t), and the angle of s1 from x towards y [rad]."""
    xx, yy, xy = disc_stress(x, y)
    return np.hypot(xx - yy, 2 * xy) / 4, np.arctan2(2 * xy, xx - yy) / 2
