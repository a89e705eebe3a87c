"""Every edge-on fringe image of a Hertz contact at nu = 1/2, in one table.

Lengths in contact radii a and stress in peak pressures p0 leave one number, kappa = C p0 a / lambda. So the
dark-field image is one function I(x/a, z/a; kappa) for each polariser angle, whatever the material, ball,
depth and colour of the light. It is marched once on a grid and read off by cubic splines.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy import ndarray
from scipy.interpolate import BSpline, make_interp_spline

from palpate.core.errors import RangeError
from palpate.core.shapes import Float
from palpate.mechanics.half_space.hertz import secondary_stress
from palpate.optics.march import Retarder, graded_slices, march_even
from palpate.optics.polariscope import dark_field

CUBIC = 3
FARTHEST = 50.0  # contact radii; farther out a point shows the light of this distance, below (0.06 kappa)^2
STEP = 0.08  # of the grids' own coordinates, in which the field is about equally smooth everywhere
NEAR_SURFACE = 0.2  # z/a below which rows stop getting finer: a fringe under the contact is 1/(4 kappa) high
RIM, RIM_SHARE = 0.04, 0.2  # width x/a around the contact's rim where columns gather, and how strongly
KAPPA_STEP = 0.08
SLICES = 128  # on the half ray

Grid = Float[ndarray, " _"]


@dataclass(frozen=True, slots=True)
class FringeTable:
    """Dark-field light I(kappa, z/a, x/a) as cubic-spline coefficients.

    Attributes:
        coefficients: ``[kappa z x]``, float32.
        knots: of kappa, asinh of z/a and of x/a.
        greatest_kappa: up to where the table reaches.
    """

    coefficients: ndarray
    knots: tuple[Grid, Grid, Grid]
    greatest_kappa: float

    def image(
        self,
        x: Float[ndarray, " x"],
        z: Float[ndarray, " z"],
        kappa: Float[ndarray, " k"],
        weight: Float[ndarray, "k c"],
    ) -> Float[ndarray, "z x c"]:
        """Light at columns x and rows z, summed over bands with weights.

        Args:
            x: of the columns, in contact radii.
            z: of the rows, in contact radii, not negative.
            kappa: C p0 a / lambda of each band.
            weight: of each band in each channel.

        Returns:
            One image a channel; to kappa = 2.4 within 3e-3 of the marched one on 999 of 1000 points, within
            0.02 on the rest, at the rim.

        Raises:
            RangeError: some kappa lies beyond the table.
        """
        if np.max(kappa) > self.greatest_kappa:
            raise RangeError(
                f"retardance number C p0 a / lambda = {np.max(kappa):.3g} is beyond the table's "
                f"{self.greatest_kappa:.3g}; give a spec whose material and ball made this contact"
            )
        of_kappa, of_z, of_x = self.knots
        bands = (weight.T @ _basis(kappa, of_kappa)).astype(np.float32)
        columns = _basis(np.arcsinh(x), of_x)
        rows = _basis(np.arcsinh(z / NEAR_SURFACE), of_z)
        field = np.tensordot(bands, self.coefficients, axes=1)
        light = np.asarray(np.moveaxis(rows @ field @ columns.T, 0, -1))
        return light.clip(0.0, 1.0)  # splines overshoot a little where there is no light


def marched(
    x: Float[ndarray, "*n"], z: Float[ndarray, "*n"], kappa: float, polariser_rad: float, slices: int
) -> Float[ndarray, "*n"]:
    """The table's function itself, by a march along every ray.

    Args:
        x: where the rays pass, in contact radii.
        z: below the surface, in contact radii.
        kappa: C p0 a / lambda.
        polariser_rad: from x towards z [rad].
        slices: on the half ray.
    """
    return dark_field(march_even(*_slices(x, z, slices), np.pi * kappa), polariser_rad)


@lru_cache(maxsize=4)
def fringe_table(polariser_rad: float, greatest_kappa: float) -> FringeTable:
    """March the table for one polariser angle, in a second or two; kept for the next call."""
    x, z = _columns(), _rows()
    kappa = np.arange(math.ceil(greatest_kappa / KAPPA_STEP) + CUBIC + 1) * KAPPA_STEP
    a, b = (part.astype(np.float32) for part in _slices(x[None, :], z[:, None], SLICES))
    light = np.stack([_mirrored(march_even(a, b, math.pi * k), polariser_rad) for k in kappa])
    both_sides = np.concatenate([-x[:0:-1], x])
    knots = []
    for axis, at in enumerate((kappa, np.arcsinh(z / NEAR_SURFACE), np.arcsinh(both_sides))):
        spline = make_interp_spline(at, light, k=CUBIC, axis=axis)
        light = np.moveaxis(spline.c, 0, axis)
        knots.append(spline.t)
    coefficients = np.ascontiguousarray(light, dtype=np.float32)
    coefficients.setflags(write=False)
    return FringeTable(coefficients, (knots[0], knots[1], knots[2]), float(kappa[-1]))


def _rows() -> Grid:
    last = np.arcsinh(FARTHEST / NEAR_SURFACE)
    return NEAR_SURFACE * np.sinh(np.arange(0.0, last + STEP, STEP))


def _columns() -> Grid:
    # equal steps of a coordinate that rises like asinh x, and steeply once more at the rim
    x = np.sinh(np.linspace(0.0, np.arcsinh(FARTHEST), 4096))
    rise = np.arcsinh(x) + RIM_SHARE * (np.arcsinh((x - 1) / RIM) + np.arcsinh(1 / RIM))
    steps = np.linspace(0.0, rise[-1], math.ceil(rise[-1] / STEP))
    return np.asarray(np.interp(steps, rise, x))


def _mirrored(ray: Retarder, polariser_rad: float) -> Float[ndarray, "z x"]:
    # s_xz is odd in x, so the left half has the opposite q2
    left = dark_field(ray._replace(q2=-ray.q2), polariser_rad)
    return np.concatenate([left[:, :0:-1], dark_field(ray, polariser_rad)], axis=1)


def _slices(x: ndarray, z: ndarray, count: int) -> tuple[ndarray, ndarray]:
    y, dy = graded_slices(np.sqrt(x**2 + z**2 + 1), count)
    difference, shear = secondary_stress(x, y, z, 1.0, 1.0)
    return difference * dy, shear * dy


def _basis(at: Grid, knots: Grid) -> Float[ndarray, "n m"]:
    inside = np.clip(at, knots[0], knots[-1])
    return np.asarray(BSpline.design_matrix(inside, knots, CUBIC).toarray(), dtype=np.float32)
