"""Resultant of a contact's tractions: three forces and three moments about one point."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from palpate.core import Contact, InputError
from palpate.mechanics.layers.surface_grid import cells


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
