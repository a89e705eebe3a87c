"""Stress of a strip in tension with a central crack across it, by complex potentials and collocation.

Phi = f(z) z / sqrt(z^2 - a^2) + g(z), Omega = f(z) z / sqrt(z^2 - a^2) - g(z), with even polynomials f
and g of real coefficients, free the crack of traction; the free edges and the uniform ends give the
coefficients by least squares. N. I. Muskhelishvili, Some Basic Problems of the Mathematical Theory of
Elasticity (1953), on cracks.
"""

import numpy as np

TERMS = 14


class CrackedStrip:
    """A strip of width W under unit tension along y with a crack from (-a, 0) to (a, 0)."""

    def __init__(self, width: float, half_crack: float, half_length: float) -> None:
        self.a, self.scale = half_crack, max(width / 2, half_length)
        y, x = np.linspace(0, half_length, 160), np.linspace(0, width / 2, 80)
        edge, end = self._basis(width / 2 + 1j * y), self._basis(x + 1j * half_length)
        A = np.concatenate([edge[:, 0].T, edge[:, 2].T, end[:, 1].T, end[:, 2].T])
        b = np.concatenate([0 * y, 0 * y, 1 + 0 * x, 0 * x])
        self.c = np.linalg.lstsq(A, b, rcond=1e-13)[0]
        self.left_over = float(np.abs(A @ self.c - b).max())

    def intensity(self) -> float:
        """K_I over the nominal stress times sqrt(pi a)."""
        return 2 * sum(self.c[2 * j] * (self.a / self.scale) ** (2 * j) for j in range(TERMS))

    def stress(self, x, y):
        """s_xx, s_yy and s_xy in units of the nominal stress, in the quarter x, y >= 0."""
        return np.tensordot(self.c, self._basis(np.abs(x) + 1j * np.abs(y)), axes=1)

    def difference(self, x, y):
        """s1 - s2 in units of the nominal stress."""
        xx, yy, xy = self.stress(x, y)
        return np.hypot(xx - yy, 2 * xy)

    def _parts(self, z):
        root = np.sqrt(z - self.a) * np.sqrt(z + self.a)
        f, df = z / root, -(self.a**2) / root**3
        for j in range(TERMS):
            p = (z / self.scale) ** (2 * j)
            dp = 2 * j * (z / self.scale) ** (2 * j - 1) / self.scale if j else 0 * z
            yield p * f, dp * f + p * df, p * f
            yield p, dp, -p

    def _basis(self, z):
        rows, mirrored = [], np.conj(z)
        for (phi, dphi, _), (_, _, omega) in zip(self._parts(z), self._parts(mirrored), strict=True):
            both = 4 * phi.real
            along = phi + omega + (z - mirrored) * np.conj(dphi)  # s_yy - i s_xy
            rows.append((both - along.real, along.real, -along.imag))
        return np.array(rows)
