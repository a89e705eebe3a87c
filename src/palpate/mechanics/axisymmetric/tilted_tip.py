"""A hemispherical tip, gel under a skin, pressed along its axis on an inclined cylinder, with friction.

The tip's axis is z, up to its base. The top's normal is tilted from z towards -x, so the tip touches on its
side +x. Both bodies are linear (`axisymmetric_fem`), with gaps of the true sphere; all is even about y = 0.
Errors against finite strain are in `docs/decisions/0011-*.md`. Contact and Coulomb friction on cells,

    f_n >= 0,  g >= 0,  f_n g = 0;    |f_t| <= mu f_n,  slip against f_t where |f_t| = mu f_n, else none,

are solved by nonlinear block Gauss-Seidel.

Reference: M. Jean, The non-smooth contact dynamics method, Computer Methods in Applied Mechanics and
Engineering 177 (1999) 235, doi:10.1016/S0045-7825(98)00383-1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import no_type_check

import numba
import numpy as np

from palpate.core import Float, Int, RangeError, ndarray
from palpate.mechanics.axisymmetric.axisymmetric_fem import RevolvedBody, tensor_mesh

SWEEPS = 4000
CHANGE = 1e-6  # convergence relative to the maximum cell force


def solve_friction(
    compliance: Float[ndarray, "n 3 n 3"],
    gap: Float[ndarray, " n"],
    slip: Float[ndarray, "n 2"],
    friction: float,
    start: Float[ndarray, "n 3"],
) -> Float[ndarray, "n 3"]:
    """Return forces on the cells (normal, two tangential) that satisfy contact and friction [N].

    Args:
        compliance: Opening and sliding by forces [m/N]; symmetric.
        gap: Gap without force, negative for overlap [m].
        slip: Tangential motion since the last state without force [m].
        friction: Coulomb coefficient.
        start: Initial forces [N].
    """
    if not friction >= 0:
        raise RangeError(f"friction is {friction}; Coulomb's coefficient is 0 or more")
    n = len(gap)
    force = np.ascontiguousarray(start, np.float64).copy()
    C = np.ascontiguousarray(compliance, np.float64).reshape(3 * n, 3 * n)
    sweeps = _sweep(C, gap, slip, friction, force, SWEEPS, CHANGE)
    if sweeps >= SWEEPS:
        raise RangeError(f"contact and friction found no rest in {SWEEPS} sweeps; press by smaller steps")
    return force


@numba.njit(cache=True, nogil=True)
@no_type_check
def _sweep(C, gap, slip, friction, force, most, change):
    n = len(gap)
    f = force.reshape(3 * n)
    for sweep in range(most):
        greatest = change_now = 0.0
        for i in range(n):
            row = 3 * i
            opening = gap[i] + np.dot(C[row], f)
            normal = max(0.0, f[row] - opening / C[row, row])
            change_now, f[row] = max(change_now, abs(normal - f[row])), normal
            greatest = max(greatest, normal)
            if friction == 0.0:
                continue
            if normal == 0.0:
                f[row + 1] = f[row + 2] = 0.0
                continue
            stiff = max(C[row + 1, row + 1], C[row + 2, row + 2])
            a = f[row + 1] - (slip[i, 0] + np.dot(C[row + 1], f)) / stiff
            b = f[row + 2] - (slip[i, 1] + np.dot(C[row + 2], f)) / stiff
            size = np.hypot(a, b)
            if size > friction * normal:
                a, b = a * friction * normal / size, b * friction * normal / size
            change_now = max(change_now, abs(a - f[row + 1]), abs(b - f[row + 2]))
            f[row + 1], f[row + 2] = a, b
        if change_now <= change * greatest or greatest == 0.0:
            return sweep
    return most


FACET = np.array([1.0, 4.0, 1.0]) / 6  # weights of an even pressure on ends and middle of a facet
PATCH = np.array([[0.0, 0.0], *(0.7 * np.array([np.cos(a), np.sin(a)]) for a in np.arange(6) * np.pi / 3)])
WITHIN = np.deg2rad(56.0)  # angle from the first touch within which cells may touch

Cells = Int[ndarray, " n"]


@dataclass(frozen=True)
class TipModes:
    """Compliance of a tip under loads on the cells of its skin, mode by mode [m/N rad].

    Attributes:
        polar_rad: Ends of the rings of cells.
        azimuths: Cells in a half ring.
        skin: Mean displacement (r, around, z) of rings by forces on others.
        pins, pins_rad: Displacement of points on the skin's inside, and their polar angles.
    """

    radius_m: float
    polar_rad: Float[ndarray, " rings_1"]
    azimuths: int
    skin: Float[ndarray, "m rings 3 rings 3"]
    pins: Float[ndarray, "m places 3 rings 3"]
    pins_rad: Float[ndarray, " places"]


@dataclass(frozen=True)
class TopModes:
    """Compliance of a specimen's top ``[modes radii 3 radii 3]`` under rings of load [m/N rad]."""

    radii_m: Float[ndarray, " radii"]
    top: Float[ndarray, "m radii 3 radii 3"]


