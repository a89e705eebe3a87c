"""The part of the softness study's page that shows the experiments with people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from palpate.psychophysics import Condition, Presentation
from palpate.psychophysics.analysis import clopper_pearson_interval
from palpate.reports.trial_page import ShareRow, confusion_figure, share_figure
from palpate_reproductions.softness.judged_softness import ALIKE, UNLIKE, JudgedSoftness, fewest_answers
from palpate_reproductions.softness.published_judgements import (
    PEOPLE,
    RANKINGS_PRINTED,
    WIDTHS_PRINTED,
    printed_ranking,
)
from palpate_reproductions.study_results import StudyEntry

PLAIN = "no faults, by accuracy"


def judged_shown(found: JudgedSoftness, entries: Sequence[StudyEntry]) -> Mapping[str, Any]:
    """Values that the template ``softness_judged.html`` shows."""
    explained = [one for one in entries if one.get("why")]
    single = [fit.deviance_p for (_, cue), fit in found.fits.items() if cue is not Condition.INTEGRATED]
    heads = list(dict.fromkeys((one.presentation, one.condition) for one in found.pairs))
    return {
        "totals": [f"{100 * one.confusion.total_accuracy:.2f}" for one in RANKINGS_PRINTED],
        "misprints": sum("misprint" in one["why"] for one in explained),
        "rounded_up": sum(one["why"] == "rounded up" for one in explained),
        "confusions": confusion_figure(
            {f"{one.presentation} {one.condition}": one.confusion for one in RANKINGS_PRINTED}
        ),
        "differing": [{**one, "published": _printed(one["published"])} for one in explained],
        "people_low": clopper_pearson_interval(PEOPLE, PEOPLE)[0],
        "fewest": fewest_answers(tuple(WIDTHS_PRINTED)),
        "differences": found.differences,
        "failures": [_failure(found, one) for one in Presentation],
        "gains": found.gains,
        "faulty_p": f"{min(single):.2g} to {max(single):.2g}",
        "predicted": {f"{one}: both cues predicted": _predicted(found, one) for one in Presentation},
        "shuffled": ", ".join(f"{middle:.1f} ({ninth:.1f})" for middle, ninth in found.shuffled.values()),
        "wrong_sign": " and ".join(f"{lost:.0f}" for lost in found.wrong_sign.values()),
        "pair_heads": [f"{presentation} {condition}" for presentation, condition in heads],
        "pair_rows": {
            name: [one for one in found.pairs if one.name == name]
            for name in dict.fromkeys(one.name for one in found.pairs)
        },
    }


def _printed(value: float | None) -> str:
    return "" if value is None else f"{value:g}"


def _failure(found: JudgedSoftness, presentation: Presentation) -> dict[str, Any]:
    one, needs = found.predictions[presentation][PLAIN], found.needs[presentation]
    k, c = (printed_ranking(presentation, cue).confusion for cue in list(Condition)[1:])
    return {
        "named": presentation.value,
        "k": 100 * k.total_accuracy,
        "c": 100 * c.total_accuracy,
        "accuracy": 100 * one.accuracy,
        "low": 100 * one.low,
        "high": 100 * one.high,
        "observed": 100 * one.observed,
        "alike_p": found.predictions[presentation][ALIKE].p,
        "unlike": 100 * found.predictions[presentation][UNLIKE].accuracy,
        "unlike_p": found.predictions[presentation][UNLIKE].p,
        "alike_low": 100 * found.predictions[presentation][ALIKE].low,
        "alike_high": 100 * found.predictions[presentation][ALIKE].high,
        "p": one.p,
        "p_said": f"{one.p:.3f}" if one.p > 0.0015 else "0.001, the least that 2,000 simulated studies tell",
        "rho": needs.correlation,
        "rho_low": needs.correlation_interval[0],
        "rho_high": needs.correlation_interval[1],
        "gain": needs.gain,
        "gain_low": needs.gain_interval[0],
        "gain_high": needs.gain_interval[1],
    }


def _predicted(found: JudgedSoftness, presentation: Presentation) -> str:
    rows = [
        ShareRow(name, one.accuracy, one.low, one.high)
        for name, one in found.predictions[presentation].items()
    ]
    observed = found.predictions[presentation][PLAIN].observed
    return share_figure(rows, "total accuracy of rankings with both cues [%]", observed)
