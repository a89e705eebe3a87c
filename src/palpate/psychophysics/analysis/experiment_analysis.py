"""Analysis of one experiment: accuracy, confusions, thresholds, and differences between conditions.

A setting is a presentation and a condition; judgments are never pooled over settings. Estimates that need
more participants are omitted and named in the caveats, as are missing answers and unbounded functions.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from palpate.core import Float, InputError, Int, ndarray
from palpate.psychophysics.analysis.condition_models import (
    ConditionCounts,
    LogOddsDifference,
    MixedLogistic,
    ShareDifference,
    counts_of,
    fit_mixed_logistic,
    marginal_log_odds,
    share_differences,
)
from palpate.psychophysics.analysis.proportions import (
    Ends,
    clopper_pearson_interval,
    cluster_interval,
    wald_interval,
    wilson_interval,
)
from palpate.psychophysics.analysis.psychometric_fit import PsychometricFit, SigmoidShape, fit_psychometric
from palpate.psychophysics.analysis.rank_confusion import (
    RankConfusion,
    confusion_of_places,
    places_given,
    rank_correlation,
)
from palpate.psychophysics.judgements import Judgement, Stimulus, Task
from palpate.psychophysics.trial_statistics import mean_interval

DEVIANCE_DRAWS = 400
SIMULATED = "simulated participants or display: nothing here is a measurement"


@dataclass(frozen=True, slots=True)
class SettingAccuracy:
    """Proportion of correct answers in one setting; of rankings, of correct positions.

    Attributes:
        wald, wilson, clopper_pearson: 95 % intervals, assuming independent answers.
        clusters: 95 % interval over participants; None for one.
    """

    task: Task
    setting: str
    participants: int
    right: int
    n: int
    wald: Ends
    wilson: Ends
    clopper_pearson: Ends
    clusters: Ends | None

    @property
    def share(self) -> float:
        """Right answers over all."""
        return self.right / self.n


@dataclass(frozen=True)
class SettingRankings:
    """Rankings in one setting.

    Attributes:
        tau, rho: Kendall's and Spearman's coefficients, mean over rankings.
        told: number of rankings whose tau has p < 0.05 (exact, two-sided).
        tau_interval: Student's 95 % interval over participants, clipped to -1 to 1; None if undefined.
    """

    setting: str
    confusion: RankConfusion
    perfect: int
    tau: float
    rho: float
    told: int
    tau_interval: Ends | None


@dataclass(frozen=True)
class SettingThreshold:
    """Psychometric function of pairs with one standard.

    Attributes:
        given, n: number of "softer than the standard" answers, and of all, at each level.
        fit: pooled over participants, over `counted`: the level, sign-reversed if softer is -1 (logarithmic:
            inverted).
        pse: point of subjective equality with its interval [unit of the stimuli].
        own_pse: mean over the `own_bounded` participants with a bounded one, with Student's 95 % interval.
    """

    setting: str
    standard: str
    levels: Float[ndarray, " n"]
    given: Int[ndarray, " n"]
    n: Int[ndarray, " n"]
    fit: PsychometricFit
    counted: Float[ndarray, " n"]
    pse: tuple[float, float, float]
    own_pse: tuple[float, float, float] | None
    own_bounded: int
    participants: int


@dataclass(frozen=True)
class TaskComparison:
    """Comparison of the settings of one task; `mixed` for pairs only, since positions in a ranking are
    dependent.
    """

    task: Task
    shares: tuple[ShareDifference, ...]
    marginal: tuple[LogOddsDifference, ...]
    mixed: MixedLogistic | None


@dataclass(frozen=True)
class ExperimentAnalysis:
    """Analysis of an experiment; `unanswered` and `caveats` are one sentence each."""

    participants: tuple[str, ...]
    judgements: int
    unanswered: tuple[str, ...]
    accuracies: tuple[SettingAccuracy, ...]
    rankings: tuple[SettingRankings, ...]
    thresholds: tuple[SettingThreshold, ...]
    comparisons: tuple[TaskComparison, ...]
    caveats: tuple[str, ...]
    unit: str

    def to_dict(self) -> dict[str, Any]:
        """All of it as JSON can hold it; what is not finite is None."""
        return _plain(
            asdict(self) | {"accuracies": [asdict(a) | {"share": a.share} for a in self.accuracies]}
        )


def analyse_experiment(
    judgements: Sequence[Judgement],
    stimuli: Mapping[str, Stimulus],
    *,
    unanswered: Sequence[str] = (),
    simulated: bool = False,
    shape: SigmoidShape = SigmoidShape.GAUSSIAN,
    logarithmic: bool = False,
    lapse: float | None = None,
    seed: int = 0,
) -> ExperimentAnalysis:
    """Analyze the judgments of an experiment.

    Args:
        simulated: whether answers or stimuli are simulated; becomes the first caveat.
        logarithmic: use the logarithm of levels; always true for Weibull.
        lapse: lapse rate at both ends of psychometric functions; None to estimate it.
    """
    if not judgements:
        raise InputError(
            f"no answers among {len(unanswered)} rows; there is nothing to analyse", code="no-answers"
        )
    rng = np.random.default_rng(seed)
    groups: dict[tuple[Task, str], list[Judgement]] = {}
    for one in sorted(judgements, key=lambda one: (one.task, one.presentation, "IKC".index(one.condition))):
        groups.setdefault((one.task, f"{one.presentation} {one.condition}"), []).append(one)
    logarithmic = logarithmic or shape is SigmoidShape.WEIBULL
    counted = {at: _right(each, stimuli) for at, each in groups.items()}
    accuracies = tuple(_accuracy(*at, each, rng) for at, each in counted.items())
    rankings = tuple(_rankings(s, each, stimuli) for (t, s), each in groups.items() if t is Task.RANK)
    thresholds, left_out = _thresholds(groups, stimuli, shape, logarithmic, lapse, rng)
    people = tuple(sorted({one.participant for one in judgements}))
    comparisons = tuple(_compared(task, counted) for task in Task) if len(people) > 1 else ()
    return ExperimentAnalysis(
        participants=people,
        judgements=len(judgements),
        unanswered=tuple(unanswered),
        accuracies=accuracies,
        rankings=rankings,
        thresholds=thresholds,
        comparisons=tuple(one for one in comparisons if one.shares or one.marginal),
        caveats=(
            *([SIMULATED] if simulated else []),
            *_caveats(people, groups, counted, unanswered),
            *left_out,
        ),
        unit=next(iter(stimuli.values())).unit,
    )


Answers = Mapping[str, tuple[int, int]]  # of each participant, right and all


def _right(judgements: Sequence[Judgement], stimuli: Mapping[str, Stimulus]) -> dict[str, tuple[int, int]]:
    found: dict[str, tuple[int, int]] = {}
    for one in judgements:
        k, n = found.get(one.participant, (0, 0))
        truth = one.truth(stimuli)
        hits = sum(a == b for a, b in zip(one.answer, truth, strict=True))
        found[one.participant] = (k + hits, n + len(truth))
    return found


def _accuracy(task: Task, setting: str, answers: Answers, rng: np.random.Generator) -> SettingAccuracy:
    k, n = (tuple(each) for each in zip(*answers.values(), strict=True))
    right, all_ = sum(k), sum(n)
    clusters = cluster_interval(k, n, rng) if len(answers) > 1 else None
    return SettingAccuracy(
        task, setting, len(answers), right, all_, wald_interval(right, all_), wilson_interval(right, all_),
        clopper_pearson_interval(right, all_), clusters,
    )  # fmt: skip


def _rankings(
    setting: str, judgements: Sequence[Judgement], stimuli: Mapping[str, Stimulus]
) -> SettingRankings:
    names, places = places_given(judgements, stimuli)
    found = [rank_correlation(one) for one in places]
    taus: dict[str, list[float]] = {}
    for one, each in zip(judgements, found, strict=True):
        taus.setdefault(one.participant, []).append(each.tau)
    means = [float(np.mean(each)) for each in taus.values()]
    interval = None
    if len(means) > 1 and np.ptp(means) > 0:
        low, high = mean_interval(means)
        interval = (max(low, -1.0), min(high, 1.0))  # no tau lies beyond
    return SettingRankings(
        setting,
        confusion_of_places(names, places),
        int((places == np.arange(len(names))).all(axis=1).sum()),
        float(np.mean([one.tau for one in found])),
        float(np.mean([one.rho for one in found])),
        sum(one.tau_p < 0.05 for one in found),
        interval,
    )


def _thresholds(
    groups: Mapping[tuple[Task, str], Sequence[Judgement]], stimuli: Mapping[str, Stimulus],
    shape: SigmoidShape, logarithmic: bool, lapse: float | None, rng: np.random.Generator,
) -> tuple[tuple[SettingThreshold, ...], list[str]]:  # fmt: skip
    found, left_out = [], []
    for (task, setting), judgements in groups.items():
        if task is not Task.PAIR:
            continue
        common = set.intersection(*(set(one.presented) for one in judgements))
        levels = {stimuli[name].level for one in judgements for name in one.presented}
        if len(common) != 1 or len(levels) < 3:
            left_out.append(
                f"{setting}: no psychometric function; pairs with one standard and two comparisons or more "
                "are needed"
            )
            continue
        one = _threshold(setting, next(iter(common)), judgements, stimuli, shape, logarithmic, lapse, rng)
        found.append(one)
        if 1 < one.participants > one.own_bounded:
            left_out.append(
                f"{setting}: {one.own_bounded} of {one.participants} participants' own answers bound a point "
                "of equality; the others' lies near the end of the levels or beyond, and the mean of these "
                "alone is drawn towards the middle: take the pooled one, or set levels further out"
            )
    return tuple(found), left_out


def _threshold(
    setting: str, standard: str, judgements: Sequence[Judgement], stimuli: Mapping[str, Stimulus],
    shape: SigmoidShape, logarithmic: bool, lapse: float | None, rng: np.random.Generator,
) -> SettingThreshold:  # fmt: skip
    softer = stimuli[standard].softer
    levels, (given, n) = _counts(standard, judgements, stimuli)

    def turned(level: Any) -> Any:
        return level**softer if logarithmic else softer * level

    counted = np.asarray(turned(levels), np.float64)
    fit = fit_psychometric(
        counted, given, n, shape, guess=lapse or 0.0, lapse=lapse, guess_is_lapse=True,
        logarithmic=logarithmic, deviance_draws=DEVIANCE_DRAWS, rng=rng,
    )  # fmt: skip
    low, high = sorted((turned(fit.threshold.low), turned(fit.threshold.high)))
    own = _own_pses(standard, judgements, stimuli, fit, turned)
    return SettingThreshold(
        setting, standard, levels, given, n, fit, counted, (turned(fit.threshold.value), low, high),
        (float(np.mean(own)), *mean_interval(own)) if len(own) > 1 else None, len(own),
        len({one.participant for one in judgements}),
    )  # fmt: skip


def _counts(
    standard: str, judgements: Sequence[Judgement], stimuli: Mapping[str, Stimulus]
) -> tuple[Float[ndarray, " n"], tuple[Int[ndarray, " n"], Int[ndarray, " n"]]]:
    """Levels compared with the standard, how often each was called softer, and of how many."""
    all_, softer = Counter[float](), Counter[float]()
    for one in judgements:
        (name,) = set(one.presented) - {standard}
        level = stimuli[name].level
        all_[level] += 1
        softer[level] += one.answer == (name,)
    levels = sorted(all_)
    return np.array(levels, np.float64), (
        np.array([softer[one] for one in levels]),
        np.array([all_[one] for one in levels]),
    )


def _own_pses(
    standard: str, judgements: Sequence[Judgement], stimuli: Mapping[str, Stimulus], pooled: PsychometricFit,
    turned: Callable[[Any], Any],
) -> list[float]:  # fmt: skip
    """Participants' own points of equality, of those whose answers bound it; lapses as pooled."""
    values = []
    for person in sorted({one.participant for one in judgements}):
        levels, (given, n) = _counts(
            standard, [one for one in judgements if one.participant == person], stimuli
        )
        if len(levels) < 2:
            continue
        f = pooled.function
        own = fit_psychometric(
            np.asarray(turned(levels), np.float64), given, n, f.shape, guess=f.guess, lapse=f.lapse,
            logarithmic=f.logarithmic, deviance_draws=0,
        )  # fmt: skip
        if all(own.threshold.bounded):
            values.append(float(turned(own.threshold.value)))
    return values


