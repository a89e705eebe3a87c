"""Tables at finite strain of a rigid upright punch with a rounded edge, pressed into a bonded disc.

The punch has radius R and an edge radius of 0.1 R, without friction. Material, units, and interpolation are
those of `disc_table`. Solved by `tools/punch_tables.py`; mesh errors are in `tools/punch_study.json`. Scalars
are interpolated as F / d, a, and p / d^(2/3). On the punch's upright side the top rises within one knot.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from palpate.core import Contact, ContactSolution, Float, InputError, Pose, Probe, ndarray
from palpate.mechanics.axisymmetric.disc_table import (
    DiscTable,
    Knots,
    TabulatedPress,
    pressed_contact,
)
from palpate.mechanics.half_space.hertz import GRID_POINTS, grid_around, positive

EDGE = 0.1  # edge radius [R]


@dataclass(frozen=True)
class PunchedDisc(TabulatedPress):
    """The disc at one depth of a punch, with known contact normals."""

    @cached_property
    def top_load(self) -> Knots:
        """Pressure -n.s.n with the punch's normal, which sums to the force [E]."""
        sine = np.clip((self.r - (1.0 - EDGE)) / EDGE, 0.0, 1.0)
        cosine = np.sqrt(1.0 - sine**2)
        rr, _, zz, rz = self.stress[:, 0]
        pressure = -(sine**2 * rr + 2.0 * sine * cosine * rz + cosine**2 * zz)
        return np.asarray(pressure * (self.r < self.contact_radius))


@dataclass(frozen=True)
class PunchTable(DiscTable):
    """A rounded punch pressed step by step; see `DiscTable`."""

    INDENTER: ClassVar[str] = "punch"
    POWERS: ClassVar[tuple[float, float, float]] = (1.0, 0.0, 2.0 / 3.0)
    PRESSED: ClassVar[type[TabulatedPress]] = PunchedDisc


def is_punched(contact: Contact) -> bool:
    """Return whether a contact is of these tables."""
    return contact.probe.shape == PunchTable.INDENTER and contact.solution is ContactSolution.DISC_TABLE


def press_punch(
    probe: Probe,
    pose: Pose,
    youngs_modulus_pa: float,
    thickness_m: float,
    disc_radius_m: float,
    friction: float = 0.0,
    poisson_ratio: float = 0.49,
    x_m: Float[ndarray, " nx"] | None = None,
    y_m: Float[ndarray, " ny"] | None = None,
) -> Contact:
    """Press an upright rounded punch into a bonded disc, at finite strain; arguments as of
    `press_finite_strain`.

    Returns:
        Contact with the pressure normal to the surface, without the punch's upright side.
    """
    if probe.shape != "punch" or probe.tilt_rad != 0.0:
        raise InputError(
            f"the tables are of an upright punch, got probe shape {probe.shape!r}, leaning by "
            f"{probe.tilt_rad:g} rad; use shape 'punch', upright"
        )
    R = probe.radius_m
    positive("the punch's radius", R, "m")
    positive("Young's modulus", youngs_modulus_pa, "Pa")
    positive("the disc's thickness", thickness_m, "m")
    positive("the disc's radius", disc_radius_m, "m")
    x, y, _ = grid_around(pose, np.linspace(-1.5 * R, 1.5 * R, GRID_POINTS), x_m, y_m)
    table = PunchTable.of_disc(thickness_m / R, friction, poisson_ratio)
    return pressed_contact(table, probe, pose, youngs_modulus_pa, disc_radius_m, x, y)
