"""Recalibrate intervals for a session by some tens of its labeled rows; the network stays.

Of n exchangeable scores a new one is below the r-th smallest, r = ceil(c (n + 1)), with probability r / (n +
1) (V. Vovk, A. Gammerman and G. Shafer, Algorithmic Learning in a Random World, Springer 2005,
doi:10.1007/b106715); n counts presses. Given the rows, the coverage is Beta(r, n + 1 - r).

Intervals for a future session, from errors in held-out sessions.

Errors within a session are correlated, so the promise rests on the number of sessions K.

**Distribution-free**, where K (1 - c) >= c (nine sessions at c = 0.9): the r-th smallest of one score per
session, r = ceil(c (K + 1)), covers a new session with probability r / (K + 1) (R. Dunn, L. Wasserman and A.
Ramdas, J. Am. Stat. Assoc. 118, 2491 (2023), section 4, doi:10.1080/01621459.2022.2060112). The mean over all
drawings is computed in closed form; by Jensen's inequality it covers at least as often where larger errors
are rarer, and it is at least the rows' own weighted quantile. Beyond 200 sessions the weighted quantile at c
(K + 1) / K is used (Y. Lee, R. F. Barber and R. Willett, arXiv:2306.06342).

**Parametric**, for two sessions and more: errors are Gaussian about an offset that is Gaussian between
sessions. Each session is one observation of the mean squared error; the half-width is Student's t with K
degrees of freedom times its root. Nothing is guaranteed where offsets are not Gaussian.

The kept model has seen all sessions; one session more must change it little (jackknife: R. F. Barber et al.,
Ann. Statist. 49, 486 (2021), doi:10.1214/20-AOS1965).
"""

from __future__ import annotations

import math
import shutil
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import beta, norm, t as student
from sklearn.model_selection import GroupKFold

from palpate.calibration.calibration_job import (
    CalibrationJob,
    finest_columns,
    groups_within,
    refuse_other_size,
    rule_in_run,
    table_to_learn,
)
from palpate.calibration.calibration_plan import CalibrationPlan
from palpate.calibration.certificate import (
    PREDICTIONS_FILE,
    instrument_card,
    interval_fields,
    made_fields,
    most_missed,
    run_card,
    write_picture,
)
from palpate.calibration.classes import (
    ClassLabels,
    HeldOutClasses,
    held_out_classes,
    known_codes,
    target_values,
)
from palpate.calibration.coverage.conformal import fit_spread, parts_by_group, spread_terms
from palpate.calibration.coverage.grouped_rates import (
    grouped_coverage_interval,
    is_distribution_free,
    new_group_quantile,
    rank_of_new_group,
    weighted_quantile,
)
from palpate.calibration.coverage.range_scores import range_cards
from palpate.calibration.evaluation import predictions, rows_to_score, same_session, score, zeros_of
from palpate.calibration.robustness.perturbation_suite import (
    CertifiedModel,
    Suite,
    adapted_guard,
    former_frames,
)
from palpate.core import Float, InputError, PathText, Progress, Values, new_folder, refuse_existing, silent
from palpate.estimators.certified import CARD_FILE, Estimator, checked_file
from palpate.estimators.class_sets import ClassCard, ClassOutputs, Outputs, TargetLayout
from palpate.estimators.findings import IntervalResetCard, RobustnessCard, SessionsCard
from palpate.estimators.guard import NoveltyDetector
from palpate.estimators.intervals import Intervals, intervals_of, layout_of, mahalanobis, within
from palpate.estimators.model_card import (
    Card,
    InstrumentCard,
    RangeCard,
    ScoreCard,
    TargetCard,
    VectorCard,
    sealed,
)
from palpate.recordings import Run, Split, pack
from palpate.recordings.joined_runs import check_instruments, sessions_of
from palpate.recordings.label_tables import with_own, write_table
from palpate.recordings.manifest import ReferenceInstrument

FOLDS_OF_GUARD = 10


