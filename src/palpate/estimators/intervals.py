"""Intervals of readings: from held-out errors, over the range of a target, and for a vector as a whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from palpate.core import (
    Bool,
    CircularReading,
    Float,
    InputError,
    Int,
    Reading,
    Shaped,
    Values,
    VectorReading,
    split_column,
)
from palpate.core.reading import Ellipsoid, provenance
from palpate.estimators.class_sets import Outputs, TargetLayout
from palpate.estimators.model_card import Card, CellsCard, InstrumentCard, TargetCard, VectorCard

Row = Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True)
class ErrorCells:
    """Bands of the scaled error, one in each cell of a range; the outermost cells have no end.

    Attributes:
        limits: Ascending limits between cells, in the target's unit.
        centre, half: Band of each cell in units of the spread; a half of 0 is no band.
    """

    limits: Float[np.ndarray, " m"]
    centre: Float[np.ndarray, " k"]
    half: Float[np.ndarray, " k"]

    def cells(self, values: Row) -> Int[np.ndarray, " n"]:
        return np.searchsorted(self.limits, values, side="right")

    def of_estimates(self, estimate: Row, spread: Row) -> tuple[Row, Row]:
        """Return the ends of the band of each estimate's cell; inf and -inf without one."""
        at = self.cells(estimate)
        middle, half = estimate + spread * self.centre[at], spread * self.half[at]
        some = half > 0
        return np.where(some, middle - half, np.inf), np.where(some, middle + half, -np.inf)

    def of_truths(self, estimate: Row, spread: Row) -> tuple[Row, Row]:
        """Return the least and greatest truth that its own cell's band keeps; inf and -inf without one."""
        middle, reach = estimate[:, None] + spread[:, None] * self.centre, spread[:, None] * self.half
        least, greatest = middle - reach, middle + reach
        least[:, 1:] = np.maximum(least[:, 1:], self.limits)
        greatest[:, :-1] = np.minimum(greatest[:, :-1], self.limits)
        kept = (least <= greatest) & (self.half > 0)
        return np.where(kept, least, np.inf).min(axis=1), np.where(kept, greatest, -np.inf).max(axis=1)


@dataclass(frozen=True, slots=True)
class RangeIntervals:
    """Intervals with the nominal coverage in every cell of truths and of estimates.

    A truth is kept if the band of its cell of truths holds its scaled error r = (truth - estimate) / spread,
    |r - centre| <= half (label-conditional conformal prediction: V. Vovk, A. Gammerman and G. Shafer,
    Algorithmic Learning in a Random World, 2005, ch. 4.5, doi:10.1007/b106715); cells of estimates likewise
    (Mondrian conformal regression: H. Boström and U. Johansson, Proc. Mach. Learn. Res. 128, 114 (2020)). The
    interval is the smallest that holds both and the one of constant width. Bands come from
    `calibration.coverage.conformal`.
    """

    by_truth: ErrorCells
    by_estimate: ErrorCells

    def ends(self, estimate: Row, spread: Row, half: Row) -> tuple[Row, Row]:
        """Return the ends of the interval around each estimate, low <= estimate <= high.

        Args:
            estimate: Estimate in the target's unit.
            spread: Expected error size.
            half: Half-width of the interval of constant width.
        """
        low, high = estimate - half, estimate + half
        for least, greatest in (
            self.by_truth.of_truths(estimate, spread),
            self.by_estimate.of_estimates(estimate, spread),
        ):
            low, high = np.minimum(low, least), np.maximum(high, greatest)
        return low, high


MIN_RATIO, MAX_RATIO = 0.2, 5.0
"""The spread is held between these multiples of the typical error: a quadratic fitted inside the
calibrated range must not run away outside it."""


def design(scaled: Values) -> Float[np.ndarray, "n k"]:
    """Return the terms of a quadratic in the scaled values: 1, values, products."""
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
        """Return the spread ``[n t]`` at these outputs ``[n o]``, in the targets' units."""
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
        """Return half-widths ``[n t]`` of the intervals of constant quantile."""
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
        """Return estimates less truths ``[n t]``, by the shortest way for circular targets."""
        estimate = self.estimates(outputs)
        return estimate - true if self.layout is None else self.layout.differences(estimate, true)

    def hold(self, outputs: Outputs, true: Values) -> Bool[np.ndarray, "n t"]:
        """Return whether each interval covers the truth, ends included."""
        inside = np.abs(self.errors(outputs, true)) <= self.half_widths(outputs)
        low, high = self.ends(outputs)
        for j, one in enumerate(self.by_range):
            if one is not None:
                inside[:, j] = within(true[:, j], low[:, j], high[:, j])
        return inside


ROUNDING = 1e-9  # tolerance at an interval's ends, relative to its length


