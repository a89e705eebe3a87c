"""Stress under a tabled non-axisymmetric probe or a laterally loaded punch, resampled on flat planes.

The table's quarter is rotated to the probe and read in a window and on a wide grid. The fraction of a light
press that belongs to linear layers, and the shear of a lateral load, are added on the same planes.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import map_coordinates

from palpate.core import Bool, Contact, Float, Float32, Probe, ndarray
from palpate.mechanics.axisymmetric.punch_table import is_punched
from palpate.mechanics.layers.layer_stress import OnGrid, stress_under
from palpate.mechanics.probe_contact import light_pressure, share_of_table
from palpate.mechanics.probe_table import ODD_ACROSS, ODD_ALONG, PressedLayer, own_frame
from palpate.sensors.palm.palm_press import between, field_under
from palpate.sensors.palm.palm_spec import PalmSpec
from palpate.sensors.palm.pulled_ball import Laid
from palpate.sensors.palm.tabled_probes import probe_table_of

NEAR_PLANES, DEEP_PLANES = 48, 20  # planes around the probe and down to the base
BELOW = 0.2  # extent of the near planes below the probe, in thicknesses
BESIDE = 0.5  # window beyond the probe, in thicknesses
CELLS = 160  # cells per side of window and wide grid
LIGHT_PLANES = 20  # planes of linear layers, finest at the surface
FINER = 2  # refinement of the quarter's knots

Stress = Float32[ndarray, "nz 5 ny nx"]


def stress_beneath(spec: PalmSpec, contact: Contact) -> Laid:
    """Return the five stresses of a ray around a probe for which `is_tabled_probe` or `is_punched` holds."""
    h, probe = spec.thickness_m, contact.probe
    deep = min(contact.pose.depth_m + BELOW * h, 0.9 * h)
    planes = np.concatenate(
        [
            np.linspace(0.0, deep, NEAR_PLANES),
            deep + (h - deep) * np.linspace(0, 1, DEEP_PLANES + 1)[1:] ** 1.5,
        ]
    )
    halves = probe.radius_m + probe.length_m / 2 + BESIDE * h, spec.radius_m
    share = 1.0 if is_punched(contact) else float(share_of_table(contact.pose.depth_m / h))
    of_table = _of_punch if is_punched(contact) else _of_table
    layers = _of_layers(spec, contact, 1.0 - share) if share < 1.0 or contact.shear_pa is not None else None
    made = []
    for half in halves:
        stress = np.zeros((len(planes), 5, 1, 1), np.float32)
        if share > 0.0:
            stress = of_table(spec, contact, planes, half)
        if layers is not None:
            stress = np.float32(share) * stress + _read_layers(spec, contact, layers, planes, half)
        first = contact.pose.x_m - half + half / CELLS, contact.pose.y_m - half + half / CELLS
        made.append(OnGrid(first, (2 * half / CELLS, 2 * half / CELLS), stress))
    return Laid(planes, *made)


def _of_layers(spec: PalmSpec, contact: Contact, share: float) -> tuple[OnGrid, OnGrid]:
    h, x, y = spec.thickness_m, contact.x_m, contact.y_m
    pressure = np.zeros_like(contact.pressure_pa)
    if share > 0.0:
        table, modulus = probe_table_of(spec, contact.probe), share * spec.youngs_modulus_pa
        pressure = modulus * light_pressure(table, contact.probe, contact.pose, h, x, y)
    planes = h * np.linspace(0, 1, LIGHT_PLANES) ** 2
    return stress_under(h, spec.poisson_ratio, planes, pressure, x, y, contact.shear_pa)


def _read_layers(
    spec: PalmSpec,
    contact: Contact,
    layers: tuple[OnGrid, OnGrid],
    planes: Float[ndarray, " nz"],
    half: float,
) -> Stress:
    aside = _aside(half)
    x, y = contact.pose.x_m + aside, contact.pose.y_m + aside
    (near, is_near), (far, _) = (_read_grid(grid, x, y) for grid in layers)
    read = np.where(is_near, near, far)
    onto = CubicSpline(np.linspace(0, 1, LIGHT_PLANES), np.eye(LIGHT_PLANES))(
        np.sqrt(planes / spec.thickness_m)
    ).astype(np.float32)
    return np.asarray(np.tensordot(onto, read, axes=1))


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


@lru_cache(maxsize=4)
def _finer(spec: PalmSpec, probe: Probe, depth_m: float) -> tuple[PressedLayer, Float32[ndarray, "6 m y x"]]:
    """The quarter at one depth, and its stress on finer knots, faded out at the table's sides [E]."""
    at = probe_table_of(spec, probe).at(depth_m / spec.thickness_m)
    stress = at.stress
    for axis, knots in ((3, at.x), (2, at.y), (1, at.zeta)):
        stress = PchipInterpolator(knots, stress, axis=axis)(between(knots, FINER))
    left = at.share_at(between(at.x, FINER), between(at.y, FINER)[:, None])
    return at, np.asarray(stress * left, np.float32)


def _aside(half: float) -> Float[ndarray, " n"]:
    return (np.arange(CELLS) + 0.5) * (2 * half / CELLS) - half


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


def _of_punch(spec: PalmSpec, contact: Contact, planes: Float[ndarray, " nz"], half: float) -> Stress:
    base, aside = field_under(spec, contact.probe, contact.pose.depth_m), _aside(half)
    r = np.hypot(aside[None, :], aside[:, None])
    c, s = aside[None, :] / r, aside[:, None] / r
    top, out = np.interp(r, base.r_m, base.surface_m), np.interp(r, base.r_m, np.arange(len(base.r_m)))
    laid = np.empty((len(planes), 5, CELLS, CELLS), np.float32)
    for k, z in enumerate(planes):
        zeta = np.clip((z - top) / (base.thickness_m - top), 0, 1)
        down = np.interp(zeta, base.zeta, np.arange(len(base.zeta)))
        rr, tt, zz, rz = (
            map_coordinates(part, [down, out], order=1, mode="nearest") for part in base.stress_pa
        )
        laid[k] = (
            rr * c * c + tt * s * s - zz,
            rr * s * s + tt * c * c - zz,
            (rr - tt) * s * c,
            rz * c,
            rz * s,
        )
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