def facet_modes(
    body: RevolvedBody, facets: Int[ndarray, "rings 3"], pins: Cells, modes: int
) -> tuple[Float[ndarray, "m rings 3 rings 3"], Float[ndarray, "m places 3 rings 3"]]:
    """Return compliances of facets, and of other nodes, under even pressure on facets."""
    skin_nodes, where = np.unique(facets, return_inverse=True)
    spread = np.zeros((len(facets), len(skin_nodes)))
    np.add.at(spread, (np.arange(len(facets))[:, None], where.reshape(facets.shape)), FACET)
    read = np.concatenate([skin_nodes, pins])
    skin, inside = [], []
    for m in range(modes):
        C = body.compliance(m, skin_nodes, read)
        C = np.einsum("xanb,jn->xajb", C, spread)
        skin.append(np.einsum("in,najb->iajb", spread, C[: len(skin_nodes)]))
        inside.append(C[len(skin_nodes) :])
    return np.stack(skin), np.stack(inside)


@dataclass(frozen=True)
class TiltedPress:
    """One state of a press.

    Attributes:
        approach_m: Approach along the tip's axis [m].
        force_n: Force by cell of the half y > 0, along the specimen's normal, up its slope, and y [N].
        lift_n: Vertical force on the whole tip [N].
        area_m2: Whole contact area [m^2].
    """

    approach_m: float
    force_n: Float[ndarray, "n 3"]
    lift_n: float
    area_m2: float


