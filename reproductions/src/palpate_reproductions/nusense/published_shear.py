"""Equation (3.1) of the thesis as a baseline: gamma of a press from its pressure, without the layers.

    gamma_j = (3/E) d(sigma * phi)/dx_j

has the unit 1/m as printed. To compare it with what a camera sees, a thickness t and a scale are assumed: E
and t of the gel alone, on which the tiles lie; phi a Gaussian whose standard deviation is the depth of the
tiles; the shear acts over t and moves the tiles by t gamma_j. Gamma_ss is then alpha K times the mean length
of that shift over the lattice, as equation (3.3) has it. Nothing of this is fitted.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from palpate.calibration.shear.force_law import held_out
from palpate.calibration.shear.touch_cues import PUBLISHED_ALPHA_PX, SIDE_SAMPLES
from palpate.core import Bool, Float, Pose, ndarray
from palpate.estimators.surface_strain import shear_from_pressure
from palpate.sensors.nusense.nusense_sensor import NuSense

FORCES_N = (0.5, 9.0)
DEPTHS = 24

Series = Float[ndarray, " n"]


class ShearCurve(NamedTuple):
    """Gamma by equation (3.1) over force."""

    force_n: Series
    gamma: Series


def shear_forces(pad: NuSense, tip: str) -> ShearCurve:
    """The curve of a tip in the pad's middle, 0.5 to 9 N."""
    probe = pad.probe(tip)
    forces, values = [], []
    for depth in np.linspace(0, pad.known_depth_m(probe), DEPTHS + 1)[1:]:
        contact = pad.press(probe, Pose(0.0, 0.0, float(depth)))
        if FORCES_N[0] <= contact.force_n <= FORCES_N[1]:
            forces.append(contact.force_n)
            values.append(published_gamma_of(pad, contact.pressure_pa, contact.x_m, contact.y_m))
    return ShearCurve(np.array(forces), np.array(values))


def published_gamma_of(
    pad: NuSense, pressure_pa: Float[ndarray, "ny nx"], x_m: Float[ndarray, " nx"], y_m: Float[ndarray, " ny"]
) -> float:
    """Gamma_ss by equation (3.1) of a pressure on the pad."""
    layers, pattern = pad.spec.layers, pad.spec.pattern
    wide = 4 * layers.pattern_depth_m  # the blur reaches beyond the grid that holds the contact
    x, y = (np.arange(axis[0] - wide, axis[-1] + wide, axis[1] - axis[0]) for axis in (x_m, y_m))
    left, below = (int(np.abs(to - axis[0]).argmin()) for to, axis in ((x, x_m), (y, y_m)))
    padded = np.zeros((len(y), len(x)))
    padded[below : below + len(y_m), left : left + len(x_m)] = pressure_pa
    strain = shear_from_pressure(padded, x, y, layers.pattern_depth_m, layers.gel_pa, layers.gel_m)
    shift_px = layers.gel_m * np.hypot(*strain) * pad.spec.lens.focal_px[0] / pad.spec.camera_m
    seen_m2 = (pattern.columns - 2) * (pattern.rows - 2) * pattern.cast_pitch_m**2  # between outer corners
    mean_px = float(shift_px.sum() * (x[1] - x[0]) * (y[1] - y[0]) / seen_m2)
    return PUBLISHED_ALPHA_PX * SIDE_SAMPLES**2 * mean_px


def scale_of_published_shear(
    curve: ShearCurve, gamma: Series, force_n: Series, press: ndarray
) -> Mapping[str, float]:
    """What the curve makes of measured gamma: without a fit, and with one scale of gamma.

    Args:
        gamma, force_n, press: of frames on loading branches.
    """
    expected = np.interp(force_n, curve.force_n, curve.gamma)

    def forces(scale: float) -> Series:
        return np.interp(scale * gamma, curve.gamma, curve.force_n)

    def scale_by(kept: Bool[ndarray, " n"]) -> float:
        return float((gamma[kept] @ expected[kept]) / (gamma[kept] @ gamma[kept]))

    fitted = held_out(lambda kept: forces(scale_by(kept)), press)
    slope = np.polyfit(curve.gamma, curve.force_n, 1)
    return {
        "slope_N": float(slope[0]),
        "offset_N": float(slope[1]),
        "gamma_over_measured": scale_by(np.ones(len(gamma), bool)),
        "mae_N": float(np.abs(forces(1.0) - force_n).mean()),
        "one_scale_mae_N": float(np.abs(fitted - force_n).mean()),
    }
