"""Motion of the tiles under a load on the pad, in all three directions, about the probe's axis.

Waves of load cross the layers to the tiles' plane as in `palpate.mechanics.layers.stack_field`; here only
the motion is wanted, on one plane, again and again, so that each wave's response is kept.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import fft
from scipy.ndimage import map_coordinates, spline_filter

from palpate.core import Contact, Field, Float, InputError, ndarray
from palpate.mechanics.layers.stack import Stack, climb
from palpate.mechanics.layers.surface_grid import Cells, Waves, spread
from palpate.sensors.nusense.pad_contact import PATTERN_CELL_M

SIDE = 192  # cells about the probe: 38 mm to each side, over eight thicknesses of the pad
ALIGNED = 1e-6

Spectrum = Float[ndarray, "py half"]


@dataclass(frozen=True, slots=True, eq=False)
class PatternMotion:
    """Displacement of the tiles' lower face from rest.

    Attributes:
        centre_m: the probe's axis (x, y), about which the grid lies [m].
        cell_m: its step [m].
        moved_m: along x, y and z ``[3 ny nx]`` at (i + 1/2 - n/2) cells from the centre [m].
        knots: the cubic spline through them ``[3 ny nx]`` [m].
    """

    centre_m: tuple[float, float]
    cell_m: float
    moved_m: Float[ndarray, "3 ny nx"]
    knots: Float[ndarray, "3 ny nx"]

    def at(self, x_m: Float[ndarray, " n"], y_m: Float[ndarray, " n"]) -> Float[ndarray, "3 n"]:
        """Displacement along x, y and z of tiles that rest at places; 0 far from the probe [m]."""
        side = self.moved_m.shape[1]
        rows = (np.asarray(y_m) - self.centre_m[1]) / self.cell_m + side / 2 - 0.5
        columns = (np.asarray(x_m) - self.centre_m[0]) / self.cell_m + side / 2 - 0.5
        return np.stack(
            [map_coordinates(knots, [rows, columns], order=3, prefilter=False) for knots in self.knots]
        )


class PlaneResponse(NamedTuple):
    """Motion on a plane per wave of load; `i` times where it is said [m/Pa].

    Attributes:
        waves: of the grid.
        xx, xy, yy: along x and y by shear along x and y.
        pressed_x, pressed_y: i times this along x and y by pressure.
        lifted_x, lifted_y: -i times this along z by shear.
        zz: along z by pressure.
    """

    waves: Waves
    xx: Spectrum
    xy: Spectrum
    yy: Spectrum
    pressed_x: Spectrum
    pressed_y: Spectrum
    lifted_x: Spectrum
    lifted_y: Spectrum
    zz: Spectrum


@lru_cache(maxsize=16)
def plane_response(stack: Stack, interface: int, side: int, cell_m: float) -> PlaneResponse:
    """Response of the plane below a number of layers, on a square periodic grid."""
    waves = spread(Cells(side, side, cell_m, cell_m), 0.0)
    in_plane, across = climb(stack.slabs, stack.below, waves.k)
    one, other = in_plane[interface], across[interface]
    CR = one.compliance @ one.transmission / waves.k[:, None, None]
    cr = (other.compliance @ other.transmission)[:, 0, 0] / waves.k
    on, c, s = waves.gather, waves.cos, waves.sin
    along, sideways, coupled = on(CR[:, 0, 0]), on(cr), on(CR[:, 0, 1])
    lifted = on(CR[:, 1, 0])
    xx, yy = c * c * along + s * s * sideways, s * s * along + c * c * sideways
    zz = on(CR[:, 1, 1])
    zz[0, 0] = waves.mean_wave(CR[:, 1, 1])
    xx[0, 0] = yy[0, 0] = waves.mean_wave((CR[:, 0, 0] + cr) / 2)
    fields = (c * s * (along - sideways), yy, c * coupled, s * coupled, c * lifted, s * lifted, zz)
    return PlaneResponse(waves, xx, *fields)


def pattern_motion(stack: Stack, interface: int, contact: Contact) -> PatternMotion:
    """The tiles' motion under a contact.

    Args:
        stack: the pad.
        interface: number of layers above the tiles' lower face.
        contact: on the grid of `pad_contact`; its tractions are those of the pad as it remembers.
    """
    share = 1.0 / contact.history.stiffening
    response = plane_response(stack, interface, SIDE, PATTERN_CELL_M)
    p = response.waves.forward(_coarse(contact.pressure_pa * share, contact))
    moved_x, moved_y = 1j * response.pressed_x * p, 1j * response.pressed_y * p
    moved_z = response.zz * p
    if contact.shear_pa is not None:
        qx, qy = (response.waves.forward(_coarse(q * share, contact)) for q in contact.shear_pa)
        moved_x = moved_x + response.xx * qx + response.xy * qy
        moved_y = moved_y + response.xy * qx + response.yy * qy
        moved_z = moved_z - 1j * (response.lifted_x * qx + response.lifted_y * qy)
    moved = fft.irfft2(np.stack([moved_x, moved_y, moved_z]), response.waves.shape)
    knots = np.stack([spline_filter(part, order=3) for part in moved])
    return PatternMotion((contact.pose.x_m, contact.pose.y_m), PATTERN_CELL_M, moved, knots)


def _coarse(load: Field, contact: Contact) -> Field:
    """Means of a load on the pattern's larger cells, in the middle of their grid."""
    cell = float(contact.x_m[1] - contact.x_m[0])
    times = round(PATTERN_CELL_M / cell)
    ny, nx = load.shape
    centred = abs(float(contact.x_m[0] + contact.x_m[-1]) / 2 - contact.pose.x_m) < ALIGNED
    even = ny % (2 * times) == 0 and nx % (2 * times) == 0
    if not (abs(times * cell - PATTERN_CELL_M) < ALIGNED * cell + 1e-12 and even and centred):
        raise InputError("a contact on another grid than NUSense's; make it with the sensor's press()")
    ny, nx = ny // times, nx // times
    means = load.reshape(ny, times, nx, times).mean(axis=(1, 3))
    whole = np.zeros((SIDE, SIDE))
    top, left = (SIDE - ny) // 2, (SIDE - nx) // 2
    whole[top : top + ny, left : left + nx] = means
    return whole
