"""A rigid probe without an axis pressed deep into a bonded layer: tables at finite strain.

Lying cylinders, edges and two balls have two planes of symmetry; a table holds a quarter of a square of the
layer. Lengths in its thickness h and stresses in Young's moduli E make one table serve any membrane of the
same proportions. The material is that of `axisymmetric.disc_table`, the base is bonded, the sides and the top
around the contact are free, and the probe has no friction. Edges of the probe's body are rounded, by
`rounding`. Solved by `tools/probe_tables.py`; `tools/probe_study.json` holds what its mesh costs.

Below the first depth that was solved every press is like that, only smaller: force and area by powers of the
depth that the first two depths show, stress and pressure as the force.

In the probe's own frame x points along its length, y across, z into the layer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator

from palpate.core import Contact, Field, Float, Int, Pose, Probe, RangeError, ndarray

FOLDER = resources.files("palpate.mechanics") / "tables"
FROM_PROBE_TABLE = "finite-strain table in three dimensions"
"""With which the model of a contact of these tables begins."""
SAME = 1e-6  # relative: two lengths that differ by rounding only
STRESSES = ("xx", "yy", "zz", "yz", "xz", "xy")  # Voigt's order
FADES = (0.75, 0.95)
"""Shares of the square's half side from where to where what is far from the probe fades out: it is that of a
square's rim, and would stand where there is no rim under a press elsewhere."""
ODD_ALONG = np.array([0, 0, 0, 0, 1, 1])
"""Whether each stress changes sign with x; and with y: `ODD_ACROSS`."""
ODD_ACROSS = np.array([0, 0, 0, 1, 0, 1])

Knots = Float[ndarray, " n"]
Plane = Float[ndarray, "ny nx"]


@dataclass(frozen=True)
class PressedLayer:
    """The layer at one depth of a probe; lengths in h, stresses in E.

    Attributes:
        depth, force, area, peak_pressure: of the press; the area is that of the contact seen from above.
        x, y, zeta: knots of the quarter; zeta is 0 at the deformed top and 1 at the base.
        surface: z of the deformed top ``[ny nx]``, positive where pressed in.
        pressure: normal pressure on the top ``[ny nx]``, which sums to the force over the area from above.
        stress: Cauchy stress in the order of `STRESSES` ``[6 m ny nx]``.
    """

    depth: float
    force: float
    area: float
    peak_pressure: float
    x: Float[ndarray, " nx"]
    y: Float[ndarray, " ny"]
    zeta: Float[ndarray, " m"]
    surface: Plane
    pressure: Plane
    stress: Float[ndarray, "6 m ny nx"]

    def share_at(self, x: ndarray, y: ndarray) -> ndarray:
        """How much of the table is left where it fades out: 1 about the probe, 0 at the sides."""
        start, end = FADES
        out = np.clip((np.hypot(x, y) / self.x[-1] - start) / (end - start), 0, 1)
        return np.asarray(1 - out**2 * (3 - 2 * out))

    def on_top(self, values: Plane, x: ndarray, y: ndarray) -> ndarray:
        """Values of the top at places of the whole layer, 0 beyond its sides."""
        read = RegularGridInterpolator((self.y, self.x), values, bounds_error=False, fill_value=0.0)
        return np.asarray(read(np.stack([np.abs(y), np.abs(x)], axis=-1)))


