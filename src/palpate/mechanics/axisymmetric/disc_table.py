"""Tables of a bonded elastomer disc under a rigid axisymmetric indenter, solved at finite strain.

The disc is neo-Hookean, W = mu/2 (tr C - 3) - mu ln J + lambda/2 (J - 1)^2, with nu = 0.49, bonded base, and
free side and top. Lengths are in indenter radii R, stresses in Young's moduli E. Other thicknesses are
interpolated by a parabola through three tables over 1 / thickness. See `SphereTable` and `PunchTable`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
from scipy.interpolate import PchipInterpolator

from palpate.core import (
    Contact,
    ContactSolution,
    Float,
    Float32,
    InputError,
    Pose,
    Probe,
    RangeError,
    ndarray,
)
from palpate.core.array_files import MAX_ARRAY_BYTES
from palpate.core.parsing import parser

SAME = 1e-6  # relative tolerance for rounding
MAX_APART = 1.15  # maximum ratio of solved thicknesses for interpolation
NEAREST = 3  # tables in the interpolation over thickness

Knots = Float[ndarray, " n"]
Fields = tuple[Knots, Float[ndarray, "4 m n"]]
AnyTable = TypeVar("AnyTable", bound="DiscTable")


@dataclass(frozen=True)
class TabulatedPress:
    """The disc at one depth, in the units of `DiscTable`."""

    depth: float
    force: float
    contact_radius: float
    peak_pressure: float
    r: Knots
    zeta: Float[ndarray, " m"]
    surface: Knots
    stress: Float[ndarray, "4 m n"]
    thickness: float
    disc_radius: float

    @cached_property
    def top_load(self) -> Knots:
        """Vertical load per area seen from above [E], which sums to the force; without
        friction the pressure.
        """
        slope = np.gradient(self.surface, self.r)
        return np.asarray(slope * self.stress[3, 0] - self.stress[2, 0]) * (self.r < self.contact_radius)

    @cached_property
    def top_friction(self) -> Knots:
        """Friction of the sphere along the surface, outwards positive [E]."""
        slope = np.gradient(self.surface, self.r)
        rr, _, zz, rz = self.stress[:, 0]
        along = (slope * (rr - zz) + (slope**2 - 1.0) * rz) / (1.0 + slope**2)
        return np.asarray(along) * (self.r < self.contact_radius)


@dataclass(frozen=True)
class DiscTable:
    """A disc pressed step by step; lengths in R, stresses in E, forces in E R^2, z into the layer.

    Attributes:
        depth: Ascending from 0.
        peak_pressure: Maximum -n.s.n of the top.
        r: Spatial radius, from 0 to disc_radius.
        zeta: 0 at the deformed top, 1 at the base.
        surface: z of the deformed top at r, positive where pressed in.
        stress: Cauchy stress rr, tt, zz, rz at (r, zeta), with z = surface + zeta (thickness - surface).
    """

    INDENTER: ClassVar[str] = ""
    POWERS: ClassVar[tuple[float, float, float]] = (1.0, 0.0, 0.0)
    """Exponents of depth of force, contact radius, and maximum pressure at first touch."""
    PRESSED: ClassVar[type[TabulatedPress]] = TabulatedPress

    thickness: float
    disc_radius: float
    poisson_ratio: float
    friction: float
    depth: Float[ndarray, " d"]
    force: Float[ndarray, " d"]
    contact_radius: Float[ndarray, " d"]
    peak_pressure: Float[ndarray, " d"]
    r: Float[ndarray, " n"]
    zeta: Float[ndarray, " m"]
    surface: Float32[ndarray, "d n"]
    stress: Float32[ndarray, "d 4 m n"]

    @classmethod
    def of_disc(cls: type[AnyTable], ratio: float, friction: float, poisson_ratio: float) -> AnyTable:
        """The shipped table of a disc (thickness over indenter radius `ratio`), or one interpolated from the
        nearest.
        """
        near = _solved_near(cls, ratio, friction, poisson_ratio)  # type: ignore[arg-type]
        if len(near) == 1:
            return near[0]
        if near:
            solved = tuple(t.thickness for t in near)
            return _between(cls, solved, ratio, friction, poisson_ratio)  # type: ignore[arg-type]
        choices = "; ".join(
            f"{t.thickness:g} R with friction {t.friction:g}, Poisson's ratio {t.poisson_ratio:g}"
            for t in map(cls.load, cls.shipped())
        )
        raise RangeError(
            f"no table is solved for a disc {ratio:g} R thick with friction {friction:g} and Poisson's ratio "
            f"{poisson_ratio:g}; choose a {cls.INDENTER} radius R and a friction among: {choices}"
            f"; or a thickness between two that are within {100 * (MAX_APART - 1):.0f} % of each other",
            code="no-table",
        )

    @classmethod
    def holds(
        cls, ratio: float, friction: float, poisson_ratio: float, disc_radius: float = math.inf
    ) -> bool:
        """Whether `of_disc` has a table, of a disc that is no wider than `disc_radius` [R]."""
        near = _solved_near(cls, ratio, friction, poisson_ratio)  # type: ignore[arg-type]
        return bool(near) and near[0].disc_radius <= disc_radius * (1 + SAME)

    @property
    def greatest_depth(self) -> float:
        """Maximum depth [R]."""
        return float(self.depth[-1])

    @classmethod
    def shipped(cls) -> tuple[str, ...]:
        """Names of the shipped tables, as "sphere-h2-mu0": thickness 2 R, friction 0."""
        names = (p.name for p in resources.files("palpate.mechanics").joinpath("tables").iterdir())
        own = (name for name in names if name.startswith(f"{cls.INDENTER}-") and name.endswith(".npz"))
        return tuple(sorted(name.removesuffix(".npz") for name in own))

    @classmethod
    def load(cls: type[AnyTable], name: str) -> AnyTable:
        """Load a shipped table (cached)."""
        return _loaded(cls, name)  # type: ignore[arg-type]  # mypy takes no class for hashable

    @classmethod
    @parser("disc table", InputError, max_bytes=MAX_ARRAY_BYTES)
    def open(cls: type[AnyTable], path: Path) -> AnyTable:
        """Load an .npz file written by `tools/disc_tables.py`."""
        with np.load(path, allow_pickle=False) as file:
            values: dict[str, Any] = {key: file[key] if file[key].ndim else float(file[key]) for key in file}
        return cls(**values)

    def at(self, depth: float) -> TabulatedPress:
        """The disc at one depth [R]."""
        if not 0.0 <= depth <= self.greatest_depth * (1.0 + SAME):
            raise RangeError(
                f"depth {depth:g} R lies outside 0 to {self.greatest_depth:g} R, where the table was solved; "
                f"press less deeply or use a larger {self.INDENTER}",
                code="outside-table",
            )
        depth = min(depth, self.greatest_depth)
        force, radius, pressure = (
            float(depth**power * ratio(depth)) if depth > 0.0 else 0.0
            for power, ratio in zip(self.POWERS, self._ratios, strict=True)
        )
        fields = (self.r, self.zeta, *self._fields(depth, force, radius, pressure))
        return self.PRESSED(float(depth), force, radius, pressure, *fields, self.thickness, self.disc_radius)

    def contact_radius_at(self, depth: float) -> float:
        """Contact radius at a depth [R]."""
        return float(depth ** self.POWERS[1] * self._ratios[1](depth))

    def force_at(self, depth: Knots) -> Knots:
        """Forces at many depths [R] [E R^2]."""
        if not np.all((depth >= 0.0) & (depth <= self.greatest_depth * (1.0 + SAME))):
            raise RangeError(
                f"depths of {np.min(depth):g} to {np.max(depth):g} R; the table was solved from 0 to "
                f"{self.greatest_depth:g} R"
            )
        depth = np.minimum(depth, self.greatest_depth)
        return np.asarray(depth ** self.POWERS[0] * self._ratios[0](depth))

    @cached_property
    def _ratios(self) -> tuple[PchipInterpolator, PchipInterpolator, PchipInterpolator]:
        """Force, contact radius, and pressure over their powers of depth, from `_first` at first touch."""
        d = self.depth[1:]
        rest = (self.force[1:], self.contact_radius[1:], self.peak_pressure[1:])
        force, radius, pressure = (
            PchipInterpolator(self.depth, np.concatenate([[start], values / d**power]))
            for start, values, power in zip(self._first(), rest, self.POWERS, strict=True)
        )
        return force, radius, pressure

    def _first(self) -> tuple[float, float, float]:
        """These ratios at first touch: those at the first solved depth."""
        first = (self.force[1], self.contact_radius[1], self.peak_pressure[1])
        force, radius, pressure = (
            float(value / self.depth[1] ** power) for value, power in zip(first, self.POWERS, strict=True)
        )
        return force, radius, pressure

    def _fields(self, depth: float, F: float, a: float, p: float) -> Fields:
        if depth == 0.0:
            return np.zeros_like(self.r), np.zeros(self.stress.shape[1:])
        k = int(np.clip(np.searchsorted(self.depth, depth), 1, len(self.depth) - 1))
        if k == 1:  # below the first depth every press is like it, only smaller
            return self._brought(1, depth, F, a, p)
        edges = self.contact_radius[k - 1 : k + 1]
        if edges[1] - edges[0] > np.interp(edges[1], self.r[1:], np.diff(self.r)):
            low, high = (self._brought(i, depth, F, a, p) for i in (k - 1, k))
        else:
            low, high = ((self.surface[i].astype(float), self.stress[i].astype(float)) for i in (k - 1, k))
        share = (depth - self.depth[k - 1]) / (self.depth[k] - self.depth[k - 1])
        return (1.0 - share) * low[0] + share * high[0], (1.0 - share) * low[1] + share * high[1]

    def _brought(self, k: int, depth: float, F: float, a: float, p: float) -> Fields:
        """Depth k's fields scaled to another depth: surface with depth, stress with force."""
        return (
            self.surface[k].astype(float) * (depth / self.depth[k]),
            self.stress[k].astype(float) * (F / self.force[k]),
        )


