"""Polarised light through slices of birefringence whose axes turn along the ray.

Each slice is a linear retarder, exp(i (u s3 + v s1)) in Pauli's matrices, with u and v half the phase of
s_xx - s_zz and of 2 s_xz. The product of slices is a unit quaternion q0 + i (q1 s3 + q2 s1 + q3 s2). A ray
through a field that is even along it comes out with q3 = 0: met backwards the stack is the same, so the whole
is one linear retarder, though neither its axis nor its order is that of the summed stress.

Reference: H. Aben and C. Guillemet, Photoelasticity of Glass, Springer (1993), on integrated photoelasticity.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from palpate.core import Float, InputError, ndarray

Summed = Float[ndarray, "*n"]
Slices = Float[ndarray, "s *n"]


class Retarder(NamedTuple):
    """The unitary q0 + i (q1 s3 + q2 s1 + q3 s2) of a ray; q0^2 + q1^2 + q2^2 + q3^2 = 1.

    `q1` is the part along the axes x and z, `q2` the part along their diagonals, `q3` the rotation.
    """

    q0: Summed
    q1: Summed
    q2: Summed
    q3: Summed

    def then(self, after: Retarder) -> Retarder:
        """This one first, `after` next."""
        p0, p1, p2, p3 = self
        a0, a1, a2, a3 = after
        return Retarder(
            a0 * p0 - a1 * p1 - a2 * p2 - a3 * p3,
            a0 * p1 + a1 * p0 - a2 * p3 + a3 * p2,
            a0 * p2 + a2 * p0 + a1 * p3 - a3 * p1,
            a0 * p3 + a3 * p0 - a1 * p2 + a2 * p1,
        )

    def backwards(self) -> Retarder:
        """The same slices met in the opposite order."""
        return self._replace(q3=-self.q3)


def graded_slices(scale_m: Float[ndarray, "*n"], count: int) -> tuple[ndarray, ndarray]:
    """Slices along a ray from its midpoint to infinity, finest where the stress is.

    Args:
        scale_m: distance over which the stress changes on each ray [m].
        count: slices on the half ray.

    Returns:
        Midpoints y > 0 and thicknesses dy [m], each ``[count *n]``: equal steps of the angle atan(y / scale).
    """
    if count < 1:
        raise InputError(f"{count} slices make no ray; give 1 or more")
    step = np.pi / 2 / count
    angle = ((np.arange(count) + 0.5) * step).reshape(-1, *(1,) * np.ndim(scale_m))
    return scale_m * np.tan(angle), scale_m / np.cos(angle) ** 2 * step


def march(difference: Slices, shear: Slices, per_stress: float) -> Retarder:
    """Carry polarised light through slices in order.

    Args:
        difference: (s_xx - s_zz) dy of each slice [Pa m].
        shear: 2 s_xz dy of each slice [Pa m].
        per_stress: pi C / lambda [1/(Pa m)]: half the phase, in radians, of one Pa m.

    Returns:
        The ray's retarder. Second order in the slices' thickness.
    """
    total = _slice(difference[0], shear[0], per_stress)
    for a, b in zip(difference[1:], shear[1:], strict=True):
        total = total.then(_slice(a, b, per_stress))
    return total


def march_even(difference: Slices, shear: Slices, per_stress: float) -> Retarder:
    """The same for a whole ray whose stress is even about its midpoint, from the half with y > 0."""
    half = march(difference, shear, per_stress)
    return half.backwards().then(half)


def _slice(a: Summed, b: Summed, per_stress: float) -> Retarder:
    half_phase = per_stress * np.hypot(a, b)
    turn = per_stress * np.sinc(half_phase / np.pi)
    return Retarder(np.cos(half_phase), turn * a, turn * b, np.zeros_like(a))
