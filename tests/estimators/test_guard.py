"""The guard stays down on frames like those calibrated on, and rises on all others."""

import numpy as np
import pytest

from palpate.core.errors import CertificateError, InputError
from palpate.estimators.guard import Guard, fit_guard, thumbnails


def scene(rng: np.random.Generator, n: int, lamp: float = 1.0) -> np.ndarray:
    """A bright disc on a fixed background, pressed at a random place."""
    rows, columns = np.mgrid[0:64, 0:64]
    background = 60 + 50 * np.exp(-((rows - 20) ** 2 + (columns - 40) ** 2) / 300)
    at = rng.uniform(20, 44, (n, 2))
    disc = 90 * np.exp(-((rows - at[:, :1, None]) ** 2 + (columns - at[:, 1:, None]) ** 2) / 60)
    noisy = lamp * (background + disc) + rng.normal(0, 3, (n, 64, 64))
    return np.clip(noisy, 0, 255).astype(np.uint8)[..., None]


@pytest.fixture(scope="module")
def guard() -> Guard:
    rng = np.random.default_rng(0)
    thumbs = thumbnails(scene(rng, 400))
    folds = np.array_split(rng.permutation(400), 5)
    return fit_guard(thumbs, folds, thumbnails(scene(rng, 12)[:, :, :, :] * 0 + 70))


def rising(guard: Guard, images: np.ndarray) -> float:
    return float(np.mean([guard.atypicality(image) > 1 for image in images]))


def test_the_guard_stays_down_on_good_frames(guard: Guard) -> None:
    # Asked: down on 95 %. 1 % of either distance is let go, so 200 frames leave 4 on average.
    assert rising(guard, scene(np.random.default_rng(1), 200)) <= 0.05


@pytest.mark.parametrize("fault", ["dark", "half as bright", "saturated", "shifted", "shifted down", "other"])
def test_the_guard_rises_on_bad_frames(guard: Guard, fault: str) -> None:
    rng = np.random.default_rng(2)
    good = scene(rng, 100)
    bad = {
        "dark": good // 10,
        "half as bright": good // 2,
        "saturated": np.clip(good.astype(int) + 120, 0, 255).astype(np.uint8),
        "shifted": np.roll(good, 6, axis=2),
        "shifted down": np.roll(good, 6, axis=1),
        "other": rng.integers(0, 255, good.shape, dtype=np.uint8),
    }[fault]
    assert rising(guard, bad) >= 0.95


def test_a_guard_comes_back_from_disk_as_it_was(guard: Guard, tmp_path) -> None:
    guard.save(tmp_path / "guard.npz")
    again = Guard.load(tmp_path / "guard.npz")
    image = scene(np.random.default_rng(3), 1)[0]
    assert again.atypicality(image) == pytest.approx(guard.atypicality(image), rel=1e-6)
    assert again.drift(image) == guard.drift(image)


@pytest.mark.parametrize("content", [b"", b"not arrays", b"PK\x03\x04 cut"])
def test_a_damaged_guard_is_refused(content: bytes, tmp_path) -> None:
    path = tmp_path / "guard.npz"
    path.write_bytes(content)
    with pytest.raises(CertificateError, match="not a guard"):
        Guard.load(path)


def test_arrays_that_hold_objects_are_refused(tmp_path) -> None:
    path = tmp_path / "guard.npz"
    np.savez(path, mean=np.array([{"an": "object"}], dtype=object))
    with pytest.raises(CertificateError):
        Guard.load(path)


def test_drift_is_about_one_where_nothing_changed_and_large_when_the_lamp_does() -> None:
    rng = np.random.default_rng(4)
    still = np.clip(80 + rng.normal(0, 6, (30, 64, 64, 1)), 0, 255).astype(np.uint8)
    thumbs = thumbnails(still[:20])
    guard = fit_guard(thumbs, np.array_split(np.arange(20), 4), thumbs)
    for image in still[20:]:
        drift = guard.drift(image)
        assert drift is not None
        # The spread among references has a floor of half a grey level, which averaging stays below.
        assert drift.statistic < 2
        assert not drift.drifted
    dimmed = guard.drift((still[0] * 0.9).astype(np.uint8))
    assert dimmed is not None
    assert dimmed.drifted


def test_without_a_reference_there_is_no_drift() -> None:
    thumbs = thumbnails(scene(np.random.default_rng(5), 20))
    guard = fit_guard(thumbs, np.array_split(np.arange(20), 4), thumbs[:0])
    assert guard.drift(scene(np.random.default_rng(5), 1)[0]) is None


def test_too_few_frames_are_refused() -> None:
    thumbs = thumbnails(scene(np.random.default_rng(6), 4))
    with pytest.raises(InputError, match="record 6 or more"):
        fit_guard(thumbs, [np.array([0])], thumbs[:0])