@dataclass(frozen=True)
class ProbeTable:
    """A probe pressed step by step; lengths in h, stresses in E, forces in E h^2.

    Attributes:
        shape: of the probe: "cylinder", "edge" or "two-points".
        radius, length: of the probe, as of `core.Probe`.
        rounding: radius of its rounded edges; 0 of balls.
        poisson_ratio, half_side: of the layer.
        depth: ascending, from the first that was solved, above 0.
        force, area, peak_pressure: at each depth.
        x, y, zeta: as of `PressedLayer`.
        surface_amount, surface_mode: surface and pressure are their product ``[d k]``, ``[k 2 ny nx]``.
        stress_amount, stress_mode: of the stress, likewise ``[d l]``, ``[l 6 m ny nx]``.
    """

    shape: str
    radius: float
    length: float
    rounding: float
    poisson_ratio: float
    half_side: float
    depth: Float[ndarray, " d"]
    force: Float[ndarray, " d"]
    area: Float[ndarray, " d"]
    peak_pressure: Float[ndarray, " d"]
    x: Float[ndarray, " nx"]
    y: Float[ndarray, " ny"]
    zeta: Float[ndarray, " m"]
    surface_amount: Float[ndarray, "d k"]
    surface_mode: Int[ndarray, "k 2 ny nx"]
    stress_amount: Float[ndarray, "d l"]
    stress_mode: Int[ndarray, "l 6 m ny nx"]

    @classmethod
    def open(cls, path: Path) -> ProbeTable:
        """A table from an .npz file written by `tools/probe_tables.py`."""
        with np.load(path, allow_pickle=False) as file:
            values: dict[str, Any] = {key: file[key] if file[key].ndim else file[key].item() for key in file}
        return cls(**values)

    @property
    def greatest_depth(self) -> float:
        """The deepest press of the table [h]."""
        return float(self.depth[-1])

    def fits(self, probe: Probe, thickness_m: float) -> bool:
        """Tell whether a probe, upright, is the table's in a layer of a thickness."""
        own = (self.radius * thickness_m, self.length * thickness_m)
        return probe.tilt_rad == 0.0 and probe.shape == self.shape and all(
            math.isclose(a, b, rel_tol=SAME, abs_tol=SAME * thickness_m)
            for a, b in zip(own, (probe.radius_m, probe.length_m), strict=True)
        )  # fmt: skip

    def at(self, depth: float) -> PressedLayer:
        """The layer at one depth [h].

        Raises:
            RangeError: the depth lies outside the table.
        """
        if not 0.0 <= depth <= self.greatest_depth * (1 + SAME):
            raise RangeError(
                f"depth {depth:g} h lies outside 0 to {self.greatest_depth:g} h, where the table of a "
                f"{self.shape} was solved; press less"
            )
        depth = min(depth, self.greatest_depth)
        force, area = (float(part[0]) for part in self._scalars(np.array([depth])))
        solved = max(depth, float(self.depth[0]))
        lighter = force / float(self.force_at(np.array([solved]))[0])
        top = np.tensordot(self._amounts[0](solved), self.surface_mode, axes=1)
        stress = np.tensordot(self._amounts[1](solved), self.stress_mode, axes=1) * lighter
        peak = float(PchipInterpolator(self.depth, self.peak_pressure)(solved)) * lighter
        pressure = np.maximum(top[1], 0.0)
        summed = 4.0 * np.trapezoid(np.trapezoid(pressure, self.x, axis=1), self.y)
        knots, pressure = (self.x, self.y, self.zeta), pressure * (force / summed)
        return PressedLayer(depth, force, area, peak, *knots, top[0] * (depth / solved), pressure, stress)

    def force_at(self, depth: Knots) -> Knots:
        """Forces at many depths [h], as `at` gives them one by one [E h^2]."""
        return self._scalars(depth)[0]

    def area_at(self, depth: Knots) -> Knots:
        """Areas of the contact likewise [h^2]."""
        return self._scalars(depth)[1]

    def _scalars(self, depth: Knots) -> tuple[Knots, Knots]:
        first, second = self.depth[:2]
        ratio = np.minimum(np.asarray(depth) / first, 1.0)
        force, area = (
            PchipInterpolator(self.depth, part)(np.maximum(depth, first))
            * ratio ** (np.log(part[1] / part[0]) / np.log(second / first))
            for part in (self.force, self.area)
        )
        return np.asarray(force), np.asarray(area)

    @cached_property
    def _amounts(self) -> tuple[PchipInterpolator, PchipInterpolator]:
        top, inside = (
            PchipInterpolator(self.depth, part) for part in (self.surface_amount, self.stress_amount)
        )
        return top, inside


@lru_cache(maxsize=1)
def probe_tables() -> tuple[ProbeTable, ...]:
    """All that come with palpate."""
    files = sorted(p.name for p in FOLDER.iterdir() if p.name.startswith("probe-"))
    return tuple(ProbeTable.open(Path(str(FOLDER / name))) for name in files)


