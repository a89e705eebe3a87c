"""A round skin seen edge-on through its own rim: each image column's ray inside, for a telecentric camera.

The camera looks along -y, so every ray leaves along +y. At the rim it meets the wall at asin(x/R) to the
normal outside and asin(x/(nR)) inside, by Snell's law, and turns by their difference. All stays in a
horizontal plane. Inside, the ray passes the disc's axis at b = x/n: the disc is a cylindrical lens that
magnifies n times and shows only |b| < R/n. By symmetry the ray turns once more where it enters at the far
wall: the lamp must be wide enough to send light there, at twice the turn, which is taken for granted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core import Bool, Float, InputError, RangeError, ndarray

Columns = Float[ndarray, " w"]


@dataclass(frozen=True, slots=True)
class ColumnRays:
    """The ray of each image column inside the skin; 0 and not visible where a column misses it.

    Attributes:
        impact_m: b, signed distance from the disc's axis, positive to the right of the light's path [m].
        turn_rad: phi; the light runs along (sin phi, cos phi) in (x, y) [rad].
        half_chord_m: half the path inside [m]; the middle is nearest to the disc's axis.
        transmission: of both walls, the mean of both polarisations.
        visible: the column looks into the skin.
    """

    impact_m: Columns
    turn_rad: Columns
    half_chord_m: Columns
    transmission: Columns
    visible: Bool[ndarray, " w"]

    def about(self, x0_m: float, y0_m: float) -> tuple[Columns, Columns, Columns]:
        """The rays as an upright axis at (x0, y0) sees them [m].

        Returns:
            Signed offset of each ray from the axis, and where it enters and leaves the skin, 0 being nearest
            to the axis. The offset's direction is (cos phi, -sin phi).
        """
        if not np.isfinite(x0_m + y0_m):
            raise InputError(f"the axis at ({x0_m}, {y0_m}) m must be finite numbers")
        c, s = np.cos(self.turn_rad), np.sin(self.turn_rad)
        offset = self.impact_m - (x0_m * c - y0_m * s)
        along = x0_m * s + y0_m * c
        return offset, -self.half_chord_m - along, self.half_chord_m - along


def round_rim(x_m: Columns, radius_m: float, index: float) -> ColumnRays:
    """Rays through the bare round rim of a disc in air.

    Args:
        x_m: of the columns, measured from the disc's axis across the camera's view [m].
        radius_m: R of the disc [m].
        index: n of the skin over that around it, 1 or more; silicones have 1.40 to 1.43, and 1 switches
            refraction off.

    Returns:
        The rays; at grazing columns the transmission falls to 0. Fresnel's loss is averaged over the two
        polarisations: that they differ turns the polarisation of rays near the rim, by less than 1 degree
        for |x| < R/2 at n = 1.41, and is left out.
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
    """Share of light that one wall lets pass, upright (s) and level (p) polarisation.

    Args:
        outside_rad: angle to the normal outside [rad].
        inside_rad: the refracted one [rad].
        index: inside over outside.

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
