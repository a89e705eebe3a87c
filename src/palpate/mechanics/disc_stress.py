"""Stress of a disc pressed across its diameter, in closed form.

Two opposite point loads P along y at (0, R) and (0, -R), plane stress, thickness t. With a = R - y, b = R +
y, p = x^2 + a^2, q = x^2 + b^2,

    s_xx = -2P/(pi t) (a x^2 / p^2 + b x^2 / q^2 - 1/2R)
    s_yy = -2P/(pi t) (a^3 / p^2 + b^3 / q^2 - 1/2R)
    s_xy =  2P/(pi t) (a^2 x / p^2 - b^2 x / q^2).

Reference: S. Timoshenko and J. N. Goodier, Theory of Elasticity, 3rd ed. (1970), art. 41.
"""

from __future__ import annotations

import numpy as np

from palpate.core import Float, ndarray

Points = Float[ndarray, "*n"]


def disc_stress(x: Points, y: Points) -> tuple[Points, Points, Points]:
    """Return s_xx, s_yy, s_xy of a disc of radius 1 loaded at y = 1 and -1, in units of P / (pi R t).

    NaN outside the disc and at the loads; 1, -3, 0 at the centre.
    """
    a, b = 1 - y, 1 + y
    inside = (x**2 + y**2 <= 1) & (x**2 + (1 - np.abs(y)) ** 2 > 0)
    p, q = (np.where(inside, x**2 + s**2, np.nan) ** 2 for s in (a, b))
    return (
        np.asarray(1 - 2 * x**2 * (a / p + b / q)),
        np.asarray(1 - 2 * (a**3 / p + b**3 / q)),
        np.asarray(2 * x * (a**2 / p - b**2 / q)),
    )


def disc_difference(x: Points, y: Points) -> tuple[Points, Points]:
    """Return s1 - s2 over that of the centre, 8 P / (pi D t), and the angle of s1 from x towards y [rad]."""
    xx, yy, xy = disc_stress(x, y)
    return np.hypot(xx - yy, 2 * xy) / 4, np.arctan2(2 * xy, xx - yy) / 2
