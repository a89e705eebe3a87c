"""Copies told apart: frames of the former copy are refused, those of the one adapted to are not."""

import shutil

import numpy as np
import pytest
from tests.refusals import refused

from palpate.calibration import CalibrationPlan, calibrate, evaluate
from palpate.calibration.adaptation import MIN_REFUSED_FORMER, adapt, tell_apart
from palpate.calibration.sessions import reset_intervals
from palpate.core import CertificateError
from palpate.estimators import Estimator, read_card
from palpate.estimators.certified import check_files
from palpate.estimators.guard import CopyDiscriminator

pytestmark = pytest.mark.usefixtures("changes_untried")


def touches(count: int, rng: np.random.Generator, pattern: float = 0.0) -> np.ndarray:
    """Thumbnails of spots at random places, on a copy with a faint pattern of its own."""
    rows, columns = np.mgrid[0:12, 0:16]
    place = rng.uniform(3, 13, (count, 1, 1))
    spot = 80 * np.exp(-((columns - place) ** 2 + (rows - 6) ** 2) / 6)
    own = pattern * np.cos(rows * 2.1) * np.sin(columns * 1.7)
    return (60 + spot + own + rng.normal(0, 1, (count, 12, 16)))[..., None]


def shares(found, own: np.ndarray, former: np.ndarray) -> list[float]:
    """Shares of fresh frames of each copy that are refused."""
    judge = found.discriminator
    return [
        float(np.mean(side.reshape(len(side), -1) @ judge.axis - judge.offset > judge.limit))
        for side in (own, former)
    ]


def test_a_faint_pattern_tells_the_copies_apart_on_fresh_frames(rng) -> None:
    found = tell_apart(touches(40, rng, 3.0), np.arange(40), touches(600, rng), np.arange(600) // 12)
    assert found.useful
    own, former = shares(found, touches(1000, rng, 3.0), touches(1000, rng))
    assert own <= 0.03
    assert former >= 0.97


def test_copies_that_are_alike_are_said_not_to_be_told(rng) -> None:
    found = tell_apart(touches(40, rng), np.arange(40), touches(600, rng), np.arange(600) // 12)
    assert found.refused_former < MIN_REFUSED_FORMER
    assert not found.useful


@pytest.fixture(scope="module")
def kept(record_spots_module, tmp_path_factory):
    """A folder with a calibration, adapted to a copy whose lamp is a little darker."""
    folder = tmp_path_factory.mktemp("kept")
    plan = CalibrationPlan(("x_mm", "height_mm"), "pca-ridge", "group:press", size_px=(12, 16), delta=True)
    calibrate(record_spots_module("run", 16), plan, folder / "cal")
    adapt(folder / "cal", record_spots_module("few", 20, seed=1, lamp=-0.5), folder / "adapted")
    return folder


@pytest.fixture
def adapted(kept, tmp_path):
    """A copy of both; the adapted one."""
    for name in ("cal", "adapted"):
        shutil.copytree(kept / name, tmp_path / name)
    return tmp_path / "adapted"


@pytest.mark.slow
def test_an_adapted_calibration_refuses_the_former_copys_frames(adapted, record_spots, tmp_path) -> None:
    card, estimator = read_card(adapted), Estimator.open(adapted)
    assert card.copy_of.name == "spots of few"
    assert card.copy_of.former == f"spots of calibration {read_card(tmp_path / 'cal').id}"
    fresh = record_spots("fresh", 20, seed=3, lamp=-0.5)
    former = record_spots("former", 20, seed=4)

    def refused_as_former(run) -> int:
        zero = estimator.zero(run.frame(0).image)
        whys = [estimator.read(frame, zero)["x_mm"].why for frame in run.frames()]
        return sum(card.copy_of.name in why for why in whys)

    assert refused_as_former(fresh) <= 0.03 * len(fresh)
    assert evaluate(estimator, former)["frames_valid"] == 0
    # Without the discriminator they pass: both copies' frames are in the novelty detector.
    estimator._copies = None
    assert evaluate(estimator, former)["frames_valid"] > 50


def test_a_damaged_discriminator_is_refused_and_intervals_set_anew_keep_it(
    adapted, record_spots, tmp_path
) -> None:
    run = record_spots("later", 12, seed=8, lamp=-0.5)
    assert reset_intervals(adapted, run, tmp_path / "anew").copy_of == read_card(adapted).copy_of
    Estimator.open(tmp_path / "anew")
    (adapted / "copy.npz").write_bytes(b"")
    with pytest.raises(CertificateError, match=r"copy\.npz"):
        Estimator.open(adapted)
    with pytest.raises(CertificateError, match=r"copy\.npz"):
        check_files(adapted, read_card(adapted))


def test_several_copies_in_one_calibration_are_held_out_whole(record_spots, rewritten, tmp_path) -> None:
    runs = [record_spots(f"r{k}", 4, seed=k, lamp=4.0 * k) for k in range(3)]
    runs = [
        rewritten(run, tmp_path / f"c{k}", lambda row, k=k: {**row, "copy": f"copy {k}", "session": "monday"})
        for k, run in enumerate(runs)
    ]
    calibrate(runs, CalibrationPlan(("x_mm", "height_mm"), "mean", size_px=(6, 8)), tmp_path / "cal")
    card = read_card(tmp_path / "cal")
    assert card.split.columns == ("copy",)
    assert (card.sessions.column, card.sessions.held_out) == ("copy", 3)


def test_an_axis_of_another_size_or_no_archive_is_refused(tmp_path) -> None:
    CopyDiscriminator(np.arange(4.0), 0.5, 0.25).save(tmp_path / "copy.npz")
    assert CopyDiscriminator.load(tmp_path / "copy.npz", 4).axis.tolist() == [0, 1, 2, 3]
    with refused("file-misfit", CertificateError):
        CopyDiscriminator.load(tmp_path / "copy.npz", 5)
    (tmp_path / "copy.npz").write_bytes(b"no archive")
    with refused("file-damaged", CertificateError):
        CopyDiscriminator.load(tmp_path / "copy.npz", 4)