@dataclass(frozen=True, slots=True)
class ExpectedCoverage:
    """Coverage of intervals that the r-th smallest of n exchangeable scores sets.

    Attributes:
        mean: r / (n + 1).
        low, high: 95 % limits over drawings of the n.
    """

    rank: int
    mean: float
    low: float
    high: float

    @classmethod
    def of(cls, n: int, coverage: float) -> ExpectedCoverage:
        """Return the expected coverage of so many scores.

        Example:
            >>> found = ExpectedCoverage.of(100, 0.9)
            >>> found.rank, round(found.mean, 3), round(found.low, 3), round(found.high, 3)
            (91, 0.901, 0.836, 0.951)
        """
        rank = rank_of_new_group(n, coverage)
        low, high = beta.ppf([0.025, 0.975], rank, n + 1 - rank)
        return cls(rank, rank / (n + 1), float(low), float(high))


def intervals_set_anew(former: Intervals, outputs: Outputs, true: Values, groups: np.ndarray) -> Intervals:
    """Return intervals of a session from rows that the network has not seen; bands over the range go.

    Args:
        outputs, true: of the model ``[n o]``, and labels ``[n t]``.
        groups: group (press) of each row ``[n]``.
    """
    scores = np.abs(former.errors(outputs, true)) / former.spread.at(outputs)
    quantile = [new_group_quantile(column, groups, former.coverage) for column in scores.T]
    return replace(former, quantile=np.array(quantile), by_range=())


def radius_set_anew(
    correlation: Float[np.ndarray, "k k"],
    scaled: Float[np.ndarray, "n k"],
    groups: np.ndarray,
    coverage: float,
) -> float:
    """Return the radius of a vector's joint region in a session; the ellipsoid's shape stays.

    Args:
        correlation: of the former session's errors, in units of their spread.
        scaled: signed errors of the rows, in these units.
    """
    radius = new_group_quantile(mahalanobis(scaled, correlation), groups, coverage)
    return max(radius, float(np.finfo(np.float32).tiny))


def reset_intervals(
    folder: PathText,
    run: Run,
    out: PathText,
    progress: Progress = silent,
    *,
    instruments: Mapping[str, ReferenceInstrument] | None = None,
) -> Card:
    """Recalibrate a calibration's intervals by some tens of labeled rows of a new session.

    The network stays to the last byte; the novelty detector adds the session's frames.

    Args:
        folder: calibration; it is not changed.
        run: labeled rows of one new session, of nine groups or more at 90 %.
        out: calibration folder to make; must not exist, and appears whole.
        instruments: reference instruments of label columns; precede the run's manifest.
    """
    folder, out = Path(folder), Path(out)
    refuse_existing(out)
    started = time.monotonic()
    estimator = Estimator.open(folder)
    check_instruments(run, estimator.card.columns, instruments or {})
    stated = run.manifest.instruments | dict(instruments or {})
    rows = _SessionRows.read(estimator, run, progress)
    intervals = intervals_set_anew(intervals_of(estimator.card), rows.outputs, rows.true, rows.groups)
    halves = _half_turns_at_most(intervals, intervals.half_widths(rows.outputs))
    classes = _classes(estimator.card, rows)
    with new_folder(out) as building:
        shutil.copyfile(checked_file(folder, estimator.card.model), building / "model.onnx")
        if (copies := estimator.card.copy_of) is not None and copies.file is not None:
            shutil.copyfile(checked_file(folder, copies.file), building / copies.file.file)
        detector, robustness = _guard(estimator, run, intervals, out, progress)
        detector.save(building / "guard.npz")
        table = with_own(
            rows.table, {"row": rows.rows, "frame": rows.names, "held_out_in_fold": 0 * rows.rows}
        )
        for j, column in enumerate(estimator.card.columns):
            estimate, half = rows.predicted[:, j], halves[:, j]
            table[f"half_width:{column}"] = half
            table[f"low:{column}"], table[f"high:{column}"] = estimate - half, estimate + half
        if classes is not None:
            table = classes.with_answers(table, np.arange(len(table)))
        write_table(table, building / PREDICTIONS_FILE)
        _write_pictures(folder, building, estimator.card, run, rows)
        cards = None if classes is None else classes.cards
        seconds = time.monotonic() - started
        card = _card(estimator.card, building, run, rows, stated, intervals, cards, robustness, seconds)
        (building / CARD_FILE).write_text(card.model_dump_json(indent=1))
        Estimator.open(building)
    return card


