"""Findings of audits as data: a code, the target, and values. Their sentences are written here alone."""

from __future__ import annotations

from enum import StrEnum
from typing import Literal, NamedTuple

from pydantic import Field

from palpate.estimators.card_ground import CardPart

Severity = Literal["fails", "warns", "notes"]
SEVERITIES: tuple[Severity, ...] = ("fails", "warns", "notes")


class FindingCode(StrEnum):
    """Finding of a calibration audit."""

    ROWS_SHIFTED = "rows-shifted"
    OUTSIDE_DRIFTS = "outside-drifts"
    OUTSIDE_LIT = "outside-lit"
    BURNT_IN = "burnt-in"
    ORDER_DRIFTS = "order-drifts"
    ORDER_UNCHECKED = "order-unchecked"
    ORDER_CHECKED = "order-checked"
    ORDER_NEIGHBORS = "order-neighbors"
    ORDER_UNKNOWN = "order-unknown"
    ORDER_OF_FEW = "order-of-few"
    BLOCKS_EXTRAPOLATE = "blocks-extrapolate"
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
    SESSIONS_ALIKE = "sessions-alike"
    SESSIONS_COPIED = "sessions-copied"
    SESSION_TELLS_TARGET = "session-tells-target"


class _Words(NamedTuple):
    severity: Severity
    text: str
    remedy: str = ""


_AGAIN = "calibrate again, and compare both by `palpate evaluate` on another session"
_CROP = f"cut it away by `--crop {{crop}}`, {_AGAIN}"
_OUTSIDE = (
    "what lies outside the skin predicts {name} by itself: R² {folds:.2f} on the calibration's folds, "
    "{blocks:.2f} on short blocks of time; the model has {model:.2f} from the whole image"
)
_ORDER = (
    "{name} follows the {scale} of the rows: a smooth function of it explains {share:.0%} of the variance "
    "(rank correlation {rank:+.2f}; {level:.1%} of shuffled {units} do as well)"
)
_SHUFFLE = "record presses in random order, with a label press"
_ONE_SESSION = "this may be one session under two names, which tests no other day"

_WORDS: dict[FindingCode, _Words] = {
    FindingCode.ROWS_SHIFTED: _Words(
        "fails",
        "images fit labels {lag:+d} rows away better than their own (R² {best:.2f}, own {own:.2f}): the "
        "table is shifted against the images, or labels lag behind",
        "pair each image with the label {lag:+d} rows away, and import again",
    ),
    FindingCode.OUTSIDE_DRIFTS: _Words(
        "fails",
        f"{_OUTSIDE}. {{name}} follows the order of the rows, so a drift may predict it in place of touch",
        _CROP,
    ),
    FindingCode.OUTSIDE_LIT: _Words("notes", f"{_OUTSIDE}. Rows are in no order: presses light it", _CROP),
    FindingCode.BURNT_IN: _Words(
        "fails",
        "one small location at the border predicts {name} by itself (R² {share:.2f}, model {model:.2f}), and "
        "those around it do not (R² {around:.2f}): is the label, a text or a bar, burnt into the image?",
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
    FindingCode.BLOCKS_EXTRAPOLATE: _Words(
        "warns",
        "each block holds out a part of the range of {name} that was not trained on: its scores measure "
        "extrapolation",
        "use shorter blocks (`--split blocks:ROWS`)",
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
    FindingCode.SESSIONS_ALIKE: _Words(
        "warns", f"frames of sessions {{pairs}} do not differ more than presses do: {_ONE_SESSION}"
    ),
    FindingCode.SESSIONS_COPIED: _Words(
        "warns", f"{{count}} of {{held}} frames equal frames of another session: {_ONE_SESSION}"
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
