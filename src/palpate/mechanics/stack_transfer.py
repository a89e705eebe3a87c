"""How a wave of load passes through slabs, without any growing exponential.

Of a wave exp(i k x) let u_k = i U and u_z = W be the motion, and q_k = i k F, q_z = k G the load on the upper
face of what lies below a plane (minus the stress on it). With s = k z the equations of equilibrium are
y' = A y for y = (U, W, F, G), in which (A^2 - 1)^2 = 0; across the wave likewise, with A^2 = 1. So with
B = A^2 - 1

    exp(-A s) = cosh s + (s/2) sinh s B - A (sinh s + (s cosh s - sinh s)/2 B).

Let C be the compliance of what lies below a slab, (U, W) = C (F, G). Climbing the slab by exp(-A s) turns
(C; 1) into (N; D): its upper face has the compliance N D^-1, and the load that arrives below is D^-1 times
the load above. Both are bounded at any s once exp(s) is taken out of N and D.

Reference: W. T. Thomson, J. Appl. Phys. 21, 89 (1950), doi:10.1063/1.1699629, for the transfer of a state;
the compliance in place of the state is what keeps it from overflowing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from palpate.core.shapes import Float

DEEP = 22.0  # k h beyond which the far face is felt by less than s^2 exp(-2 s) = 4e-17

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
    """What a family of waves does at one plane between slabs.

    Attributes:
        compliance: motion per load there, times k [1/Pa].
        arriving: load there per load on the surface.
    """

    compliance: Squares
    arriving: Squares


class Levels(NamedTuple):
    """The same at every plane, from the surface to the base."""

    compliance: list[Squares]
    arriving: list[Squares]

    def at(self, level: int) -> Level:
        """At one of them."""
        return Level(self.compliance[level], self.arriving[level])


def climb(slabs: Sequence[Slab], below: Material | None, k: Waves) -> tuple[Levels, Levels]:
    """The compliance at every plane, from the base up, and the load that arrives, from the surface down.

    Args:
        slabs: from the surface downwards.
        below: the half-space under them; None for a rigid floor.
        k: wavenumbers [1/m], positive.

    Returns:
        The motion along the wave and into the skin (U, W), 2 x 2, and that across the wave, 1 x 1.
    """
    in_plane = _climb(slabs, k, _in_plane, half_space, below)
    return in_plane, _climb(slabs, k, _across, half_space_across, below)


def half_space(material: Material) -> Float[ndarray, "2 2"]:
    """Compliance of a half-space in (U, W), times k [1/Pa]: Boussinesq's and Cerruti's."""
    mu, nu = material
    return np.array([[1 - nu, 0.5 - nu], [0.5 - nu, 1 - nu]]) / mu


def half_space_across(material: Material) -> Float[ndarray, "1 1"]:
    """Compliance of a half-space across the wave, times k [1/Pa]."""
    return np.array([[1 / material.mu]])


def _in_plane(material: Material) -> Float[ndarray, "4 4"]:
    mu, nu = material
    n = nu / (1 - nu)
    yielding = (1 - 2 * nu) / (2 * mu * (1 - nu))  # 1 / (lambda + 2 mu)
    plate = 2 * mu / (1 - nu)  # E / (1 - nu^2)
    return np.array(
        [
            [0.0, -1.0, -1 / mu, 0.0],
            [n, 0.0, 0.0, -yielding],
            [-plate, 0.0, 0.0, -n],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )


def _across(material: Material) -> Float[ndarray, "2 2"]:
    return np.array([[0.0, -1 / material.mu], [-material.mu, 0.0]])


def _climb(
    slabs: Sequence[Slab],
    k: Waves,
    generator: Callable[[Material], ndarray],
    endless: Callable[[Material], ndarray],
    below: Material | None,
) -> Levels:
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
    arriving = [np.broadcast_to(np.eye(d), (len(k), d, d))]
    for down in passing:
        arriving.append(down @ arriving[-1])
    return Levels(compliance, arriving)


def _upwards(A: Square, s: Waves) -> Squares:
    """exp(-s) exp(-A s)."""
    one = np.eye(len(A))
    B = A @ A - one
    fading = np.exp(-2 * s)
    cosh, sinh = (1 + fading) / 2, -np.expm1(-2 * s) / 2
    terms = ((cosh, one), (s * sinh / 2, B), (-sinh, A), (-(s * cosh - sinh) / 2, A @ B))
    return np.asarray(sum(f[:, None, None] * matrix for f, matrix in terms))