@dataclass(frozen=True, slots=True)
class _SessionRows:
    """Rows of the new session, as the calibration reads them.

    Attributes:
        rows: of the run ``[n]``, without no-contact rows.
        outputs, of_classes: of the network for the targets ``[n o]`` and for classes ``[n k]``.
        columns: label columns that name a group; none where each row is its own.
    """

    session: str
    rows: np.ndarray
    names: list[str]
    table: pd.DataFrame
    outputs: Outputs
    of_classes: ClassOutputs
    predicted: Values
    true: Values
    columns: tuple[str, ...]
    groups: np.ndarray

    @property
    def count(self) -> int:
        return len(np.unique(self.groups))

    @classmethod
    def read(cls, estimator: Estimator, run: Run, progress: Progress) -> _SessionRows:
        card = estimator.card
        session = _new_session(estimator, run)
        rows = rows_to_score(card, run.labels)
        labels = run.labels.iloc[rows].reset_index(drop=True)
        true = target_values(labels, card.columns, str(run.path))
        for one in card.classes or ():
            known_codes(labels, one.column, one.values, str(run.path))
        groups = groups_within(labels)
        _check_count(len(np.unique(groups)), len(rows), card.coverage, run)
        refuse_other_size(run, card, rows.tolist())
        read = predictions(estimator, run, progress=progress)
        table = labels.assign(**{str(name): read[name] for name in read if str(name).startswith("estimate:")})
        zeros, layout = zeros_of(estimator, run), layout_of(card)
        every = np.concatenate([estimator.outputs(run.frame(int(row)), zeros.get(int(row))) for row in rows])
        outputs, of_classes = np.split(every, [layout.outputs], axis=1)
        names = [run.frame(int(row)).name for row in rows]
        return cls(
            session, rows, names, table, outputs, of_classes, layout.decoded(outputs), true,
            finest_columns(labels), groups,
        )  # fmt: skip


def _new_session(estimator: Estimator, run: Run) -> str:
    if why := same_session(estimator, run):
        raise InputError(
            f"{run.path} sets no interval for another day: {why}; record rows of the new session",
            code="trained-on",
        )
    sessions = sorted(set(sessions_of(run).tolist()))
    if len(sessions) != 1:
        raise InputError(
            f"{run.path} holds {len(sessions)} sessions ({', '.join(sessions[:5])}); intervals are set "
            f"for one: give its rows alone, or calibrate on all of them"
        )
    return str(sessions[0])


def _check_count(groups: int, rows: int, coverage: float, run: Run) -> None:
    if is_distribution_free(groups, coverage):
        return
    least = next(n for n in range(1, 10_000) if is_distribution_free(n, coverage))
    raise InputError(
        f"{run.path} holds {rows} labelled rows of {groups} groups; {least} or more set intervals that hold "
        f"{100 * coverage:g} % of new ones, and some tens set them well",
        code="few-groups",
    )


def _guard(
    estimator: Estimator, run: Run, intervals: Intervals, beside: Path, progress: Progress
) -> tuple[NoveltyDetector, RobustnessCard]:
    """A guard that knows the frames of all sessions; this one sets its limits and tests camera changes."""
    former = NoveltyDetector.load(checked_file(estimator.folder, estimator.card.guard))
    prefix = f".{beside.name}."
    with tempfile.TemporaryDirectory(prefix=prefix, suffix=".work", dir=beside.parent) as work:
        suite = _suite(estimator, run, intervals, Path(work))
        detector, robustness = adapted_guard(suite, former_frames(estimator), progress)
    if len(suite.job.untouched.rows):
        return detector, robustness
    detector = replace(
        detector,
        reference=former.reference,
        reference_spread=former.reference_spread,
        drift_limit=former.drift_limit,
    )
    return detector, robustness


