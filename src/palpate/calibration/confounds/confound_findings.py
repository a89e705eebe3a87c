"""Findings of an audit: what was found, in a sentence, and what to do about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from palpate.calibration.confounds.outside_control import TellingCell
from palpate.calibration.confounds.recorded_units import RecordedUnits
from palpate.calibration.confounds.row_order import OrderCheck, ShiftCheck
from palpate.calibration.confounds.target_functions import TargetFunction

Severity = Literal["fails", "warns", "notes"]
SEVERITIES: tuple[Severity, ...] = ("fails", "warns", "notes")

MIN_OUTSIDE_SHARE = 0.1
"""R² from which what lies outside the skin is said to tell a label; more is asked where presses are few."""
OUTSIDE_SHARE_PER_UNIT = 4.0
MIN_CELL_SHARE = 0.3
CELL_SHARE_PER_UNIT = 8.0
"""R² over the presses' number that the best of some sixty places may have by chance."""
MAX_AROUND = 0.5
"""R² around a place, over its own, up to which it stands alone: light that a press spreads does not."""
EXACT_SHARE, EXACT_ERROR = 0.98, 0.1
"""R² of a place from which it is exact, and its squared error over that around: touch fades, a text ends."""
MIN_BORDER_SHARE = 0.5
MORE_THAN_SKIN = 0.7
"""Squared error of what lies far from the skin, over the skin's, up to which touch cannot have spread it."""
BORDER_ERROR = 2.0
"""Squared error of a place at the border, over the model's, up to which it tells as much as the model."""


