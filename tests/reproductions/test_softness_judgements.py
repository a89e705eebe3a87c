"""The softness report's experiments with people: golden values, named misprints, a failure that stands."""

import numpy as np
import pytest

from palpate.psychophysics import Condition, Presentation
from palpate.psychophysics.judgements import RankObserver
from palpate_reproductions.softness.judged_softness import _interval_entries, _table_entries, fewest_answers
from palpate_reproductions.softness.observers import (
    correlation_needed,
    needs_of,
    predict_by_accuracy,
    predict_of_unlike_people,
)
from palpate_reproductions.softness.published_judgements import RANKINGS_PRINTED, printed_ranking

DIAGONALS = {"I": (146, 131), "K": (87, 85), "C": (99, 95)}
TOTALS = {"I": (97.33, 87.33), "K": (58.00, 56.67), "C": (66.00, 63.33)}


def matrices(presentation: Presentation):
    i, k, c = (printed_ranking(presentation, one).confusion for one in Condition)
    return i, k, c


@pytest.mark.parametrize("one", RANKINGS_PRINTED, ids=lambda one: one.where)
def test_tables_1_and_2_come_from_their_counts(one) -> None:
    side = int(one.presentation is Presentation.RENDERED)
    assert one.confusion.right == DIAGONALS[one.condition][side]
    assert 100 * one.confusion.total_accuracy == pytest.approx(TOTALS[one.condition][side], abs=0.005)
    assert one.confusion.rankings == 30
    assert one.where == f"Table {side + 1}, C{'LM'[side]}{'IKC'.index(one.condition) + 1}({one.condition})"


def test_every_misprint_is_named_and_nothing_else_is() -> None:
    entries = list(table_entries())
    misprints = {(e["name"], e["published"]) for e in entries if "misprint" in e.get("why", "")}
    assert misprints == {
        ("direct I: total accuracy", 98.67),
        ("direct I SS1: relative accuracy", 86.67),
        ("rendered I: total accuracy, in the text", 87.35),
    }
    up = {(e["name"], e["published"]) for e in entries if e.get("why") == "rounded up"}
    assert {("rendered I: total accuracy", 87.34), ("rendered C: total accuracy", 63.34)} <= up
    assert len(up) == 10
    assert all(str(published).endswith("4") for _, published in up)


def table_entries():
    for one in RANKINGS_PRINTED:
        yield from _table_entries("s", one)
    yield from _interval_entries("s")


def test_intervals_have_their_golden_values() -> None:
    found = {one["name"]: one["value"] for one in table_entries()}
    for mean, width in ((0.75, 0.3099), (0.82, 0.2750), (0.79, 0.2915)):
        assert found[f"eq. (7), mean {mean:g} of 30: width from end to end"] == pytest.approx(width, abs=5e-5)
        assert found[f"mean {mean:g} times 30 answers"] % 1 > 0.3
    assert fewest_answers((0.75, 0.82, 0.79)) == 28
    assert found["30 right of 30, eq. (7): width"] == 0
    assert found["30 right of 30, Wilson: low end"] == pytest.approx(0.8865, abs=5e-5)
    assert found["30 right of 30, Clopper and Pearson: low end"] == pytest.approx(0.8843, abs=5e-5)


def test_reliability_weighting_fails_and_stays_failed() -> None:
    for presentation, about, worst in (
        (Presentation.DIRECT, 0.767, 0.02),
        (Presentation.RENDERED, 0.745, 0.08),
    ):
        i, k, c = matrices(presentation)
        rng = np.random.default_rng(0)
        found = predict_by_accuracy(k, c, i, rng)
        assert found.accuracy == pytest.approx(about, abs=0.003)
        assert found.p < worst
        assert found.observed > found.high - 0.02
        better = predict_by_accuracy(k, c, i, rng, correlation=-0.8)
        worse = predict_by_accuracy(k, c, i, rng, correlation=0.5)
        assert worse.accuracy < found.accuracy < better.accuracy
        alike = predict_by_accuracy(k, c, i, rng, independent=10)
        assert alike.high - alike.low > 1.3 * (found.high - found.low)


def test_what_would_be_needed_is_what_gives_the_counted_accuracy() -> None:
    for presentation, rho, gain in (
        (Presentation.DIRECT, -0.750, 1.99),
        (Presentation.RENDERED, -0.489, 1.40),
    ):
        i, k, c = matrices(presentation)
        needs = needs_of(k, c, i, np.random.default_rng(0), studies=100)
        assert needs.correlation == pytest.approx(rho, abs=2e-3)
        assert needs.gain == pytest.approx(gain, abs=0.01)
        assert needs.correlation_interval[1] < 0
        d = needs.sensitivities
        assert correlation_needed(*d) == needs.correlation
        assert RankObserver.evenly(needs.gain * np.hypot(d[0], d[1])).total_accuracy() == pytest.approx(
            i.total_accuracy, abs=1e-3
        )


@pytest.mark.parametrize(
    ("presentation", "percent"), [(Presentation.DIRECT, 87.6), (Presentation.RENDERED, 85.3)]
)
def test_people_who_are_good_at_either_cue_would_explain_it(
    presentation: Presentation, percent: float
) -> None:
    """87.6 and 85.3 % are another code's, by 200,000 drawn people."""
    i, k, c = matrices(presentation)
    found = predict_of_unlike_people(k, c, i, np.random.default_rng(0), log_scatter=1.0, studies=400)
    assert 100 * found.accuracy == pytest.approx(percent, abs=0.1)
    assert found.p > 0.05