def _suite(estimator: Estimator, run: Run, intervals: Intervals, work: Path) -> Suite:
    card = estimator.card
    whole = pack(run, work / "packed", card.input.preparation)
    plan = CalibrationPlan.of_card(card, rule_in_run(card, run))
    groups = groups_within(table_to_learn(run.labels, plan))
    count = min(FOLDS_OF_GUARD, len(np.unique(groups)))
    folds = tuple(held for _, held in GroupKFold(count).split(groups, groups=groups))
    parts = Split("session", (), groups, folds, "whole groups of the new session")
    job = CalibrationJob.of(run, plan, parts, whole)
    outputs = [estimator.values(x) for _, x in job.data.batches(np.arange(len(groups)))]
    held_out = np.concatenate(outputs)[:, : plan.layout.outputs]
    return Suite(job, held_out, CertifiedModel(estimator), intervals)


def _write_pictures(folder: Path, building: Path, card: Card, run: Run, rows: _SessionRows) -> None:
    for part in card.files:
        if part.file in ("example.png", "reference.png"):
            shutil.copyfile(checked_file(folder, part), building / part.file)
    span = np.array([target.greatest - target.least for target in card.targets])
    if not len(span):
        return
    errors = layout_of(card).differences(rows.predicted, rows.true)
    worst = most_missed(errors, span, [target.is_read for target in card.targets])
    for row in rows.rows[worst].tolist():
        write_picture(building / f"worst-{row}.png", card.input.preparation.apply(run.frame(row).image))


def _card(
    former: Card,
    building: Path,
    run: Run,
    rows: _SessionRows,
    instruments: Mapping[str, ReferenceInstrument],
    intervals: Intervals,
    classes: tuple[ClassCard, ...] | None,
    robustness: RobustnessCard,
    seconds: float,
) -> Card:
    halves = _half_turns_at_most(intervals, intervals.half_widths(rows.outputs))
    errors, over_range = intervals.errors(rows.outputs, rows.true), _over_range(former, rows, intervals)
    expected = ExpectedCoverage.of(rows.count, former.coverage)
    targets = tuple(
        target.model_copy(
            update=interval_fields(intervals, j, over_range[j], _untold_width(target, former.coverage))
            | {"score": _score(target, rows, j, halves[:, j], errors[:, j])}
            | {"measured_by": _instrument(target, instruments, former.coverage)}
        )
        for j, target in enumerate(former.targets)
    )
    reset = _reset_card(former, run, rows, expected)
    changed: dict[str, Any] = {
        "targets": targets,
        "seconds": round(seconds, 1),
        "interval_reset": reset,
        "sessions": _sessions(former, rows, reset.text),
        "robustness": robustness,
        "confounds": None,  # it was of the former's frames
        "vectors": former.vectors and tuple(_vector(v, former, rows) for v in former.vectors),
        "classes": classes,
        "split": former.split.model_copy(
            update={
                "reason": f"{former.split.reason}; the intervals are of session {rows.session}",
                "columns": rows.columns,
                "groups": rows.count,
                "rows_scored": len(rows.rows),
            }
        ),
    }
    return sealed(former.model_dump(exclude={"id"}) | made_fields(building) | changed)


def _instrument(
    target: TargetCard, stated: Mapping[str, ReferenceInstrument], coverage: float
) -> InstrumentCard | None:
    """Instrument of the session's labels, which set the width; the former one where none is stated."""
    return instrument_card(stated.get(target.column), coverage) or target.measured_by


def _score(
    target: TargetCard,
    rows: _SessionRows,
    j: int,
    half: Float[np.ndarray, " n"],
    error: Float[np.ndarray, " n"],
) -> ScoreCard:
    """Errors in the session, and the share held of the rows that set the width, as on any card."""
    return score(
        target.unit, rows.true[:, j], rows.predicted[:, j], half, target.training_mean, rows.groups,
        inside=within(error, -half, half), period=target.period,
    )  # fmt: skip


