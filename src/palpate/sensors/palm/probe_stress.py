"""Stress under a contact without symmetry, on flat planes in a window and on a wide grid.

Of a tabled probe the quarter is rotated to the probe, of a laterally loaded ball or punch the rings are laid
out. The fraction of a light press that belongs to linear layers, and the shear of a lateral load, are added
on the same planes. All else is of linear layers.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import map_coordinates

from palpate.core import Bool, Contact, ContactSolution, Float, Float32, Probe, ndarray
from palpate.mechanics.axisymmetric.pulled_sphere import (
    PulledStress,
    angle_from,
    pulled_sphere_table,
)
from palpate.mechanics.axisymmetric.shape_table import is_punched
from palpate.mechanics.layers.layer_stress import OnGrid, stress_under
from palpate.mechanics.probe_contact import is_tabled_probe, light_pressure, share_of_table
from palpate.mechanics.probe_table import ODD_ACROSS, ODD_ALONG, PressedLayer, own_frame
from palpate.optics.march import AxisymmetricField
from palpate.sensors.palm.palm_press import FADED, FRICTION, between, field_at, pressed
from palpate.sensors.palm.palm_spec import PalmSpec
from palpate.sensors.palm.press_corrections import applied_rim, lateral_of
from palpate.sensors.palm.probe_shapes import probe_table_of

PLANES = 20  # planes of linear layers, finest at the surface
NEAR_PLANES, BALL_NEAR_PLANES, DEEP_PLANES = 48, 44, 20  # around a probe, around the ball, down to the base
BELOW = 0.2  # extent of the near planes below a probe, in thicknesses
BESIDE = 0.5  # window beyond a probe, in thicknesses
WINDOW, WIDEST = 3.0, 2.4  # half the ball's window: contact radii, limited to ball radii
CELLS = 160  # cells per side of window and wide grid
FINER = 2  # refinement of the quarter's knots

Plane = Float[ndarray, "ny nx"]
Stress = Float32[ndarray, "nz 5 ny nx"]


class Laid(NamedTuple):
    """Stress around a contact on planes [m], in a window and on a wide grid.

    `graded` planes lie at equal steps of the root of depth, along which stress is smooth.
    """

    planes_m: Float[ndarray, " nz"]
    near: OnGrid
    far: OnGrid
    graded: bool = False


def is_pulled_ball(contact: Contact) -> bool:
    """Return whether a contact is of the finite-strain table under a lateral load."""
    return contact.solution is ContactSolution.PULLED_TABLE


def laid_of(spec: PalmSpec, contact: Contact) -> Laid:
    """Return the five stresses of a ray around a contact."""
    h, probe, depth_m = spec.thickness_m, contact.probe, contact.pose.depth_m
    pulled = is_pulled_ball(contact)
    if not (pulled or is_punched(contact) or is_tabled_probe(contact)):
        return _layers(spec, contact, contact.pressure_pa)
    count, below = NEAR_PLANES, BELOW * h
    window = probe.radius_m + probe.length_m / 2 + BESIDE * h
    share, layers = 1.0, None
    if pulled:
        count, below = BALL_NEAR_PLANES, pressed(spec, depth_m).contact_radius * probe.radius_m
        window = min(WINDOW * below, WIDEST * probe.radius_m)
    else:
        share = 1.0 if is_punched(contact) else float(share_of_table(depth_m / h))
        if share < 1.0 or contact.shear_pa is not None:
            layers = _layers(spec, contact, _light_pressure(spec, contact, 1.0 - share))
    deep = min(depth_m + below, 0.9 * h)
    ends = deep + (h - deep) * np.linspace(0, 1, DEEP_PLANES + 1)[1:] ** 1.5
    planes = np.concatenate([np.linspace(0.0, deep, count), ends])
    of_table = _of_table if is_tabled_probe(contact) else _of_rings
    made = []
    for half in (window, spec.radius_m):
        stress = np.zeros((len(planes), 5, 1, 1), np.float32)
        if share > 0.0:
            stress = of_table(spec, contact, planes, half)
        if layers is not None:
            stress = np.float32(share) * stress + _read_layers(contact, layers, planes, half)
        cell, aside = 2 * half / CELLS, float(_aside(half)[0])
        made.append(OnGrid((contact.pose.x_m + aside, contact.pose.y_m + aside), (cell, cell), stress))
    return Laid(planes, made[0], made[1])


def _aside(half: float) -> Float[ndarray, " n"]:
    return (np.arange(CELLS) + 0.5) * (2 * half / CELLS) - half


def rows_of(laid: Laid, z_m: Float[ndarray, " h"]) -> Float32[ndarray, "h nz"]:
    """Return the weights of interpolation from planes to rows."""
    planes, unit = laid.planes_m, np.eye(len(laid.planes_m))
    if laid.graded:
        return np.asarray(CubicSpline(np.sqrt(planes), unit)(np.sqrt(z_m)), np.float32)
    return np.stack([np.interp(z_m, planes, one) for one in unit], axis=1).astype(np.float32)


def summed_along(laid: Laid) -> tuple[Float[ndarray, " w"], Float[ndarray, "nz w"], Float[ndarray, "nz w"]]:
    """Return the window's columns and the integrals of s_xx - s_zz and s_xz along y on each plane [Pa m]."""
    near, far = laid.near, laid.far
    (x, y), (wide_x, wide_y) = (
        [
            first + np.arange(count) * cell
            for first, count, cell in zip(
                grid.first_m, reversed(grid.stress_pa.shape[2:]), grid.cell_m, strict=True
            )
        ]
        for grid in (near, far)
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


def _layers(spec: PalmSpec, contact: Contact, pressure_pa: Plane) -> Laid:
    h = spec.thickness_m
    planes = h * np.linspace(0, 1, PLANES) ** 2
    load = pressure_pa, contact.x_m, contact.y_m, contact.shear_pa
    return Laid(planes, *stress_under(h, spec.poisson_ratio, planes, *load), graded=True)


def _light_pressure(spec: PalmSpec, contact: Contact, share: float) -> Plane:
    """Pressure of the fraction of a press that belongs to linear layers."""
    if not share > 0.0:
        return np.zeros_like(contact.pressure_pa)
    table, grid = probe_table_of(spec, contact.probe), (contact.x_m, contact.y_m)
    light = light_pressure(table, contact.probe, contact.pose, spec.thickness_m, *grid)
    return np.asarray(share * spec.youngs_modulus_pa * light)


def _read_layers(contact: Contact, layers: Laid, planes: Float[ndarray, " nz"], half: float) -> Stress:
    aside = _aside(half)
    x, y = contact.pose.x_m + aside, contact.pose.y_m + aside
    (near, is_near), (far, _) = (_read_grid(grid, x, y) for grid in (layers.near, layers.far))
    return np.asarray(np.tensordot(rows_of(layers, planes), np.where(is_near, near, far), axes=1))


def _read_grid(grid: OnGrid, x: ndarray, y: ndarray) -> tuple[Stress, Bool[ndarray, "ny nx"]]:
    """Linear interpolation of a grid, 0 beyond it, with the mask of points inside."""
    rows, columns = grid.stress_pa.shape[2:]
    i, j = (x - grid.first_m[0]) / grid.cell_m[0], (y - grid.first_m[1]) / grid.cell_m[1]
    across, down = (_weights(at, count) for at, count in ((i, columns), (j, rows)))
    inside = ((j >= 0) & (j <= rows - 1))[:, None] & ((i >= 0) & (i <= columns - 1))
    return down @ grid.stress_pa @ across.T * inside, inside


def _weights(at: ndarray, count: int) -> Float32[ndarray, "n count"]:
    """Weights of linear interpolation between points 0, 1, ..."""
    return np.maximum(1.0 - np.abs(at[:, None] - np.arange(count)), 0.0).astype(np.float32)


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


def _of_rings(spec: PalmSpec, contact: Contact, planes: Float[ndarray, " nz"], half: float) -> Stress:
    """Stress under a punch, or under a ball with its pull, from rings about the axis."""
    pose, R, h = contact.pose, contact.probe.radius_m, spec.thickness_m
    base, aside = field_at(spec, pose.depth_m, contact.probe), _aside(half)
    x, y = aside[None, :], aside[:, None]
    r = np.hypot(x, y)
    c, s = x / np.maximum(r, 1e-12), y / np.maximum(r, 1e-12)
    top = np.interp(r, base.r_m, base.surface_m)
    table = base.stress_pa.reshape(4, -1).T.astype(np.float32)
    cos, sin = np.zeros_like(r), np.zeros_like(r)
    if is_pulled_ball(contact):
        added, ratio = _added(spec, contact), applied_rim(spec, pose).force_ratio
        cos, sin = angle_from(x, y, _pull(spec, contact))
        top = top + R * cos * np.interp(r / R, added.r, added.surface, right=0.0)
        table = _table(added, base, R)
        table[:, :4] *= ratio
        table[:, 4:] *= spec.youngs_modulus_pa * ratio
    across_at = np.interp(r, base.r_m, np.arange(len(base.r_m)))
    stress = np.empty((len(planes), 5, CELLS, CELLS), np.float32)
    for k, z in enumerate(planes):
        zeta = np.clip((z - top) / (h - top), 0, 1)
        rr, tt, zz, rz, *m = _read(
            table, len(base.r_m), np.interp(zeta, base.zeta, np.arange(len(base.zeta))), across_at
        )
        rt, tz = 0.0, 0.0
        if m:
            rr, tt, zz, rz = rr + m[0] * cos, tt + m[1] * cos, zz + m[2] * cos, rz + m[3] * cos
            rt, tz = m[4] * sin, m[5] * sin
        stress[k, 0] = rr * c * c + tt * s * s - 2 * rt * s * c - zz
        stress[k, 1] = rr * s * s + tt * c * c + 2 * rt * s * c - zz
        stress[k, 2] = (rr - tt) * s * c + rt * (c * c - s * s)
        stress[k, 3], stress[k, 4] = rz * c - tz * s, rz * s + tz * c
    return stress


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
    table: Float32[ndarray, "mn f"], columns: int, down: Plane, out: Plane
) -> Float32[ndarray, "f ny nx"]:
    i = np.minimum(down.astype(np.int32), len(table) // columns - 2)
    j = np.minimum(out.astype(np.int32), columns - 2)
    a, b = ((at - k).astype(np.float32)[..., None] for at, k in ((down, i), (out, j)))
    at = i * columns + j
    above = table[at] * (1 - b) + table[at + 1] * b
    under = table[at + columns] * (1 - b) + table[at + columns + 1] * b
    return np.moveaxis(above * (1 - a) + under * a, -1, 0)


@lru_cache(maxsize=4)
def _finer(spec: PalmSpec, probe: Probe, depth_m: float) -> tuple[PressedLayer, Float32[ndarray, "6 m y x"]]:
    """The quarter at one depth, and its stress on finer knots, faded out at the table's sides [E]."""
    at = probe_table_of(spec, probe).at(depth_m / spec.thickness_m)
    stress = at.stress
    for axis, knots in ((3, at.x), (2, at.y), (1, at.zeta)):
        stress = PchipInterpolator(knots, stress, axis=axis)(between(knots, FINER))
    left = at.share_at(between(at.x, FINER), between(at.y, FINER)[:, None])
    return at, np.asarray(stress * left, np.float32)


def _of_table(spec: PalmSpec, contact: Contact, planes: Float[ndarray, " nz"], half: float) -> Stress:
    pose, h, aside = contact.pose, spec.thickness_m, _aside(half)
    at, stress = _finer(spec, contact.probe, pose.depth_m)
    x, y = own_frame(contact.probe, pose, pose.x_m + aside[None, :], pose.y_m + aside[:, None])
    x, y = x / h, y / h
    top = at.on_top(at.surface, x, y)
    right, down = (
        np.interp(np.abs(place), between(knots, FINER), np.arange(FINER * (len(knots) - 1) + 1))
        for place, knots in ((x, at.x), (y, at.y))
    )
    signs = [
        np.sign(x) ** odd * np.sign(y) ** across for odd, across in zip(ODD_ALONG, ODD_ACROSS, strict=True)
    ]
    columns = np.stack(
        [
            [sign * map_coordinates(level, [down, right], order=1) for level in part]
            for sign, part in zip(signs, stress, strict=True)
        ]
    ).astype(np.float32)
    levels = between(at.zeta, FINER)
    laid = np.empty((len(planes), 5, CELLS, CELLS), np.float32)
    for k, z in enumerate(planes / h):
        zeta = np.clip((z - top) / (1.0 - top), 0, 1)
        i = np.clip(np.searchsorted(levels, zeta, side="right") - 1, 0, len(levels) - 2)
        share = ((zeta - levels[i]) / (levels[i + 1] - levels[i])).astype(np.float32)
        above, under = (np.take_along_axis(columns, (i + n)[None, None], axis=1)[:, 0] for n in (0, 1))
        laid[k] = _turned(above + (under - above) * share, contact.probe.turn_rad)
    laid *= np.float32(spec.youngs_modulus_pa)
    return laid


def _turned(stress: Float32[ndarray, "6 ny nx"], turn: float) -> list[ndarray]:
    """Stress of a ray in the palm's frame from the probe's frame."""
    xx, yy, zz, yz, xz, xy = stress
    c, s = math.cos(turn), math.sin(turn)
    return [
        c * c * xx + s * s * yy - 2 * c * s * xy - zz,
        s * s * xx + c * c * yy + 2 * c * s * xy - zz,
        c * s * (xx - yy) + (c * c - s * s) * xy,
        c * xz - s * yz,
        s * xz + c * yz,
    ]
