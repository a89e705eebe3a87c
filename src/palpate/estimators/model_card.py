"""The card: everything a calibration says of itself, as JSON that is checked when it is read."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, model_serializer, model_validator

from palpate.recordings.preparation import Preparation

FORMAT = "palpate-calibration/1"


class _CardPart(BaseModel):
    """Part of a card.

    Attributes:
        added: fields that came later, a parent class's too; one that is None is left out of the text, so
            that older cards keep the text that gave their id.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, ser_json_inf_nan="constants")
    added: ClassVar[tuple[str, ...]] = ()

    @model_serializer(mode="wrap")
    def _dumped(self, dump: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        return {k: v for k, v in dump(self).items() if v is not None or k not in self.added}


class ScoreCard(_CardPart):
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
        return self.mae > 0.95 * self.mean_mae


class CellsCard(_CardPart):
    """Bands of the scaled error, one in each cell of a range; see `estimators.range_intervals`.

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


class TenthCard(_CardPart):
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


class RangeCard(_CardPart):
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


class CircularCard(_CardPart):
    """A target that comes round again, which the model gives as cosine and sine.

    Attributes:
        period: after which it does, in the target's unit.
        centre, scale: of the two outputs, see `estimators.certified.ErrorSpread`.
    """

    period: float = Field(gt=0)
    centre: tuple[float, float]
    scale: tuple[float, float]


class VectorCard(_CardPart):
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


class InstrumentCard(_CardPart):
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


class TargetCard(_CardPart):
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


class FileCard(_CardPart):
    """A file that belongs to the calibration, and the hash of its bytes."""

    file: str = Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$")
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class InputCard(_CardPart):
    """Kind of image that is read, and how it becomes the network's input.

    Attributes:
        frame_px: (height, width) of the frames calibrated on [px].
        size_px, channels, crop_px, beside_px: see `recordings.preparation.Preparation`.
        delta: whether the input is the difference from a no-contact reference.
    """

    frame_px: tuple[int, int]
    size_px: tuple[int, int]
    channels: Literal[1, 3]
    crop_px: tuple[int, int, int, int] | None
    delta: bool
    beside_px: tuple[int, int, int, int] | None = None

    @property
    def preparation(self) -> Preparation:
        """The preparation that makes it so."""
        return Preparation(self.crop_px, self.size_px, self.channels, self.beside_px)


class ReferenceCard(_CardPart):
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


class SplitCard(_CardPart):
    """Split by which rows were held out, numbers of rows learnt from and scored, and the audit."""

    kind: str
    reason: str
    columns: tuple[str, ...]
    groups: int
    folds: int
    rows_learnt: int
    rows_scored: int
    clean: bool
    audit: str
    details: dict[str, Any]


class ConfoundFindingCard(_CardPart):
    """Finding of the confound audit: a sentence, and what to do.

    Attributes:
        kind: ``rows shifted``, ``outside``, ``burnt in``, ``order`` or ``function``.
        target: column it is about; empty where it is about all.
        severity: ``fails`` where scores cannot be relied on, ``warns`` where they say less than they seem to,
            ``notes`` where nothing came of it.
        text, remedy: sentences without their full stop.
    """

    kind: str
    target: str
    severity: Literal["fails", "warns", "notes"]
    text: str
    remedy: str


class TargetConfoundCard(_CardPart):
    """What other than touch tells of one target, beside the model; shares of variance (R²), held out.

    Attributes:
        column: of the target.
        rank_correlation: Spearman's, with the row's number.
        order_r2: told by a smooth function of order or time.
        order_level: share of shufflings of whole presses that tell as much.
        model_r2: told by the model from the whole picture.
        outside_r2, outside_r2_blocks: told by what lies outside the skin, on the calibration's folds and on
            short interleaved blocks; None where there is no outside.
        inside_r2: told by the skin, asked as the outside is.
    """

    column: str
    rank_correlation: float
    order_r2: float
    order_level: float
    model_r2: float
    outside_r2: float | None
    outside_r2_blocks: float | None
    inside_r2: float | None


class ConfoundCard(_CardPart):
    """Audit of what other than touch could have told the labels.

    Attributes:
        failed: whether the scores cannot be relied on.
        findings: the gravest first.
        targets: what was asked of each.
        outside_share: share of the prepared picture that lies outside the skin; None where none was found.
        outside: how the outside was found, or why there is none.
        skin_px: box (x, y, width, height) around the skin [px of the recorded frame].
        row_lag: rows by which labels come later than the images that they fit; 0 as it should be.
        map_file: array ``[t y x]`` of the growth of each target's mean absolute error, in its unit, where a
            block of the picture shows nothing; None where there is none.
        map_rows: held-out rows that it is the mean of.
    """

    failed: bool
    findings: tuple[ConfoundFindingCard, ...]
    targets: tuple[TargetConfoundCard, ...]
    outside_share: float | None
    outside: str
    skin_px: tuple[int, int, int, int] | None
    row_lag: int
    map_file: str | None
    map_rows: int | None


class RunCard(_CardPart):
    """Recording that was learnt from."""

    run_id: str
    hash: str
    frames: int
    origin: str
    licence: str


class SessionErrorCard(_CardPart):
    """Errors of one target from session to session, in its unit.

    Attributes:
        between: standard deviation of the sessions' mean errors about no error.
        within: standard deviation of errors within a session.
        coverage_least: the lowest coverage of any session that was held out, by the intervals of this card.
    """

    between: float
    within: float
    coverage_least: float


class SessionsCard(_CardPart):
    """Sessions that were learnt from, and what that promises of another one.

    Attributes:
        column: what tells them apart: ``session``, or ``sensor`` or ``copy`` where copies were held out.
        names: of the sessions (or copies) learnt from.
        runs: the recordings, where there are several.
        held_out: how many were held out whole and scored; 0 where none was.
        rule: how the intervals were made: ``one session`` (for rows like those of the sessions learnt
            from), ``parametric`` or ``distribution-free`` (for a new session).
        rank: of the score among one from each session, where the rule is distribution-free.
        factor: by which few sessions widen the intervals, where it is parametric.
        errors: of each target's column, where sessions were held out.
        findings: what stands against the promise, in sentences.
        text: the promise, in words.
    """

    column: str
    names: tuple[str, ...]
    runs: tuple[RunCard, ...]
    held_out: int
    rule: Literal["one session", "parametric", "distribution-free"]
    rank: int | None
    factor: float | None
    errors: dict[str, SessionErrorCard]
    findings: tuple[str, ...]
    text: str


class SplitScoreCard(_CardPart):
    """Scores by one way of holding rows out.

    Attributes:
        kind: the split, as a person would type it.
        folds, rows: how many, and how many rows were scored.
        mae, r2, coverage: of each target's column; the coverage is that of this card's intervals.
        order_r2: of each target's column, the share of its variance that a row's nearest neighbour in order
            explains, of those that were trained on: what the clock alone tells.
        meaningless: targets' columns whose scores by this split say nothing of new rows.
    """

    kind: str
    folds: int
    rows: int
    mae: dict[str, float]
    r2: dict[str, float]
    coverage: dict[str, float]
    order_r2: dict[str, float]
    meaningless: tuple[str, ...]


class OrderCard(_CardPart):
    """Shuffled folds and short blocks of the order in which rows were taken, side by side.

    Attributes:
        splits: scores by each; the first is the card's own.
        rank_correlation: Spearman's, of each target's column with the row's number.
        text: what the two say, in words; and what was left out.
    """

    splits: tuple[SplitScoreCard, ...]
    rank_correlation: dict[str, float]
    text: str


class IntervalResetCard(_CardPart):
    """Rows of a new session that set the intervals anew, the network being that of another calibration.

    Attributes:
        calibration: id of that calibration.
        run: the recording of the new session.
        session: its name.
        rows, groups: how many set the intervals, and how many groups (presses) they are of.
        rank: of the score, among one from each group.
        coverage_mean, coverage_low, coverage_high: coverage to expect in that session: its mean over
            drawings of so many groups, and the range that holds 95 of 100 of them.
        text: all of it in words.
    """

    calibration: str
    run: RunCard
    session: str
    rows: int
    groups: int
    rank: int
    coverage_mean: float
    coverage_low: float
    coverage_high: float
    text: str


class CopyCard(_CardPart):
    """Copy of the sensor that a calibration was adapted to, and how its frames are told from the former's.

    Attributes:
        name: of this copy, and of the `former` one.
        run_id: of this copy's recording.
        file: what tells the two apart.
        refused_own: share of this copy's frames that it turned away, each judged without its own press.
        refused_former: share of the former copy's frames that it turned away.
        text: what that means, in words.
    """

    name: str
    former: str
    run_id: str
    file: FileCard | None
    refused_own: float
    refused_former: float
    text: str


class TrialCard(_CardPart):
    """One way that a model tried on inner folds, see `estimators.networks.model_interface.Trial`."""

    name: str
    error: float | None
    seconds: float
    note: str


class ChoiceCard(_CardPart):
    """Choice that the model that is kept made by inner folds of the rows it learnt from."""

    chosen: str
    trials: tuple[TrialCard, ...]


class PerturbationCard(_CardPart):
    """Held-out frames changed by one kind of perturbation at one size.

    Attributes:
        kind, size, unit: see `calibration.robustness`.
        frames: so many were changed.
        error_ratio: mean absolute error over that of unchanged frames, the mean over the targets.
        covered: share of readings whose interval held the truth.
        beyond: share of readings whose error was beyond twice the half-width.
        refused: share of frames that the guard refused, by examples of other frames.
        silent: share of readings beyond twice the half-width and not refused.
    """

    kind: str
    size: float
    unit: str
    frames: int
    error_ratio: float
    covered: float
    beyond: float
    refused: float
    silent: float


class RobustnessCard(_CardPart):
    """What changes of the camera cost the model, and what the guard does about them.

    Attributes:
        text: of it, or why it was not tried.
        frames: unchanged held-out frames that all is compared with.
        refused, beyond: of these, as in `PerturbationCard`.
        table: a row for each kind and size; empty where frames were too few.
    """

    text: str
    frames: int
    refused: float
    beyond: float
    table: tuple[PerturbationCard, ...]


class Card(_CardPart):
    """All of it. `id` is a hash of everything else, so no word can change unnoticed.

    Attributes:
        agreement: largest difference between the exported and the trained model, as a share of range.
        seconds: time the calibration took, since it was last taken up [s].
        adapted_from: id of the calibration whose network this one corrects to another copy of its sensor;
            None where it is a calibration of its own.
        vectors: targets that are also read together; None where there are none.
        sessions: what was learnt from, session by session; None on cards from before they were told apart.
        order: the split beside another one; None where rows come in groups.
        interval_reset: what set the intervals anew; None where that were the rows held out.
        copy_of: the copy adapted to; None where it was not adapted, or before copies were told apart.
        choice: what the model tried, and what it took; None where it had nothing to choose.
        robustness: against changes of the camera; None in cards of before, and in adapted ones.
        confounds: audit of what other than touch could have told the labels; None where none was made.
    """

    added: ClassVar[tuple[str, ...]] = (
        "adapted_from", "vectors", "sessions", "order", "interval_reset", "copy_of", "choice",
        "robustness", "confounds",
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
    targets: tuple[TargetCard, ...] = Field(min_length=1)
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
    order: OrderCard | None = None
    interval_reset: IntervalResetCard | None = None
    copy_of: CopyCard | None = None
    choice: ChoiceCard | None = None
    robustness: RobustnessCard | None = None
    confounds: ConfoundCard | None = None

    @model_validator(mode="after")
    def _targets_fit(self) -> Card:
        t = len(self.targets) + sum(target.circular is not None for target in self.targets)
        terms = 1 + t + t * (t + 1) // 2  # of `estimators.certified.design`
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


def card_id(content: Mapping[str, Any]) -> str:
    """Twelve hexadecimal digits from the card's content without its `id`."""
    rest = {key: value for key, value in content.items() if key != "id"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def sealed(content: Mapping[str, Any]) -> Card:
    """A card with its id set from its content (given as keyword values, without `id`)."""
    unsealed = Card(id="", **content)
    return unsealed.model_copy(update={"id": card_id(unsealed.model_dump(mode="json"))})
