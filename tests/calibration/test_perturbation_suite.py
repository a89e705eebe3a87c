"""What changes of the camera cost is measured on the model that is kept, and told."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from palpate.calibration import CalibrationPlan, adapt, calibrate
from palpate.calibration.robustness.perturbation_suite import (
    MIN_ROWS,
    _harm,
    _more_often,
    _text,
    told_targets,
)
from palpate.calibration.robustness.perturbations import KINDS, perturbed
from palpate.estimators import Estimator, read_card
from palpate.estimators.card_ground import card_id
from palpate.estimators.finding_cards import PerturbationCard
from palpate.estimators.guard import NoveltyDetector
from palpate.estimators.model_card import sealed
from palpate.estimators.target_layout import TargetLayout
from palpate.recordings import Run, RunWriter

PLAN = CalibrationPlan(("x_mm", "height_mm"), "pca-ridge", split="group:press", size_px=(24, 32))


def cells(card) -> dict[tuple[str, float], object]:
    return {(cell.kind, cell.size): cell for cell in card.robustness.table}


@pytest.fixture(scope="module")
def spots(tmp_path_factory, record_spots_module):
    folder = tmp_path_factory.mktemp("suite")
    run = record_spots_module("run", 40)
    calibrate(run, PLAN, folder / "cal")
    return run, Estimator.open(folder / "cal")


def test_every_change_has_its_row_and_slight_ones_cost_nothing(spots) -> None:
    table = cells(spots[1].card)
    assert set(table) == {
        (kind, size) for kind in {cell.kind for cell in table.values()} for size in KINDS[kind].sizes
    }
    assert len(table) == 50
    for cell in table.values():
        assert 0 <= cell.silent <= cell.beyond <= 1 - cell.covered <= 1
        assert cell.unit == KINDS[cell.kind].unit
    assert table["compression", 5].error_ratio < 1.1
    assert spots[1].card.robustness.refused <= 0.03


def test_the_sentence_says_that_slight_changes_cost_less_than_a_tenth() -> None:
    def cell(ratio: float, refused: float) -> PerturbationCard:
        return PerturbationCard(
            kind="zoom", size=0.25, unit="%", frames=12, error_ratio=ratio, covered=0.9, beyond=0.0,
            refused=refused, silent=0.0, passes=False,
        )  # fmt: skip

    said = _text([cell(1.09, 0.25), cell(1.11, 0.75)], 400, 0.01, 0.003)
    assert "75 %" in said
    assert "nothing" not in said


def test_one_frame_misread_in_a_dozen_names_no_change_and_three_do() -> None:
    """Of 400 unchanged frames 3 are misread: one of 12 has a chance of 11 %, and 55 changes are tried."""
    frames = [12] * 55
    assert not any(_more_often([1] * 9 + [0] * 46, frames, 3, 400))
    assert _more_often([4] + [1] * 54, frames, 3, 400) == [True] + [False] * 54
    assert not any(_more_often([4] + [1] * 54, frames, 60, 400)), "as often as unchanged ones"


def test_chance_alone_names_a_change_in_one_card_of_twenty(rng) -> None:
    """The negative control: 55 changes that cost nothing, 12 frames each, where 2 % are misread anyway."""
    drawn = [(rng.binomial(12, 0.02, 55), rng.binomial(400, 0.02)) for _ in range(100)]
    named = [any(_more_often(wrong.tolist(), [12] * 55, int(usual), 400)) for wrong, usual in drawn]
    assert np.mean(named) <= 0.11  # 5 %, and thrice the scatter of a hundred


def test_targets_that_are_not_read_do_not_count(rng) -> None:
    """The second is noise that the model answers with its mean; an angle likewise with any direction."""
    true = np.column_stack([rng.uniform(0, 10, 400), rng.uniform(0, 1, 400), rng.uniform(-180, 180, 400)])
    angles = np.deg2rad(rng.uniform(-180, 180, 400))
    outputs = np.column_stack(
        [true[:, 0] + rng.normal(0, 0.1, 400), np.full(400, 0.5), np.cos(angles), np.sin(angles)]
    )
    layout, widths = TargetLayout((None, None, 360.0)), np.tile([0.4, 0.9, 320.0], (400, 1))
    told = told_targets(outputs, true, true, widths, layout, 0.9)
    assert told.tolist() == [True, False, False]
    wide = np.tile([10.0, 0.9, 320.0], (400, 1))
    assert not told_targets(outputs, true, true, wide, layout, 0.9).any()


def test_a_shift_costs_a_place_what_it_shifts_and_is_refused(spots) -> None:
    """The target is a place in the image: moved by 8 px of 64, it is misread by as much."""
    shift = [cells(spots[1].card)["shift", size] for size in KINDS["shift"].sizes]
    assert shift[-1].error_ratio > 3 > 1.5 > shift[0].error_ratio
    assert shift[-1].beyond > 0.2
    assert shift[-1].refused > 0.9
    assert max(cell.silent for cell in shift) <= 0.1  # ten frames a size: one reading of twenty is 5 %


def test_frames_of_another_run_are_judged_as_the_card_says(spots, record_spots, tmp_path) -> None:
    _, estimator = spots
    fresh = record_spots("fresh", 30, seed=1)
    rng = np.random.default_rng(0)
    frames = [fresh.frame(int(row)).image for row in range(len(fresh)) if row % 6 in (2, 5)]
    wrong = [estimator.read(frame)["x_mm"].why for frame in frames]
    assert np.mean(["unlike" in why for why in wrong]) <= 0.1
    moved = [estimator.read(perturbed(frame, "shift", 8, rng))["x_mm"].why for frame in frames]
    assert np.mean(["unlike" in why for why in moved]) >= 0.9
    assert np.mean(["shifted" in why for why in moved]) >= 0.5


@pytest.mark.slow
def test_where_one_fold_is_scored_frames_learnt_from_are_known_to_be_unchanged_too(
    spots, record_spots, tmp_path
) -> None:
    """Else a touch between the few scored ones is taken for a camera that has moved."""
    plan = replace(PLAN, folds=3, scored_folds=1)
    estimator = Estimator.open(calibrate(spots[0], plan, tmp_path / "one"))
    changes = NoveltyDetector.load(tmp_path / "one" / "guard.npz").changes
    assert estimator.card.split.rows_scored < np.sum(changes.kind == 0) == 200
    assert not changes.harm[changes.kind == 0].any()
    other = record_spots("other", 40, seed=9)
    frames = np.flatnonzero(~other.labels["reference"].astype(bool))
    accepted = [all(r.valid for r in estimator.read(other.frame(int(i))).values()) for i in frames]
    assert np.mean(accepted) > 0.9
    table = cells(estimator.card)
    assert np.mean([cell.silent for cell in table.values()]) <= estimator.card.robustness.beyond + 0.02


def test_a_model_that_sees_nothing_is_harmed_by_nothing(spots, tmp_path) -> None:
    """The negative control: always saying the mean costs no change anything, so that known ones pass."""
    calibrate(spots[0], replace(PLAN, model="mean"), tmp_path / "cal")
    table = cells(read_card(tmp_path / "cal")).values()
    assert {cell.error_ratio for cell in table} == {1.0}
    assert np.mean([cell.refused for cell in table]) < 0.25
    seen = np.mean([cell.refused for cell in cells(spots[1].card).values()])
    assert seen > np.mean([cell.refused for cell in table])


def test_harm_is_the_rise_of_the_share_beyond_twice_the_half_width() -> None:
    """Gaussian errors of a quarter of the half-width: P(|error + d| > 2) by the normal distribution.

    2,000 draws know a share to 1.1 %.
    """
    errors = np.random.default_rng(1).normal(0, 0.5, (2000, 1))
    moved = np.array([0.0, 1.0, 2.0, -2.0, 5.0])
    want = norm.sf((2 - np.abs(moved)) / 0.5) - norm.sf(4)
    np.testing.assert_allclose(_harm(errors, moved[:, None], never(5, 1)), want, atol=0.03)
    of_two = _harm(np.repeat(errors, 2, axis=1), np.array([[5.0, 0.0]]), never(1, 2))
    np.testing.assert_allclose(of_two, 0.5, atol=0.01)
    no_numbers = _harm(errors, np.array([[np.nan], [np.inf]]), never(2, 1))
    assert no_numbers[1] == pytest.approx(1.0, abs=0.01)


def never(m: int, t: int) -> np.ndarray:
    """Errors that do not come round again."""
    return np.full((m, t), np.inf)


def test_an_angle_moved_by_all_but_a_degree_of_a_turn_is_harmed_as_by_a_degree() -> None:
    """A half-width of 10 degrees: 359 degrees are 35.9, a turn 36. A plain number is harmed by all of it."""
    errors = np.random.default_rng(1).normal(0, 0.5, (2000, 1))
    moved = np.array([[35.9], [-35.9], [0.1], [18.0], [36.0 * 3 + 1]])
    harm = _harm(errors, moved, np.full((5, 1), 36.0))
    np.testing.assert_allclose(harm[[0, 1]], harm[2], atol=0.002)
    assert harm[2] < 0.002
    assert harm[3] == pytest.approx(1.0, abs=0.01)
    assert harm[4] == pytest.approx(_harm(errors, np.array([[1.0]]), never(1, 1))[0], abs=1e-9)
    assert (_harm(errors, moved[:2], never(2, 1)) > 0.99).all()


def test_too_few_frames_say_what_they_cannot_tell(record_spots, tmp_path) -> None:
    calibrate(record_spots("run", 8), PLAN, tmp_path / "cal")
    estimator = Estimator.open(tmp_path / "cal")
    found = estimator.card.robustness
    assert found.frames == 40 < MIN_ROWS
    assert found.table == ()
    assert (found.frames, found.table) == (40, ())


def test_a_card_of_before_keeps_its_id(spots) -> None:
    _, estimator = spots
    text = estimator.card.model_dump(mode="json")
    assert card_id(text) == estimator.card.id
    former = sealed({k: getattr(estimator.card, k) for k in type(estimator.card).model_fields
                     if k not in ("id", "robustness")})  # fmt: skip
    assert "robustness" not in former.model_dump(mode="json")
    assert former.id != estimator.card.id


@pytest.fixture(scope="module")
def adapted(spots, tmp_path_factory, record_spots_module) -> Estimator:
    """The same camera, whose lamp is darker: another copy of the sensor."""
    folder = tmp_path_factory.mktemp("adapted")
    adapt(spots[1].folder, record_spots_module("own", 20, seed=2, lamp=-15.0), folder / "cal")
    return Estimator.open(folder / "cal")


def test_an_adapted_guard_knows_what_a_change_costs_on_its_own_copy(adapted) -> None:
    found = adapted.card.robustness
    assert found.frames == 100
    table = cells(adapted.card)
    assert len(table) == 50
    assert found.refused <= 0.03
    assert table["shift", 8].error_ratio > 3
    assert table["shift", 8].refused > 0.9
    assert table["compression", 5].error_ratio < 1.1
    assert table["compression", 5].refused <= 0.25
    assert np.mean([cell.silent for cell in table.values()]) <= found.beyond + 0.02


def test_an_adapted_guard_judges_fresh_frames_of_its_copy_as_its_card_says(
    adapted, spots, record_spots
) -> None:
    """The former guard is the negative control: it takes the copy's own frames for strange."""
    fresh = record_spots("fresh", 30, seed=4, lamp=-15.0)
    frames = [fresh.frame(row).image for row in range(len(fresh)) if row % 6 in (2, 5)]
    rng = np.random.default_rng(0)

    def refused(estimator: Estimator, images: list[np.ndarray]) -> float:
        return float(np.mean(["unlike" in estimator.read(image)["x_mm"].why for image in images]))

    assert refused(adapted, frames) <= 0.15
    assert refused(spots[1], frames) >= 0.5
    assert refused(adapted, [perturbed(frame, "shift", 8, rng) for frame in frames]) >= 0.9


def test_an_adapted_card_says_where_its_frames_are_too_few_for_that(spots, record_spots, tmp_path) -> None:
    own = record_spots("own", 12, seed=2)
    with RunWriter.create(tmp_path / "few", own.manifest, overflow="wait") as writer:
        for i, row in enumerate(own.labels.to_dict("records")):
            if i % 6 != 5:
                writer.frame(own.frame(i).image, labels=row)
    card = adapt(spots[1].folder, Run.open(tmp_path / "few"), tmp_path / "cal")
    assert card.robustness.table == ()
    assert (card.robustness.frames, card.robustness.table) == (48, ())
    assert NoveltyDetector.load(tmp_path / "cal" / "guard.npz").changes is None
