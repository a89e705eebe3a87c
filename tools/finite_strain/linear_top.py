"""The top of a linear elastic cylinder, bonded to its base, by rings and Fourier modes.

The top's height over its plane is  h = sum over rings k and modes m of  a_km N_k(r) cos m t,  even about the
plane t = 0, and the energy of the half of the cylinder at 0 < t < pi is a . S a / 2. Loads are normal to the
plane; what the top moves along it is left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from palpate.mechanics.axisymmetric.axisymmetric_fem import RevolvedBody, tensor_mesh

FINE_TO = 0.85  # of the radius


@dataclass(frozen=True)
class LinearTop:
    """A cylinder [mm, MPa]."""

    mpa: float
    poisson_ratio: float = 0.48
    radius: float = 20.0
    height: float = 40.0
    rings: int = 9
    modes: int = 7

    @cached_property
    def knots(self) -> Float[ndarray, " n"]:
        """Ends of the quadratic pieces along the radius."""
        fine = FINE_TO * self.radius
        return np.concatenate([np.linspace(0.0, fine, self.rings - 1), np.linspace(fine, self.radius, 3)[1:]])

    @cached_property
    def unknowns(self) -> list[tuple[int, int]]:
        """(mode, ring) of each; on the axis there is mode 0 only."""
        nodes = 2 * len(self.knots) - 1
        return [(m, k) for m in range(self.modes) for k in range(nodes) if m == 0 or k > 0]

    @property
    def size(self) -> int:
        return len(self.unknowns)

    @cached_property
    def stiffness(self) -> Float[ndarray, "t t"]:
        """S, of the half cylinder."""
        down = np.cumsum(1.35 ** np.arange(12))
        mesh = tensor_mesh(self.knots, np.concatenate([-down[::-1] / down[-1] * self.height, [0.0]]))
        r, z = mesh.doflocs
        fixed = np.flatnonzero(np.isclose(z, -self.height))
        body = RevolvedBody(mesh, np.full(mesh.t.shape[1], self.mpa), self.poisson_ratio, fixed)
        top = np.flatnonzero(np.isclose(z, 0.0, atol=1e-9))
        top = top[np.argsort(r[top])]
        S, start = np.zeros((self.size, self.size)), 0
        for m in range(self.modes):
            rings = top if m == 0 else top[1:]
            answer = body.compliance(m, rings, rings)[:, 2, :, 2]
            end = start + len(rings)
            S[start:end, start:end] = np.linalg.inv(answer) * (np.pi if m == 0 else np.pi / 2)
            start = end
        return (S + S.T) / 2

    def beyond(self, at: Float[ndarray, "f q 2"]) -> Bool[ndarray, "f q"]:
        """Whether a place is beside the cylinder."""
        return np.hypot(at[..., 0], at[..., 1]) > self.radius

    def at(self, at: Float[ndarray, "f q 2"]) -> list[ndarray]:
        """Height [f q t] and its slopes [f q 2 t] at places, by the unknowns."""
        r, t = np.hypot(at[..., 0], at[..., 1]), np.arctan2(at[..., 1], at[..., 0])
        r = np.clip(r, 1e-6, self.radius)
        N, D = self._rings(r)
        c, s = np.cos(t), np.sin(t)
        height, slope = [], []
        for m in range(self.modes):
            cm, sm = np.cos(m * t)[..., None], np.sin(m * t)[..., None]
            rings = slice(0 if m == 0 else 1, None)
            out, around = (D * cm)[..., rings], (-m * N * sm / r[..., None])[..., rings]
            height.append((N * cm)[..., rings])
            slope.append(
                np.stack(
                    [out * c[..., None] - around * s[..., None], out * s[..., None] + around * c[..., None]],
                    -2,
                )
            )
        return [np.concatenate(height, axis=-1), np.concatenate(slope, axis=-1)]

    def _rings(self, r: Float[ndarray, "f q"]) -> tuple[ndarray, ndarray]:
        """Quadratic shape functions along the radius, and their slopes."""
        piece = np.clip(np.searchsorted(self.knots, r) - 1, 0, len(self.knots) - 2)
        half = (self.knots[piece + 1] - self.knots[piece]) / 2
        x = (r - self.knots[piece]) / half - 1
        shapes = np.stack([-x * (1 - x) / 2, 1 - x**2, x * (1 + x) / 2], axis=-1)
        slopes = np.stack([x - 0.5, -2 * x, x + 0.5], axis=-1) / half[..., None]
        N, D = np.zeros((2, *r.shape, 2 * len(self.knots) - 1))
        to = 2 * piece[..., None] + np.arange(3)
        np.put_along_axis(N, to, shapes, axis=-1)
        np.put_along_axis(D, to, slopes, axis=-1)
        return N, D
