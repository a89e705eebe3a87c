"""Middle and edge of the field of reference pins, from the lattice, even if some pins are hidden.

Algorithm 1 of the compliance report takes the circle about the middle pin through the outermost ones. Hidden
pins are placed by a smooth map from layout to image, because one missing pin changes that circle by tens of
percent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core import Float, InputError, Int, ndarray
from palpate.estimators.lattice.ring_layout import MAX_RINGS, ring_of, ring_sites

DEGREES = (5, 40), (3, 20), (1, 6)  # of the map, and pins that it needs
ALIKE = 1e-6  # pitches, tolerance of equal distances of the outermost positions

Points = Float[ndarray, "p 2"]


@dataclass(frozen=True)
class PinField:
    """Position of the middle pin and of the outermost ones: six corners of a hexagon, or the last ring."""

    middle: Float[ndarray, 2]
    edge: Float[ndarray, "e 2"]

    @property
    def radius(self) -> float:
        """Radius of the circle: root mean square distance of the outermost pins from the middle."""
        return float(np.sqrt(((self.edge - self.middle) ** 2).sum(axis=1).mean()))

    @property
    def farthest(self) -> float:
        return float(np.hypot(*(self.edge - self.middle).T).max())

    @property
    def area(self) -> float:
        """Area of that circle, in the square of the unit of the places."""
        return np.pi * self.radius**2


def pin_field(places: Points, cells: Int[ndarray, "p 2"]) -> PinField:
    """Return middle and edge of reference pins.

    Args:
        places: Pin positions in any plane; NaN if lost.
        cells: Lattice cells, (0, 0) being the middle (`PinTracks.cells`).
    """
    seen = np.isfinite(places).all(axis=1)
    at, names = places[seen], cells[seen]
    if seen.sum() < DEGREES[-1][1]:
        raise InputError(
            f"{int(seen.sum())} pins are visible; {DEGREES[-1][1]} are needed", code="too-few-pins"
        )
    rings = int(ring_of(names).max())
    if rings > MAX_RINGS:
        raise InputError(f"{rings} rings of pins; up to {MAX_RINGS} are known")
    whole = ring_sites().cells[: ring_sites().upto(rings)]
    planes = {kind: ring_sites(kind).places[: len(whole)] for kind in ("hexagonal", "rings")}
    number = {cell: i for i, cell in enumerate(map(tuple, whole.tolist()))}
    own = np.array([number[cell] for cell in map(tuple, names.tolist())])
    degree = next(degree for degree, least in DEGREES if len(at) >= least)
    fits = {kind: _fit(plane[own], at, degree) for kind, plane in planes.items()}
    kind = min(fits, key=lambda one: fits[one][1])
    expected = _terms(planes[kind], degree) @ fits[kind][0]
    expected[own] = at
    away = np.hypot(*planes[kind].T)
    return PinField(expected[0], expected[away > away.max() - ALIKE])


def _fit(plane: Points, at: Points, degree: int) -> tuple[Float[ndarray, "k 2"], float]:
    """Coefficients of the map from layout to image, and its squared residual."""
    terms = _terms(plane, degree)
    fit, *_ = np.linalg.lstsq(terms, at, rcond=None)
    return fit, float(((terms @ fit - at) ** 2).sum())


def _terms(plane: Points, degree: int) -> Float[ndarray, "p k"]:
    x, y = (plane / MAX_RINGS).T
    return np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=1)