NAME_PRESSES = "if they were, label which rows are of one press in a column press"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that an audit found.

    Attributes:
        kind: what kind of thing: ``rows shifted``, ``outside``, ``burnt in``, ``order``, ``function``.
        target: the column it is about; empty where it is about all.
        severity: ``fails`` where the scores cannot be relied on, ``warns`` where they say less than they seem
            to, ``notes`` where nothing came of it.
        text: the finding in a sentence.
        remedy: what to do, in a sentence.
    """

    kind: str
    target: str
    severity: Severity
    text: str
    remedy: str


def min_outside_share(units: int) -> float:
    """R² from which what lies outside the skin tells a label beyond chance, with so many presses."""
    return MIN_OUTSIDE_SHARE + OUTSIDE_SHARE_PER_UNIT / units


@dataclass(frozen=True, slots=True)
class TargetEvidence:
    """What was asked about one target.

    Attributes:
        column: of the target, or the name of one of a direction's two outputs.
        order: the label against order and time.
        model: R² of the model's held-out estimates.
        outside: R² of the outside, held out on the calibration's folds; None where there is no outside.
        outside_blocks: the same on short interleaved blocks.
        far: R² of what lies far from the skin; None where nothing does or the outside told nothing.
        inside: R² of the skin, asked in the same way; None where the outside told nothing.
        cell: the place by itself that tells most; None where none was asked.
        cell_outside: whether that place lies outside the skin.
        label: label column that it is of; empty where that is `column`.
    """

    column: str
    order: OrderCheck
    model: float
    outside: float | None = None
    outside_blocks: float | None = None
    far: float | None = None
    inside: float | None = None
    cell: TellingCell | None = None
    cell_outside: bool = False
    label: str = ""

    @property
    def about(self) -> str:
        """Label column that it is of."""
        return self.label or self.column

    @property
    def said(self) -> str:
        """What a sentence calls it."""
        return output_in_words(self.column, self.about)

    def told_outside(self, units: int) -> bool:
        """True if the outside tells the label beyond chance."""
        best = max((r for r in (self.outside, self.outside_blocks) if r is not None), default=0.0)
        return best >= min_outside_share(units)


def output_in_words(name: str, label: str) -> str:
    """A target as a sentence calls it: by its label column, or as the cosine or the sine of that.

    Example:
        >>> output_in_words("angle_cos_ratio", "angle_deg")
        'the cosine of angle_deg'
    """
    if name == label:
        return label
    return f"the {'cosine' if name.endswith('_cos_ratio') else 'sine'} of {label}"


def ranked(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """The gravest first; of equal ones the order found."""
    return tuple(sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity)))


def outside_findings(evidence: TargetEvidence, units: int, crop: str) -> list[Finding]:
    """Findings about order, outside and burnt-in labels of one target.

    Args:
        evidence: what was asked.
        units: how many presses there are.
        crop: the remedy that cuts the outside.
    """
    order, told = evidence.order, evidence.told_outside(units)
    found = []
    if told and order.follows:
        found.append(_outside(evidence, crop))
    elif (cell := _lone_cell(evidence, units)) is not None:
        found.append(_burnt_in(evidence, cell, crop))
    elif told and _better_than_the_skin(evidence):
        found.append(_outside(evidence, crop))
    if order.follows:
        found.append(_order(evidence, told))
    return found


def _better_than_the_skin(evidence: TargetEvidence) -> bool:
    """Light that a press spreads fades with distance and tells less than the skin; a text may tell more."""
    if evidence.inside is None or evidence.far is None:
        return False
    left = 1 - evidence.far
    return left <= MORE_THAN_SKIN * (1 - evidence.inside) and left <= BORDER_ERROR * (1 - evidence.model)


def _lone_cell(evidence: TargetEvidence, units: int) -> TellingCell | None:
    cell = evidence.cell
    by_chance = CELL_SHARE_PER_UNIT / units
    if cell is None or cell.share < MIN_CELL_SHARE + by_chance:
        return None
    if cell.share >= EXACT_SHARE and 1 - cell.share <= EXACT_ERROR * (1 - cell.around):
        return cell
    if cell.around > MAX_AROUND * cell.share:
        return None
    as_the_model = cell.share >= MIN_BORDER_SHARE + by_chance and 1 - cell.share <= BORDER_ERROR * (
        1 - evidence.model
    )
    if as_the_model or (evidence.cell_outside):
        return cell
    return None


def _outside(evidence: TargetEvidence, crop: str) -> Finding:
    assert evidence.outside is not None
    assert evidence.outside_blocks is not None
    column = evidence.said
    follows = evidence.order.follows
    meaning = (
        f", and {column} follows the order of the rows, so that what drifts with time tells it; the scores "
        "may be the rim's, not the touch's"
        if follows
        else "; as rows are in no order, this is light that presses spread, or something that goes with them"
    )
    return Finding(
        "outside",
        evidence.about,
        "fails" if follows else "notes",
        f"what lies outside the skin tells {column} by itself: R² {evidence.outside:.2f} on the "
        f"calibration's folds and {evidence.outside_blocks:.2f} on short blocks of time, where the model has "
        f"{evidence.model:.2f} from the whole picture{meaning}",
        crop,
    )


def _burnt_in(evidence: TargetEvidence, cell: TellingCell, crop: str) -> Finding:
    column = evidence.said
    where = "outside the skin" if evidence.cell_outside else "at the border of the picture"
    return Finding(
        "burnt in",
        evidence.about,
        "fails",
        f"one small place {where} tells {column} by itself (R² {cell.share:.2f}, the model "
        f"{evidence.model:.2f}), and the places around it do not (R² {cell.around:.2f}): is the label, a "
        "text or a bar, burnt into the picture there?",
        crop,
    )


def _order(evidence: TargetEvidence, told_outside: bool) -> Finding:
    order, column = evidence.order, evidence.said
    by = "time" if order.by_time else "the order of the rows"
    by += " in its session" if order.sessions > 1 else ""
    text = (
        f"{column} follows {by}: a smooth function of it tells {100 * order.share:.0f} % of the variance "
        f"(rank correlation {order.rank_correlation:+.2f}; shuffled {order.units} do as well in "
        f"{100 * order.level:.1f} % of cases)"
    )
    named = "" if order.units == "presses" else f"; {NAME_PRESSES}"
    remedy = (
        f"record presses in random order{named}; until then, `--split blocks` holds out stretches of time, "
        "and `palpate evaluate` on another session says what is true of it"
    )
    if told_outside:
        return Finding(
            "order", evidence.about, "fails", f"{text}; anything that drifts with time tells it too", remedy
        )
    if evidence.outside is not None:
        checked = f"{text}; what lies outside the skin does not tell it, so that no drift is seen to help"
        return Finding("order", evidence.about, "notes", checked, remedy)
    unseen = f"{text}; whether the model reads a drift cannot be seen, as the picture shows no outside"
    return Finding("order", evidence.about, "warns", unseen, remedy)


def order_not_asked(units: RecordedUnits) -> list[Finding]:
    """Note that the order of the rows could not be asked, where there are too few units; else none."""
    if units.can_be_ordered:
        return []
    if not units.in_recorded_order:
        text = (
            "the order of recording is not known: rows lie in the order of the images' names, so that "
            "nothing is said of labels which follow that order, and of a drift that tells them"
        )
        return [Finding("order", "", "notes", text, "import with a column that says it (--order-by COLUMN)")]
    sessions = len(units.in_sessions)
    where = f" in {sessions} sessions" if sessions > 1 else ""
    text = (
        f"order could not be asked: {units.count} {units.kind}{where} lie in any order too often by chance, "
        "so that labels which follow the order of the rows, and a drift that tells them, would not be found"
    )
    remedy = "record more presses, 6 or more in a session, in random order"
    if units.kind != "presses":
        remedy += f"; {NAME_PRESSES}"
    return [Finding("order", "", "notes", text, remedy)]


def function_finding(function: TargetFunction, names: Sequence[str], columns: Sequence[str] = ()) -> Finding:
    """Finding about targets that are functions of each other; `columns` are those that are calibrated."""
    columns = columns or names
    labels = dict(zip(names, columns, strict=True))
    own = labels[function.target]
    of = " and ".join(output_in_words(name, labels[name]) for name in function.of)
    column = output_in_words(function.target, own)
    rest = ",".join(dict.fromkeys(name for name in columns if name != own))
    relation = f"{column} and {of} tell each other" if function.both_ways else f"{column} follows from {of}"
    return Finding(
        "function",
        own,
        "warns",
        f"{relation} in this recording: {100 * function.told:.0f} % of the rows of {column} are told within "
        "2 % of its range without any picture; their scores are not independent evidence, and where the "
        "relation does not hold neither will this reading",
        f"calibrate on rows where they vary apart, or leave one out: --targets {rest}",
    )


def shift_finding(shift: ShiftCheck) -> Finding | None:
    """Finding about labels that belong to other rows' images."""
    if shift.lag == 0:
        return None
    side = "later" if shift.lag > 0 else "earlier"
    rows = f"{abs(shift.lag)} row{'s' if abs(shift.lag) > 1 else ''}"
    return Finding(
        "rows shifted",
        "",
        "fails",
        f"images fit the labels of {rows} {side} better than their own (R² {shift.best:.2f} against "
        f"{shift.own:.2f}): the table is shifted against the images, or labels lag behind",
        f"pair each image with the label {rows} {side}, and import again",
    )
