"""Parts of a card that say what was found about its promise: by audit, session, order, copy and change."""

from __future__ import annotations

from typing import ClassVar, Literal

from palpate.estimators.card_ground import CardPart, FileCard, RunCard


class ConfoundFindingCard(CardPart):
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


class TargetConfoundCard(CardPart):
    """What other than touch tells of one target, beside the model; shares of variance (R²), held out.

    Attributes:
        column: of the target.
        rank_correlation: Spearman's, with the row's number, both within their session.
        order_r2: told by a smooth function of order or time, of the variance within sessions.
        order_level: share of shufflings that tell as much, of whole presses (of rows, or stretches of nearly
            equal labels, where no column says) within their session. Older cards whose split holds
            sessions out shuffled whole sessions, over all rows joined.
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


class ConfoundCard(CardPart):
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


class SessionErrorCard(CardPart):
    """Errors of one target from session to session, in its unit.

    Attributes:
        between: standard deviation of the sessions' mean errors about no error.
        within: standard deviation of errors within a session.
        coverage_least: the lowest coverage of any session that was held out, by the intervals of this card.
    """

    between: float
    within: float
    coverage_least: float


class SessionsCard(CardPart):
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


class ValidScoreCard(CardPart):
    """Scores of one target's valid readings alone, on a run that a calibration was evaluated on.

    Attributes:
        n: how many were valid.
        mae: their mean absolute error, in the target's unit.
        covered: share of them whose interval held the truth.
        low, high: 95 % interval of that share, groups counted as groups; all four are None where none was
            valid.
    """

    n: int
    mae: float | None = None
    covered: float | None = None
    low: float | None = None
    high: float | None = None


MAX_TOLD_BY_ORDER = 0.5
"""Share of a target's variance told by the rows nearest in order, above which a split says nothing of it."""


class SplitScoreCard(CardPart):
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

    def tells_by_order(self, column: str) -> bool:
        """True where the rows nearest in order tell more than half of a target, without any picture."""
        return self.order_r2[column] > MAX_TOLD_BY_ORDER


class OrderCard(CardPart):
    """Shuffled folds and short blocks of the order in which rows were taken, side by side.

    Attributes:
        splits: scores by each; the first is the card's own.
        rank_correlation: Spearman's, of each target's column with the row's number.
        text: what the two say, in words; and what was left out.
    """

    splits: tuple[SplitScoreCard, ...]
    rank_correlation: dict[str, float]
    text: str


def is_sorted(rank_correlation: float) -> bool:
    """True of a target so nearly sorted by the rows' order that no length of blocks hides it."""
    return rank_correlation**2 > MAX_TOLD_BY_ORDER


class IntervalResetCard(CardPart):
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
        former_half_widths: of each target's column, the mean over these rows of the half-widths that the
            former intervals have there; None in cards of before, whose scores state the coverage to expect in
            the place of the share that was counted.
    """

    added: ClassVar[tuple[str, ...]] = ("former_half_widths",)

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
    former_half_widths: dict[str, float] | None = None


class CopyCard(CardPart):
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


class TrialCard(CardPart):
    """One way that a model tried on inner folds, see `estimators.networks.model_interface.Trial`."""

    name: str
    error: float | None
    seconds: float
    note: str


class ChoiceCard(CardPart):
    """Choice that the model that is kept made by inner folds of the rows it learnt from."""

    chosen: str
    trials: tuple[TrialCard, ...]


class TrainingCard(CardPart):
    """How long the network that is kept has learnt; see `TrainingRecord`."""

    steps: int
    epochs: int
    batch: int
    best_step: int
    stopped: bool

    @property
    def sentence(self) -> str:
        """The same in words."""
        end = "until watched groups gained no more" if self.stopped else "to the end of its schedule"
        kept = f"; kept are the weights after step {self.best_step:,}" if self.best_step else ""
        return f"{self.steps:,} steps of up to {self.batch} rows ({self.epochs:,} epochs), {end}{kept}"


class PerturbationCard(CardPart):
    """Held-out frames changed by one kind of perturbation at one size.

    Attributes:
        kind, size, unit: see `calibration.robustness`.
        frames: so many were changed.
        error_ratio: mean absolute error over that of unchanged frames, the mean over the targets that are
            read (on cards of before over all, as all shares here).
        covered: share of readings whose error was at most the half-width.
        beyond: share of readings whose error was beyond twice the half-width.
        refused: share of frames that the guard alone refused, by examples of other frames; the range's rule
            and intervals as long as the range are not counted.
        silent: share of readings beyond twice the half-width and not refused by the guard.
        passes: whether frames pass wrong significantly more often than unchanged ones; None on cards of
            before, which name every change whose `silent` is above theirs by more than 2 %.
    """

    added: ClassVar[tuple[str, ...]] = ("passes",)

    kind: str
    size: float
    unit: str
    frames: int
    error_ratio: float
    covered: float
    beyond: float
    refused: float
    silent: float
    passes: bool | None = None


class RobustnessCard(CardPart):
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
