"""What virtual units show: errors of quantities, and how often something held, printed as they come."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import TypeVar

import numpy as np

from palpate.core import PalpateError

T = TypeVar("T")
NORMAL = 1.645  # standard deviations that 90 % of a normal law lie within


class Tally:
    """Errors of every quantity, and whether intervals held them."""

    def __init__(self) -> None:
        self._rows: dict[str, list[tuple[float, bool]]] = defaultdict(list)

    def add(self, name: str, error: float, held: bool) -> None:
        """One result."""
        self._rows[name].append((error, bool(held)))

    def interval(self, name: str, error: float, standard_deviation: float) -> None:
        """One result whose interval holds 90 % of a normal law."""
        self.add(name, error, abs(error) <= NORMAL * standard_deviation)

    def attempted(self, name: str, verb: Callable[..., T], *arguments: object) -> T | None:
        """What a function returns; None, and counted, where it refuses."""
        try:
            return verb(*arguments)
        except PalpateError as e:
            print("   refused:", name, str(e)[:100], flush=True)
            self.add(f"{name}; refused", 1.0, True)
            return None

    def __str__(self) -> str:
        lines = []
        for name, rows in self._rows.items():
            off, held = np.array(rows, float).T
            lines.append(
                f"{name}: mean absolute {np.abs(off).mean():.3g}, mean {off.mean():.3g}, greatest "
                f"{np.abs(off).max():.3g}; held or said {100 * held.mean():.0f} % of {len(held)}"
            )
        return "\n".join(lines)

    def follow(self, units: Iterable[object]) -> None:
        """Go through virtual units that are added as they are drawn, and print all after each."""
        start = time.monotonic()
        for k, _ in enumerate(units):
            print(f"\n{k + 1} units, {time.monotonic() - start:.0f} s\n{self}", flush=True)