def probe_table_for(
    probe: Probe, thickness_m: float, radius_m: float, friction: float, poisson_ratio: float
) -> ProbeTable | None:
    """The table of a probe on a membrane; None if there is none.

    Args:
        probe: what presses.
        thickness_m, radius_m: of the membrane, which is no narrower than the table's square [m].
        friction: Coulomb's coefficient between probe and skin; tables are without.
        poisson_ratio: of the membrane.
    """
    if friction != 0.0:
        return None
    for table in probe_tables():
        wide = radius_m >= table.half_side * thickness_m * (1 - SAME)
        if wide and abs(table.poisson_ratio - poisson_ratio) < SAME and table.fits(probe, thickness_m):
            return table
    return None


def is_tabled_probe(contact: Contact) -> bool:
    """Tell whether a contact is of these tables."""
    return contact.model.startswith(FROM_PROBE_TABLE)


def own_frame(probe: Probe, pose: Pose, x_m: ndarray, y_m: ndarray) -> tuple[ndarray, ndarray]:
    """Places along and across a probe that is turned about its middle [m]."""
    c, s = math.cos(probe.turn_rad), math.sin(probe.turn_rad)
    x, y = x_m - pose.x_m, y_m - pose.y_m
    return c * x + s * y, c * y - s * x


def press_probe(
    table: ProbeTable,
    probe: Probe,
    pose: Pose,
    youngs_modulus_pa: float,
    thickness_m: float,
    radius_m: float,
    x_m: Float[ndarray, " nx"],
    y_m: Float[ndarray, " ny"],
) -> Contact:
    """Press a probe into a bonded layer by its table, at finite strain.

    Args:
        table: for which `probe_table_for` gave the probe.
        probe: turned anyhow about z.
        pose: where, and how deep, from 0 to the table's depth.
        youngs_modulus_pa: of the layer [Pa].
        thickness_m, radius_m: of the layer [m].
        x_m, y_m: columns and rows of the contact's grid [m].

    Returns:
        The contact. Its pressure is that normal to the skin and sums to the force over the area seen from
        above. Its radius is that of a disc of the contact's area.

    Raises:
        RangeError: the depth lies outside the table, or the contact reaches over the rim.
    """
    h, E = thickness_m, youngs_modulus_pa
    if not 0.0 <= pose.depth_m <= table.greatest_depth * h * (1 + SAME):
        raise RangeError(
            f"depth {pose.depth_m * 1e3:.7g} mm of a {probe.shape} lies outside 0 to "
            f"{table.greatest_depth * h * 1e3:g} mm, where its table was solved; press less"
        )
    at = table.at(min(pose.depth_m / h, table.greatest_depth))
    along, across = own_frame(probe, pose, x_m[None, :], y_m[:, None])
    along, across = along / h, across / h
    pressure: Field = at.on_top(at.pressure, along, across) * E
    touching = pressure > TOUCHES * at.peak_pressure * E
    _check_within(touching, x_m, y_m, radius_m)
    return Contact(
        x_m=x_m,
        y_m=y_m,
        pressure_pa=pressure,
        displacement_m=at.on_top(at.surface, along, across) * at.share_at(along, across) * h,
        touching=touching,
        force_n=at.force * E * h**2,
        radius_m=math.sqrt(at.area / math.pi) * h,
        probe=probe,
        pose=pose,
        model=f"{FROM_PROBE_TABLE}: rigid {probe.shape}, edges rounded by {table.rounding * h * 1e3:g} mm, "
        f"bonded neo-Hookean layer, nu {table.poisson_ratio:g}, no friction, "
        f"depth <= {table.greatest_depth * h * 1e3:g} mm",
    )


TOUCHES = (
    0.02  # of the greatest pressure, below which the table's straight lines between knots are no contact
)


def _check_within(touching: ndarray, x_m: ndarray, y_m: ndarray, radius_m: float) -> None:
    rows, columns = np.nonzero(touching)
    furthest = float(np.hypot(x_m[columns], y_m[rows]).max(initial=0.0))
    if furthest > radius_m:
        raise RangeError(
            f"the contact reaches {furthest * 1e3:.1f} mm from the membrane's axis, over its rim at "
            f"{radius_m * 1e3:g} mm; press nearer to the middle"
        )
