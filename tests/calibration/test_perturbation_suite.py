"""What changes of the camera cost is measured on the model that is kept, and told."""

import numpy as np
import pytest
from scipy.stats import norm

from palpate.calibration import CalibrationPlan, adapt, calibrate
from palpate.calibration.robustness.perturbation_suite import (
    MIN_ROWS,
    _harm,
    _more_often,
    told_targets,
)
from palpate.calibration.robustness.perturbations import KINDS, perturbed
from palpate.estimators import Estimator
from palpate.estimators.class_sets import TargetLayout

PLAN = CalibrationPlan(("x_mm", "height_mm"), "pca-ridge", split="group:press", size_px=(24, 32))


def cells(card) -> dict[tuple[str, float], object]:
    return {(cell.kind, cell.size): cell for cell in card.robustness.table}


@pytest.fixture(scope="module")
def spots(tmp_path_factory, record_spots_module):
    folder = tmp_path_factory.mktemp("suite")
    run = record_spots_module("run", 24)
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


def test_chance_alone_names_a_change_in_one_card_of_twenty(rng) -> None:
    """The negative control: 55 changes that cost nothing, 12 frames each, where 2 % are misread anyway."""
    drawn = [(rng.binomial(12, 0.02, 55), rng.binomial(400, 0.02)) for _ in range(60)]
    named = [any(_more_often(wrong.tolist(), [12] * 55, int(usual), 400)) for wrong, usual in drawn]
    assert np.mean(named) <= 0.11  # 5 %, and twice the scatter of sixty


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


def test_harm_is_the_rise_of_the_share_beyond_twice_the_half_width() -> None:
    """Gaussian errors of a quarter of the half-width: P(|error + d| > 2) by the normal distribution."""
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


def test_too_few_frames_say_what_they_cannot_tell(record_spots, tmp_path) -> None:
    calibrate(record_spots("run", 8), PLAN, tmp_path / "cal")
    estimator = Estimator.open(tmp_path / "cal")
    found = estimator.card.robustness
    assert found.frames < MIN_ROWS
    assert (found.frames, found.table) == (40, ())


@pytest.fixture(scope="module")
def adapted(spots, tmp_path_factory, record_spots_module) -> Estimator:
    """The same camera, whose lamp is darker: another copy of the sensor."""
    folder = tmp_path_factory.mktemp("adapted")
    adapt(spots[1].folder, record_spots_module("own", 12, seed=2, lamp=-15.0), folder / "cal")
    return Estimator.open(folder / "cal")


def test_an_adapted_guard_knows_what_a_change_costs_on_its_own_copy(adapted) -> None:
    found = adapted.card.robustness
    assert found.frames == 60
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
    fresh = record_spots("fresh", 15, seed=4, lamp=-15.0)
    frames = [fresh.frame(row).image for row in range(len(fresh)) if row % 6 in (2, 5)]
    rng = np.random.default_rng(0)

    def refused(estimator: Estimator, images: list[np.ndarray]) -> float:
        return float(np.mean(["unlike" in estimator.read(image)["x_mm"].why for image in images]))

    assert refused(adapted, frames) <= 0.15
    assert refused(spots[1], frames) >= 0.5
    assert refused(adapted, [perturbed(frame, "shift", 8, rng) for frame in frames]) >= 0.9