@dataclass(frozen=True)
class TiltedContact:
    """A tip above an inclined specimen (None for a rigid plate), at a tilt of 0 to 50
    degrees, with friction.
    """

    tip: TipModes
    top: TopModes | None
    tilt_rad: float
    friction: float

    @cached_property
    def cells(self) -> tuple[Cells, Cells]:
        """Ring and azimuth of every cell that may touch."""
        ring, azimuth = np.meshgrid(np.arange(len(self._polar)), np.arange(self.tip.azimuths), indexing="ij")
        close = self._outward[ring.ravel(), azimuth.ravel()] @ self._touch > np.cos(WITHIN)
        return ring.ravel()[close], azimuth.ravel()[close]

    @property
    def _polar(self) -> Float[ndarray, " rings"]:
        return (self.tip.polar_rad[1:] + self.tip.polar_rad[:-1]) / 2

    @property
    def _azimuth(self) -> Float[ndarray, " azimuths"]:
        return (np.arange(self.tip.azimuths) + 0.5) * np.pi / self.tip.azimuths

    @property
    def _outward(self) -> Float[ndarray, "rings azimuths 3"]:
        """Directions from the centre to the cells; z up."""
        phi, theta = self._polar[:, None], self._azimuth
        x, y, z = np.sin(phi) * np.cos(theta), np.sin(phi) * np.sin(theta), -np.cos(phi)
        return np.stack(np.broadcast_arrays(x, y, z), axis=-1)

    @property
    def _touch(self) -> Float[ndarray, 3]:
        """Direction from the centre to the first touch."""
        return np.array([np.sin(self.tilt_rad), 0.0, -np.cos(self.tilt_rad)])

    @property
    def axes(self) -> Float[ndarray, "3 3"]:
        """The specimen's normal, up its slope, and y, in (x, y, z)."""
        c, s = np.cos(self.tilt_rad), np.sin(self.tilt_rad)
        return np.array([[-s, 0.0, c], [c, 0.0, s], [0.0, 1.0, 0.0]])

    @cached_property
    def cell_area_m2(self) -> Float[ndarray, " n"]:
        """Area of every cell, projected on the specimen's plane [m^2]."""
        ring, azimuth = self.cells
        strip = -np.diff(np.cos(self.tip.polar_rad)) * np.pi / self.tip.azimuths
        return self.tip.radius_m**2 * strip[ring] * (self._outward[ring, azimuth] @ self._touch)

    @cached_property
    def compliance(self) -> Float[ndarray, "n 3 n 3"]:
        """Opening and sliding of cells by unit forces, in the specimen's axes [m/N]."""
        both = self._tip_compliance()
        return both if self.top is None else both + self._top_compliance(self.top)

    def _tip_compliance(self) -> Float[ndarray, "n 3 n 3"]:
        ring, azimuth = self.cells
        theta = self._azimuth[azimuth]
        C = np.zeros((len(ring), 3, len(ring), 3))
        for m, skin in enumerate(self.tip.skin):
            angle = _angular(m, theta) * np.sinc(m / (2 * self.tip.azimuths))
            C += _per_pair(m) * angle[:, :, None, None] * skin[ring][:, :, ring] * angle
        turn = self._from_cylindrical(theta)
        return _rotate(C, turn)

    def _from_cylindrical(self, theta: Float[ndarray, " n"]) -> Float[ndarray, "n 3 3"]:
        """Specimen's axes by (r, around, z) at every azimuth."""
        c, s, o = np.cos(theta), np.sin(theta), np.zeros_like(theta)
        rows = [[c, s, o], [-s, c, o], [o, o, o + 1]]
        cylindrical = np.stack([np.stack(row, axis=-1) for row in rows], axis=1)
        return np.einsum("xi,nai->nxa", self.axes, cylindrical)

    def _top_compliance(self, top: TopModes) -> Float[ndarray, "n 3 n 3"]:
        """The specimen's part, with each cell spread over a patch of its size."""
        at = self.places_on_top_m[:, None] + np.sqrt(self.cell_area_m2 / np.pi)[:, None, None] * PATCH
        rho, psi = np.hypot(at[..., 0], at[..., 1]), np.arctan2(at[..., 1], at[..., 0])
        hat = _hats(top.radii_m, rho) / len(PATCH)
        # specimen axes: up the slope, y, normal; loads are those on the tip, reversed
        c, s, o = np.cos(psi), np.sin(psi), np.zeros_like(psi)
        turn = np.stack(
            [np.stack([o, o, o + 1], -1), np.stack([c, -s, o], -1), np.stack([s, c, o], -1)], axis=-2
        )
        n = len(at)
        C = np.zeros((n, 3, n, 3))
        for m, ring_compliance in enumerate(top.top):
            spread = np.einsum("npk,npxa,npa->nxka", hat, turn, _angular(m, psi))
            rows = spread.reshape(3 * n, -1)
            k = len(top.radii_m)
            C += _per_pair(m) * (rows @ ring_compliance.reshape(3 * k, 3 * k) @ rows.T).reshape(C.shape)
        return C

    @cached_property
    def places_on_top_m(self) -> Float[ndarray, "n 2"]:
        """Positions of the cells above the specimen, up the slope and y [m]."""
        ring, azimuth = self.cells
        return self.tip.radius_m * self._outward[ring, azimuth] @ self.axes[1:].T

    @cached_property
    def clearance_m(self) -> Float[ndarray, " n"]:
        """Gap of every cell at first touch [m]."""
        ring, azimuth = self.cells
        return self.tip.radius_m * (1.0 - self._outward[ring, azimuth] @ self._touch)

    def through(self, approaches_m: Float[ndarray, " k"]) -> list[TiltedPress]:
        """States at ascending approaches, each from the last, since friction is history-dependent [m]."""
        n = len(self.clearance_m)
        C = self.compliance
        force, rest = np.zeros((n, 3)), np.zeros((n, 2))
        down = self.axes @ np.array([0.0, 0.0, -1.0])
        states = []
        for approach in approaches_m:
            base = approach * down
            gap = self.clearance_m + base[0]
            force = solve_friction(C, gap, base[1:] - rest, self.friction, force)
            rest = base[1:] + np.einsum("iajb,jb->ia", C, force)[:, 1:]
            lift = 2.0 * float((force @ self.axes[:, 2]).sum())
            area = 2.0 * float(self.cell_area_m2[force[:, 0] > 0].sum())
            states.append(TiltedPress(float(approach), force, lift, area))
        return states

    def pins_moved_m(self, press: TiltedPress) -> Float[ndarray, "places azimuths 3"]:
        """Displacement (r, around, z) of the skin's inside at the cells' azimuths [m]."""
        ring, azimuth = self.cells
        theta = self._azimuth[azimuth]
        turn = self._from_cylindrical(theta)
        force = np.einsum("nxa,nx->na", turn, press.force_n)
        rings = len(self._polar)
        motion = np.zeros((len(self.tip.pins_rad), self.tip.azimuths, 3))
        for m, pins in enumerate(self.tip.pins):
            load = force * _angular(m, theta) * np.sinc(m / (2 * self.tip.azimuths)) * _per_pair(m)
            by_ring = np.stack([np.bincount(ring, load[:, a], rings) for a in range(3)], axis=1)
            motion += np.einsum("iajb,jb->ia", pins, by_ring)[:, None] * _angular(m, self._azimuth)
        return motion


