"""The card: everything a calibration says of itself, as JSON that is checked when it is read."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, ClassVar, Literal

from pydantic import Field, model_validator

from palpate.core import InputError, Lens, LensModel
from palpate.estimators.card_ground import CardPart, FileCard, RunCard, SealedCard, card_id
from palpate.estimators.class_sets import ClassCard
from palpate.estimators.finding_cards import (
    ChoiceCard,
    ConfoundCard,
    CopyCard,
    IntervalResetCard,
    RobustnessCard,
    SessionsCard,
    TrainingCard,
)
from palpate.estimators.findings import Finding
from palpate.estimators.reading_steps import StepsCard, reading_steps
from palpate.recordings.preparation import Preparation

FORMAT = "palpate-calibration/1"

NO_BETTER = 0.95
"""Share of the error of always saying the mean, above which an estimate says nothing."""


class ScoreCard(CardPart):
    """Scores of one target on held-out rows, in its unit.

    Attributes:
        unit: of everything here that has one.
        n: rows scored.
        mae, rmse, bias: mean absolute, root mean square and mean signed error.
        r2: share of the truth's variance explained; below 0 is worse than its mean.
        mean_mae: mean absolute error of always saying the training rows' mean.
        coverage_90: share of rows whose 90 % interval held the truth.
        coverage_90_low, coverage_90_high: 95 % interval of that share, groups counted as groups.
        half_width: mean half-width of the intervals.
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
        """True if the estimate is no better than always saying the mean (within 5 %)."""
        return self.mae > NO_BETTER * self.mean_mae


class CellsCard(CardPart):
    """Bands of the scaled error, one in each cell of a range; see `estimators.intervals`.

    Attributes:
        limits: between the cells, ascending, in the target's unit; the outermost cells have no end.
        centre, half: of each cell's band, in units of the spread.
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
        start, end: of the tenth, in the target's unit.
        n, groups: rows and their groups.
        covered: rows whose interval held the truth.
        bias: mean signed error, estimate less truth.
        p: probability of so few, or fewer, where 5 % less than was promised is covered, groups counted.
    """

    start: float
    end: float
    n: int
    groups: int
    covered: int
    bias: float
    p: float


class RangeCard(CardPart):
    """How a target's intervals follow its range, and where a reading counts as beyond it.

    Attributes:
        by_truth, by_estimate: bands that the intervals are made from; None where groups are too few to set
            them, and the target's `quantile` holds over the whole range.
        beyond: how far below and above the range an estimate may lie, in the target's unit.
        reach: how far below and above the range an interval may reach.
        tenths: scores of the range's tenths.
    """

    by_truth: CellsCard | None
    by_estimate: CellsCard | None
    beyond: tuple[float, float]
    reach: tuple[float, float]
    tenths: tuple[TenthCard, ...]


class CircularCard(CardPart):
    """A target that comes round again, which the model gives as cosine and sine.

    Attributes:
        period: after which it does, in the target's unit.
            centre, scale: of the two outputs, see `estimators.intervals.ErrorSpread`.
        untold_width: width from which on an interval tells nothing, in the target's unit: the coverage's
            share of the calibrated arc, or 0 where rows held out were told no more than always saying the
            mean tells; None in cards of before, where it is the period.
    """

    added: ClassVar[tuple[str, ...]] = ("untold_width",)

    period: float = Field(gt=0)
    centre: tuple[float, float]
    scale: tuple[float, float]
    untold_width: float | None = Field(default=None, ge=0)


class VectorCard(CardPart):
    """A vector: targets whose joint region covers all of them at once at the stated rate.

    Attributes:
        column: its name, quantity_unit; the readings' key.
        columns: of its components, all in one unit.
        components: their names.
        correlation: S of the errors, each in units of its own spread, row after row.
        radius: conformal quantile of sqrt(rᵀ S⁻¹ r).
        n: rows scored.
        covered: share of them whose truth lay in the region.
        low, high: 95 % interval of that share, groups counted as groups.
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
    """What a target's labels were measured with, see `recordings.reference_instruments`; in the target's
    unit.

    Attributes:
        instrument, certificate, certified_on, standard_uncertainty, resolution, backlash, bias_removed: as
            stated by whoever recorded them.
        half_width: of the interval, at the calibration's coverage, that the standard uncertainty alone would
            give; it is joined to the model's in every reading.
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
    """One target: what it is, where it was calibrated, how its intervals are made, how it scored.

    Attributes:
        column: the label column, e.g. ``depth_mm``.
        quantity, unit: its two halves.
        least, greatest: the calibrated range, in `unit`.
        training_mean: of the labels learnt from, in `unit`.
        centre, scale, typical, coefficients, quantile: see `estimators.certified`.
        score: on held-out folds.
        over_range: its intervals and its scores along the range; None in cards of before, and where it is
            circular.
        circular: how it comes round again; None where it does not.
        measured_by: what its labels come from; None where nothing was stated.
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
        """After which the target comes round again, in `unit`; None where it does not."""
        return None if self.circular is None else self.circular.period

    @property
    def has_range_rule(self) -> bool:
        """False on cards of before, which refuse only what lies wholly beyond the range."""
        return self.over_range is not None or self.circular is not None

    @property
    def untold_width(self) -> float | None:
        """Least width of an interval that tells nothing, in `unit`; None on cards of before.

        It is the length of the range. Intervals around directions drawn at random need only the coverage's
        share of the arc to hold as many truths as they promise, so that for an angle the card states it.
        """
        if self.circular is None:
            return None if self.over_range is None else self.greatest - self.least
        stated = self.circular.untold_width
        return self.circular.period if stated is None else stated

    @property
    def is_as_unsure_as_its_range(self) -> bool:
        """True if its intervals tell nothing on average, by their width; never on cards of before."""
        return self.untold_width is not None and 2 * self.score.half_width >= self.untold_width

    @property
    def is_read(self) -> bool:
        """False where the model does not tell it: no better than the mean, or as unsure as the range."""
        return not (self.score.says_nothing or self.is_as_unsure_as_its_range)

    @property
    def is_never_valid(self) -> bool:
        """True where no reading of it is valid, since it is not read; cards of before have no such rule."""
        return self.has_range_rule and not self.is_read


class LensCard(CardPart):
    """Lens whose bending is taken out of a frame: `core.Lens` with its `id` and `field_rad`."""

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
        """The card's part of a lens."""
        numbers = {key: value for key, value in lens.card().items() if key != "schema"}
        return cls(**numbers, field_rad=lens.field_rad)

    @property
    def lens(self) -> Lens:
        """The lens of these numbers."""
        fields = self.model_dump(exclude={"id", "field_rad"})
        return Lens(**fields)


