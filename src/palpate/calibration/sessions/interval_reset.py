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
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
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
from palpate.calibration.certificate import CalibrationResult, run_card, target_cards, write_certificate
from palpate.calibration.classes import ClassLabels, held_out_parts, known_codes, target_values
from palpate.calibration.coverage.conformal import fit_spread, parts_by_group, spread_terms
from palpate.calibration.coverage.grouped_rates import (
    grouped_coverage_interval,
    is_distribution_free,
    new_group_quantile,
    rank_of_new_group,
    weighted_quantile,
)
from palpate.calibration.evaluation import same_session, zeros_of
from palpate.calibration.robustness.perturbation_suite import (
    CertifiedModel,
    Suite,
    former_frames,
    guard_of,
)
from palpate.core import Float, InputError, PathText, Progress, Values, refuse_existing, silent
from palpate.estimators.certified import Estimator, checked_file
from palpate.estimators.class_sets import Outputs, TargetLayout
from palpate.estimators.findings import IntervalResetCard, RobustnessCard, SessionsCard
from palpate.estimators.guard import NoveltyDetector
from palpate.estimators.intervals import Intervals, intervals_of, mahalanobis
from palpate.estimators.model_card import Card, RangeCard, SplitCard, TargetCard, VectorCard
from palpate.recordings import Run, Split, pack
from palpate.recordings.joined_runs import check_instruments, sessions_of
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
    card = estimator.card
    check_instruments(run, card.columns, instruments or {})
    session = _new_session(estimator, run)
    plan = CalibrationPlan.of_card(
        card, rule_in_run(card, run), instruments=run.manifest.instruments | dict(instruments or {})
    )
    with tempfile.TemporaryDirectory(prefix=f".{out.name}.", suffix=".work", dir=out.parent) as work:
        job = _job(card, run, plan, Path(work))
        zeros = zeros_of(estimator, run)
        every = [estimator.outputs(run.frame(int(row)), zeros.get(int(row))) for row in job.rows]
        outputs, classes = held_out_parts(job.classes, np.concatenate(every), job.data.groups, plan)
        intervals = intervals_set_anew(intervals_of(card), outputs, job.data.values, job.data.groups)
        # Changed frames are compared with unchanged ones of the job, whose no-contact image is not rounded.
        known = [estimator.values(inputs) for _, inputs in job.data.batches(np.arange(len(job.rows)))]
        known_outputs = np.concatenate(known)[:, : plan.layout.outputs]
        suite = Suite(job, known_outputs, CertifiedModel(estimator), intervals)
        detector, robustness = _guard(estimator, suite, progress)
        result = CalibrationResult(
            job, None, outputs, intervals, suite.fitted, detector, time.monotonic() - started, robustness,
            classes=classes,
        )  # fmt: skip
        more = partial(_fields, result, estimator, session)
        return write_certificate(result, out, former=card, split=_split(card, job, session), more=more)


def _job(card: Card, run: Run, plan: CalibrationPlan, work: Path) -> CalibrationJob:
    """Rows of the new session, without no-contact rows; whole groups of them are the folds of the guard."""
    table = table_to_learn(run.labels, plan)
    target_values(table, card.columns, str(run.path))
    labels = tuple(
        ClassLabels(c.column, c.values, c.names, known_codes(table, c.column, c.values, str(run.path)))
        for c in card.classes or ()
    )
    groups = groups_within(table)
    _check_count(len(np.unique(groups)), len(table), card.coverage, run)
    refuse_other_size(run, card, range(len(run)))
    count = min(FOLDS_OF_GUARD, len(np.unique(groups)))
    folds = tuple(held for _, held in GroupKFold(count).split(groups, groups=groups))
    parts = Split("session", finest_columns(table), groups, folds, "whole groups of the new session")
    whole = pack(run, work / "packed", card.input.preparation)
    return CalibrationJob.of(run, plan, parts, whole, labels)


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


def _guard(estimator: Estimator, suite: Suite, progress: Progress) -> tuple[NoveltyDetector, RobustnessCard]:
    """A guard that knows the frames of all sessions; this one sets its limits and tests camera changes."""
    detector, robustness = guard_of(suite, progress, former_frames(estimator))
    if len(suite.job.untouched.rows):
        return detector, robustness
    former = NoveltyDetector.load(checked_file(estimator.folder, estimator.card.guard))
    detector = replace(
        detector,
        reference=former.reference,
        reference_spread=former.reference_spread,
        drift_limit=former.drift_limit,
    )
    return detector, robustness