def _half_turns_at_most(intervals: Intervals, halves: Values) -> Values:
    """Half-widths ``[n t]``, none of a circular target beyond half its turn: nothing lies farther off."""
    periods = (None,) * halves.shape[1] if intervals.layout is None else intervals.layout.periods
    return np.minimum(halves, [np.inf if period is None else period / 2 for period in periods])


def _over_range(former: Card, rows: _SessionRows, intervals: Intervals) -> list[RangeCard | None]:
    """Where the range ends for the new intervals: as far as the former's rows or these usually go."""
    ranges = [(target.least, target.greatest) for target in former.targets]
    own = range_cards(intervals, rows.outputs, rows.true, rows.groups, ranges)
    return [_farther(one, target.over_range) for one, target in zip(own, former.targets, strict=True)]


def _untold_width(target: TargetCard, coverage: float) -> float | None:
    """Width from which on an arc tells nothing: the network tells no more than it did, or as little."""
    if target.circular is None:
        return None
    nothing = target.circular.untold_width == 0
    return 0.0 if nothing else coverage * (target.greatest - target.least)


def _farther(one: RangeCard | None, former: RangeCard | None) -> RangeCard | None:
    if one is None or former is None:
        return one
    return one.model_copy(
        update={
            name: tuple(map(max, getattr(one, name), getattr(former, name))) for name in ("beyond", "reach")
        }
    )


def _vector(vector: VectorCard, former: Card, rows: _SessionRows) -> VectorCard:
    at, own = [former.columns.index(part) for part in vector.columns], intervals_of(former)
    scaled = own.errors(rows.outputs, rows.true) / own.spread.at(rows.outputs)
    correlation = np.array(vector.correlation)
    radius = radius_set_anew(correlation, scaled[:, at], rows.groups, former.coverage)
    inside = mahalanobis(scaled[:, at], correlation) <= radius
    low, high = grouped_coverage_interval(inside, rows.groups)
    rate = {"covered": float(inside.mean()), "low": low, "high": high}
    return vector.model_copy(update={"radius": radius, "n": len(rows.rows)} | rate)


def _classes(former: Card, rows: _SessionRows) -> HeldOutClasses | None:
    if not former.classes:
        return None
    labels = tuple(
        ClassLabels(c.column, c.values, c.names, known_codes(rows.table, c.column, c.values, rows.session))
        for c in former.classes
    )
    return held_out_classes(labels, rows.of_classes, rows.groups, former.coverage)


def _reset_card(former: Card, run: Run, rows: _SessionRows, expected: ExpectedCoverage) -> IntervalResetCard:
    what = "rows" if rows.count == len(rows.rows) else f"{' and '.join(rows.columns)} groups"
    low, mean, high = (100 * rate for rate in (expected.low, expected.mean, expected.high))
    own = rows.count == len(rows.rows)
    drawn = "the" if own else "one row being drawn from each group, the expected"
    circa, at_least = ("", "") if own else ("about ", " or more")
    before = intervals_of(former)
    low_before, high_before = before.ends(rows.outputs)
    were = _half_turns_at_most(before, (high_before - low_before) / 2).mean(axis=0)
    text = (
        f"The intervals were set anew for session {rows.session} by {len(rows.rows)} labelled rows of it, "
        f"the network being that of calibration {former.id}: {drawn} score of rank "
        f"{expected.rank} of {rows.count} {what}. They cover {circa}{mean:.1f} % of that session's rows on "
        f"average over such sets of rows; this set, with a probability of 95 %{at_least}, {low:.1f} to "
        f"{high:.1f} %. These rows set the coverage and do not test it. Of a third session they say nothing."
    )
    return IntervalResetCard(
        calibration=former.id,
        run=run_card(run),
        session=rows.session,
        rows=len(rows.rows),
        groups=rows.count,
        rank=expected.rank,
        coverage_mean=expected.mean,
        coverage_low=expected.low,
        coverage_high=expected.high,
        text=text,
        former_half_widths=dict(zip(former.columns, were.tolist(), strict=True)),
    )


