"""Stress under the palm's laterally loaded ball: the tabled press and pull, resampled on flat planes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator

from palpate.core import Contact, ContactSolution, Float, Float32, ndarray
from palpate.mechanics.axisymmetric.pulled_sphere import (
    PulledStress,
    angle_from,
    pulled_sphere_table,
)
from palpate.mechanics.layers.layer_stress import OnGrid
from palpate.optics.axisymmetric_march import AxisymmetricField
from palpate.sensors.palm.palm_press import FADED, FRICTION, field_at, pressed
from palpate.sensors.palm.palm_rim import applied_rim, lateral_of
from palpate.sensors.palm.palm_spec import PalmSpec

NEAR_PLANES, DEEP_PLANES = 44, 20  # planes around the ball and down to the base
WINDOW, WIDEST = 3.0, 2.4  # half the window: contact radii, limited to ball radii
CELLS = 160  # cells per side of window and wide grid

Plane = Float[ndarray, "ny nx"]


class Laid(NamedTuple):
    """Stress around a contact on planes [m], in a window and on a wide grid."""

    planes_m: Float[ndarray, " nz"]
    near: OnGrid
    far: OnGrid


def is_pulled_ball(contact: Contact) -> bool:
    """Return whether a contact is of the finite-strain table under a lateral load."""
    return contact.solution is ContactSolution.PULLED_TABLE


def stress_about(spec: PalmSpec, contact: Contact) -> Laid:
    """Return the five stresses of a ray around a contact for which `is_pulled_ball` holds."""
    added, R = _added(spec, contact), spec.indenter_radius_m
    press = pressed(spec, contact.pose.depth_m)
    a, h = press.contact_radius * R, spec.thickness_m
    deep = min(contact.pose.depth_m + a, 0.9 * h)
    planes = np.concatenate(
        [
            np.linspace(0.0, deep, NEAR_PLANES),
            deep + (h - deep) * np.linspace(0, 1, DEEP_PLANES + 1)[1:] ** 1.5,
        ]
    )
    halves = min(WINDOW * a, WIDEST * R), spec.radius_m
    return Laid(planes, *(_on_grid(spec, contact, added, planes, half) for half in halves))


def _added(spec: PalmSpec, contact: Contact) -> PulledStress:
    """Stress added by the pull, in moduli of the membrane with the rim's effect."""
    pose, R = contact.pose, spec.indenter_radius_m
    unit = spec.youngs_modulus_pa * applied_rim(spec, pose).force_ratio * R**2
    return pulled_sphere_table().at(
        pressed(spec, pose.depth_m), math.hypot(*_pull(spec, contact)) / unit, FRICTION
    )


def _pull(spec: PalmSpec, contact: Contact) -> tuple[float, float]:
    """Lateral load without an applied rim's contribution [N]."""
    effect = applied_rim(spec, contact.pose)
    rim = lateral_of(effect, contact.pose, contact.force_n / effect.force_ratio)
    return contact.lateral_n[0] - rim[0], contact.lateral_n[1] - rim[1]


