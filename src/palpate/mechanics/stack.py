"""A stack of elastic layers, bonded to one another, and what its surface answers to a wave of load.

A load on the surface is a sum of waves exp(i (k_x x + k_y y)). Under one of them the motion along the wave
and into the skin (k, z) is apart from the motion across it (t), and each is linear in a few numbers that
depend on k = |k| alone: the surface compliance. For one bonded layer the normal part is the closed form of
Burmister,

    u_z / p = 2 (1 - nu^2) / (E k) M(k h),
    M(s) = [(3 - 4 nu) sinh 2s - 2s] / [(3 - 4 nu) cosh 2s + 2 s^2 + 5 - 12 nu + 8 nu^2].

Small strain, isotropic linear layers, laterally infinite.

Reference: D. M. Burmister, J. Appl. Phys. 16, 89 (1945), doi:10.1063/1.1707558.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy import ndarray

from palpate.core.errors import InputError, RangeError
from palpate.core.shapes import Float
from palpate.mechanics.stack_transfer import Material, Slab, climb

Base = Literal["bonded", "half-space"]
LONG_WAVE = 1e-7  # k times the stack's thickness that stands for k = 0; what is left out is its square

Waves = Float[ndarray, " k"]


@dataclass(frozen=True, slots=True)
class Layer:
    """One layer of a stack.

    Attributes:
        thickness_m: positive [m]; ``math.inf`` only for the last layer of a stack on a half-space.
        youngs_modulus_pa: positive [Pa].
        poisson_ratio: 0 to below 0.5. At 0.5 a layer between rigid walls has no compliance at all.

    Raises:
        RangeError: one of them lies outside its range.
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
        """Whether it reaches down without end."""
        return self.thickness_m == math.inf

    @property
    def material(self) -> Material:
        """The layer's shear modulus [Pa] and Poisson's ratio."""
        return Material(self.youngs_modulus_pa / (2.0 * (1.0 + self.poisson_ratio)), self.poisson_ratio)

    @property
    def reduced_modulus_pa(self) -> float:
        """E* = E / (1 - nu^2) [Pa]."""
        return self.youngs_modulus_pa / (1.0 - self.poisson_ratio**2)


@dataclass(frozen=True, slots=True)
class Stack:
    """Layers from the surface downwards, perfectly bonded to one another.

    Attributes:
        layers: one or more, the touched one first.
        base: ``"bonded"``: the last layer sticks to a rigid floor. ``"half-space"``: the last layer reaches
            down without end, and its thickness is ``math.inf``.

    Raises:
        InputError: no layer, a base of another name, or a thickness that does not fit the base.

    Example:
        >>> skin = Stack((Layer(1e-3, 0.8e6, 0.49), Layer(9e-3, 0.2e6, 0.49)))
        >>> round(skin.thickness_m, 6)
        0.01
    """

    layers: tuple[Layer, ...]
    base: Base = "bonded"

    def __post_init__(self) -> None:
        if not self.layers:
            raise InputError("a stack of no layers has no surface; give one Layer or more")
        if self.base not in get_args(Base):
            raise InputError(f"a stack's base is 'bonded' or 'half-space', not {self.base!r}")
        endless = [layer.endless for layer in self.layers]
        if any(endless[:-1]) or endless[-1] != (self.base == "half-space"):
            raise InputError(
                "thickness math.inf belongs to the last layer of a stack on a half-space, and to no other: "
                f"base {self.base!r} has thicknesses {[layer.thickness_m for layer in self.layers]} m"
            )

    @property
    def slabs(self) -> tuple[Slab, ...]:
        """The layers of finite thickness, as what carries a load from face to face."""
        return tuple(Slab(layer.material, layer.thickness_m) for layer in self.layers if not layer.endless)

    @property
    def below(self) -> Material | None:
        """The half-space below; None on a rigid floor."""
        return self.layers[-1].material if self.base == "half-space" else None

    @property
    def thickness_m(self) -> float:
        """From the surface to the floor [m]; infinite on a half-space."""
        return sum(layer.thickness_m for layer in self.layers)


class Compliance(NamedTuple):
    """What the surface does under a wave of load, per load [m/Pa]; each ``[k]``.

    With loads q_k along the wave, q_t across it and p into the skin, and t = z x k:

        u_k = along q_k + i coupled p,     u_t = across q_t,     u_z = -i coupled q_k + normal p.
    """

    along: Waves
    coupled: Waves
    across: Waves
    normal: Waves


def surface_compliance(stack: Stack, wavenumber_per_m: Waves) -> Compliance:
    """What the surface of the stack answers to waves of load.

    The load is carried from the bottom upwards as a compliance, which stays bounded for any k h. Relative
    rounding is below 1e-12 for one layer.

    Args:
        stack: the layers.
        wavenumber_per_m: k = 2 pi / wavelength [1/m]; positive, and 0 too on a rigid floor, where the answer
            is that of uniaxial strain and of simple shear.

    Returns:
        The compliances [m/Pa] at each k; the 3 x 3 matrix they make is Hermitian and positive definite.

    Raises:
        RangeError: k is negative, not finite, or 0 on a half-space, which yields without end.

    Example:
        >>> layer = Stack((Layer(10e-3, 0.3e6, 0.49),))
        >>> oedometric = 10e-3 * (1 + 0.49) * (1 - 2 * 0.49) / (0.3e6 * (1 - 0.49))
        >>> bool(np.isclose(surface_compliance(layer, np.array([0.0])).normal[0], oedometric))
        True
    """
    k = np.asarray(wavenumber_per_m, float)
    if not np.all((k >= 0.0) & (k < math.inf)):
        raise RangeError(f"wavenumbers reach from {k.min()} to {k.max()} 1/m; give finite numbers from 0 up")
    if stack.base == "half-space" and not np.all(k > 0.0):
        raise RangeError("a half-space yields without end to a uniform load; give wavenumbers above 0 1/m")
    if stack.base == "bonded":
        k = np.maximum(k, LONG_WAVE / stack.thickness_m)
    in_plane, across = climb(stack.slabs, stack.below, k)
    C, c = in_plane.compliance[0] / k[:, None, None], across.compliance[0] / k[:, None, None]
    return Compliance(C[:, 0, 0], C[:, 0, 1], c[:, 0, 0], C[:, 1, 1])
