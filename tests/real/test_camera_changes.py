"""Changes of the camera, on another collection of a real sensor: what costs is refused, the rest passes."""

import numpy as np
import pytest

from palpate.calibration import CalibrationPlan, calibrate
from palpate.calibration.robustness.perturbations import KINDS, kinds_for, perturbed
from palpate.estimators import Estimator
from palpate.recordings import Run, import_images

TARGETS = ("edge_mm", "depth_mm")
INSIDE = (20, 20, 88, 88)  # px: the pins, without the rim whose specks drift with time


@pytest.fixture(scope="module")
def sessions(real_data, tmp_path_factory) -> tuple[Estimator, Run]:
    source, folder = real_data / "edge-two-sessions", tmp_path_factory.mktemp("edge")
    if not source.is_dir():
        pytest.skip(f"no edge taps at {source}")
    for part in ("first", "second"):
        import_images(
            source / part, folder / part, labels=source / part / "labels.csv", image_column="image_file"
        )
    plan = CalibrationPlan(TARGETS, split="random", crop_px=INSIDE)
    calibrate(Run.open(folder / "first"), plan, folder / "cal")
    return Estimator.open(folder / "cal"), Run.open(folder / "second")


def judged(estimator: Estimator, image: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, bool]:
    """Errors in half-widths, and whether the guard refuses."""
    readings = [estimator.read(image)[column] for column in TARGETS]
    error = [abs(r.value - t) / ((r.high - r.low) / 2) for r, t in zip(readings, true, strict=True)]
    return np.array(error), "unlike those" in readings[0].why


@pytest.mark.slow
def test_another_session_passes_and_what_costs_is_refused(sessions) -> None:
    """Asked: false refusals 10 %, silent readings 2 %, free changes accepted 80 %. Found: 3, 0.4 and 92 %."""
    estimator, run = sessions
    true, rng = run.labels[list(TARGETS)].to_numpy(float), np.random.default_rng(0)
    clean = [judged(estimator, run.frame(row).image, true[row]) for row in range(0, len(run), 5)]
    beyond = float(np.mean([error > 2 for error, _ in clean]))
    assert np.mean([refused for _, refused in clean]) <= 0.10
    silent, unguarded, accepted = [], [], []
    for kind in kinds_for(run.frame(0).image):
        for size in KINDS[kind].sizes:
            rows = rng.choice(len(run), 15, replace=False)
            before = [judged(estimator, run.frame(int(row)).image, true[row])[0] for row in rows]
            found = [
                judged(estimator, perturbed(run.frame(int(row)).image, kind, size, rng), true[row])
                for row in rows
            ]
            error, refused = np.array([e for e, _ in found]), np.array([r for _, r in found])
            silent.append(np.mean((error > 2) & ~refused[:, None]))
            unguarded.append(np.mean(error > 2))
            if error.mean() < 1.1 * np.mean(before) and unguarded[-1] <= beyond + 0.01:
                accepted.append(1 - refused.mean())
    assert np.mean(unguarded) > 0.25, "the negative control: without a guard a third is silently wrong"
    assert np.mean(silent) <= beyond + 0.02
    assert np.mean(accepted) >= 0.80
