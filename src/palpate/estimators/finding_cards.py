"""Parts of a card that say what was found about its promise: by audit, session, order, copy and change."""

from __future__ import annotations

from typing import Literal

from palpate.estimators.card_ground import CardPart, FileCard, RunCard
from palpate.estimators.findings import Finding


class TargetConfoundCard(CardPart):
    """Held-out R² of what other than touch predicts one target, next to the model's.

    Attributes:
        rank_correlation: Spearman's, with the row number, within sessions.
        order_r2: R² within sessions of a smooth function of temporal order.
        order_level: Ratio of shufflings of whole presses (or rows) within their session that do as well.
        outside_r2, outside_r2_blocks: R² of the image outside the skin, on the folds and on short interleaved
            blocks.
        inside_r2: R² of the skin by the same kind of regression.
        neighbors_r2: R² of the training rows nearest in order; None for grouped or unordered rows.
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
        failed: Whether the scores are unreliable.
        outside_share: Ratio of the prepared image outside the skin; None if none was found.
        outside: How the outside was found, or why there is none.
        skin_px: Box (x, y, width, height) around the skin [px of the recorded frame].
        row_lag: Rows by which labels are later than the images that they fit.
        map_file, map_rows: Array ``[t y x]`` of the growth of each target's mean absolute error under
            occlusion, and the number of held-out rows behind it; None if not measured.
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
    """Errors of one target in its unit.

    Attributes:
        between: Standard deviation of the sessions' mean errors about 0.
        within: Standard deviation within a session.
        coverage_least: Lowest coverage of any held-out session.
    """

    between: float
    within: float
    coverage_least: float


class SessionsCard(CardPart):
    """Sessions of the training rows, and what they promise of a new one.

    Attributes:
        column: Column that names them: ``session``, ``sensor``, or ``copy``.
        held_out: Number of sessions held out whole and scored.
        rule: ``one session`` (rows like those trained on), ``parametric``, or ``distribution-free`` (new
            sessions).
        rank: Rank of the score among one from each session, if distribution-free.
        factor: Widening of the intervals for few sessions, if parametric.
        text: Promise in words.
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
    """Scores of one target's valid readings on an evaluated run; None if none is valid.

    Attributes:
        mae: Mean absolute error in the target's unit.
        covered: Ratio covered by the interval.
        low, high: 95 % interval of that ratio, by groups.
    """

    n: int
    mae: float | None = None
    covered: float | None = None
    low: float | None = None
    high: float | None = None


class IntervalResetCard(CardPart):
    """Rows of a new session that recalibrated the intervals of another calibration.

    Attributes:
        calibration, run, session: Id of that calibration, recording of the session, and its name.
        rows, groups: Number of rows, and of their groups (presses).
        rank: Rank of the score among one from each group.
        coverage_mean, coverage_low, coverage_high: Expected coverage in that session, and its 95 % range.
        former_half_widths: Mean former half-width over these rows by target column.
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
        file: Discriminator.
        refused_own, refused_former: Ratio of each unit's frames that it rejects, without their own press.
    """

    name: str
    former: str
    run_id: str
    file: FileCard | None
    refused_own: float
    refused_former: float
    text: str


class TrialCard(CardPart):
    """Variant that a model tried on inner folds (`model_interface.Trial`)."""

    name: str
    error: float | None
    seconds: float
    note: str


class ChoiceCard(CardPart):
    """Choice of the final model by inner folds of its training rows."""

    chosen: str
    trials: tuple[TrialCard, ...]


class TrainingCard(CardPart):
    """Training of the final network (`TrainingRecord`)."""

    steps: int
    epochs: int
    batch: int
    best_step: int
    stopped: bool

    @property
    def sentence(self) -> str:
        end = "until watched groups gained no more" if self.stopped else "to the end of its schedule"
        kept = f"; kept are the weights after step {self.best_step:,}" if self.best_step else ""
        return f"{self.steps:,} steps of up to {self.batch} rows ({self.epochs:,} epochs), {end}{kept}"


class PerturbationCard(CardPart):
    """Held-out frames changed by one perturbation (`calibration.robustness`).

    Attributes:
        error_ratio: Mean absolute error over that of unchanged frames, averaged over targets.
        covered, beyond: Ratios of readings with errors within the half-width, and beyond twice it.
        refused: Ratio of frames that the guard refuses by examples of other frames.
        silent: Ratio of readings beyond twice the half-width that the guard accepts.
        passes: Whether wrong readings pass significantly more often than on unchanged frames.
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
    """Effect of camera changes on the model and the guard, with unchanged frames for comparison."""

    text: str
    frames: int
    refused: float
    beyond: float
    table: tuple[PerturbationCard, ...]
