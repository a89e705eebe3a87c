"""A cylinder bonded to its base, half of it, at finite strain in 20-node bricks; its top is z = 0.

Bricks fill a square block in x and y that is drawn out to a disc:  x = R u sqrt(1 - v^2 / 2),
y = R v sqrt(1 - u^2 / 2). So the mesh has no pole, and four corners on the rim, at 45 degrees.

Reference: P. Fong, Analytical methods for squaring the disc (2015), arXiv:1509.06344.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from .bricks import OUTSIDE, Bricks

GROWTH = 1.35  # of a cell's height over that of the one above it


@dataclass(frozen=True)
class Cylinder:
    """A cylinder [mm, MPa]."""

    mpa: float
    poisson_ratio: float = 0.48
    radius: float = 20.0
    height: float = 40.0
    across: int = 14
    down: int = 6

    @cached_property
    def body(self) -> Bricks:
        """Its half at y > 0, layer by layer from +x to -x."""
        u, v = np.linspace(1.0, -1.0, self.across + 1), np.linspace(1.0, 0.0, self.across // 2 + 1)
        deep = np.cumsum(GROWTH ** np.arange(self.down))
        z = np.concatenate([-deep[::-1] / deep[-1] * self.height, [0.0]])
        E = np.full((self.across, self.across // 2, self.down), self.mpa)
        return Bricks((u, v, z), self._place, E, self.poisson_ratio, self._held)

    def _place(self, at: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
        u, v, z = at.T
        x, y = u * np.sqrt(1 - v**2 / 2), v * np.sqrt(1 - u**2 / 2)
        return np.stack([self.radius * x, self.radius * y, z], axis=1)

    def _held(self, at: Float[ndarray, "n 3"]) -> ndarray:
        _, v, z = at.T
        held = np.repeat(np.isclose(z, -self.height)[:, None], 3, axis=1)
        held[:, 1] |= np.isclose(v, 0.0)
        return held

    @cached_property
    def facets(self) -> Int[ndarray, " t"]:
        """Cells below the top."""
        return np.arange(self.across * (self.across // 2)) * self.down + self.down - 1

    @cached_property
    def facet_nodes(self) -> Int[ndarray, "t 8"]:
        """Of the top, cell by cell."""
        return self.body.nodes_of[self.facets][:, OUTSIDE]
