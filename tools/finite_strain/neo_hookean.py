"""Nearly incompressible neo-Hookean solid, with the pressure as its own field.

Energy  W = mu/2 (tr C - 3) - mu ln J + lambda/2 (J - 1)^2,  split by  p = lambda (J - 1)  (tension positive).
First Piola-Kirchhoff stress  P = mu (F - F^-T) + p J F^-T,  Cauchy stress  s = mu/J (F F^T - 1) + p.
At small strain mu and lambda are Lame's constants, so E and nu keep their meaning.

Reference: J. Bonet and R. D. Wood, Nonlinear Continuum Mechanics for Finite Element Analysis (2008), ch. 6,
doi:10.1017/CBO9780511755446.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

PARTS = ((0, 0), (0, 1), (1, 0), (1, 1), (2, 2))  # rr, rz, zr, zz, tt

Gradient = Float[ndarray, "cells q 5"]
Scalar = Float[ndarray, "cells q"]


@dataclass(frozen=True)
class NeoHookean:
    """Young's modulus is 1, the unit of stress."""

    poisson_ratio: float

    @property
    def mu(self) -> float:
        return 0.5 / (1.0 + self.poisson_ratio)

    @property
    def lame(self) -> float:
        nu = self.poisson_ratio
        return nu / ((1.0 + nu) * (1.0 - 2.0 * nu))


def deformation(H: Gradient) -> Float[ndarray, "cells q 3 3"]:
    """F = 1 + grad u as 3 x 3 matrices over (r, z, theta)."""
    F = np.zeros((*H.shape[:-1], 3, 3))
    for part, (i, j) in enumerate(PARTS):
        F[..., i, j] = H[..., part]
    return F + np.eye(3)


def volume_ratio(F: Float[ndarray, "cells q 3 3"]) -> Scalar:
    """J = det F."""
    return (F[..., 0, 0] * F[..., 1, 1] - F[..., 0, 1] * F[..., 1, 0]) * F[..., 2, 2]


def inverse_transpose(F: Float[ndarray, "cells q 3 3"]) -> Float[ndarray, "cells q 3 3"]:
    """F^-T of a meridian deformation."""
    plane = F[..., 0, 0] * F[..., 1, 1] - F[..., 0, 1] * F[..., 1, 0]
    G = np.zeros_like(F)
    G[..., 0, 0], G[..., 1, 1] = F[..., 1, 1] / plane, F[..., 0, 0] / plane
    G[..., 0, 1], G[..., 1, 0] = -F[..., 1, 0] / plane, -F[..., 0, 1] / plane
    G[..., 2, 2] = 1.0 / F[..., 2, 2]
    return G


def first_piola(
    mu: float | Float[ndarray, "cells 1"], H: Gradient, p: Scalar
) -> tuple[Gradient, Float[ndarray, "cells q 5 5"], Gradient, Scalar]:
    """Stress and its derivatives.

    Returns:
        P; dP/dF; J F^-T, which is both dP/dp and dJ/dF; and J.
    """
    F = deformation(H)
    J, G = volume_ratio(F), inverse_transpose(F)
    pJ = p * J
    A = np.empty((*p.shape, 5, 5))
    for a, (i, j) in enumerate(PARTS):
        for b, (k, m) in enumerate(PARTS):
            A[..., a, b] = (mu - pJ) * G[..., i, m] * G[..., k, j] + pJ * G[..., i, j] * G[..., k, m]
        A[..., a, a] += mu
    g = np.stack([G[..., i, j] for i, j in PARTS], axis=-1)
    f = np.stack([F[..., i, j] for i, j in PARTS], axis=-1)
    return np.asarray(mu)[..., None] * (f - g) + pJ[..., None] * g, A, J[..., None] * g, J


def cauchy(solid: NeoHookean, H: Gradient, p: Scalar) -> Float[ndarray, "cells q 4"]:
    """Cauchy stress rr, tt, zz, rz in the deformed body."""
    F = deformation(H)
    excess = F @ np.swapaxes(F, -1, -2) - np.eye(3)
    s = solid.mu / volume_ratio(F)[..., None, None] * excess + p[..., None, None] * np.eye(3)
    return np.stack([s[..., 0, 0], s[..., 2, 2], s[..., 1, 1], s[..., 0, 1]], axis=-1)