class InputCard(CardPart):
    """Kind of image that is read, and how it becomes the network's input.

    Attributes:
        frame_px: (height, width) of the frames calibrated on [px].
        size_px, channels, crop_px, beside_px, lens: see `recordings.preparation.Preparation`.
        delta: whether the input is the difference from a no-contact reference.
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
        """The preparation that makes it so."""
        lens = None if self.lens is None else self.lens.lens
        return Preparation(self.crop_px, self.size_px, self.channels, self.beside_px, lens)

    def check_lens(self, lens: Lens) -> None:
        """Refuse frames that came through another lens than those calibrated on.

        Frames do not tell their lens, so that whoever gives them has to.

        Raises:
            InputError: the numbers of both are not the same, or the calibration took frames as they are.
        """
        if self.lens is None:
            raise InputError(
                f"the frames come through lens {lens.id}, and the calibration was made without a lens: it "
                "takes frames as the camera gives them. Leave --lens out for those, or calibrate with it"
            )
        if self.lens.id != lens.id:
            raise InputError(
                f"the frames come through lens {lens.id}, and the calibration was made through lens "
                f"{self.lens.id}: its numbers hold for that camera alone. Calibrate with --lens of this one"
            )


class ReferenceCard(CardPart):
    """Rows of a run that show the untouched sensor.

    Attributes:
        column, value: rows where the label column holds this value; None where the run has none.
        by: columns within whose groups a reference holds; empty for one reference for all.
        frames: how many such frames the calibration had.
        learnt: whether they were learnt from, and are scored, like any other.
    """

    column: str | None
    value: str | None
    by: tuple[str, ...]
    frames: int
    learnt: bool


class SplitCard(CardPart):
    """Split by which rows were held out, numbers of rows learnt from and scored, and the audit."""

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
        """What the leakage audit found, in words."""
        if self.audit is not None:
            return self.audit
        if not self.findings:
            return "no held-out frame equals a trained one, and no group is on both sides"
        return "; ".join(one.text for one in self.findings)


class Card(SealedCard):
    """All of it. `id` is a hash of everything else, so no word can change unnoticed.

    Attributes:
        agreement: largest difference between the exported and the trained model, as a share of range.
        seconds: time the calibration took, since it was last taken up [s].
        adapted_from: id of the calibration whose network this one corrects to another copy of its sensor;
            None where it is a calibration of its own.
        vectors: targets that are also read together; None where there are none.
        sessions: what was learnt from, session by session; None on cards from before they were told apart.
        interval_reset: what set the intervals anew; None where that were the rows held out.
        copy_of: the copy adapted to; None where it was not adapted, or before copies were told apart.
        choice: what the model tried, and what it took; None where it had nothing to choose.
        training: how long the network has learnt; None where the model does not say.
        robustness: against changes of the camera; None in cards of before, and in adapted ones.
        confounds: audit of what other than touch could have told the labels; None where none was made.
        classes: labels of classes, whose outputs stand behind the targets'; None where there are none.
        steps: from a camera's pixels to a reading; None on a card from before it said so.
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
        """The targets' columns, in the model's order."""
        return [target.column for target in self.targets]

    @property
    def runs(self) -> list[RunCard]:
        """Every recording that it has part of its content from, as far as it names them.

        What an adapted calibration was adapted from is told by that one's own card.
        """
        parts = self.sessions.runs if self.sessions else ()
        return [self.run, *parts, *([self.interval_reset.run] if self.interval_reset else ())]

    @property
    def is_simulated(self) -> bool:
        """Whether a virtual sensor gave a recording of these."""
        return any(one.is_simulated for one in self.runs)


def sealed(content: Mapping[str, Any]) -> Card:
    """A card with its steps and its id set from its content (given as keyword values, without `id`)."""
    told = Card(id="", **content)
    unsealed = told.model_copy(update={"steps": reading_steps(told)})
    return unsealed.model_copy(update={"id": card_id(unsealed.model_dump(mode="json"))})
