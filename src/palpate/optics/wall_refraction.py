"""Refraction at the round rim of a disc seen edge-on by a telecentric camera.

The camera looks along -y. At the rim a ray has the angles asin(x/R) outside and asin(x/(nR)) inside, and
turns by their difference. Inside it passes the axis at b = x/n: a cylindrical lens of magnification n that
shows |b| < R/n. The lamp is assumed wide enough for twice the turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core import Bool, Float, InputError, RangeError, ndarray

Columns = Float[ndarray, " w"]


@dataclass(frozen=True, slots=True)
class ColumnRays:
    """Ray of each image column inside the membrane; 0 and not visible where it misses.

    Attributes:
        impact_m: b, signed distance from the disc's axis, positive to the right of the light's path [m].
        turn_rad: phi; light runs along (sin phi, cos phi) in (x, y).
        half_chord_m: Half the path inside [m].
        transmission: Both walls, averaged over polarisations.
    """

    impact_m: Columns
    turn_rad: Columns
    half_chord_m: Columns
    transmission: Columns
    visible: Bool[ndarray, " w"]

    def about(self, x0_m: float, y0_m: float) -> tuple[Columns, Columns, Columns]:
        """Signed offset from an upright axis at (x0, y0), along (cos phi, -sin phi), and entry and exit from
        the nearest point [m].
        """
        if not np.isfinite(x0_m + y0_m):
            raise InputError(f"the axis at ({x0_m}, {y0_m}) m must be finite numbers")
        c, s = np.cos(self.turn_rad), np.sin(self.turn_rad)
        offset = self.impact_m - (x0_m * c - y0_m * s)
        along = x0_m * s + y0_m * c
        return offset, -self.half_chord_m - along, self.half_chord_m - along


def round_rim(x_m: Columns, radius_m: float, index: float) -> ColumnRays:
    """Return rays through the bare round rim of a disc in air.

    Args:
        x_m: Columns from the disc's axis [m].
        radius_m: R [m].
        index: Relative refractive index, at least 1, which disables refraction.
    """
    _check(x_m, radius_m, index)
    visible = abs(x_m) < radius_m
    x = np.where(visible, x_m, 0.0)
    outside, inside = np.arcsin(x / radius_m), np.arcsin(x / (index * radius_m))
    return ColumnRays(
        impact_m=x / index,
        turn_rad=outside - inside,
        half_chord_m=np.where(visible, radius_m * np.cos(inside), 0.0),
        transmission=np.where(visible, _two_walls(outside, inside, index), 0.0),
        visible=visible,
    )


def fresnel(outside_rad: Columns, inside_rad: Columns, index: float) -> tuple[Columns, Columns]:
    """Return the transmission of one wall for s and p polarisation, at angles outside and inside [rad].

    Reference: M. Born and E. Wolf, Principles of Optics, sec. 1.5.2, doi:10.1017/CBO9781139644181.
    """
    o, i = np.cos(outside_rad), np.cos(inside_rad)
    upright = ((o - index * i) / (o + index * i)) ** 2
    level = ((index * o - i) / (index * o + i)) ** 2
    return np.asarray(1 - upright), np.asarray(1 - level)


def _two_walls(outside_rad: Columns, inside_rad: Columns, index: float) -> Columns:
    upright, level = fresnel(outside_rad, inside_rad, index)
    return (upright**2 + level**2) / 2


def _check(x_m: Columns, length_m: float, index: float) -> None:
    if not (length_m > 0 and np.isfinite(length_m)):
        raise RangeError(f"the skin's size {length_m} m must be a positive number of metres")
    if not (index >= 1 and np.isfinite(index)):
        raise RangeError(f"refractive index {index} is below 1; silicones in air have 1.40 to 1.43")
    if not np.isfinite(x_m).all():
        raise RangeError("every column needs a finite x in metres; look for NaN")
