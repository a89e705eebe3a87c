"""Coverage of a set of presses: where and how hard the sensor was pressed, and what is missing, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

Box = tuple[int, int, int, int]

COLUMNS, ROWS = ("left", "middle", "right"), ("top", "middle", "bottom")
FORCE_BINS = 5
NICE = (1.0, 2.0, 2.5, 5.0, 10.0)
MIN_FOR_SIDES = 6  # presses, before it is said that a side has none


class LabelledPress(NamedTuple):
    """Force of a press [N], and where in the image its contact lies [px]; None where that is not seen."""

    force_n: float
    place_px: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class PressCoverage:
    """Presses by place and force.

    Attributes:
        edges_n: of the bins of force [N].
        counts: presses in each row and column of the image and each bin of force ``[3 3 b]``.
        unplaced_counts: presses whose contact is not seen, in each bin of force ``[b]``.
    """

    edges_n: tuple[float, ...]
    counts: np.ndarray
    unplaced_counts: np.ndarray
    asked: int

    @classmethod
    def of(
        cls,
        presses: Sequence[LabelledPress],
        region: Box,
        asked: int = 40,
        force_range_n: tuple[float, float] | None = None,
    ) -> PressCoverage:
        """Count presses.

        Args:
            region: of the image in which contacts lie, x, y, width, height [px].
            force_range_n: least and greatest force that shall be covered; None takes 0 to the greatest so far
                [N].
        """
        forces = [one.force_n for one in presses]
        edges = force_edges(force_range_n or (0.0, max(forces, default=1.0)))
        counts = np.zeros((3, 3, len(edges) - 1), np.int64)
        unplaced = np.zeros(len(edges) - 1, np.int64)
        for one in presses:
            k = int(np.searchsorted(edges, one.force_n, side="right")) - 1
            k = min(max(k, 0), len(edges) - 2)  # what lies beyond, in the last bin
            if one.place_px is None:
                unplaced[k] += 1
                continue
            x, y, width, height = region
            column = min(max(int(3 * (one.place_px[0] - x) / width), 0), 2)
            row = min(max(int(3 * (one.place_px[1] - y) / height), 0), 2)
            counts[row, column, k] += 1
        return cls(tuple(edges), counts, unplaced, asked)

    @property
    def unplaced(self) -> int:
        """Presses whose contact is not seen."""
        return int(self.unplaced_counts.sum())

    @property
    def presses(self) -> int:
        """How many presses there are."""
        return int(self.counts.sum()) + self.unplaced

    @property
    def missing(self) -> list[str]:
        """What is missing, most urgent first; empty where nothing is."""
        if not self.presses:
            return ["all of it: press anywhere, and hold still for a second"]
        gaps = [f"a gap at {low:g} to {high:g} N" for low, high in self.gaps_n]
        return [*gaps, *(f"nothing at the {side}" for side in self.bare)]

    @property
    def bare(self) -> list[str]:
        """Parts of the image without a press: left, right, top, bottom, middle."""
        if self.counts.sum() < MIN_FOR_SIDES:
            return []
        by_place = self.counts.sum(axis=2)
        sides = {"left": by_place[:, 0], "right": by_place[:, 2], "top": by_place[0], "bottom": by_place[2]}
        bare = [name for name, cells in sides.items() if cells.sum() == 0]
        return [*bare, "middle"] if by_place[1, 1] == 0 and len(bare) < 2 else bare

    @property
    def text(self) -> str:
        """The same in one line.

        Example:
            >>> PressCoverage.of([LabelledPress(0.5, (5.0, 5.0))], (0, 0, 9, 9), 40, (0.0, 5.0)).text
            '1 of 40, a gap at 1 to 5 N'
        """
        return ", ".join([f"{self.presses} of {self.asked}", *self.missing])

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "edges_N": list(self.edges_n),
            "columns": list(COLUMNS),
            "rows": list(ROWS),
            "counts": self.counts.tolist(),
            "unplaced": self.unplaced,
        }

    @property
    def gaps_n(self) -> list[tuple[float, float]]:
        """Bins of force without a press, next ones joined; those of presses that are not seen count too."""
        by_force = self.counts.sum(axis=(0, 1)) + self.unplaced_counts
        gaps: list[tuple[float, float]] = []
        for k, count in enumerate(by_force.tolist()):
            if count:
                continue
            low, high = self.edges_n[k], self.edges_n[k + 1]
            if gaps and gaps[-1][1] == low:
                gaps[-1] = gaps[-1][0], high
            else:
                gaps.append((low, high))
        return gaps


def force_edges(force_range_n: tuple[float, float]) -> np.ndarray:
    """Edges of about five bins of force at round numbers, nearest to a range's ends [N].

    Example:
        >>> force_edges((0.0, 5.0)).tolist()
        [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    """
    low, high = force_range_n
    width = max(high - low, 1e-6) / FORCE_BINS
    scale = 10.0 ** math.floor(math.log10(width))
    step = next(scale * nice for nice in NICE if scale * nice >= width * (1 - 1e-9))
    first = math.floor(low / step + 0.5)
    last = max(math.floor(high / step + 0.5), first + 1)
    return np.round(np.arange(first, last + 1) * step, 9)