def _split(former: Card, job: CalibrationJob, session: str) -> SplitCard:
    return former.split.model_copy(
        update={
            "reason": f"{former.split.reason}; the intervals are of session {session}",
            "columns": job.parts.group_columns,
            "groups": len(np.unique(job.data.groups)),
            "rows_scored": len(job.packed),
        }
    )


def _fields(result: CalibrationResult, estimator: Estimator, session: str, folder: Path) -> dict[str, Any]:
    """Fields of the card that stay, and those of the session; the network stays to the last byte."""
    former = estimator.card
    shutil.copyfile(checked_file(estimator.folder, former.model), folder / "model.onnx")
    if former.copy_of is not None and former.copy_of.file is not None:
        copies = former.copy_of.file
        shutil.copyfile(checked_file(estimator.folder, copies), folder / copies.file)
    names = ("sensor", "agreement", "adapted_from", "run", "reference")
    reset, (low, high) = _reset_card(former, result, session), result.intervals.ends(result.held_out)
    targets = target_cards(result, result.intervals, (high - low) / 2, former.targets)
    return {name: getattr(former, name) for name in names} | {
        "targets": tuple(
            _target(*pair, former.coverage) for pair in zip(former.targets, targets, strict=True)
        ),
        "interval_reset": reset,
        "sessions": _sessions(former, reset.text),
        "vectors": former.vectors and tuple(_vector(v, former, result) for v in former.vectors),
    }


def _target(former: TargetCard, one: TargetCard, coverage: float) -> TargetCard:
    """The card of a target, whose range ends as far as the former's rows or these usually go."""
    update: dict[str, Any] = {
        "over_range": _farther(one.over_range, former.over_range),
        # Instrument of the session's labels, which set the width; the former one where none is stated.
        "measured_by": one.measured_by or former.measured_by,
    }
    if one.circular is not None and former.circular is not None:
        # The network tells no more of an arc than it did, or as little.
        nothing, arc = former.circular.untold_width == 0, former.greatest - former.least
        update["circular"] = one.circular.model_copy(
            update={"untold_width": 0.0 if nothing else coverage * arc}
        )
    return one.model_copy(update=update)


def _farther(one: RangeCard | None, former: RangeCard | None) -> RangeCard | None:
    if one is None or former is None:
        return one
    return one.model_copy(
        update={
            name: tuple(map(max, getattr(one, name), getattr(former, name))) for name in ("beyond", "reach")
        }
    )


def _vector(vector: VectorCard, former: Card, result: CalibrationResult) -> VectorCard:
    at, own = [former.columns.index(part) for part in vector.columns], intervals_of(former)
    groups = result.data.groups
    scaled = own.errors(result.held_out, result.data.values) / own.spread.at(result.held_out)
    correlation = np.array(vector.correlation)
    radius = radius_set_anew(correlation, scaled[:, at], groups, former.coverage)
    inside = mahalanobis(scaled[:, at], correlation) <= radius
    low, high = grouped_coverage_interval(inside, groups)
    rate = {"covered": float(inside.mean()), "low": low, "high": high}
    return vector.model_copy(update={"radius": radius, "n": len(scaled)} | rate)


def _reset_card(former: Card, result: CalibrationResult, session: str) -> IntervalResetCard:
    groups, count = len(np.unique(result.data.groups)), len(result.held_out)
    expected, own = ExpectedCoverage.of(groups, former.coverage), groups == count
    what = "rows" if own else f"{' and '.join(result.job.parts.group_columns)} groups"
    low, mean, high = (100 * rate for rate in (expected.low, expected.mean, expected.high))
    drawn = "the" if own else "one row being drawn from each group, the expected"
    circa, at_least = ("", "") if own else ("about ", " or more")
    low_before, high_before = intervals_of(former).ends(result.held_out)
    were = ((high_before - low_before) / 2).mean(axis=0)
    text = (
        f"The intervals were set anew for session {session} by {count} labelled rows of it, "
        f"the network being that of calibration {former.id}: {drawn} score of rank "
        f"{expected.rank} of {groups} {what}. They cover {circa}{mean:.1f} % of that session's rows on "
        f"average over such sets of rows; this set, with a probability of 95 %{at_least}, {low:.1f} to "
        f"{high:.1f} %. These rows set the coverage and do not test it. Of a third session they say nothing."
    )
    return IntervalResetCard(
        calibration=former.id,
        run=run_card(result.job.run),
        session=session,
        rows=count,
        groups=groups,
        rank=expected.rank,
        coverage_mean=expected.mean,
        coverage_low=expected.low,
        coverage_high=expected.high,
        text=text,
        former_half_widths=dict(zip(former.columns, were.tolist(), strict=True)),
    )


def _sessions(former: Card, text: str) -> SessionsCard:
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
