"""Intervals around a network's outputs: how large an error is to be expected, and what holds the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core import Bool, Float, Shaped, Values
from palpate.estimators.intervals.range_intervals import ErrorCells, RangeIntervals
from palpate.estimators.model_card import Card, CellsCard, TargetCard
from palpate.estimators.target_layout import Outputs, TargetLayout

MIN_RATIO, MAX_RATIO = 0.2, 5.0
"""The spread is held between these multiples of the typical error: a quadratic fitted inside the
calibrated range must not run away outside it."""


def design(scaled: Values) -> Float[np.ndarray, "n k"]:
    """Terms of a quadratic in the scaled values: 1, each value, each product of two."""
    n, t = scaled.shape
    first, second = np.triu_indices(t)
    return np.concatenate([np.ones((n, 1)), scaled, scaled[:, first] * scaled[:, second]], axis=1)


@dataclass(frozen=True, slots=True)
class ErrorSpread:
    """Expected error size: log spread is a quadratic in the model's outputs (`TargetLayout`).

    Attributes:
        centre, scale: Standardization of the outputs ``[o]``.
        typical: Mean absolute held-out error ``[t]``.
        coefficients: Coefficients of log(spread / typical) ``[t k]``, see `design`.
    """

    centre: Float[np.ndarray, " o"]
    scale: Float[np.ndarray, " o"]
    typical: Float[np.ndarray, " t"]
    coefficients: Float[np.ndarray, "t k"]

    def at(self, values: Outputs) -> Values:
        """The spread ``[n t]`` at these outputs of the model ``[n o]``, in the targets' units."""
        scaled = np.clip((values - self.centre) / self.scale, -3.0, 3.0)
        ratio = np.exp(np.clip(design(scaled) @ self.coefficients.T, np.log(MIN_RATIO), np.log(MAX_RATIO)))
        return self.typical * ratio


@dataclass(frozen=True, slots=True)
class Intervals:
    """Intervals with half-width quantile · spread, or with constant coverage over the range.

    Attributes:
        quantile: Conformal quantile of the scaled held-out errors ``[t]``.
        by_range: `RangeIntervals` of each target; None for one quantile over its range, empty if all have
            one.
        layout: Layout of the targets in the outputs; None if each is one.
    """

    spread: ErrorSpread
    quantile: Float[np.ndarray, " t"]
    coverage: float
    by_range: tuple[RangeIntervals | None, ...] = ()
    layout: TargetLayout | None = None

    def half_widths(self, values: Outputs) -> Values:
        """Half-width ``[n t]`` of the interval with one quantile, around the estimate of each output."""
        return self.quantile * self.spread.at(values)

    def ends(self, outputs: Outputs) -> tuple[Values, Values]:
        """Return the ends ``[n t]`` in the targets' units; circular ones continue beyond half a period."""
        estimate, spread, half = self.estimates(outputs), self.spread.at(outputs), self.half_widths(outputs)
        low, high = estimate - half, estimate + half
        for j, one in enumerate(self.by_range):
            if one is not None:
                low[:, j], high[:, j] = one.ends(estimate[:, j], spread[:, j], half[:, j])
        return low, high

    def estimates(self, outputs: Outputs) -> Values:
        return outputs if self.layout is None else self.layout.decoded(outputs)

    def errors(self, outputs: Outputs, true: Values) -> Values:
        """Estimates less truths ``[n t]``, the shortest way round where a target is circular."""
        estimate = self.estimates(outputs)
        return estimate - true if self.layout is None else self.layout.differences(estimate, true)

    def hold(self, outputs: Outputs, true: Values) -> Bool[np.ndarray, "n t"]:
        """Tell where each interval holds the truth, its ends included."""
        inside = np.abs(self.errors(outputs, true)) <= self.half_widths(outputs)
        low, high = self.ends(outputs)
        for j, one in enumerate(self.by_range):
            if one is not None:
                inside[:, j] = within(true[:, j], low[:, j], high[:, j])
        return inside


ROUNDING = 1e-9  # of an interval's length: a truth at its very end, computed another way, counts as held


def within(
    true: Shaped[np.ndarray, " n"], low: Shaped[np.ndarray, " n"], high: Shaped[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Tell which truths lie in their intervals, but for rounding."""
    slack = ROUNDING * (high - low)
    return np.asarray((low - slack <= true) & (true <= high + slack))


def layout_of(card: Card) -> TargetLayout:
    """The order of the model's outputs that a card states."""
    return TargetLayout(tuple(target.period for target in card.targets))


def intervals_of(card: Card) -> Intervals:
    """The intervals that a card describes."""
    targets = card.targets
    centres = [(), *((t.centre,) if t.circular is None else t.circular.centre for t in targets)]
    scales = [(), *((t.scale,) if t.circular is None else t.circular.scale for t in targets)]
    spread = ErrorSpread(
        np.concatenate(centres),
        np.concatenate(scales),
        np.array([t.typical for t in targets]),
        np.array([t.coefficients for t in targets]) if targets else np.empty((0, 1)),
    )
    by_range = tuple(map(_range_intervals, targets))
    return Intervals(
        spread, np.array([t.quantile for t in targets]), card.coverage, by_range, layout_of(card)
    )


def _range_intervals(target: TargetCard) -> RangeIntervals | None:
    stated = target.over_range
    if stated is None or stated.by_truth is None or stated.by_estimate is None:
        return None
    return RangeIntervals(_error_cells(stated.by_truth), _error_cells(stated.by_estimate))


def _error_cells(stated: CellsCard) -> ErrorCells:
    return ErrorCells(*(np.array(part, np.float64) for part in (stated.limits, stated.centre, stated.half)))
