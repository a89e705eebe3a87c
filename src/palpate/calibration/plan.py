"""What a calibration is asked to do: one frozen page, saved with the result."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from palpate.core.errors import InputError


@dataclass(frozen=True, slots=True)
class Reference:
    """Which rows show the untouched sensor.

    Attributes:
        column, value: rows where a label column holds this value (compared as a number where both are).
        by: a reference holds within the groups of these columns; empty for one reference for all.
    """

    column: str
    value: str
    by: tuple[str, ...] = ()

    @classmethod
    def parse(cls, text: str, by: tuple[str, ...] = ()) -> Reference:
        """Read ``column=value``, e.g. ``mass_g=0``.

        Raises:
            InputError: it is not of that form.
        """
        column, equals, value = text.partition("=")
        if not (column and equals and value):
            raise InputError(f"reference {text!r} is not COLUMN=VALUE, as in mass_g=0 or touched=false")
        return cls(column.strip(), value.strip(), by)


@dataclass(frozen=True, slots=True)
class Plan:
    """One calibration.

    Attributes:
        targets: label columns to estimate, named quantity_unit.
        model: a name from `estimators.networks.MODELS`.
        split: how rows are held out, see `recordings.splits.split`.
        folds: how many parts, where the split does not fix it; None takes five, or eight where the model is
            costly to train.
        scored_folds: how many of them are held out in turn; None takes all, or one where the model is costly
            to train and one fold gives scores enough. With one, the model that was scored is the one kept.
        seed: of everything random.
        size_px: (height, width) of the network's input [px]; None takes the model's own.
        channels: 1 for grey, 3 for RGB.
        crop_px: (x, y, width, height) cut from each frame first [px].
        beside_px: a second such crop, laid to the right of the first [px].
        delta: learn from the difference to a no-contact reference.
        reference: which rows are that reference.
        learn_untouched: learn from (and score) those rows too, as from any other.
        coverage: how often intervals shall hold the truth.
        options: the model's own fields, by name.
    """

    targets: tuple[str, ...]
    model: str = "pca-ridge"
    split: str = "auto"
    folds: int | None = None
    scored_folds: int | None = None
    seed: int = 0
    size_px: tuple[int, int] | None = None
    channels: Literal[1, 3] = 1
    crop_px: tuple[int, int, int, int] | None = None
    beside_px: tuple[int, int, int, int] | None = None
    delta: bool = False
    reference: Reference | None = None
    learn_untouched: bool = False
    coverage: float = 0.9
    options: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.targets:
            raise InputError("no target to calibrate; name label columns, as in --targets depth_mm,force_N")
        repeated = sorted({t for t in self.targets if self.targets.count(t) > 1})
        if repeated:
            raise InputError(f"targets named twice: {', '.join(repeated)}; name each once")
        if self.scored_folds is not None and self.scored_folds < 1:
            raise InputError(f"{self.scored_folds} folds to score; at least 1 must be held out")
        if not 0.5 <= self.coverage < 1:
            raise InputError(f"coverage is {self.coverage}; it is a rate from 0.5 up to, not including, 1")

    def to_dict(self) -> dict[str, Any]:
        """As plain values for JSON."""
        return asdict(self)
