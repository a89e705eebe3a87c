"""A Reading: a measured quantity that says how far it can be trusted."""

from __future__ import annotations

from dataclasses import dataclass, replace

from palpate.core.errors import UnitError
from palpate.core.units import unit


@dataclass(frozen=True, slots=True)
class Drift:
    """How far the untouched sensor has moved from what it was at calibration.

    Attributes:
        statistic: distance of the no-contact image from the calibration's, in units of the spread among
            the calibration's own no-contact images; around 1 when nothing has changed.
        limit: the statistic above which the calibration is stale.
    """

    statistic: float
    limit: float

    @property
    def drifted(self) -> bool:
        """Whether the sensor must be re-zeroed or calibrated anew."""
        return self.statistic > self.limit


@dataclass(frozen=True, slots=True)
class Reading:
    """One quantity read from one frame.

    Attributes:
        quantity: what was measured, e.g. ``depth``.
        value: the estimate, in `unit`.
        low, high: the interval around it, in `unit`.
        unit: SI until `in_unit` converts it for the edges.
        coverage: how often such intervals hold the truth, by calibration (0.9 is nine in ten).
        calibrated_range: least and greatest value the calibration saw, in `unit`.
        valid: False when the value should not be used.
        why: why it should not be; empty when valid.
        drift: of the sensor since calibration; None where no no-contact image was given or kept.
        calibration: id of the calibration that made the estimate.
        frame: name of the frame it was read from.
        time_s: that frame's capture time [s].
    """

    quantity: str
    value: float
    low: float
    high: float
    unit: str
    coverage: float
    calibrated_range: tuple[float, float]
    valid: bool
    why: str
    drift: Drift | None
    calibration: str
    frame: str
    time_s: float

    @property
    def column(self) -> str:
        """The name at the edges, with the unit in it: ``depth_mm``."""
        return f"{self.quantity}_{self.unit}"

    def in_unit(self, symbol: str) -> Reading:
        """The same reading in another unit of the same quantity.

        Raises:
            UnitError: the unit measures something else.
        """
        old, new = unit(self.unit), unit(symbol)
        if old.si != new.si:
            raise UnitError(f"{self.quantity} is in {self.unit}, which cannot be shown in {symbol}")

        def convert(value: float) -> float:
            return new.from_si(old.to_si(value))

        least, greatest = self.calibrated_range
        return replace(
            self,
            value=convert(self.value),
            low=convert(self.low),
            high=convert(self.high),
            unit=symbol,
            calibrated_range=(convert(least), convert(greatest)),
        )

    def __str__(self) -> str:
        half = (self.high - self.low) / 2
        verdict = "inside the calibrated range" if self.valid else self.why
        return f"{self.quantity} {self.value:.3g} {self.unit} ± {half:.2g} {self.unit}, {verdict}"
