"""Angles are learnt, scored and read modulo their period, whatever convention their labels follow."""

from __future__ import annotations

import numpy as np
import pytest
from tests.refusals import refused

from palpate.calibration import CalibrationPlan, adapt, calibrate, evaluate
from palpate.calibration.certificate import read_predictions
from palpate.calibration.coverage.range_scores import (
    calibrated_arc,
    refuse_no_angles,
    uninformative_width,
)
from palpate.calibration.evaluation import score
from palpate.core import InputError, LabelError, ManualClock, UnitError
from palpate.estimators import Estimator, read_card
from palpate.recordings import Manifest, Run, RunWriter

pytestmark = pytest.mark.usefixtures("changes_untried")


def record_edges(path, count: int, *, seed: int = 0, turn: float = 360.0, shift: float = 0.0) -> Run:
    """Record a bright lobe at an angle around the centre; negative labels of odd rows are a turn more."""
    rng, clock = np.random.default_rng(seed), ManualClock()
    rows, columns = np.mgrid[-16:16, -16:16] + 0.5
    around, away = np.degrees(np.arctan2(rows, columns)), np.hypot(rows, columns)
    labels = {"angle_deg": "number", "depth_mm": "number"}
    manifest = Manifest.new(sensor="edges", labels=labels)
    with RunWriter.create(path, manifest, clock=clock, overflow="wait") as writer:
        for k in range(count):
            angle, depth = rng.uniform(-turn / 2, turn / 2), rng.uniform(1, 2)
            lobe = np.exp(3 * (np.cos(np.radians((around - angle) * 360 / turn)) - 1)) * (away < 14)
            image = np.clip(30 + 80 * depth * lobe + rng.normal(0, 3, (32, 32)), 0, 255).astype(np.uint8)
            clock.sleep(0.1)
            label = (angle + shift) + (turn if k % 2 and angle + shift < 0 else 0.0)
            writer.frame(image, labels={"angle_deg": label, "depth_mm": depth})
    return Run.open(path)


PLAN = CalibrationPlan(
    ("depth_mm", "angle_deg"), "pca-ridge", split="random", size_px=(24, 24), circular={"angle_deg": None}
)


@pytest.fixture(scope="module")
def edges(tmp_path_factory):
    folder = tmp_path_factory.mktemp("edges")
    run = record_edges(folder / "run", 180)
    calibrate(run, PLAN, folder / "cal")
    return folder, run


@pytest.mark.slow
def test_an_angle_is_read_across_the_turn_as_well_as_elsewhere(edges) -> None:
    """The same column as a plain target is the negative control: near ±180° it errs by half a turn."""
    folder, run = edges
    card, table = read_card(folder / "cal"), read_predictions(folder / "cal", read_card(folder / "cal"))
    angle = card.targets[1]
    assert angle.circular is not None
    assert angle.circular.period == 360
    assert (angle.least, angle.greatest) == (-180, 180)
    assert angle.score.mae < 6
    assert angle.score.r2 > 0.99
    assert 0.85 < angle.score.coverage_90 < 0.95
    true, guess = table["angle_deg"].to_numpy(), table["estimate:angle_deg"].to_numpy()
    error = np.abs((guess - true + 180) % 360 - 180)
    assert error.mean() == pytest.approx(angle.score.mae)
    seam = np.abs(np.abs((true + 180) % 360 - 180) - 180) < 20
    assert error[seam].mean() < 8
    plain = CalibrationPlan(("angle_deg",), split="random", size_px=(24, 24))
    calibrate(run, plain, folder / "plain")
    assert read_card(folder / "plain").targets[0].score.mae > 5 * angle.score.mae


def test_a_copy_that_is_mounted_turned_is_corrected_by_directions(edges, tmp_path) -> None:
    """25° of turn in the mount are a rotation of cosine and sine, and linear, so that they are learnt."""
    folder, _ = edges
    copy = record_edges(tmp_path / "copy", 40, seed=2, shift=25.0)
    card = adapt(folder / "cal", copy, tmp_path / "adapted")
    change = card.split.details["correction"]["angle_deg"]
    assert change["mae_before"] == pytest.approx(25, abs=1.5)
    assert change["mae_after"] < 4
    assert card.targets[1].period == 360
    fresh = record_edges(tmp_path / "fresh", 60, seed=3, shift=25.0)
    found = evaluate(Estimator.open(tmp_path / "adapted"), fresh)["targets"]["angle_deg"]
    assert found["mae"] < 5
    # 40 presses set the intervals, 60 rows test them: three standard errors of both.
    assert found["coverage_90"] > 0.9 - 3 * (0.09 / 40 + 0.09 / 60) ** 0.5


