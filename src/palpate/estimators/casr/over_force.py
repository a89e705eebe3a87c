"""The motion of pins as a smooth function of force, whatever the frames' number and times were.

Each pin's motion is fitted by a polynomial in the cube root of force, in which young contact is nearly
straight, and read at fixed forces; so presses of any speed and frame rate can be compared pin by pin.
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray
from scipy.spatial import cKDTree

from palpate.core.errors import InputError, RangeError
from palpate.core.shapes import Float
from palpate.estimators.casr.pin_press import PinPress

DEGREE = 4
SPARE = 2  # frames more than the polynomial has coefficients
NEAR = 0.35  # of the pins' spacing: farther is another pin
LEAST_MATCHED = 0.8
BEYOND_N = 0.15  # how far a level may lie outside the frames' forces

Levels = Float[ndarray, " l"]
Layout = Float[ndarray, "p 2"]


def at_forces(
    force_n: Float[ndarray, " f"], values: Float[ndarray, k * n], levels_n: Levels
) -> Float[ndarray, l * n]:
    """Values that change smoothly with force, at fixed forces.

    Args:
        force_n: of each value [N].
        values: e.g. motion of pins.
        levels_n: where to read [N].

    Raises:
        RangeError: a level beyond the forces that there are.
    """
    low, high = float(force_n.min()), float(force_n.max())
    if levels_n.min() < low - BEYOND_N or levels_n.max() > high + BEYOND_N:
        raise RangeError(
            f"frames from {low:.3g} to {high:.3g} N; values are wanted from {levels_n.min():g} to "
            f"{levels_n.max():g} N: press as far as the references were pressed"
        )
    degree = min(DEGREE, len(force_n) - 1 - SPARE)
    fit, *_ = np.linalg.lstsq(_powers(force_n, high, degree), values.reshape(len(values), -1), rcond=None)
    return (_powers(levels_n, high, degree) @ fit).reshape(len(levels_n), *values.shape[1:])


def _powers(force_n: Float[ndarray, " f"], scale: float, degree: int) -> Float[ndarray, "f d"]:
    return np.vander(np.cbrt(force_n / scale), degree + 1, increasing=True)


def laid_on(press: PinPress, layout_px: Layout) -> Float[ndarray, "f p 2"]:
    """The motion of a press's pins in the order of a layout; NaN for pins it has not.

    Raises:
        InputError: its pins are not those of the layout.
    """
    spacing = float(np.median(cKDTree(layout_px).query(layout_px, k=2)[0][:, 1]))
    found = np.isfinite(press.moved_px).all(axis=(0, 2))
    at = press.untouched_px[found]
    if not len(at):
        raise InputError("every pin is lost; look at light, focus and speed")
    shift = at.mean(axis=0) - layout_px.mean(axis=0)
    for _ in range(3):
        gap, which = cKDTree(at - shift).query(layout_px)
        near = gap < NEAR * spacing
        if near.any():
            shift = shift + np.median(at[which[near]] - shift - layout_px[near], axis=0)
    gap, which = cKDTree(at - shift).query(layout_px)
    near = gap < NEAR * spacing
    if near.mean() < LEAST_MATCHED or len(at) > len(layout_px) / LEAST_MATCHED:
        raise InputError(
            f"{int(near.sum())} of the {len(layout_px)} calibrated pins are where they should be, and "
            f"{len(at)} pins are seen: another sensor, zoom or crop, or pins lost; calibrate for it"
        )
    moved = np.full((len(press.force_n), len(layout_px), 2), np.nan)
    moved[:, near] = press.moved_px[:, found][:, which[near]]
    return moved
