"""Polarised light through slices of birefringence whose axes rotate along the ray.

Each slice is a linear retarder exp(i (u s3 + v s1)) in Pauli matrices, with u and v half the phase of s_xx -
s_zz and 2 s_xz. The product is a unit quaternion q0 + i (q1 s3 + q2 s1 + q3 s2); for a symmetric ray q3 = 0.

Reference: H. Aben and C. Guillemet, Photoelasticity of Glass, Springer (1993), on integrated photoelasticity.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from palpate.core import Float, InputError, ndarray

Summed = Float[ndarray, "*n"]
Slices = Float[ndarray, "s *n"]


class Retarder(NamedTuple):
    """The unitary q0 + i (q1 s3 + q2 s1 + q3 s2): `q1` along the axes x and z, `q2` along their diagonals,
    `q3` rotation.
    """

    q0: Summed
    q1: Summed
    q2: Summed
    q3: Summed

    def then(self, after: Retarder) -> Retarder:
        """This retarder first, `after` next."""
        p0, p1, p2, p3 = self
        a0, a1, a2, a3 = after
        return Retarder(
            a0 * p0 - a1 * p1 - a2 * p2 - a3 * p3,
            a0 * p1 + a1 * p0 - a2 * p3 + a3 * p2,
            a0 * p2 + a2 * p0 + a1 * p3 - a3 * p1,
            a0 * p3 + a3 * p0 - a1 * p2 + a2 * p1,
        )

    def backwards(self) -> Retarder:
        """The same slices in the opposite order."""
        return self._replace(q3=-self.q3)


def graded_slices(scale_m: Float[ndarray, "*n"], count: int) -> tuple[ndarray, ndarray]:
    """Return midpoints y > 0 and thicknesses dy of slices on half a ray [m], in equal steps of atan(y /
    scale).
    """
    if count < 1:
        raise InputError(f"{count} slices make no ray; give 1 or more")
    step = np.pi / 2 / count
    angle = ((np.arange(count) + 0.5) * step).reshape(-1, *(1,) * np.ndim(scale_m))
    return scale_m * np.tan(angle), scale_m / np.cos(angle) ** 2 * step


def march(difference: Slices, shear: Slices, per_stress: float) -> Retarder:
    """March polarised light through slices in order; second order in the slices' thickness.

    Args:
        difference: (s_xx - s_zz) dy of each slice [Pa m].
        shear: 2 s_xz dy of each slice [Pa m].
        per_stress: pi C / lambda [1/(Pa m)].
    """
    total = _slice(difference[0], shear[0], per_stress)
    for a, b in zip(difference[1:], shear[1:], strict=True):
        total = total.then(_slice(a, b, per_stress))
    return total


def march_even(difference: Slices, shear: Slices, per_stress: float) -> Retarder:
    """March a whole symmetric ray from its half with y > 0."""
    half = march(difference, shear, per_stress)
    return half.backwards().then(half)


def _slice(a: Summed, b: Summed, per_stress: float) -> Retarder:
    half_phase = per_stress * np.hypot(a, b)
    turn = per_stress * np.sinc(half_phase / np.pi)
    return Retarder(np.cos(half_phase), turn * a, turn * b, np.zeros_like(a))
