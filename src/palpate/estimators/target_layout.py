"""Targets and the model's outputs: one output for a plain target, cosine and sine for a circular one.

A periodic quantity jumps as a number, which a model cannot learn, but not as a point on the unit circle (C.
M. Bishop, Mixture density networks, 1994; K. V. Mardia and P. E. Jupp, Directional Statistics, 2000,
doi:10.1002/9780470316979).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.core import Float, UnitError, Values, split_column, unit

Outputs = Float[np.ndarray, "n o"]
FULL_TURN = {"deg": 360.0, "rad": 2 * math.pi}


@dataclass(frozen=True, slots=True)
class TargetLayout:
    """Order of a model's outputs; periods are in the target's unit, None if not circular."""

    periods: tuple[float | None, ...]

    @property
    def plain(self) -> bool:
        return all(period is None for period in self.periods)

    @property
    def outputs(self) -> int:
        return sum(1 if period is None else 2 for period in self.periods)

    def outputs_of(self, j: int) -> slice:
        """Return the outputs of a target."""
        start = TargetLayout(self.periods[:j]).outputs
        return slice(start, start + (1 if self.periods[j] is None else 2))

    def names(self, columns: Sequence[str]) -> tuple[str, ...]:
        """Return the outputs' names: a plain column, or ``QUANTITY_cos_ratio`` and ``…_sin_ratio``."""
        named = zip(columns, self.periods, strict=True)
        return tuple(
            name for column, period in named for name in ((column,) if period is None else _point(column))
        )

    def encoded(self, values: Values) -> Outputs:
        """Return the outputs of a perfect model for these values."""
        if self.plain:
            return values
        columns = []
        for column, period in zip(values.T, self.periods, strict=True):
            if period is None:
                columns.append(column)
            else:
                angle = 2 * np.pi * column / period
                columns += [np.cos(angle), np.sin(angle)]
        return np.stack(columns, axis=1)

    def decoded(self, outputs: Outputs) -> Values:
        """Return the estimates; circular ones are above -period/2 and up to period/2."""
        if self.plain:
            return outputs
        columns = []
        for j, period in enumerate(self.periods):
            one = outputs[:, self.outputs_of(j)]
            turn = None if period is None else period / (2 * np.pi)
            columns.append(one[:, 0] if turn is None else np.arctan2(one[:, 1], one[:, 0]) * turn)
        return np.stack(columns, axis=1)

    def differences(self, estimates: Values, true: Values) -> Values:
        """Return estimates less truths, by the shortest way for circular targets."""
        difference = estimates - true
        for j, period in enumerate(self.periods):
            if period is not None:
                difference[:, j] = (difference[:, j] + period / 2) % period - period / 2
        return difference

    def spans(self, values: Values) -> Float[np.ndarray, " o"]:
        """Return the length of each output's range, 2 for a cosine or sine."""
        spans = np.ptp(self.encoded(values), axis=0)
        for j, period in enumerate(self.periods):
            if period is not None:
                spans[self.outputs_of(j)] = 2.0
        return spans


def _point(column: str) -> tuple[str, str]:
    quantity = split_column(column)[0]
    return f"{quantity}_cos_ratio", f"{quantity}_sin_ratio"


def default_period(symbol: str) -> float:
    """Return a full turn in a unit of angle."""
    unit(symbol)
    if symbol not in FULL_TURN:
        raise UnitError(
            f"a quantity in {symbol} has no default period; give --circular phase_{symbol}=PERIOD"
        )
    return FULL_TURN[symbol]