@lru_cache
def _loaded(kind: type[AnyTable], name: str) -> AnyTable:
    if name not in kind.shipped():
        raise InputError(f"no press table {name!r} is shipped; give one of {', '.join(kind.shipped())}")
    with resources.as_file(resources.files("palpate.mechanics") / "tables" / f"{name}.npz") as path:
        return kind.open(path)


@lru_cache(maxsize=256)
def _solved_near(kind: type[AnyTable], ratio: float, friction: float, poisson_ratio: float) -> list[AnyTable]:
    """The table of a disc, the three that it is interpolated from, or none."""
    tables = [kind.load(name) for name in kind.shipped()]
    asked = friction, poisson_ratio
    alike = [t for t in tables if np.allclose((t.friction, t.poisson_ratio), asked, rtol=SAME, atol=SAME)]
    near = sorted(alike, key=lambda t: abs(1 / t.thickness - 1 / ratio))[:NEAREST]
    if near and math.isclose(near[0].thickness, ratio, rel_tol=SAME):
        return near[:1]
    below = max((t.thickness for t in alike if t.thickness < ratio), default=0.0)
    above = min((t.thickness for t in alike if t.thickness > ratio), default=math.inf)
    return near if len(near) == NEAREST and above <= MAX_APART * below else []


@lru_cache(maxsize=6)
def _stress_at_shares_of(
    kind: type[DiscTable], own: float, other: float, friction: float, poisson_ratio: float
) -> Float[ndarray, "d 4 m n"]:
    """Stress of one solved thickness at another's relative depths."""
    table, at = (kind.of_disc(h, friction, poisson_ratio) for h in (own, other))
    return np.asarray(PchipInterpolator(table.zeta, table.stress.astype(float), axis=2)(at.zeta))