def _on_grid(
    spec: PalmSpec, contact: Contact, added: PulledStress, planes: Float[ndarray, " nz"], half: float
) -> OnGrid:
    pose, R, h = contact.pose, spec.indenter_radius_m, spec.thickness_m
    modulus = spec.youngs_modulus_pa * applied_rim(spec, pose).force_ratio
    base, pull = field_at(spec, pose.depth_m), _pull(spec, contact)
    across = (np.arange(CELLS) + 0.5) * (2 * half / CELLS) - half
    x, y = across[None, :], across[:, None]
    r = np.hypot(x, y)
    c, s = x / np.maximum(r, 1e-12), y / np.maximum(r, 1e-12)
    cos, sin = angle_from(x, y, pull)
    top = np.interp(r, base.r_m, base.surface_m) + R * cos * np.interp(
        r / R, added.r, added.surface, right=0.0
    )
    table, ratio = _table(added, base, R), modulus / spec.youngs_modulus_pa
    table[:, :4] *= ratio
    table[:, 4:] *= modulus
    across_at = np.interp(r, base.r_m, np.arange(len(base.r_m)))
    stress = np.empty((len(planes), 5, CELLS, CELLS), np.float32)
    for k, z in enumerate(planes):
        zeta = np.clip((z - top) / (h - top), 0, 1)
        rr, tt, zz, rz, *m = _read(
            table, len(base.r_m), np.interp(zeta, base.zeta, np.arange(len(base.zeta))), across_at
        )
        rr, tt, zz, rz = rr + m[0] * cos, tt + m[1] * cos, zz + m[2] * cos, rz + m[3] * cos
        rt, tz = m[4] * sin, m[5] * sin
        stress[k, 0] = rr * c * c + tt * s * s - 2 * rt * s * c - zz
        stress[k, 1] = rr * s * s + tt * c * c + 2 * rt * s * c - zz
        stress[k, 2] = (rr - tt) * s * c + rt * (c * c - s * s)
        stress[k, 3], stress[k, 4] = rz * c - tz * s, rz * s + tz * c
    cell = 2 * half / CELLS
    first = pose.x_m + across[0], pose.y_m + across[0]
    return OnGrid((float(first[0]), float(first[1])), (cell, cell), stress)


def _table(added: PulledStress, base: AxisymmetricField, R: float) -> Float32[ndarray, "mn 10"]:
    """The press's four stresses [Pa] and the pull's six [E] on the press's knots, faded out as that is."""
    r = base.r_m / R
    values = PchipInterpolator(added.zeta, added.stress, axis=1)(base.zeta)
    values = PchipInterpolator(added.r, values, axis=2)(np.minimum(r, added.r[-1]))
    start, end = FADED
    share = np.clip((r / r[-1] - start) / (end - start), 0, 1)
    values = values * (1 - share**2 * (3 - 2 * share))
    return np.concatenate([base.stress_pa, values]).reshape(10, -1).T.astype(np.float32)


def _read(
    table: Float32[ndarray, "mn 10"], columns: int, down: Plane, out: Plane
) -> Float32[ndarray, "10 ny nx"]:
    i = np.minimum(down.astype(np.int32), len(table) // columns - 2)
    j = np.minimum(out.astype(np.int32), columns - 2)
    a, b = ((at - k).astype(np.float32)[..., None] for at, k in ((down, i), (out, j)))
    at = i * columns + j
    above = table[at] * (1 - b) + table[at + 1] * b
    under = table[at + columns] * (1 - b) + table[at + columns + 1] * b
    return np.moveaxis(above * (1 - a) + under * a, -1, 0)


def rows_of(planes_m: Float[ndarray, " nz"], z_m: Float[ndarray, " h"]) -> Float32[ndarray, "h nz"]:
    """Return the weights of linear interpolation from planes to rows."""
    return np.stack([np.interp(z_m, planes_m, unit) for unit in np.eye(len(planes_m))], axis=1).astype(
        np.float32
    )


def summed_along(laid: Laid) -> tuple[Float[ndarray, " w"], Float[ndarray, "nz w"], Float[ndarray, "nz w"]]:
    """Return the window's columns and the integrals of s_xx - s_zz and s_xz along y on each plane [Pa m]."""
    near, far = laid.near, laid.far
    x, y = (first + np.arange(CELLS) * cell for first, cell in zip(near.first_m, near.cell_m, strict=True))
    wide_x, wide_y = (
        first + np.arange(CELLS) * cell for first, cell in zip(far.first_m, far.cell_m, strict=True)
    )
    low, high = y[0] - near.cell_m[1] / 2, y[-1] + near.cell_m[1] / 2
    edges = wide_y[:, None] + far.cell_m[1] * np.array([-0.5, 0.5])
    inside = np.clip(np.minimum(edges[:, 1], high) - np.maximum(edges[:, 0], low), 0.0, None)
    share = far.cell_m[1] - inside
    sums = []
    for which in (0, 3):
        beyond = np.einsum("y,zyx->zx", share, far.stress_pa[:, which])
        spread = np.stack([np.interp(x, wide_x, row) for row in beyond])
        sums.append(near.stress_pa[:, which].sum(axis=1) * near.cell_m[1] + spread)
    return x, sums[0], sums[1]
