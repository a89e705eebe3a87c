"""Findings of audits as data: a code, the target, and values. Their sentences are written here alone.

Parts of a card that say what was found about its promise: by audit, session, order, copy and change.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Literal, NamedTuple

from pydantic import Field

from palpate.estimators.card_ground import CardPart, FileCard, RunCard

Severity = Literal["fails", "warns", "notes"]
SEVERITIES: tuple[Severity, ...] = ("fails", "warns", "notes")


class FindingCode(StrEnum):
    """Finding of a calibration audit."""

    ROWS_SHIFTED = "rows-shifted"
    OUTSIDE_DRIFTS = "outside-drifts"
    BURNT_IN = "burnt-in"
    ORDER_DRIFTS = "order-drifts"
    ORDER_UNCHECKED = "order-unchecked"
    ORDER_CHECKED = "order-checked"
    ORDER_NEIGHBORS = "order-neighbors"
    ORDER_UNKNOWN = "order-unknown"
    ORDER_OF_FEW = "order-of-few"
    FUNCTION = "function"
    CONTRADICTING_LABELS = "contradicting-labels"
    ALTERED_COPIES = "altered-copies"
    LOOK_ALIKES = "look-alikes"
    GROUPS_SHARED = "groups-shared"
    GROUPS_NOT_HELD_OUT = "groups-not-held-out"
    SESSION_OF_FEW_ROWS = "session-of-few-rows"
    SESSIONS_ALTERNATE = "sessions-alternate"
    CONSTANT_IN_SESSION = "constant-in-session"
    UNIT_OF_SESSION = "unit-of-session"
    RUNS_WITHOUT_SESSION = "runs-without-session"
    SESSIONS_COPIED = "sessions-copied"
    SESSION_TELLS_TARGET = "session-tells-target"


class _Words(NamedTuple):
    severity: Severity
    text: str
    remedy: str = ""


_AGAIN = "calibrate again, and compare both by `palpate evaluate` on another session"
_CROP = f"cut it away by `--crop {{crop}}`, {_AGAIN}"
_ORDER = (
    "{name} follows the {scale} of the rows: a smooth function of it explains {share:.0%} of the variance "
    "(rank correlation {rank:+.2f}; {level:.1%} of shuffled {units} do as well)"
)
_SHUFFLE = "record presses in random order, with a label press"

_WORDS: dict[FindingCode, _Words] = {
    FindingCode.ROWS_SHIFTED: _Words(
        "fails",
        "images fit labels {lag:+d} rows away better than their own (R² {best:.2f}, own {own:.2f}): the "
        "table is shifted against the images, or labels lag behind",
        "pair each image with the label {lag:+d} rows away, and import again",
    ),
    FindingCode.OUTSIDE_DRIFTS: _Words(
        "fails",
        "what lies outside the skin predicts {name} by itself: R² {folds:.2f} on the calibration's folds, "
        "{blocks:.2f} on short blocks of time; the model has {model:.2f} from the whole image. {name} "
        "follows the order of the rows, so a drift may predict it in place of touch",
        _CROP,
    ),
    FindingCode.BURNT_IN: _Words(
        "fails",
        "{share:.0%} of the pixels that decide {name} lie outside the skin, or in a corner: is the label, a "
        "text or a bar, burnt into the image?",
        _CROP,
    ),
    FindingCode.ORDER_DRIFTS: _Words(
        "fails", f"{_ORDER}; what lies outside the skin, which may drift, predicts it too", _SHUFFLE
    ),
    FindingCode.ORDER_UNCHECKED: _Words(
        "warns", f"{_ORDER}; whether the model reads a drift cannot be tested", _SHUFFLE
    ),
    FindingCode.ORDER_CHECKED: _Words(
        "notes", f"{_ORDER}; what lies outside the skin does not predict it", _SHUFFLE
    ),
    FindingCode.ORDER_NEIGHBORS: _Words(
        "warns",
        "the trained rows just before and after each held-out row explain {share:.0%} of the variance of "
        "{name} without an image: {kind} folds do not test it",
        _SHUFFLE,
    ),
    FindingCode.ORDER_UNKNOWN: _Words(
        "notes",
        "the order of recording is unknown, since rows lie in the order of file names: neither labels in "
        "order nor a drift would be found",
        "import with a column that states it (--order-by COLUMN)",
    ),
    FindingCode.ORDER_OF_FEW: _Words(
        "notes",
        "order was not tested: {count} {units} in {sessions} sessions lie in any order too often by chance",
        "record 6 or more presses in a session, in random order, with a label press",
    ),
    FindingCode.FUNCTION: _Words(
        "warns",
        "{name} follows from {of} in this recording, within 2 % of its range in {share:.0%} of its rows: "
        "their scores are not independent",
        "calibrate on rows where they vary independently, or leave one out (--targets)",
    ),
    FindingCode.CONTRADICTING_LABELS: _Words(
        "fails",
        "the same image has two labels in {count} of {held} held-out frames ({first}, {second}): at least "
        "one is wrong",
        "remove the wrong one",
    ),
    FindingCode.ALTERED_COPIES: _Words(
        "fails",
        "{count} of {held} held-out frames are altered copies of trained ones (noise, light, shift), or "
        "repeat a press",
        "remove them, or group them with their originals by a column",
    ),
    FindingCode.LOOK_ALIKES: _Words(
        "fails",
        "{count} of {held} held-out frames equal trained ones within camera noise: scores show how well "
        "those are remembered",
        "split by what groups them, such as the press",
    ),
    FindingCode.GROUPS_SHARED: _Words(
        "fails",
        "the random split has frames of one group on both sides: {groups}",
        "split by one of these (`--split group:COLUMN`)",
    ),
    FindingCode.GROUPS_NOT_HELD_OUT: _Words(
        "notes", "scores are for new {held_out}, not for new {groups}, which are on both sides"
    ),
    FindingCode.SESSION_OF_FEW_ROWS: _Words(
        "warns",
        "session {session} has {rows} rows, too few to represent another day",
        "join it to its session, or leave it out",
    ),
    FindingCode.SESSIONS_ALTERNATE: _Words(
        "warns",
        "rows of {sessions} sessions alternate {times} times in recorded order, as no re-mounting does: no "
        "other day is tested",
        "let session name what was recorded without re-mounting",
    ),
    FindingCode.CONSTANT_IN_SESSION: _Words(
        "warns", "{name} is constant in session {session}, which does not test its range"
    ),
    FindingCode.UNIT_OF_SESSION: _Words(
        "warns",
        "{name} spans {small:.3g} in session {first} and {large:.3g} in session {second}: are their units "
        "the same?",
    ),
    FindingCode.RUNS_WITHOUT_SESSION: _Words(
        "warns",
        "{runs} have no label session, and each counts as a session of its own name next to labeled runs",
        "label session in every run",
    ),
    FindingCode.SESSIONS_COPIED: _Words(
        "warns",
        "{count} of {held} frames equal frames of another session: this may be one session under two names, "
        "which tests no other day",
    ),
    FindingCode.SESSION_TELLS_TARGET: _Words(
        "warns",
        "{share:.0%} of the variance of {name} lies between sessions, so that light or mounting predict it",
        "record each session over the whole range",
    ),
}

ORDER_CODES = frozenset(
    {
        FindingCode.ORDER_DRIFTS,
        FindingCode.ORDER_UNCHECKED,
        FindingCode.ORDER_CHECKED,
        FindingCode.ORDER_NEIGHBORS,
    }
)


class Finding(CardPart):
    """One finding of an audit.

    Attributes:
        target: Label column concerned; empty if all are.
        values: Numbers and names of its sentence.
    """

    code: FindingCode
    target: str = ""
    values: dict[str, int | float | str] = Field(default_factory=dict)

    @property
    def severity(self) -> Severity:
        """``fails``: scores are unreliable; ``warns``: they mean less; ``notes``: neither."""
        return _WORDS[self.code].severity

    @property
    def text(self) -> str:
        """Sentence without a full stop."""
        return self._written(_WORDS[self.code].text)

    @property
    def remedy(self) -> str:
        """Remedy; empty if the sentence contains it."""
        return self._written(_WORDS[self.code].remedy)

    def _written(self, template: str) -> str:
        return template.format(**{"name": self.target, **self.values})


def ranked(findings: list[Finding]) -> tuple[Finding, ...]:
    """Return findings by severity, the gravest first."""
    return tuple(sorted(findings, key=lambda one: SEVERITIES.index(one.severity)))


class TargetConfoundCard(CardPart):
    """Held-out R² of what other than touch predicts one target, next to the model's.

    Attributes:
        rank_correlation: Spearman's, with the row number, within sessions.
        order_r2: R² within sessions of a smooth function of temporal order.
        order_level: Ratio of shufflings of whole presses (or rows) within their session that do as well.
        outside_r2, outside_r2_blocks: R² of the image outside the skin, on the folds and on short interleaved
            blocks.
        neighbors_r2: R² of the training rows nearest in order; None for grouped or unordered rows.
    """

    column: str
    rank_correlation: float
    order_r2: float
    order_level: float
    model_r2: float
    outside_r2: float | None
    outside_r2_blocks: float | None
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
