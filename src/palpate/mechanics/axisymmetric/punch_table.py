"""A rigid upright punch, its edge rounded, pressed deep into a bonded disc: tables at finite strain.

The punch is a cylinder of radius R whose edge is a quarter of a circle of 0.1 R. Skin slides under it without
friction: outwards, around the edge and, from a third of a radius of depth on, up the upright side. Material,
units and what is drawn between thicknesses are those of `disc_table`. Solved by `tools/punch_tables.py`;
`tools/punch_study.json` holds what its mesh costs, and how far it goes.

Between depths d the scalars are read as F / d, a and p / d^(2/3), p being the greatest pressure, which is at
the edge: under a light touch skin comes to lie on a strip of it that widens as d^(2/3). A table has one
height of the top at each radius: where skin lies on the upright side, the top rises within one knot.
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
    disc_table_for,
    is_disc_tabled,
    pressed_contact,
)
from palpate.mechanics.half_space.hertz import GRID_POINTS, grid_around, positive

EDGE = 0.1  # R, radius of the rounded edge


@dataclass(frozen=True)
class PunchedDisc(TabulatedPress):
    """The disc at one depth of a punch, whose shape is known where it touches."""

    @cached_property
    def top_load(self) -> Knots:
        """The pressure -n.s.n [E], n being the punch's own normal; sums to the force."""
        sine = np.clip((self.r - (1.0 - EDGE)) / EDGE, 0.0, 1.0)
        cosine = np.sqrt(1.0 - sine**2)
        rr, _, zz, rz = self.stress[:, 0]
        pressure = -(sine**2 * rr + 2.0 * sine * cosine * rz + cosine**2 * zz)
        return np.asarray(pressure * (self.r < self.contact_radius))


@dataclass(frozen=True)
class PunchTable(DiscTable):
    """A rounded punch pressed step by step; attributes and units as of `DiscTable`."""

    INDENTER: ClassVar[str] = "punch"
    POWERS: ClassVar[tuple[float, float, float]] = (1.0, 0.0, 2.0 / 3.0)
    PRESSED: ClassVar[type[TabulatedPress]] = PunchedDisc


def is_punched(contact: Contact) -> bool:
    """Tell whether a contact is of these tables."""
    return contact.probe.shape == PunchTable.INDENTER and contact.solution is ContactSolution.DISC_TABLE


def is_punch_tabled(ratio: float, friction: float, poisson_ratio: float) -> bool:
    """Whether `punch_table_for` has one; arguments as there."""
    return is_disc_tabled(PunchTable, ratio, friction, poisson_ratio)


def punch_table_for(ratio: float, friction: float, poisson_ratio: float) -> PunchTable:
    """The punch's table of a disc; see `disc_table_for`."""
    return disc_table_for(PunchTable, ratio, friction, poisson_ratio)


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
    """Press an upright rounded punch into a bonded disc, at finite strain.

    Args:
        probe: a punch that does not lean, and its radius R [m]. Its edge is rounded by 0.1 R.
        pose, youngs_modulus_pa, thickness_m, disc_radius_m, friction, poisson_ratio, x_m, y_m: as of
            `press_finite_strain`.

    Returns:
        The contact. Its pressure is that normal to the skin, which sums to the force over the area seen from
        above; on the punch's upright side, which is not seen from there, it is left out.
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
    table = punch_table_for(thickness_m / R, friction, poisson_ratio)
    return pressed_contact(table, probe, pose, youngs_modulus_pa, disc_radius_m, x, y)
