"""Fringe orders of the edge-on view: how many wavelengths a ray is retarded by, to first order.

N = C / lambda |integral of (s_xx - s_zz, 2 s_xz) dy|. Where the axes turn along the ray it is not the order
of the light that comes out, but counts the fringes from the outside in to a few per cent.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import ndarray
from scipy.interpolate import RegularGridInterpolator

from palpate.core.shapes import Float
from palpate.optics.axisymmetric import AxisymmetricField
from palpate.optics.stress_optic import fringe_order
from palpate.sensors.palm.field import field_of, pressed
from palpate.sensors.palm.spec import PalmSpec

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
        """The 99.9th percentile: a table's sharpest corner is not a fringe."""
        return float(np.quantile(self.order, 0.999))

    @property
    def steepest_per_m(self) -> float:
        """The 99.9th percentile of its slope: fringes a metre where they are densest."""
        return float(np.quantile(np.hypot(*np.gradient(self.order, self.depth_m, self.offset_m)), 0.999))


def edge_on(spec: PalmSpec, depth_m: float, points: int = 121) -> Orders:
    """Orders near the axis, down from the rest surface.

    Within two ball radii to the side, and down to the underside; under a light touch within six contact
    radii both ways, where its fringes are.
    """
    press = pressed(spec, depth_m)
    field, R = field_of(press, spec), spec.indenter_radius_m
    reach = NEAR * press.contact_radius * R or np.inf
    s = np.linspace(0, min(2 * R, reach), points)
    z = np.linspace(0, min(spec.thickness_m, reach), points)
    difference, shear = integrated(field, s, z)
    C = spec.stress_optic.at(np.array([WAVELENGTH_M]))[0]
    return Orders(s, z, fringe_order(difference, shear, float(C), WAVELENGTH_M))


def integrated(
    field: AxisymmetricField, offset_m: Float[ndarray, " s"], depth_m: Float[ndarray, " z"]
) -> tuple[Float[ndarray, "z s"], Float[ndarray, "z s"]]:
    """The integrals of s_xx - s_zz and of 2 s_xz along whole rays [Pa m]."""
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