@lru_cache(maxsize=16)
def _between(
    kind: type[AnyTable],
    thicknesses: tuple[float, ...],
    ratio: float,
    friction: float,
    poisson_ratio: float,
) -> AnyTable:
    """Table of an unsolved thickness, by Lagrange interpolation over 1 / thickness."""
    tables = [kind.of_disc(h, friction, poisson_ratio) for h in thicknesses]
    inverse = 1 / np.array(thicknesses)
    weights = [
        float(np.prod([(1 / ratio - other) / (own - other) for other in inverse if other != own]))
        for own in inverse
    ]
    first = tables[0]
    depths = min((t.depth for t in tables), key=len)
    n = len(depths)

    def mixed(part: str) -> ndarray:
        return np.asarray(sum(w * getattr(t, part)[:n] for w, t in zip(weights, tables, strict=True)))

    asked = first.thickness, friction, poisson_ratio
    stress = np.zeros_like(first.stress[:n], dtype=float)
    for weight, h in zip(weights, thicknesses, strict=True):
        stress += weight * _stress_at_shares_of(kind, h, *asked)[:n]  # type: ignore[arg-type]
    return replace(
        first,
        thickness=ratio,
        depth=depths,
        force=mixed("force"),
        contact_radius=mixed("contact_radius"),
        peak_pressure=mixed("peak_pressure"),
        surface=mixed("surface").astype(np.float32),
        stress=np.asarray(stress, np.float32),
    )