def _angular(mode: int, theta: ndarray) -> ndarray:
    """Angular factors: cos m t along r and z, sin m t around."""
    c, s = np.cos(mode * theta), np.sin(mode * theta)
    return np.stack([c, s, c], axis=-1)


def _per_pair(mode: int) -> float:
    """Amplitude per radian of two unit forces at t and -t."""
    return (1.0 if mode == 0 else 2.0) / np.pi


def _rotate(C: Float[ndarray, "n 3 n 3"], turn: Float[ndarray, "n 3 3"]) -> Float[ndarray, "n 3 n 3"]:
    half = np.einsum("nxa,namb->nxmb", turn, C)
    return np.einsum("myb,nxmb->nxmy", turn, half)


def _hats(knots: Float[ndarray, " k"], at: Float[ndarray, "n p"]) -> Float[ndarray, "n p k"]:
    """Weights of linear interpolation, constant beyond the last knot."""
    j = np.clip(np.searchsorted(knots, at) - 1, 0, len(knots) - 2)
    t = np.clip((at - knots[j]) / (knots[j + 1] - knots[j]), 0.0, 1.0)
    weights = np.zeros((*at.shape, len(knots)))
    np.put_along_axis(weights, j[..., None], (1 - t)[..., None], axis=-1)
    np.put_along_axis(weights, j[..., None] + 1, t[..., None], axis=-1)
    return weights


CORE = 0.05  # radius of the fixed core over the tip's
FINE_TO = np.deg2rad(84.0)  # polar angle of even cells
TOP_FINE_TO = 0.85  # extent of even cells over a cylinder's radius


def tip_modes(
    radius_m: float,
    skin_m: float,
    skin_pa: float,
    gel_pa: float,
    poisson_ratio: float,
    *,
    rings: int = 42,
    azimuths: int = 24,
    modes: int = 32,
) -> TipModes:
    """Return the compliance of a hemisphere with fixed equator and core.

    Args:
        radius_m, skin_m: Radius, and thickness of the skin [m].
        skin_pa, gel_pa: Young's moduli [Pa].
        poisson_ratio: Of both.
        rings, azimuths: Cells from the axis to 84 degrees, and around half of it.
        modes: Number of Fourier modes.
    """
    if not (0 < skin_m < 0.5 * radius_m and skin_pa > 0 and gel_pa > 0 and 0 < poisson_ratio < 0.5):
        raise RangeError(
            f"a tip of radius {1e3 * radius_m:g} mm with a skin of {1e3 * skin_m:g} mm, {skin_pa:g} Pa, gel "
            f"{gel_pa:g} Pa, Poisson's ratio {poisson_ratio:g}; the skin is thinner than half the radius, "
            "moduli are positive, the ratio is between 0 and 1/2"
        )
    body, facets, inside = _hemisphere(radius_m, skin_m, skin_pa, gel_pa, poisson_ratio, rings)
    skin, pins = facet_modes(body, facets, inside, modes)
    r, z = body.places_m[inside].T
    return TipModes(
        radius_m, np.linspace(0.0, FINE_TO, rings + 1), azimuths, skin, pins, np.arctan2(r, radius_m - z)
    )


