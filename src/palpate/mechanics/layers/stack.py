"""Stack of bonded elastic layers, and the transfer of a wave of surface load through it.

For a wave exp(i k x) let u_k = i U and u_z = W be the motion, and q_k = i k F, q_z = k G the load on what
lies below a plane. With s = k z, y' = A y for y = (U, W, F, G), with (A^2 - 1)^2 = 0; across the wave
likewise, with A^2 = 1. With B = A^2 - 1,

    exp(-A s) = cosh s + (s/2) sinh s B - A (sinh s + (s cosh s - sinh s)/2 B).

The compliance C of what lies below a slab, (U, W) = C (F, G), is propagated upwards: exp(-A s) turns (C; 1)
into (N; D), the new compliance is N D^-1, and the transmitted load D^-1 times the load above, both bounded
for any s. For one bonded layer the normal part is Burmister's M of `bonded_layer`.

References: D. M.
Burmister, J. Appl. Phys. 16, 89 (1945), doi:10.1063/1.1707558; W. T. Thomson, J. Appl. Phys. 21, 89 (1950),
doi:10.1063/1.1699629.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from palpate.core import Float, InputError, RangeError, ndarray

DEEP = 22.0  # k h beyond which the far face has no effect (4e-17)

Waves = Float[ndarray, " k"]
Square = Float[ndarray, "d d"]
Squares = Float[ndarray, "k d d"]


class Material(NamedTuple):
    """Shear modulus [Pa] and Poisson's ratio."""

    mu: float
    nu: float


class Slab(NamedTuple):
    """A thickness [m] of one material."""

    material: Material
    thickness_m: float


class Level(NamedTuple):
    """Compliance (motion per load there, times k [1/Pa]) and transmission (load there per surface load) at
    one plane.
    """

    compliance: Squares
    transmission: Squares


def climb(slabs: Sequence[Slab], below: Material | None, k: Waves) -> tuple[list[Level], list[Level]]:
    """Return compliance and transmission at every plane from the surface to the base.

    Args:
        slabs: Slabs from the surface downwards.
        below: Half-space under them; None for a rigid floor.
        k: Wavenumbers, positive [1/m].

    Returns:
        For motion along the wave and into the layer (U, W), and across the wave.
    """
    in_plane = _climb(slabs, k, _in_plane, half_space, below)
    return in_plane, _climb(slabs, k, _across, half_space_across, below)


def half_space(material: Material) -> Float[ndarray, "2 2"]:
    """Return the compliance of a half-space in (U, W), times k [1/Pa]."""
    mu, nu = material
    return np.array([[1 - nu, 0.5 - nu], [0.5 - nu, 1 - nu]]) / mu


def half_space_across(material: Material) -> Float[ndarray, "1 1"]:
    """Return the compliance of a half-space across the wave, times k [1/Pa]."""
    return np.array([[1 / material.mu]])


def _in_plane(material: Material) -> Float[ndarray, "4 4"]:
    mu, nu = material
    n = nu / (1 - nu)
    uniaxial = (1 - 2 * nu) / (2 * mu * (1 - nu))  # 1 / (lambda + 2 mu)
    plate = 2 * mu / (1 - nu)  # E / (1 - nu^2)
    return np.array(
        [[0.0, -1.0, -1 / mu, 0.0], [n, 0.0, 0.0, -uniaxial], [-plate, 0.0, 0.0, -n], [0.0, 0.0, 1.0, 0.0]]
    )


def _across(material: Material) -> Float[ndarray, "2 2"]:
    return np.array([[0.0, -1 / material.mu], [-material.mu, 0.0]])


def _climb(
    slabs: Sequence[Slab],
    k: Waves,
    generator: Callable[[Material], ndarray],
    endless: Callable[[Material], ndarray],
    below: Material | None,
) -> list[Level]:
    d = len(generator(Material(1.0, 0.0))) // 2
    base = np.zeros((d, d)) if below is None else endless(below)
    compliance: list[Squares] = [np.broadcast_to(base, (len(k), d, d))]
    passing: list[Squares] = []
    for material, thickness in reversed(slabs):
        s = k * thickness
        P = _upwards(generator(material), s)
        C = compliance[0]
        N = P[:, :d, :d] @ C + P[:, :d, d:]
        D = np.linalg.inv(P[:, d:, :d] @ C + P[:, d:, d:])
        deep = (s > DEEP)[:, None, None]
        compliance.insert(0, np.where(deep, endless(material), N @ D))
        passing.insert(0, np.exp(-s)[:, None, None] * D)
    transmission = [np.broadcast_to(np.eye(d), (len(k), d, d))]
    for down in passing:
        transmission.append(down @ transmission[-1])
    return [Level(*plane) for plane in zip(compliance, transmission, strict=True)]


def _upwards(A: Square, s: Waves) -> Squares:
    """exp(-s) exp(-A s)."""
    one = np.eye(len(A))
    B = A @ A - one
    fading = np.exp(-2 * s)
    cosh, sinh = (1 + fading) / 2, -np.expm1(-2 * s) / 2
    terms = ((cosh, one), (s * sinh / 2, B), (-sinh, A), (-(s * cosh - sinh) / 2, A @ B))
    return np.asarray(sum(f[:, None, None] * matrix for f, matrix in terms))