def pressed_contact(
    table: DiscTable,
    probe: Probe,
    pose: Pose,
    youngs_modulus_pa: float,
    disc_radius_m: float,
    x_m: Float[ndarray, " nx"],
    y_m: Float[ndarray, " ny"],
) -> Contact:
    """Return the contact of a table's press at a pose; arguments as of `press_finite_strain`."""
    R, E = probe.radius_m, youngs_modulus_pa
    check_fits(table, pose, R, disc_radius_m)
    at = table.at(min(pose.depth_m / R, table.greatest_depth))
    east, north = (x_m[None, :] - pose.x_m) / R, (y_m[:, None] - pose.y_m) / R
    r = np.hypot(east, north)
    inwards = np.interp(r, at.r, at.top_friction) * E / np.maximum(r, SAME)
    return Contact(
        x_m=x_m,
        y_m=y_m,
        pressure_pa=np.interp(r, at.r, at.top_load) * E,
        displacement_m=np.interp(r, at.r, at.surface) * R,
        touching=r < at.contact_radius,
        force_n=at.force * E * R**2,
        radius_m=at.contact_radius * R,
        probe=probe,
        pose=pose,
        solution=ContactSolution.DISC_TABLE,
        model=f"finite-strain table: rigid {table.INDENTER}, bonded neo-Hookean disc {table.thickness:g} R "
        f"thick, nu {table.poisson_ratio:g}, friction {table.friction:g}, "
        f"depth <= {table.greatest_depth:g} R",
        shear_pa=np.stack([inwards * east, inwards * north]) if table.friction > 0.0 else None,
    )


def check_fits(table: DiscTable, pose: Pose, R: float, disc_radius_m: float) -> None:
    """Reject presses that are deeper or wider than the table, or reach over the rim."""
    if not 0.0 <= pose.depth_m <= table.greatest_depth * R * (1.0 + SAME):
        raise RangeError(
            f"depth {pose.depth_m * 1e3:g} mm of a {table.INDENTER} of radius {R * 1e3:g} mm lies outside "
            f"0 to {table.greatest_depth * R * 1e3:g} mm, where its table was solved; press less deeply or "
            f"use a larger {table.INDENTER}",
            code="outside-table",
        )
    if disc_radius_m < table.disc_radius * R * (1.0 - SAME):
        raise RangeError(
            f"a disc of radius {disc_radius_m * 1e3:g} mm is smaller than the table's, "
            f"{table.disc_radius * R * 1e3:g} mm ({table.disc_radius:g} R); press a wider disc",
            code="disc-too-small",
        )
    centre = math.hypot(pose.x_m, pose.y_m)
    reach = table.contact_radius_at(min(pose.depth_m / R, table.greatest_depth)) * R
    if centre + reach > disc_radius_m:
        raise RangeError(
            f"a contact of radius {reach * 1e3:.3g} mm, {centre * 1e3:.4g} mm from the centre, reaches over "
            f"the rim at {disc_radius_m * 1e3:g} mm; press within {(disc_radius_m - reach) * 1e3:.4g} mm of "
            "the centre",
            code="contact-over-rim",
        )