def within(
    true: Shaped[np.ndarray, " *n"], low: Shaped[np.ndarray, " *n"], high: Shaped[np.ndarray, " *n"]
) -> Bool[np.ndarray, " *n"]:
    """Return whether truths lie in their intervals, except for rounding."""
    slack = ROUNDING * (high - low)
    return np.asarray((low - slack <= true) & (true <= high + slack))


def layout_of(card: Card) -> TargetLayout:
    """Return the order of the model's outputs of a card."""
    return TargetLayout(tuple(target.period for target in card.targets))


def intervals_of(card: Card) -> Intervals:
    """Return the intervals that a card describes."""
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


def mahalanobis(
    scaled: Float[np.ndarray, "n k"], correlation: Float[np.ndarray, "k k"]
) -> Float[np.ndarray, " n"]:
    """Return distances sqrt(rᵀ S⁻¹ r) of errors r in units of their spread.

    P. C. Mahalanobis, Proc. Natl. Inst. Sci. India 2, 49 (1936); as a conformal score: C. Johnstone and B.
    Cox, Proc. Mach. Learn. Res. 152, 72 (2021).
    """
    solved = np.linalg.solve(correlation, scaled.T).T
    return np.sqrt(np.maximum(np.sum(scaled * solved, axis=1), 0.0))


@cache
def joint_reach(components: int, coverage: float) -> float:
    """Return the radius of the ball that holds several standard normal errors with a coverage.

    It is the quantile of the chi distribution (JCGM 102:2011, doi:10.59161/JCGM102-2011).

    Example:
        >>> [round(joint_reach(k, 0.9), 4) for k in (1, 2, 3)]
        [1.6449, 2.146, 2.5003]
    """
    from scipy.special import chdtri  # here, since few cards need it, and sensing starts without scipy

    return float(chdtri(components, 1 - coverage)) ** 0.5


def vector_reading(
    vector: VectorCard,
    parts: Sequence[Reading | CircularReading | VectorReading],
    spread: Float[np.ndarray, " k"] | None,
    measured_by: Sequence[InstrumentCard | None] = (),
) -> VectorReading:
    """Return the vector of some readings, with its joint region.

    Args:
        vector: Card of the vector.
        parts: Readings of its components, in SI.
        spread: Expected error size of each, in the targets' unit; None if nothing was read.
        measured_by: Instruments of the labels, whose uncertainty the region includes.
    """
    quantity, unit = split_column(vector.column)
    sizes = np.ones(len(parts)) if spread is None else unit.to_si(spread)
    covariance = np.array(vector.correlation) * np.outer(sizes, sizes)
    for k, instrument in enumerate(measured_by):
        if instrument is not None and instrument.standard_uncertainty > 0:
            reach = joint_reach(len(parts), parts[0].coverage)  # of all of them: more than that of one
            covariance[k, k] += (reach * unit.to_si(instrument.standard_uncertainty) / vector.radius) ** 2
    whys = dict.fromkeys(part.why for part in parts if part.why)
    codes = dict.fromkeys(part.code for part in parts if part.code)
    first = provenance(parts[0]) | {"valid": not whys, "why": "; ".join(whys), "code": "; ".join(codes)}
    ranges = [part.calibrated_range for part in parts if isinstance(part, Reading)]
    return VectorReading(
        quantity=quantity,
        components=vector.components,
        value=np.array([part.value for part in parts if isinstance(part, Reading)]),
        region=Ellipsoid((covariance + covariance.T) / 2, vector.radius),
        calibrated_range=np.array(ranges).T,
        **first,
    )


def component_names(name: str, parts: Sequence[str]) -> tuple[str, ...]:
    """Return the names of a vector's components: what follows the vector's own name, or their whole quantity.

    Example:
        >>> component_names("force_N", ("force_x_N", "force_y_N"))
        ('x', 'y')
    """
    own = f"{split_column(name)[0]}_"
    return tuple(split_column(part)[0].removeprefix(own) for part in parts)


def vector_column(name: str, parts: Sequence[str], targets: Sequence[str]) -> str:
    """Return a vector's column: its name, such as ``force``, with the common unit of its components."""
    if not name:
        raise InputError(
            f"a vector of {', '.join(parts)} has no name; give it one, such as force", code="vector-name"
        )
    if len(parts) < 2 or len(set(parts)) < len(parts):
        raise InputError(
            f"vector {name}: {', '.join(parts)}; it has two components or more, each once", code="vector-size"
        )
    if strangers := [part for part in parts if part not in targets]:
        raise InputError(
            f"vector {name}: {', '.join(strangers)} not among the targets {', '.join(targets)}",
            code="no-target",
        )
    units = {split_column(part)[1].symbol for part in parts}
    if len(units) > 1:
        raise InputError(
            f"vector {name} has components in {', '.join(sorted(units))}; give one unit", code="vector-units"
        )
    (symbol,) = units
    column = name if name.endswith(f"_{symbol}") else f"{name}_{symbol}"
    if column in targets:
        raise InputError(
            f"vector {name}: {column} is a target already; choose another name", code="name-taken"
        )
    return column
