"""The regular grid on the surface that the stack's fields and contacts are given on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import ndarray

from palpate.core.errors import InputError
from palpate.core.shapes import Float

UNEVEN = 1e-6  # of a step: what may be left of rounding in a grid's positions


class Cells(NamedTuple):
    """How many cells along x and y, and how large [m]."""

    nx: int
    ny: int
    dx: float
    dy: float

    @property
    def area_m2(self) -> float:
        """Of one cell [m^2]."""
        return self.dx * self.dy

    @property
    def diagonal_m(self) -> float:
        """Greatest distance between two cells' centres [m]."""
        return float(np.hypot((self.nx - 1) * self.dx, (self.ny - 1) * self.dy))


def cells(x_m: Float[ndarray, " nx"], y_m: Float[ndarray, " ny"]) -> Cells:
    """The cells around the grid's points.

    Args:
        x_m: columns, rising in equal steps, 3 or more [m].
        y_m: rows, likewise [m].

    Raises:
        InputError: the steps are not equal and positive, or there are too few.
    """
    return Cells(len(x_m), len(y_m), _step("x_m", x_m), _step("y_m", y_m))


def _step(name: str, axis_m: Float[ndarray, " n"]) -> float:
    steps = np.diff(axis_m)
    mean = float(steps.mean()) if len(axis_m) >= 3 else np.nan
    if not (mean > 0.0 and np.abs(steps - mean).max() <= UNEVEN * mean):
        raise InputError(
            f"{name} is not a regular grid: give 3 or more positions in m that rise in equal steps, as of "
            "np.linspace"
        )
    return mean