def _hemisphere(
    radius: float, skin: float, skin_pa: float, gel_pa: float, nu: float, rings: int
) -> tuple[RevolvedBody, Int[ndarray, "rings 3"], Int[ndarray, " places"]]:
    """The body, the facets of its outside up to `FINE_TO`, and the nodes of the skin's inside."""
    inner = radius - skin
    coarse = np.linspace(FINE_TO, np.pi / 2, max(3, rings // 8))[1:]
    phi = np.concatenate([np.linspace(0.0, FINE_TO, rings + 1), coarse])
    depth = np.cumsum(1.3 ** np.arange(max(5, rings // 4)))
    gel = inner - depth[::-1] / depth[-1] * (inner - CORE * radius)
    rho = np.concatenate([gel, [inner, (inner + radius) / 2, radius]])

    def place(x: Float[ndarray, "2 k"]) -> Float[ndarray, "2 k"]:
        return np.stack([x[1] * np.sin(x[0]), radius - x[1] * np.cos(x[0])])

    mesh = tensor_mesh(phi, rho, place)
    r, z = mesh.doflocs
    angle, distance = np.arctan2(r, radius - z), np.hypot(r, z - radius)
    middle = mesh.doflocs[:, mesh.t].mean(axis=1)
    outer = np.hypot(middle[0], middle[1] - radius) > inner
    fixed = np.flatnonzero(np.isclose(angle, np.pi / 2) | np.isclose(distance, CORE * radius))
    outside, inside = (_along(angle, np.isclose(distance, at)) for at in (radius, inner))
    facets = np.stack([outside[:-2:2], outside[1:-1:2], outside[2::2]], axis=1)[:rings]
    body = RevolvedBody(mesh, np.where(outer, skin_pa, gel_pa), nu, fixed)
    return body, facets, inside


def top_modes(
    radius_m: float,
    height_m: float,
    youngs_pa: float,
    poisson_ratio: float,
    *,
    rings: int = 30,
    modes: int = 32,
) -> TopModes:
    """Return the compliance of a cylinder's top with bonded base; `rings` are cells along the radius."""
    if not (min(radius_m, height_m, youngs_pa) > 0 and 0 < poisson_ratio < 0.5):
        raise RangeError(
            f"a cylinder of {1e3 * radius_m:g} mm radius and {1e3 * height_m:g} mm height, {youngs_pa:g} Pa, "
            f"Poisson's ratio {poisson_ratio:g}; all are positive, the ratio below 1/2"
        )
    fine = TOP_FINE_TO * radius_m
    r = np.concatenate([np.linspace(0.0, fine, rings + 1), np.linspace(fine, radius_m, 5)[1:]])
    down = np.cumsum(1.35 ** np.arange(max(8, rings // 3)))
    z = np.concatenate([-down[::-1] / down[-1] * height_m, [0.0]])
    mesh = tensor_mesh(r, z)
    at_r, at_z = mesh.doflocs
    fixed = np.flatnonzero(np.isclose(at_z, -height_m))
    top = _along(at_r, np.isclose(at_z, 0.0, atol=1e-9))
    body = RevolvedBody(mesh, np.full(mesh.t.shape[1], youngs_pa), poisson_ratio, fixed)
    rings_by_mode = np.stack([body.compliance(m, top, top) for m in range(modes)])
    return TopModes(at_r[top], rings_by_mode)


def _along(order: Float[ndarray, " n"], which: ndarray) -> Int[ndarray, " k"]:
    """Nodes of a row, in order."""
    nodes = np.flatnonzero(which)
    return nodes[np.argsort(order[nodes])]
