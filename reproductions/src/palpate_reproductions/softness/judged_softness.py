"""The report's experiments with people: tables recomputed, intervals, and observers put to the test.

Nothing of it is measured here. Counts are the report's; accuracies and intervals follow from them; observers
are fitted to the conditions with one cue (K, C) and tested on the one with both (I), which they are never
fitted to. Single rankings are not printed, so that what differs between people cannot be told: intervals are
of thirty independent rankings, and too short where people differ.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count, permutations

import numpy as np

from palpate.psychophysics import Condition, Presentation
from palpate.psychophysics.analysis import (
    RankConfusion,
    clopper_pearson_interval,
    newcombe_interval,
    wald_full_width,
    wilson_interval,
)
from palpate.psychophysics.judgements import RankObserver
from palpate.softness import SoftObject
from palpate_reproductions.softness.observers import (
    CueNeeds,
    CuePrediction,
    ObserverFit,
    combined_observer,
    composite_log_likelihood,
    fit_observer,
    needs_of,
    predict_by_accuracy,
    predict_of_unlike_people,
    predictions_of,
)
from palpate_reproductions.softness.published_judgements import (
    PAIR_ANSWERS,
    PAIRS,
    PAIRS_PRINTED,
    PEOPLE,
    RANKINGS_PRINTED,
    WIDTHS_PRINTED,
    PublishedRanking,
    printed_ranking,
)
from palpate_reproductions.study_results import Published, StudyEntry, study_entry

SIMULATED = 2_000
ALIKE = "no faults, each person's rankings alike"
UNLIKE = "no faults, people good at either cue"
ALIKE_STUDIES = 10_000
FIT_DRAWS = 1_500
LOG_SCATTER = 1.0  # of people's d', for the row of those who are good at either cue
MECHANICS = "no faults, cues apart as the mechanics has them"


@dataclass(frozen=True)
class JudgedPair:
    """A pair of stimuli as an observer tells it, beside what is printed.

    Attributes:
        presentation, condition, name: which.
        printed: share of right answers, None where the text prints none.
    """

    presentation: Presentation
    condition: Condition
    name: str
    predicted: float
    printed: float | None


@dataclass(frozen=True)
class TouchDifference:
    """Total accuracy of rendered touch less that of direct touch, in one condition.

    Attributes:
        cells: interval of 150 answers taken as independent, which they are not.
        rankings: interval of 30 rankings of each, simulated by observers that were fitted.
    """

    condition: Condition
    value: float
    cells: tuple[float, float]
    rankings: tuple[float, float]


@dataclass(frozen=True)
class JudgedSoftness:
    """All that is found of the experiments with people.

    Attributes:
        predictions: of the integrated condition, by presentation and kind of observer.
        needs: what the plain observer would need, by presentation.
        fits: observers with lapses and reversals, one of each matrix.
        shuffled: size of d' of plain observers fitted to K's and C's matrices with the places given in every
            other order: its median and the nine tenths' end.
        wrong_sign: composite likelihood that the plain observer loses with its sign turned, by presentation,
            of K and C together.
        gains: how much further apart CL1's specimens are than CL2's in displacement and CL3's in area, in the
            logarithm, by the mechanics with assumed moduli.
    """

    predictions: Mapping[Presentation, Mapping[str, CuePrediction]]
    needs: Mapping[Presentation, CueNeeds]
    fits: Mapping[tuple[Presentation, Condition], ObserverFit]
    shuffled: Mapping[tuple[Presentation, Condition], tuple[float, float]]
    wrong_sign: Mapping[Presentation, float]
    pairs: Sequence[JudgedPair]
    differences: Sequence[TouchDifference]
    gains: tuple[float, float]


def judged_softness(
    stacked: Mapping[str, Sequence[SoftObject]], at_n: float, seed: int = 0
) -> JudgedSoftness:
    """Recompute the tables and test observers on them.

    Args:
        at_n: force at which they are compared [N].
    """
    rng = np.random.default_rng(seed)
    gains = _gains(stacked, at_n)
    predictions, needs, wrong_sign = {}, {}, {}
    pairs: list[JudgedPair] = []
    for presentation in Presentation:
        i, k, c = (printed_ranking(presentation, one).confusion for one in Condition)
        predictions[presentation] = {
            **predictions_of(k, c, i, rng),
            ALIKE: predict_by_accuracy(k, c, i, rng, independent=PEOPLE, studies=ALIKE_STUDIES),
            UNLIKE: predict_of_unlike_people(k, c, i, rng, log_scatter=LOG_SCATTER, people=PEOPLE),
            MECHANICS: predict_by_accuracy(k, c, i, rng, gains=gains),
        }
        needs[presentation] = needs_of(k, c, i, rng)
        d = needs[presentation].sensitivities
        wrong_sign[presentation] = sum(
            composite_log_likelihood(one.counts, RankObserver.evenly(at).rank_matrix())
            - composite_log_likelihood(one.counts, RankObserver.evenly(-at).rank_matrix())
            for one, at in zip((k, c), d, strict=False)
        )
        pairs += _pairs(presentation, d)
    fits = {
        (one.presentation, one.condition): fit_observer(
            one.confusion, rng, lapses=True, reversals=True, draws=FIT_DRAWS
        )
        for one in RANKINGS_PRINTED
    }
    return JudgedSoftness(
        predictions, needs, fits, _shuffled(rng), wrong_sign, pairs, _differences(fits, rng), gains
    )


def _gains(stacked: Mapping[str, Sequence[SoftObject]], at_n: float) -> tuple[float, float]:
    def apart(kind: str, cue: str) -> float:
        values = [float(getattr(one, cue).at_force(at_n)) for one in stacked[kind]]
        return math.log(max(values) / min(values))

    return (
        apart("CL1", "displacement") / apart("CL2", "displacement"),
        apart("CL1", "area") / apart("CL3", "area"),
    )


def _pairs(presentation: Presentation, sensitivities: Sequence[float]) -> Iterator[JudgedPair]:
    """Pairs as observers tell them, that of both cues as K and C predict it."""
    k, c = (RankObserver.evenly(one) for one in sensitivities[:2])
    for condition, observer in zip(Condition, (combined_observer(k, c), k, c), strict=True):
        for other, name in PAIRS:
            printed = PAIRS_PRINTED.get((presentation, condition, name))
            yield JudgedPair(presentation, condition, name, observer.pair_accuracy(other, 2), printed)


def _shuffled(rng: np.random.Generator) -> dict[tuple[Presentation, Condition], tuple[float, float]]:
    found: dict[tuple[Presentation, Condition], tuple[float, float]] = {}
    for one in RANKINGS_PRINTED:
        if one.condition is not Condition.INTEGRATED:
            names, counts = one.confusion.names, one.confusion.counts
            sizes = [
                abs(fit_observer(RankConfusion(names, counts[:, list(order)]), rng, draws=1).sensitivity)
                for order in list(permutations(range(len(names))))[1:]
            ]
            middle, ninth = np.percentile(sizes, [50, 90])
            found[one.presentation, one.condition] = float(middle), float(ninth)
    return found


def _differences(
    fits: Mapping[tuple[Presentation, Condition], ObserverFit], rng: np.random.Generator
) -> list[TouchDifference]:
    found = []
    for condition in Condition:
        direct, rendered = (printed_ranking(one, condition).confusion for one in Presentation)
        value = rendered.total_accuracy - direct.total_accuracy
        spread = math.hypot(*(_spread(fits[one, condition].observer, rng) for one in Presentation))
        first, second = ((one.right, 5 * one.rankings) for one in (direct, rendered))
        cells = newcombe_interval(first, second)
        found.append(TouchDifference(condition, value, cells, (value - 1.96 * spread, value + 1.96 * spread)))
    return found


def _spread(observer: RankObserver, rng: np.random.Generator) -> float:
    """Standard deviation of the total accuracy of thirty rankings."""
    right = (observer.drawn_places(30 * SIMULATED, rng) == np.arange(5)).mean(axis=1)
    return float(right.reshape(SIMULATED, 30).mean(axis=1).std())


def judged_entries(source: str, found: JudgedSoftness) -> Iterator[StudyEntry]:
    """All numbers of the experiments with people, beside the printed ones."""
    for one in RANKINGS_PRINTED:
        yield from _table_entries(source, one)
    yield from _interval_entries(source)
    for difference in found.differences:
        name = f"rendered less direct, {difference.condition}: total accuracy"
        yield study_entry(source, name, 100 * difference.value, "%")
        for end, value in zip(("low", "high"), difference.rankings, strict=True):
            yield study_entry(source, f"{name}, {end} of 95 % by rankings", 100 * value, "%")
    for pair in found.pairs:
        share = pair.printed
        figure = 10 if pair.presentation is Presentation.DIRECT else 11
        printed = None if share is None else Published(100 * share, f"Fig. {figure}, text")
        name = f"pair {pair.name}, {pair.presentation} {pair.condition}: right by the plain observer"
        yield study_entry(source, name, 100 * pair.predicted, "%", printed)
    yield from _observer_entries(source, found)


def _table_entries(source: str, one: PublishedRanking) -> Iterator[StudyEntry]:
    confusion = one.confusion
    total = 100 * confusion.total_accuracy
    named = f"{one.presentation} {one.condition}"
    yield _explained(source, f"{named}: total accuracy", total, one.total, one.where)
    if one.in_text is not None:
        yield _explained(source, f"{named}: total accuracy, in the text", total, one.in_text, "sec. 5.4")
    for name, found, printed in zip(confusion.names, confusion.relative_accuracy, one.relative, strict=True):
        yield _explained(source, f"{named} {name}: relative accuracy", 100 * found, printed, one.where)


def _explained(source: str, name: str, found: float, printed: float, where: str) -> StudyEntry:
    entry = study_entry(source, name, found, "%", Published(printed, where))
    off = printed - round(found, 2)
    if abs(off) > 0.005:
        entry["why"] = (
            "rounded up" if 0 < off < 0.015 else "misprint: the counts of the table itself do not give it"
        )
    return entry


def _interval_entries(source: str) -> Iterator[StudyEntry]:
    for mean, width in WIDTHS_PRINTED.items():
        printed = Published(width, "sec. 5.3")
        name = f"eq. (7), mean {mean:g} of 30: width from end to end"
        entry = study_entry(source, name, wald_full_width(mean, PAIR_ANSWERS), "1", printed)
        entry["why"] = "printed as the interval, it is the full width; ± is half of it"
        yield entry
        entry = study_entry(source, f"mean {mean:g} times 30 answers", mean * PAIR_ANSWERS, "1")
        entry["why"] = "no whole number: no count of right answers of 30 has this mean"
        yield entry
    name = "fewest answers of which all three means are whole counts, to two digits"
    yield study_entry(source, name, fewest_answers(tuple(WIDTHS_PRINTED)), "1")
    name = "30 right of 30, eq. (7): width"
    entry = study_entry(source, name, wald_full_width(1.0, PAIR_ANSWERS), "1", Published(0.0, "sec. 5.1"))
    entry["why"] = "“total confidence” is Wald's interval without width where all answers are right"
    yield entry
    yield study_entry(source, "30 right of 30, Wilson: low end", wilson_interval(30, 30)[0], "1")
    yield study_entry(
        source, "30 right of 30, Clopper and Pearson: low end", clopper_pearson_interval(30, 30)[0], "1"
    )
    name = "10 people all right, each counted once, Clopper and Pearson: low end"
    yield study_entry(source, name, clopper_pearson_interval(10, 10)[0], "1")


def fewest_answers(means: Sequence[float]) -> int:
    """Fewest answers of which every mean, to two digits, is a whole number."""
    return next(n for n in count(1) if all(round(round(m * n) / n, 2) == round(m, 2) for m in means))


def _observer_entries(source: str, found: JudgedSoftness) -> Iterator[StudyEntry]:
    for presentation in Presentation:
        needs = found.needs[presentation]
        for name, value, ends in zip("KCI", needs.sensitivities, needs.sensitivity_intervals, strict=True):
            named = f"{presentation} {name}: d' of neighbours by total accuracy"
            yield from _with_ends(source, named, value, ends, "1")
        for kind, one in found.predictions[presentation].items():
            named = f"{presentation} I predicted, {kind}"
            yield from _with_ends(
                source, f"{named}: total accuracy", 100 * one.accuracy, (100 * one.low, 100 * one.high), "%"
            )
            yield study_entry(source, f"{named}: p of what was observed", one.p, "1")
        if needs.correlation is not None:
            named = f"{presentation}: correlation of noises needed"
            yield from _with_ends(source, named, needs.correlation, needs.correlation_interval, "1")
        yield from _with_ends(
            source, f"{presentation}: gain in both cues needed", needs.gain, needs.gain_interval, "1"
        )
        yield study_entry(
            source,
            f"{presentation}: log likelihood lost by the wrong sign",
            found.wrong_sign[presentation],
            "1",
        )
    for (presentation, condition), fit in found.fits.items():
        named = f"{presentation} {condition}: observer with faults"
        yield study_entry(source, f"{named}, d'", fit.sensitivity, "1")
        yield study_entry(source, f"{named}, lapses", fit.observer.lapse, "1")
        yield study_entry(source, f"{named}, reversals", fit.observer.reversal, "1")
        yield study_entry(source, f"{named}, p of its fit", fit.deviance_p, "1")
    for (presentation, condition), (middle, ninth) in found.shuffled.items():
        yield study_entry(source, f"{presentation} {condition} shuffled: size of d', median", middle, "1")
        yield study_entry(source, f"{presentation} {condition} shuffled: size of d', 90 %", ninth, "1")
    for cue, gain in zip(("displacement", "area"), found.gains, strict=True):
        other = "CL2" if cue == "displacement" else "CL3"
        yield study_entry(source, f"CL1 over {other}, log {cue}, assumed moduli", gain, "1")


def _with_ends(
    source: str, name: str, value: float, ends: tuple[float, float], unit: str
) -> Iterator[StudyEntry]:
    yield study_entry(source, name, value, unit)
    for end, at in zip(("low", "high"), ends, strict=True):
        yield study_entry(source, f"{name}, {end} of 95 %", at, unit)
