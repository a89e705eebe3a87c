"""Sessions: what is promised of a new one holds there, and what one session promises does not."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import beta, norm
from tests.refusals import refused

from palpate.calibration import CalibrationPlan, calibrate, evaluate
from palpate.calibration.coverage.conformal import conformal_quantile, fit_intervals, vector_cards
from palpate.calibration.coverage.grouped_rates import (
    is_distribution_free,
    new_group_quantile,
    rank_of_new_group,
    weighted_quantile,
)
from palpate.calibration.robustness import perturbation_suite
from palpate.calibration.sessions import keep_evaluation, read_evaluations, reset_intervals
from palpate.calibration.sessions.interval_reset import (
    ExpectedCoverage,
    SessionSpread,
    few_sessions_factor,
    intervals_of_sessions,
    intervals_set_anew,
    parametric_quantile,
    radius_set_anew,
)
from palpate.cli.calibrate.calibrate_verbs import _card_text
from palpate.core import CertificateError, ExistsError, InputError, SplitError
from palpate.core.files import sha256_of
from palpate.estimators import Estimator, read_card
from palpate.estimators.class_sets import TargetLayout
from palpate.estimators.findings import FindingCode
from palpate.estimators.guard import NoveltyDetector
from palpate.estimators.intervals import intervals_of, mahalanobis
from palpate.recordings import Run
from palpate.recordings.label_tables import read_table

pytestmark = pytest.mark.usefixtures("changes_untried")
MIN_ROWS = perturbation_suite.MIN_ROWS

PLAN = CalibrationPlan(("x_mm", "height_mm"), "pca-ridge", size_px=(24, 32))
ROWS = 30


def drawn_sessions(count: int, offset: float, scale: float, rng: np.random.Generator) -> list[np.ndarray]:
    """Errors of sessions, each with an offset and a logarithm of its scale drawn from Gaussians."""
    return [rng.normal(offset * rng.normal(), np.exp(scale * rng.normal()), ROWS) for _ in range(count)]


def chance_within(half: float, offset: float, scale: float, rng: np.random.Generator) -> float:
    """Chance that an error of a new such session is at most `half`, over many sessions."""
    b, s = offset * rng.normal(size=2000), np.exp(scale * rng.normal(size=2000))
    return float(np.mean(norm.cdf((half - b) / s) - norm.cdf((-half - b) / s)))


def mean_coverage(count: int, offset: float, scale: float, rng: np.random.Generator) -> float:
    """Coverage of a new session by the quantile of so many, over 150 calibrations."""
    quantile = new_group_quantile if is_distribution_free(count, 0.9) else parametric_quantile
    found = []
    for _ in range(150):
        errors = np.concatenate(drawn_sessions(count, offset, scale, rng))
        scores = np.abs(errors) if quantile is new_group_quantile else errors
        half = quantile(scores, np.repeat(np.arange(count), ROWS), 0.9)
        found.append(chance_within(half, offset, scale, rng))
    return float(np.mean(found))


WORLDS = {"offsets": (1.0, 0.3), "wide offsets": (3.0, 0.3), "scales": (0.3, 0.6), "alike": (0.0, 0.0)}


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("count", [9, 20])
@pytest.mark.cases(2)
def test_nine_sessions_or_more_cover_a_new_one_at_the_stated_rate(world, count, rng) -> None:
    # 150 calibrations, each scattering by a tenth where nine sets of errors set it: four standard errors
    # below. Above, the mean over drawings covers a little more than one drawing does.
    assert 0.87 < mean_coverage(count, *WORLDS[world], rng) < 0.96


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("count", [2, 3, 5, 8])
@pytest.mark.cases(3)
def test_fewer_sessions_cover_a_new_one_where_sessions_differ_as_gaussians_do(world, count, rng) -> None:
    assert mean_coverage(count, *WORLDS[world], rng) > 0.87


@pytest.mark.parametrize("world", ["offsets", "wide offsets", "scales"])
@pytest.mark.cases(1)
def test_intervals_of_one_session_fail_in_the_next(world, rng) -> None:
    offset, scale = WORLDS[world]
    found = []
    for _ in range(150):
        (errors,) = drawn_sessions(1, offset, scale, rng)
        found.append(chance_within(conformal_quantile(np.abs(errors), 0.9), offset, scale, rng))
    assert np.mean(found) < 0.86


@pytest.mark.parametrize("count", [4, 12])
@pytest.mark.cases(1)
def test_widths_follow_the_estimate_and_hold_in_a_new_session(count, rng) -> None:
    def session(rows: int) -> tuple[np.ndarray, np.ndarray]:
        predicted = rng.uniform(0, 1, (rows, 1))
        error = (0.1 + predicted) * (0.7 * rng.normal() + rng.normal(size=(rows, 1)))
        return predicted, predicted - error

    inside, ratio = [], []
    for _ in range(12):
        parts = [session(40) for _ in range(count)]
        predicted, true = (np.concatenate(side) for side in zip(*parts, strict=True))
        of = np.repeat(np.arange(count), 40)
        intervals = intervals_of_sessions(predicted, true, of, np.arange(len(of)), 0.9)
        for _ in range(20):
            fresh, label = session(40)
            inside.append(np.mean(np.abs(fresh - label) <= intervals.half_widths(fresh)))
        ratio.append(np.divide(*intervals.half_widths(np.array([[0.9], [0.1]]))[:, 0]))
    assert 0.86 < np.mean(inside) < 0.97
    assert np.mean(ratio) == pytest.approx(5, rel=0.4)  # ten to two by the truth


def test_the_expected_rank_is_the_mean_over_drawings(rng) -> None:
    sizes = [3, 7, 1, 12, 5, 4, 9, 2, 6, 8, 5]
    scores = rng.exponential(size=sum(sizes))
    of = np.repeat(np.arange(len(sizes)), sizes)
    rank = rank_of_new_group(len(sizes), 0.8)
    drawn = np.stack([rng.choice(scores[of == k], 100_000) for k in range(len(sizes))])
    mean = np.sort(drawn, axis=0)[rank - 1].mean()
    assert new_group_quantile(scores, of, 0.8) == pytest.approx(mean, abs=0.01)


def test_gross_errors_in_every_session_are_held_too(rng) -> None:
    # 15 % of all rows are off by 100: the mean over drawings alone lies between these and the others.
    found = []
    for _ in range(200):
        errors = np.where(rng.random((10, 40)) < 0.15, 100.0, np.abs(rng.normal(size=(10, 40))))
        half = new_group_quantile(errors[:9].ravel(), np.repeat(np.arange(9), 40), 0.9)
        found.append(np.mean(errors[9] <= half))
    assert np.mean(found) > 0.9


def test_the_greatest_of_two_groups_by_hand() -> None:
    # Group 0 gives 1 or 3, group 1 gives 2: the greater of the two is 2 or 3, each with one half.
    assert new_group_quantile(np.array([1.0, 3.0, 2.0]), np.array([0, 0, 1]), 0.6) == pytest.approx(2.5)


def test_too_few_groups_for_the_rate_are_refused_with_the_number(rng) -> None:
    with refused("few-groups", InputError):
        new_group_quantile(rng.random(80), np.repeat(np.arange(8), 10), 0.9)


def test_groups_have_the_same_weight_however_many_rows_they_have() -> None:
    scores, of = np.array([1.0, *[2.0] * 99]), np.array([0] + [1] * 99)
    assert weighted_quantile(scores, of, 0.5) == 1.0
    assert weighted_quantile(scores, of, 0.51) == 2.0


def test_the_spread_between_sessions_is_recovered(rng) -> None:
    offsets = rng.normal(0, 2, 4000)
    errors = offsets[:, None] + rng.normal(0, 0.5, (4000, 5))
    found = SessionSpread.of(errors.ravel(), np.repeat(np.arange(4000), 5))
    assert found.between == pytest.approx(2, rel=0.05)
    assert found.within == pytest.approx(0.5, rel=0.05)
    # Sessions that are alike: what is left of the means is chance within a session, and is taken off.
    alike = SessionSpread.of(rng.normal(0, 1, 40_000), np.repeat(np.arange(4000), 10))
    assert alike.between < 0.1


@pytest.mark.parametrize("n", [9, 30, 100])
@pytest.mark.cases(1)
def test_the_coverage_that_rows_of_a_session_set_is_distributed_as_stated(n, rng) -> None:
    expected = ExpectedCoverage.of(n, 0.9)
    found = []
    for _ in range(2000):
        scores = rng.random(n)
        found.append(new_group_quantile(scores, np.arange(n), 0.9))  # uniform: the score is its own rate
    assert np.mean(found) == pytest.approx(expected.mean, abs=0.005)
    assert np.quantile(found, [0.025, 0.975]) == pytest.approx([expected.low, expected.high], abs=0.02)
    assert expected.low == pytest.approx(beta.ppf(0.025, expected.rank, n + 1 - expected.rank))


def test_intervals_set_anew_keep_how_the_width_follows_the_estimate(rng) -> None:
    predicted = rng.uniform(0, 1, (600, 1))
    true = predicted + rng.normal(0, 0.05 + predicted)
    former = fit_intervals(predicted, true, np.arange(600), 0.9)
    anew = intervals_set_anew(former, predicted, predicted + 3 * (true - predicted), np.arange(600))
    wide = anew.half_widths(predicted) / former.half_widths(predicted)
    assert wide == pytest.approx(np.full((600, 1), 3.0), rel=0.1)


LAMPS = np.random.default_rng(5).normal(0, 6, 40)


@pytest.fixture(scope="module")
def day(record_spots_module):
    """Return a session of one sensor, whose lamp differs from day to day; each is recorded once."""
    made: dict[tuple[int, int], Run] = {}

    def record(k: int, presses: int = 5) -> Run:
        if (k, presses) not in made:
            name = f"day{k}" if presses == 5 else f"day{k}-{presses}"
            made[k, presses] = record_spots_module(name, presses, seed=k, lamp=float(LAMPS[k]))
        return made[k, presses]

    return record


@pytest.fixture(scope="module")
def three(day, tmp_path_factory) -> Path:
    """Calibration of three sessions."""
    return calibrate([day(k) for k in range(3)], PLAN, tmp_path_factory.mktemp("three") / "cal")


@pytest.fixture(scope="module")
def one(day, tmp_path_factory) -> Path:
    """Calibration of one session."""
    return calibrate(day(0, 20), PLAN, tmp_path_factory.mktemp("one") / "cal")


def test_runs_are_joined_each_as_a_session_that_is_held_out_whole(three) -> None:
    card, table = read_card(three), read_table(three / "predictions.csv.gz")
    assert card.split.columns == ("session",)
    assert card.sessions.names == ("day0", "day1", "day2")
    assert (card.sessions.held_out, card.sessions.rule) == (3, "parametric")
    assert card.sessions.factor == pytest.approx(few_sessions_factor(3, 0.9))
    assert table.groupby("held_out_in_fold")["session"].nunique().tolist() == [1, 1, 1]
    # Each session's untouched frames are its own reference.
    assert card.reference.by == ("session",)


def test_a_run_of_a_trained_session_is_not_another_day(day, three, tmp_path, rewritten) -> None:
    estimator = Estimator.open(three)
    assert evaluate(estimator, day(1))["learnt_from_this_run"]
    assert evaluate(estimator, day(3))["same_session"] == ""
    named = rewritten(day(3), tmp_path / "named", lambda row: {**row, "session": "day0"})
    found = evaluate(estimator, named)
    assert not found["learnt_from_this_run"]
    assert "day0" in found["same_session"]


def test_nine_sessions_are_distribution_free(day, tmp_path) -> None:
    plan = replace(PLAN, model="mean", size_px=(6, 8))
    card = read_card(calibrate([day(k, 2) for k in range(9)], plan, tmp_path / "cal"))
    assert (card.sessions.rule, card.sessions.rank, card.sessions.factor) == ("distribution-free", 9, None)


def test_one_session_is_not_tested_and_is_covered_less_on_the_next(day, one) -> None:
    card = read_card(one)
    assert (card.sessions.rule, card.sessions.held_out, card.sessions.runs) == ("one session", 0, ())
    found = evaluate(Estimator.open(one), day(1, 8))
    assert found["same_session"] == ""
    assert found["targets"]["height_mm"]["coverage_90"] < 0.5


def test_one_session_under_two_names_is_refused(day, tmp_path, rewritten) -> None:
    again = rewritten(day(0), tmp_path / "again")
    with refused("session-twice", InputError):
        calibrate([day(0), day(1), again], PLAN, tmp_path / "cal")
    with pytest.raises(InputError, match="one recording"):
        calibrate([day(0), day(0)], PLAN, tmp_path / "cal")
    assert not (tmp_path / "cal").exists()


def test_a_session_split_of_one_session_is_refused(day, tmp_path) -> None:
    with refused("one-session", SplitError):
        calibrate(day(0), CalibrationPlan(("x_mm",), split="session"), tmp_path / "cal")


def test_a_target_that_is_the_session_is_refused_and_one_that_nearly_is_is_named(
    day, tmp_path, rewritten
) -> None:
    def held(k, jitter):
        rng, name = np.random.default_rng(k), tmp_path / f"d{k}-{jitter}"
        return rewritten(day(k), name, lambda row: {**row, "height_mm": 1.0 + k + jitter * rng.normal()})

    plan = CalibrationPlan(("height_mm",), "mean", size_px=(6, 8))
    with refused("session-is-target", SplitError):
        calibrate([held(k, 0.0) for k in range(3)], plan, tmp_path / "cal")
    calibrate([held(k, 0.05) for k in range(3)], plan, tmp_path / "cal")
    (finding,) = read_card(tmp_path / "cal").sessions.findings
    assert (finding.code, finding.target) == (FindingCode.SESSION_TELLS_TARGET, "height_mm")


def test_an_altered_or_foreign_evaluation_is_refused_by_name(day, one, three, tmp_path) -> None:
    own, other = (Path(shutil.copytree(kept, tmp_path / kept.parent.name)) for kept in (one, three))
    found = evaluate(Estimator.open(own), day(3))
    path = keep_evaluation(own, found)
    text, card = path.read_text(), read_card(own)
    for damaged in (text.replace('"frames_scored": 25', '"frames_scored": 26'), text[:-30], "", "[1, 2]"):
        path.write_text(damaged)
        with pytest.raises(CertificateError, match=path.name):
            read_evaluations(own, card)
    (other / path.name).parent.mkdir(exist_ok=True)
    (other / path.name).write_text(text)
    with refused("other-calibration", CertificateError, card.id):
        read_evaluations(other, read_card(other))
    with refused("other-calibration", CertificateError):
        keep_evaluation(other, found)


@pytest.mark.slow
def test_rows_of_a_new_session_set_the_intervals_anew_and_the_network_stays(
    day, tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr(perturbation_suite, "MIN_ROWS", MIN_ROWS)  # changes are tried, here
    first = day(0, 20)
    calibrate(first, PLAN, tmp_path / "cal")
    few, fresh = day(1, 25), day(2, 1)
    before = {path.name: sha256_of(path) for path in (tmp_path / "cal").iterdir()}
    card = reset_intervals(tmp_path / "cal", few, tmp_path / "anew")
    assert {path.name: sha256_of(path) for path in (tmp_path / "cal").iterdir()} == before
    former = read_card(tmp_path / "cal")
    assert card.model == former.model
    assert card.interval_reset.calibration == former.id
    assert card.interval_reset.run.run_id == few.manifest.run_id
    assert card.run == former.run
    assert (card.confounds, card.vectors) == (None, None)
    assert card.robustness.frames == 125
    assert card.robustness.table != former.robustness.table
    assert NoveltyDetector.load(tmp_path / "anew" / "guard.npz").changes is not None
    expected = ExpectedCoverage.of(25, 0.9)  # presses, since five frames are of one press
    assert (card.interval_reset.groups, card.interval_reset.rank) == (25, expected.rank)
    assert card.interval_reset.coverage_mean == expected.mean
    # The card's rates are counted, and so is how much wider the intervals are: rows and not rules say it.
    table, was = read_table(tmp_path / "anew" / "predictions.csv.gz"), intervals_of(former)
    for j, target in enumerate(card.targets):
        true, name = table[target.column].to_numpy(), target.column
        low, high = (table[f"{end}:{name}"].to_numpy() for end in ("low", "high"))
        assert target.score.coverage_90 == pytest.approx(np.mean((low <= true) & (true <= high)), abs=0.009)
        assert target.score.coverage_90 * 125 == pytest.approx(round(target.score.coverage_90 * 125))
        np.testing.assert_allclose(high - low, 2 * table[f"half_width:{name}"])
        before = was.ends(table[[f"estimate:{c}" for c in card.columns]].to_numpy())
        assert card.interval_reset.former_half_widths[name] == pytest.approx(
            np.mean(before[1] - before[0], axis=0)[j] / 2
        )
        ratio = target.score.half_width / card.interval_reset.former_half_widths[name]
        assert f"{ratio:.2f} times" in _card_text(card, tmp_path / "anew")
    assert evaluate(Estimator.open(tmp_path / "anew"), few)["learnt_from_this_run"]
    # The lamp has changed: the former intervals fail, the new ones are wider and hold.
    spread = intervals_of(card).quantile / intervals_of(former).quantile
    assert spread[1] > 3
    with refused("trained-on", InputError):
        reset_intervals(tmp_path / "cal", first, tmp_path / "none")
    with refused("few-groups", InputError):
        reset_intervals(tmp_path / "cal", fresh, tmp_path / "none")
    with pytest.raises(ExistsError):
        reset_intervals(tmp_path / "cal", few, tmp_path / "anew")
    assert not (tmp_path / "none").exists()


def test_angles_and_vectors_of_a_new_session_are_covered_at_the_rate_that_its_rows_set() -> None:
    """Twice the errors of the day before, over 40 drawings of 60 rows; the former intervals fail."""
    rng, layout = np.random.default_rng(0), TargetLayout((None, 360.0, None, None))

    def rows(n: int, size: float) -> tuple[np.ndarray, np.ndarray]:
        outputs = rng.uniform(-1, 1, (n, 5))
        angle = rng.uniform(-np.pi, np.pi, n)
        outputs[:, 1:3] = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        errors = size * (0.3 + np.abs(outputs[:, :1])) * rng.standard_normal((n, 4)) * [0.2, 9.0, 0.2, 0.2]
        errors[:, 3] += errors[:, 2]
        return outputs, layout.decoded(outputs) - errors

    outputs, true = rows(1500, 1.0)
    former = replace(fit_intervals(outputs, true, np.arange(1500), 0.9, layout), by_range=())
    columns = ("d_mm", "a_deg", "x_mm", "y_mm")
    (vector,) = vector_cards({"p_mm": ("x_mm", "y_mm")}, columns, former, outputs, true, np.arange(1500))
    correlation, radius = np.array(vector.correlation), vector.radius

    def scaled(outputs: np.ndarray, true: np.ndarray) -> np.ndarray:
        return (former.errors(outputs, true) / former.spread.at(outputs))[:, 2:]

    fresh = rows(2000, 2.0)
    covered, joint, reach = [], [], []
    for _ in range(40):
        few = rows(60, 2.0)
        anew = intervals_set_anew(former, *few, np.arange(60))
        covered.append(anew.hold(*fresh).mean(axis=0))
        reach.append(np.max(anew.half_widths(fresh[0])[:, 1]))
        own = radius_set_anew(correlation, scaled(*few), np.arange(60), 0.9)
        joint.append(np.mean(mahalanobis(scaled(*fresh), correlation) <= own))
    expected = ExpectedCoverage.of(60, 0.9).mean
    np.testing.assert_allclose(np.mean(covered, axis=0), expected, atol=0.02)
    assert np.mean(joint) == pytest.approx(expected, abs=0.02)
    assert np.median(reach) < 90  # an error of a whole turn, were it counted, would open the arc
    assert (former.hold(*fresh).mean(axis=0) < 0.7).all()
    assert np.mean(mahalanobis(scaled(*fresh), correlation) <= radius) < 0.6