def _compared(task: Task, counted: Mapping[tuple[Task, str], Answers]) -> TaskComparison:
    settings = {setting: answers for (of, setting), answers in counted.items() if of is task}
    if len(settings) < 2:
        return TaskComparison(task, (), (), None)
    people = sorted({person for answers in settings.values() for person in answers})
    rows = {(p, s): answers[p] for p in people for s, answers in settings.items() if p in answers}
    counts = _in_order(counts_of(rows), tuple(settings))
    mixed = fit_mixed_logistic(counts) if task is Task.PAIR else None
    return TaskComparison(task, share_differences(counts), marginal_log_odds(counts), mixed)


def _in_order(counts: ConditionCounts, names: tuple[str, ...]) -> ConditionCounts:
    at = [counts.conditions.index(name) for name in names]
    return ConditionCounts(names, counts.participants, counts.right[:, at], counts.n[:, at])


def _caveats(
    people: Sequence[str],
    groups: Mapping[tuple[Task, str], Sequence[Judgement]],
    counted: Mapping[tuple[Task, str], Answers],
    unanswered: Sequence[str],
) -> list[str]:
    found = []
    if unanswered:
        found.append(f"{len(unanswered)} rows have no answer and are left out: {unanswered[0]}")
    for (task, setting), each in groups.items():
        number = Counter(one.participant for one in each)
        short = {p: max(number.values()) - k for p, k in number.items() if k < max(number.values())}
        if short:
            lacking = ", ".join(f"{p} lacks {k}" for p, k in sorted(short.items()))
            found.append(
                f"{setting}, {task}: not balanced, {sum(short.values())} answers fewer than if all had "
                f"answered as many as the most did ({lacking}); shares weigh participants by their answers"
            )
        absent = sorted(set(people) - set(number))
        if absent:
            found.append(f"{setting}, {task}: not met by {', '.join(absent)}")
    if len(people) == 1:
        found.append(
            "one participant: nothing is said of other people, and conditions are not compared over people"
        )
    elif any(max(n for _, n in answers.values()) > 1 for answers in counted.values()):
        found.append(
            "Wald's, Wilson's and Clopper and Pearson's intervals take answers of one person as independent "
            "(pseudo-replication); use those over participants"
        )
    for (task, setting), answers in counted.items():
        k, n = (sum(each) for each in zip(*answers.values(), strict=True))
        if k in (0, n):
            what = "right" if k else "wrong"
            found.append(f"{setting}, {task}: all {n} are {what}; a share of {k // n} is told by no count")
    if any(task is Task.RANK for task, _ in groups):
        found.append("places in one ranking are not independent: two at least are wrong where one is")
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(name): _plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value