Base = Literal["bonded", "half-space"]
LONG_WAVE = 1e-7  # k times the stack's thickness that represents k = 0


@dataclass(frozen=True, slots=True)
class ElasticLayer:
    """One layer: thickness, ``math.inf`` only for the last layer of a half-space [m]; Young's modulus [Pa];
    Poisson's ratio below 0.5.
    """

    thickness_m: float
    youngs_modulus_pa: float
    poisson_ratio: float

    def __post_init__(self) -> None:
        if not self.thickness_m > 0.0:
            raise RangeError(
                f"a layer's thickness is {self.thickness_m} m; give a positive number of m, or math.inf for "
                "the last layer of a stack on a half-space"
            )
        if not 0.0 < self.youngs_modulus_pa < math.inf:
            raise RangeError(
                f"Young's modulus of a layer is {self.youngs_modulus_pa} Pa; give a positive number of Pa"
            )
        if not 0.0 <= self.poisson_ratio < 0.5:
            raise RangeError(
                f"Poisson's ratio {self.poisson_ratio} of a layer lies outside 0 to below 0.5; a bonded "
                "incompressible layer cannot be squeezed, so give a rubber 0.49 to 0.499"
            )

    @property
    def endless(self) -> bool:
        return self.thickness_m == math.inf

    @property
    def material(self) -> Material:
        return Material(self.youngs_modulus_pa / (2.0 * (1.0 + self.poisson_ratio)), self.poisson_ratio)

    @property
    def reduced_modulus_pa(self) -> float:
        """E* = E / (1 - nu^2) [Pa]."""
        return self.youngs_modulus_pa / (1.0 - self.poisson_ratio**2)


@dataclass(frozen=True, slots=True)
class Stack:
    """Layers from the surface downwards, perfectly bonded.

    Attributes:
        layers: One or more, the touched one first.
        base: ``"bonded"`` to a rigid floor, or ``"half-space"``, whose last layer has infinite thickness.

    Example:
        >>> skin = Stack((ElasticLayer(1e-3, 0.8e6, 0.49), ElasticLayer(9e-3, 0.2e6, 0.49)))
        >>> round(skin.thickness_m, 6)
        0.01
    """

    layers: tuple[ElasticLayer, ...]
    base: Base = "bonded"

    def __post_init__(self) -> None:
        if not self.layers:
            raise InputError(
                "a stack of no layers has no surface; give one ElasticLayer or more", code="no-layers"
            )
        if self.base not in get_args(Base):
            raise InputError(f"a stack's base is 'bonded' or 'half-space', not {self.base!r}")
        endless = [layer.endless for layer in self.layers]
        if any(endless[:-1]) or endless[-1] != (self.base == "half-space"):
            raise InputError(
                "thickness math.inf belongs to the last layer of a stack on a half-space, and to no other: "
                f"base {self.base!r} has thicknesses {[layer.thickness_m for layer in self.layers]} m",
                code="half-space-thickness",
            )

    @property
    def slabs(self) -> tuple[Slab, ...]:
        """Layers of finite thickness."""
        return tuple(Slab(layer.material, layer.thickness_m) for layer in self.layers if not layer.endless)

    @property
    def below(self) -> Material | None:
        """Half-space below; None on a rigid floor."""
        return self.layers[-1].material if self.base == "half-space" else None

    @property
    def thickness_m(self) -> float:
        """Distance from the surface to the floor [m]; infinite on a half-space."""
        return sum(layer.thickness_m for layer in self.layers)


class Compliance(NamedTuple):
    """Surface motion under a wave of load, per load [m/Pa].

    With loads q_k along the wave, q_t across it, p into the surface, and t = z x k:
    u_k = along q_k + i coupled p,     u_t = across q_t,     u_z = -i coupled q_k + normal p.
    """

    along: Waves
    coupled: Waves
    across: Waves
    normal: Waves


def surface_compliance(stack: Stack, wavenumber_per_m: Waves) -> Compliance:
    """Return the compliance of a stack's surface under waves of load.

    Args:
        stack: Layers.
        wavenumber_per_m: 2 pi / wavelength [1/m]; positive, or 0 on a rigid floor (uniaxial strain).

    Example:
        >>> layer = Stack((ElasticLayer(10e-3, 0.3e6, 0.49),))
        >>> oedometric = 10e-3 * (1 + 0.49) * (1 - 2 * 0.49) / (0.3e6 * (1 - 0.49))
        >>> bool(np.isclose(surface_compliance(layer, np.array([0.0])).normal[0], oedometric))
        True
    """
    k = np.asarray(wavenumber_per_m, float)
    if not np.all((k >= 0.0) & (k < math.inf)):
        raise RangeError(f"wavenumbers reach from {k.min()} to {k.max()} 1/m; give finite numbers from 0 up")
    if stack.base == "half-space" and not np.all(k > 0.0):
        raise RangeError(
            "a half-space yields without end to a uniform load; give wavenumbers above 0 1/m",
            code="wavenumber",
        )
    if stack.base == "bonded":
        k = np.maximum(k, LONG_WAVE / stack.thickness_m)
    in_plane, across = climb(stack.slabs, stack.below, k)
    C, c = in_plane[0].compliance / k[:, None, None], across[0].compliance / k[:, None, None]
    return Compliance(C[:, 0, 0], C[:, 0, 1], c[:, 0, 0], C[:, 1, 1])
