"""The card: everything a calibration says of itself, as JSON that is checked when it is read."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, ClassVar, Literal

from pydantic import Field, model_validator

from palpate.core import InputError, Lens, LensModel
from palpate.estimators.card_ground import CardPart, FileCard, RunCard, SealedCard, card_id
from palpate.estimators.class_sets import ClassCard
from palpate.estimators.findings import (
    ChoiceCard,
    ConfoundCard,
    CopyCard,
    Finding,
    IntervalResetCard,
    RobustnessCard,
    SessionsCard,
    TrainingCard,
)
from palpate.recordings.preparation import Preparation

FORMAT = "palpate-calibration/1"

NO_BETTER = 0.95  # ratio to the mean's error above which an estimate is uninformative


class ScoreCard(CardPart):
    """Scores of one target on held-out rows, in its unit.

    Attributes:
        r2: R²; below 0 is worse than the mean.
        mean_mae: Mean absolute error of always predicting the training mean.
        coverage_90: Ratio of rows covered by the 90 % interval.
        coverage_90_low, coverage_90_high: 95 % interval of that ratio, by groups.
        half_width: Mean half-width of the intervals.
    """

    unit: str
    n: int
    mae: float
    rmse: float
    bias: float
    r2: float
    mean_mae: float
    coverage_90: float
    coverage_90_low: float
    coverage_90_high: float
    half_width: float

    @property
    def says_nothing(self) -> bool:
        """True if the estimate is no better than the mean (within 5 %)."""
        return self.mae > NO_BETTER * self.mean_mae


class CellsCard(CardPart):
    """Bands of the scaled error, one in each cell of a range (`estimators.intervals`).

    Attributes:
        limits: Ascending limits between cells, in the target's unit; the outermost cells have no end.
        centre, half: Band of each cell, in units of the spread.
    """

    limits: tuple[float, ...]
    centre: tuple[float, ...]
    half: tuple[float, ...]

    @model_validator(mode="after")
    def _cells_fit(self) -> CellsCard:
        if not len(self.centre) == len(self.half) == len(self.limits) + 1:
            raise ValueError(f"{len(self.limits)} limits need {len(self.limits) + 1} bands")
        if any(after <= before for before, after in pairwise(self.limits)) or min(self.half) < 0:
            raise ValueError("limits of cells ascend, and half-widths of bands are 0 or more")
        return self


class TenthCard(CardPart):
    """Scored rows of one tenth of a target's range, by the truth.

    Attributes:
        covered: Rows covered by their interval.
        bias: Mean of estimate less truth.
        p: Probability of so few covered rows if the true coverage is 5 % below nominal, by groups.
    """

    start: float
    end: float
    n: int
    groups: int
    covered: int
    bias: float
    p: float


class RangeCard(CardPart):
    """Dependence of a target's intervals on its range, and limits of extrapolation.

    Attributes:
        by_truth, by_estimate: Bands of the intervals; None if groups are too few, and `quantile` holds
            everywhere.
        beyond: Distance below and above the range that an estimate may reach, in the target's unit.
        reach: The same for the ends of an interval.
    """

    by_truth: CellsCard | None
    by_estimate: CellsCard | None
    beyond: tuple[float, float]
    reach: tuple[float, float]
    tenths: tuple[TenthCard, ...]


class CircularCard(CardPart):
    """Periodic target, which the model outputs as cosine and sine.

    Attributes:
        period: Period in the target's unit.
        centre, scale: Standardization of the two outputs (`ErrorSpread`).
        untold_width: Width from which an interval is uninformative; 0 if no better than the mean, None in
            earlier cards (the period).
    """

    added: ClassVar[tuple[str, ...]] = ("untold_width",)

    period: float = Field(gt=0)
    centre: tuple[float, float]
    scale: tuple[float, float]
    untold_width: float | None = Field(default=None, ge=0)


class VectorCard(CardPart):
    """Targets whose joint region covers all of them at once.

    Attributes:
        column: Its name, quantity_unit; the readings' key.
        columns: Columns of its components, all in one unit.
        correlation: Correlation S of the errors, each in units of its own spread.
        radius: Conformal quantile of sqrt(rᵀ S⁻¹ r).
        covered: Ratio of the n scored rows inside the region.
        low, high: 95 % interval of that ratio, by groups.
    """

    column: str
    columns: tuple[str, ...] = Field(min_length=2)
    components: tuple[str, ...]
    correlation: tuple[tuple[float, ...], ...]
    radius: float = Field(gt=0)
    n: int
    covered: float
    low: float
    high: float


class InstrumentCard(CardPart):
    """Reference instrument of a target's labels, in the target's unit (`reference_instruments`).

    Attributes:
        half_width: Half-width of the interval from the standard uncertainty alone, at the calibration's
            coverage.
    """

    instrument: str
    certificate: str
    certified_on: str
    standard_uncertainty: float = Field(ge=0)
    resolution: float = Field(ge=0)
    backlash: float = Field(ge=0)
    bias_removed: float
    half_width: float = Field(ge=0)


class TargetCard(CardPart):
    """One target: calibrated range, intervals, and scores.

    Attributes:
        column: Label column, such as ``depth_mm``.
        least, greatest: Calibrated range in `unit`.
        training_mean: Mean of the training labels.
        centre, scale, typical, coefficients, quantile: See `estimators.intervals`.
        over_range: Intervals and scores along the range; None in earlier cards and for circular targets.
    """

    added: ClassVar[tuple[str, ...]] = ("over_range", "circular", "measured_by")

    column: str
    quantity: str
    unit: str
    least: float
    greatest: float
    training_mean: float
    centre: float
    scale: float = Field(gt=0)
    typical: float = Field(gt=0)
    coefficients: tuple[float, ...]
    quantile: float = Field(ge=0)
    score: ScoreCard
    over_range: RangeCard | None = None
    circular: CircularCard | None = None
    measured_by: InstrumentCard | None = None

    @property
    def period(self) -> float | None:
        """Period in `unit`; None if not circular."""
        return None if self.circular is None else self.circular.period

    @property
    def has_range_rule(self) -> bool:
        """False for cards without rules of the range."""
        return self.over_range is not None or self.circular is not None

    @property
    def untold_width(self) -> float | None:
        """Least width of an uninformative interval in `unit`: the range, or as stated for an angle."""
        if self.circular is None:
            return None if self.over_range is None else self.greatest - self.least
        stated = self.circular.untold_width
        return self.circular.period if stated is None else stated

    @property
    def is_as_unsure_as_its_range(self) -> bool:
        """True if its intervals are uninformative on average."""
        return self.untold_width is not None and 2 * self.score.half_width >= self.untold_width

    @property
    def is_read(self) -> bool:
        """False if the target is no better than the mean or as uncertain as its range."""
        return not (self.score.says_nothing or self.is_as_unsure_as_its_range)

    @property
    def is_never_valid(self) -> bool:
        """True if no reading of it is valid because it is not read."""
        return self.has_range_rule and not self.is_read


class LensCard(CardPart):
    """Lens whose distortion is corrected: `core.Lens` with its `id` and `field_rad`."""

    id: str
    field_rad: float
    model: LensModel
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, ...]
    size_px: tuple[int, int]
    max_angle_rad: float | None
    name: str

    @classmethod
    def of(cls, lens: Lens) -> LensCard:
        numbers = {key: value for key, value in lens.card().items() if key != "schema"}
        return cls(**numbers, field_rad=lens.field_rad)

    @property
    def lens(self) -> Lens:
        fields = self.model_dump(exclude={"id", "field_rad"})
        return Lens(**fields)


class InputCard(CardPart):
    """Kind of image, and how it becomes the network's input (`recordings.preparation.Preparation`).

    Attributes:
        frame_px: Height and width of the calibrated frames [px].
        delta: Whether the input is the difference from a no-contact reference.
    """

    added: ClassVar[tuple[str, ...]] = ("lens",)

    frame_px: tuple[int, int]
    size_px: tuple[int, int]
    channels: Literal[1, 3]
    crop_px: tuple[int, int, int, int] | None
    delta: bool
    beside_px: tuple[int, int, int, int] | None = None
    lens: LensCard | None = None

    @property
    def preparation(self) -> Preparation:
        lens = None if self.lens is None else self.lens.lens
        return Preparation(self.crop_px, self.size_px, self.channels, self.beside_px, lens)

    def check_lens(self, lens: Lens) -> None:
        """Refuse frames of another lens than the calibrated one."""
        if self.lens is None:
            raise InputError(
                f"the frames use lens {lens.id}, the calibration was made without a lens; omit --lens, or "
                "calibrate with it"
            )
        if self.lens.id != lens.id:
            raise InputError(
                f"the frames use lens {lens.id}, the calibration {self.lens.id}; calibrate with --lens of "
                "this one"
            )


class ReferenceCard(CardPart):
    """No-contact rows of a run.

    Attributes:
        column, value: Rows whose label column holds this value; None if the run has none.
        by: Columns within whose groups a reference holds; empty for one reference for all.
        frames: Number of such frames.
        learnt: Whether they were trained on and scored like any other.
    """

    column: str | None
    value: str | None
    by: tuple[str, ...]
    frames: int
    learnt: bool


class SplitCard(CardPart):
    """Split into training and held-out rows, and its audit."""

    added = ("audit", "block_rows", "findings")

    kind: str
    reason: str
    block_rows: int | None = None
    columns: tuple[str, ...]
    groups: int
    folds: int
    rows_learnt: int
    rows_scored: int
    clean: bool
    audit: str | None = None  # of the first cards, which state no findings
    findings: tuple[Finding, ...] | None = None
    details: dict[str, Any]

    @property
    def audit_text(self) -> str:
        """Findings of the leakage audit, in words."""
        if self.audit is not None:
            return self.audit
        if not self.findings:
            return "no held-out frame equals a trained one, and no group is on both sides"
        return "; ".join(one.text for one in self.findings)


# Rules of the steps from pixels to a reading, which `docs/how-to/read-without-palpate.md` follows. The second
# is that of cards whose labels' instruments widen readings, the third that of cards with a lens.
RULE, RULE_OF_INSTRUMENTS, RULE_OF_LENSES = "palpate-steps/1", "palpate-steps/2", "palpate-steps/3"


class StepsCard(CardPart):
    """Constants of the steps from a camera's pixels to a reading, for independent readers.

    Attributes:
        rule: Version of the steps; readers refuse unknown ones.
        grey_weights, grey_rounding, grey_shift: (weights . (red, green, blue) + rounding) >> shift is gray:
            ITU-R BT.601's 0.299, 0.587, and 0.114 in 1/32768, as OpenCV rounds them.
        smaller, larger: OpenCV interpolation if no side grows, and if one does.
        clip: Bound of the scaled outputs in the spread's terms.
        min_spread, max_spread: Bounds of the spread in units of `TargetCard.typical`.
    """

    rule: str = RULE
    grey_weights: tuple[int, int, int] = (9798, 19235, 3735)
    grey_rounding: int = 16384
    grey_shift: int = 15
    smaller: str = "INTER_AREA"
    larger: str = "INTER_LINEAR"
    clip: float = 3.0
    min_spread: float = 0.2
    max_spread: float = 5.0


class Card(SealedCard):
    """Calibration card; `id` is a hash of everything else. Fields that do not apply are None.

    Attributes:
        agreement: Largest difference between exported and trained model, relative to the range.
        seconds: Duration of the calibration since its last resumption [s].
        adapted_from: Id of the calibration whose network this one adapts to another sensor unit.
        interval_reset: Rows of another session that set the intervals.
        copy_of: Sensor unit adapted to.
        choice: Models tried, and the one chosen.
        steps: Constants of the steps from a camera's pixels to a reading.
    """

    added: ClassVar[tuple[str, ...]] = (
        "adapted_from", "vectors", "sessions", "interval_reset", "copy_of", "choice", "training",
        "robustness", "confounds", "classes", "steps",
    )  # fmt: skip

    format: Literal["palpate-calibration/1"]
    id: str
    created_utc: str
    software: dict[str, str]
    seed: int
    sensor: str
    model_name: str
    options: dict[str, Any]
    coverage: float = Field(gt=0, lt=1)
    input: InputCard
    targets: tuple[TargetCard, ...]
    model: FileCard
    guard: FileCard
    files: tuple[FileCard, ...]
    reference: ReferenceCard
    split: SplitCard
    run: RunCard
    agreement: float
    seconds: float
    adapted_from: str | None = None
    vectors: tuple[VectorCard, ...] | None = None
    sessions: SessionsCard | None = None
    interval_reset: IntervalResetCard | None = None
    copy_of: CopyCard | None = None
    choice: ChoiceCard | None = None
    training: TrainingCard | None = None
    robustness: RobustnessCard | None = None
    confounds: ConfoundCard | None = None
    classes: tuple[ClassCard, ...] | None = None
    steps: StepsCard | None = None

    @model_validator(mode="after")
    def _classes_fit(self) -> Card:
        names = [card.column for card in self.classes or ()]
        if not names and not self.targets:
            raise ValueError("it has neither a target nor a class")
        if len(set(names)) < len(names) or set(names) & set(self.columns):
            raise ValueError("a class is named as a target or another class is")
        return self

    @model_validator(mode="after")
    def _targets_fit(self) -> Card:
        t = len(self.targets) + sum(target.circular is not None for target in self.targets)
        terms = 1 + t + t * (t + 1) // 2  # of `estimators.intervals.design`
        for target in self.targets:
            if self.columns.count(target.column) > 1:
                raise ValueError(f"target {target.column} is named twice")
            if target.least > target.greatest:
                raise ValueError(f"the range of {target.column} ends before it begins")
            if len(target.coefficients) != terms:
                raise ValueError(f"{target.column} has {len(target.coefficients)} coefficients, not {terms}")
        for vector in self.vectors or ():
            if not set(vector.columns) <= set(self.columns) or vector.column in self.columns:
                raise ValueError(f"the vector {vector.column} is not made of targets, or is called as one")
            k = len(vector.columns)
            if len(vector.components) != k or [len(row) for row in vector.correlation] != [k] * k:
                raise ValueError(f"the vector {vector.column} of {k} targets has parts of other lengths")
        return self

    @property
    def columns(self) -> list[str]:
        return [target.column for target in self.targets]

    @property
    def runs(self) -> list[RunCard]:
        """Every recording that the card names."""
        parts = self.sessions.runs if self.sessions else ()
        return [self.run, *parts, *([self.interval_reset.run] if self.interval_reset else ())]

    @property
    def is_simulated(self) -> bool:
        """Whether any of the recordings is simulated."""
        return any(one.is_simulated for one in self.runs)


def sealed(content: Mapping[str, Any]) -> Card:
    """Return a card with its steps and id, from its content as keyword values."""
    told = Card(id="", **content)
    measured = any(t.measured_by is not None and t.measured_by.half_width > 0 for t in told.targets)
    rule = RULE_OF_LENSES if told.input.lens else RULE_OF_INSTRUMENTS if measured else RULE
    unsealed = told.model_copy(update={"steps": StepsCard(rule=rule)})
    return unsealed.model_copy(update={"id": card_id(unsealed.model_dump(mode="json"))})