def test_circular_scores_are_of_the_shortest_way_round() -> None:
    true, guess = np.array([179.0, -179.0, 0.0, 90.0]), np.array([-179.0, 179.0, 2.0, 88.0])
    found = score("deg", true, guess, np.full(4, 3.0), 0.0, np.arange(4), period=360.0)
    assert found.mae == pytest.approx(2)
    assert found.bias == pytest.approx(0)
    assert found.coverage_90 == 1
    assert found.mean_mae == pytest.approx((179 + 179 + 0 + 90) / 4)


@pytest.mark.parametrize(
    ("values", "arc"),
    [
        (np.linspace(150, 210, 61), (150, 210)),
        (np.array([-175.0, 170.0, 180.0, -160.0]), (170, 200)),
        (np.linspace(-30, 20, 51), (-30, 20)),
        (np.arange(0.0, 360.0, 10.0), (-180, 180)),
        (np.arange(0.0, 360.0, 30.0), (-180, 180)),
        (np.arange(0.0, 360.0, 45.0), (-180, 180)),
        (np.repeat(np.arange(0.0, 360.0, 45.0), 3) + np.tile([-2.0, 0, 1], 8), (-180, 180)),
        (2 * np.arange(0.0, 180.0, 15.0), (-180, 180)),
        (np.arange(0.0, 271.0, 30.0), (0, 270)),
        (np.arange(0.0, 271.0, 45.0), (0, 270)),
        (np.r_[0.0:91.0, 180.0:271.0], (-180, 90)),
    ],
)
@pytest.mark.cases(6)
def test_the_calibrated_arc_is_what_the_widest_gap_leaves(values, arc) -> None:
    start, end = calibrated_arc(values, 360.0)
    assert end - start == pytest.approx(arc[1] - arc[0])
    assert (start - arc[0]) % 360 == pytest.approx(0)
    assert -180 <= start < 180
    assert calibrated_arc(values / 2, 180.0) == pytest.approx((start / 2, end / 2))


@pytest.mark.parametrize("span", [180.0, 10.0])
def test_widths_around_guesses_tell_nothing_and_around_readings_something(span, rng) -> None:
    """Spread by chance makes some shorter than the share; a fifth told well makes the others count."""
    guessed = 0.9 * 2 * span * np.exp(rng.normal(0, 0.1, 200))
    assert uninformative_width(guessed, 2 * span, 0.9) == 0
    some = np.where(np.arange(200) % 5 == 0, 0.05 * span, 4 * span)
    assert uninformative_width(some, 2 * span, 0.9) == pytest.approx(1.8 * span)


@pytest.mark.slow
def test_an_angle_that_the_image_tells_nothing_of_is_never_valid(edges, tmp_path, rewritten) -> None:
    folder, run = edges
    drawn = np.random.default_rng(5)
    noise = rewritten(run, tmp_path / "run", lambda row: {**row, "angle_deg": drawn.uniform(-180, 180)})
    calibrate(noise, PLAN, tmp_path / "cal")
    assert read_card(folder / "cal").targets[1].circular.untold_width == pytest.approx(324)
    assert read_card(tmp_path / "cal").targets[1].circular.untold_width == 0
    estimator = Estimator.open(tmp_path / "cal")
    readings = [estimator.read(run.frame(i)) for i in range(40)]
    assert not any(one["angle_deg"].valid for one in readings)
    assert any(one["depth_mm"].valid for one in readings)


def test_what_counts_turns_or_never_turns_is_refused() -> None:
    mixed = np.array([-179.0, -10.0, 170.0, 350.0])
    refuse_no_angles("a_deg", mixed, "deg", 360.0)
    refuse_no_angles("a_deg", mixed, "deg", 180.0)
    with refused("counts-turns", LabelError):
        refuse_no_angles("a_deg", np.array([0.0, 100.0, 720.0]), "deg", 360.0)
    with refused("constant", LabelError):
        refuse_no_angles("a_deg", np.array([10.0, 370.0, 10.0]), "deg", 360.0)


@pytest.mark.parametrize(
    ("circular", "error", "code"),
    [
        ({"yaw_deg": None}, InputError, "no-target"),
        ({"angle_deg": 100.0}, InputError, "period"),
        ({"angle_deg": 720.0}, InputError, "period"),
        ({"angle_deg": -360.0}, InputError, "period"),
        ({"angle_deg": float("nan")}, InputError, "period"),
        ({"x_mm": None}, UnitError, "unit"),
    ],
)
def test_a_period_that_does_not_fit_is_refused(circular, error, code) -> None:
    with refused(code, error):
        CalibrationPlan(("angle_deg", "x_mm"), circular=circular)


def test_images_that_are_turned_in_training_are_refused_beside_a_direction() -> None:
    with refused("turned-images", InputError):
        CalibrationPlan(
            ("angle_deg",), model="compact-cnn", circular={"angle_deg": None}, options={"turns": 6}
        )