def _sessions(former: Card, rows: _SessionRows, text: str) -> SessionsCard:
    before = former.sessions
    return SessionsCard(
        column=before.column if before else "session",
        names=before.names if before else (),
        runs=before.runs if before else (),
        held_out=0,
        rule="one session",
        rank=None,
        factor=None,
        errors={},
        findings=before.findings if before else (),
        text=text,
    )


def few_sessions_factor(sessions: int, coverage: float) -> float:
    """Return Student's over the Gaussian quantile: the cost of few sessions in width.

    Example:
        >>> [round(few_sessions_factor(count, 0.9), 2) for count in (2, 5, 8)]
        [1.78, 1.23, 1.13]
    """
    level = (1 + coverage) / 2
    return float(student.ppf(level, sessions) / norm.ppf(level))


def parametric_quantile(scores: Float[np.ndarray, " n"], groups: np.ndarray, coverage: float) -> float:
    """Return the score that one of a new group stays below, by the parametric rule; at least that factor
    times the quantile of the scores with equal weight per group.

    Args:
        groups: group of each row ``[n]``, of two or more.
        coverage: 0 to 1.
    """
    _, of = np.unique(groups, return_inverse=True)
    counts = np.bincount(of)
    squares = np.bincount(of, weights=scores**2) / counts
    gaussian = float(norm.ppf((1 + coverage) / 2) * np.sqrt(squares.mean()))
    return few_sessions_factor(len(counts), coverage) * max(
        gaussian, weighted_quantile(np.abs(scores), of, coverage)
    )


@dataclass(frozen=True, slots=True)
class SessionSpread:
    """Standard deviation of a target's errors between sessions (less the part by chance) and within [the
    target's unit].
    """

    between: float
    within: float

    @classmethod
    def of(cls, errors: Float[np.ndarray, " n"], groups: np.ndarray) -> SessionSpread:
        """From signed errors of held-out rows and the label of each row's session ``[n]``."""
        _, of = np.unique(groups, return_inverse=True)
        counts = np.bincount(of)
        means = np.bincount(of, weights=errors) / counts
        variances = np.bincount(of, weights=(errors - means[of]) ** 2) / np.maximum(counts - 1, 1)
        between = float(np.mean(means**2 - variances / counts))
        return cls(math.sqrt(max(between, 0.0)), math.sqrt(float(variances.mean())))


def intervals_of_sessions(
    predicted: Outputs,
    true: Values,
    sessions: np.ndarray,
    groups: np.ndarray,
    coverage: float,
    layout: TargetLayout | None = None,
) -> Intervals:
    """Return intervals that cover the truth at the rate `coverage` in a session not yet seen.

    Args:
        predicted: outputs ``[n o]`` of models that had not seen the row's session.
        true: labels ``[n t]``.
        sessions: session of each row ``[n]``, two or more.
        groups: group within the sessions ``[n]``, such as the press.
        layout: of the targets in the outputs; None where each is one.
    """
    names, of = np.unique(sessions, return_inverse=True)
    if len(names) < 2:
        raise InputError("intervals for a new session need two sessions or more that were held out")
    layout = layout or TargetLayout((None,) * true.shape[1])
    errors = layout.differences(layout.decoded(predicted), true)
    terms = spread_terms(predicted, np.abs(errors), groups)
    whole = fit_spread(predicted, np.abs(errors), terms)
    scores = np.empty_like(true)
    for rest, held in parts_by_group(of):
        # With one scale for all, which the quantile undoes: the others' would only add their scatter.
        spread = replace(fit_spread(predicted[rest], np.abs(errors[rest]), terms), typical=whole.typical)
        scores[held] = errors[held] / spread.at(predicted[held])
    free = is_distribution_free(len(names), coverage)
    quantile = [
        new_group_quantile(np.abs(column), of, coverage)
        if free
        else parametric_quantile(column, of, coverage)
        for column in scores.T
    ]
    return Intervals(whole, np.array(quantile), coverage, layout=layout)
