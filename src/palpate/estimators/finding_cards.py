"""Parts of a card that say what was found about its promise: by audit, session, order, copy and change."""

from __future__ import annotations

from typing import Literal

from palpate.estimators.card_ground import CardPart, FileCard, RunCard
from palpate.estimators.findings import Finding


class TargetConfoundCard(CardPart):
    """What other than touch predicts of one target, next to the model; held-out R².

    Attributes:
        rank_correlation: Spearman's, with the row's number, both within their session.
        order_r2: of a smooth function of order or time, of the variance within sessions.
        order_level: ratio of shufflings of whole presses (or rows) within their session that do as well.
        model_r2: of the model.
        outside_r2, outside_r2_blocks: of what lies outside the skin, on the calibration's folds and on short
            interleaved blocks; None where there is no outside.
        inside_r2: of the skin, by the same kind of regression.
        neighbors_r2: of the trained rows nearest in order; None where rows come in groups or their order is
            unknown.
    """

    column: str
    rank_correlation: float
    order_r2: float
    order_level: float
    model_r2: float
    outside_r2: float | None
    outside_r2_blocks: float | None
    inside_r2: float | None
    neighbors_r2: float | None


class ConfoundCard(CardPart):
    """Audit of what other than touch could predict the labels.

    Attributes:
        failed: whether the scores are unreliable.
        findings: the gravest first.
        outside_share: ratio of the prepared picture that lies outside the skin; None where none was found.
        outside: how the outside was found, or why there is none.
        skin_px: box (x, y, width, height) around the skin [px of the recorded frame].
        row_lag: rows by which labels come later than the images that they fit.
        map_file, map_rows: array ``[t y x]`` of the growth of each target's mean absolute error, in its unit,
            where a block of the picture is blank, and the held-out rows that it is the mean of; None where
            not measured.
    """

    failed: bool
    findings: tuple[Finding, ...]
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
    """Sessions that were trained on, and what that promises of another one.

    Attributes:
        column: what names them: ``session``, or ``sensor`` or ``copy`` where those were held out.
        names: of the sessions (or sensor units).
        runs: the recordings, where there are several.
        held_out: how many were held out whole and scored.
        rule: how the intervals were made: ``one session`` (for rows like those trained on), ``parametric`` or
            ``distribution-free`` (for a new session).
        rank: of the score among one from each session, where the rule is distribution-free.
        factor: by which few sessions widen the intervals, where it is parametric.
        errors: of each target's column, where sessions were held out.
        findings: what stands against the promise.
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
    findings: tuple[Finding, ...]
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


class IntervalResetCard(CardPart):
    """Rows of a new session that recalibrated the intervals of another calibration.

    Attributes:
        calibration, run, session: id of that calibration, the recording of the session, and its name.
        rows, groups: how many set the intervals, and of how many groups (presses).
        rank: of the score, among one from each group.
        coverage_mean, coverage_low, coverage_high: expected coverage in that session: its mean over drawings
            of so many groups, and the range that holds 95 % of them.
        text: all of it in words.
        former_half_widths: of each target's column, mean half-width of the former intervals over these rows.
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
    former_half_widths: dict[str, float]


class CopyCard(CardPart):
    """Sensor unit that a calibration was adapted to, and how its frames are distinguished from the former's.

    Attributes:
        name, former: of this unit and of the former one.
        run_id: of this unit's recording.
        file: the discriminator.
        refused_own, refused_former: ratio of each unit's frames that it rejects, judged without their own
            press.
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
        frames: number of frames changed.
        error_ratio: mean absolute error over that of unchanged frames, the mean over the targets read.
        covered, beyond: ratio of readings whose error was at most the half-width, and beyond twice it.
        refused: ratio of frames that the guard alone refused, by examples of other frames.
        silent: ratio of readings beyond twice the half-width and not refused by the guard.
        passes: whether frames pass wrong significantly more often than unchanged ones.
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
    passes: bool


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
