"""A dark-field plane polariscope: polariser, sample, crossed analyser."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from palpate.core.errors import RangeError
from palpate.optics.march import Retarder

Light = Float[ndarray, "*n"]


def single_retarder(order: Light, axis_rad: Light, polariser_rad: float) -> Light:
    """Transmitted fraction of one linear retarder, sin^2(2 (theta - psi)) sin^2(pi N).

    Exact where the stress axes do not turn along the ray, as under a point load at nu = 1/2. Under a Hertz
    contact they turn, and this is only the first order: see `march`.

    Args:
        order: fringe order N.
        axis_rad: theta, the retarder's axis from x towards z [rad].
        polariser_rad: psi, the polariser's direction from x towards z [rad].

    Returns:
        Fraction of the polarised light that passes, 0 to 1.
    """
    return np.asarray(np.sin(2 * (axis_rad - polariser_rad)) ** 2 * np.sin(np.pi * order) ** 2)


def dark_field(ray: Retarder, polariser_rad: float) -> Light:
    """Transmitted fraction of a marched ray between crossed ideal polarisers, 0 to 1."""
    linear = ray.q2 * np.cos(2 * polariser_rad) - ray.q1 * np.sin(2 * polariser_rad)
    return np.asarray(linear**2 + ray.q3**2)


def with_leak(light: Light, extinction: float) -> Light:
    """What passes when the polarisers are not perfect: e + (1 - e) I.

    Args:
        light: transmitted fraction between ideal polarisers.
        extinction: e, crossed over parallel transmission of the pair, 0 to 1.

    Raises:
        RangeError: e lies outside 0 to 1.
    """
    if not 0.0 <= extinction <= 1.0:
        raise RangeError(f"extinction {extinction} lies outside 0 to 1; film polarisers have 0.0001 to 0.01")
    return extinction + (1 - extinction) * light
