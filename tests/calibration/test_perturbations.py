"""Changes of a camera's frame are as large as they say."""

import cv2
import numpy as np
import pytest
from scipy.stats import norm
from tests.refusals import refused

from palpate.calibration.robustness.perturbations import KINDS, kinds_for, perturbed
from palpate.core import InputError, RangeError

ROWS, COLUMNS = np.mgrid[0:160, 0:200]


GROUND = 20


def blob(x: float = 120.3, y: float = 60.7, sigma: float = 5.0) -> np.ndarray:
    """One bright Gaussian on an even ground."""
    light = 200 * np.exp(-((COLUMNS - x) ** 2 + (ROWS - y) ** 2) / (2 * sigma**2))
    return np.rint(GROUND + light).astype(np.uint8)


def discs(radius: float = 6.0) -> np.ndarray:
    """Twenty bright discs on black, of two grey levels, each at another part of a pixel."""
    x, y = COLUMNS % 40 - 20 - 0.13 * (COLUMNS // 40), ROWS % 40 - 20 - 0.29 * (ROWS // 40)
    return np.where(np.hypot(x, y) < radius, 255, 0).astype(np.uint8)


def coloured() -> np.ndarray:
    return np.stack([blob(), blob(80), blob(40, 90)], axis=-1)


def moments(image: np.ndarray) -> tuple[np.ndarray, float]:
    """Centroid (x, y) [px] and variance along x [px²]."""
    weight = (image.astype(float) - GROUND) / np.sum(image.astype(float) - GROUND)
    x, y = np.sum(weight * COLUMNS), np.sum(weight * ROWS)
    return np.array([x, y]), float(np.sum(weight * (COLUMNS - x) ** 2))


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.parametrize("make", [blob, discs, coloured])
def test_size_nought_changes_nothing_and_a_seed_repeats(make) -> None:
    image = make()
    before = image.copy()
    for kind in kinds_for(image):
        np.testing.assert_array_equal(perturbed(image, kind, 0, rng()), image)
        for size in KINDS[kind].sizes:
            once, again = (perturbed(image, kind, size, rng(3)) for _ in range(2))
            np.testing.assert_array_equal(once, again)
            assert once.dtype == np.uint8
            assert once.shape == image.shape
    np.testing.assert_array_equal(image, before)


@pytest.mark.parametrize("px", [0.5, 1.0, 4.0])
@pytest.mark.cases(2)
def test_a_shift_moves_the_centroid_by_its_size(px: float) -> None:
    """OpenCV moves by whole 32nds of a pixel each way, so that both together may be off by 0.044 px."""
    for seed in range(4):
        away = moments(perturbed(blob(), "shift", px, rng(seed)))[0] - moments(blob())[0]
        assert np.hypot(*away) == pytest.approx(px, abs=0.05)


@pytest.mark.parametrize("deg", [0.5, 4.0])
def test_a_turn_turns_about_the_middle_by_its_size(deg: float) -> None:
    middle = np.array([199 / 2, 159 / 2])
    before, after = (moments(image)[0] - middle for image in (blob(), perturbed(blob(), "turn", deg, rng())))
    turned = np.degrees(np.arctan2(before[0] * after[1] - before[1] * after[0], before @ after))
    # The blob is 28 px from the middle, where the 0.05 px of interpolation are 0.1 deg.
    assert abs(turned) == pytest.approx(deg, abs=0.1)
    assert np.hypot(*after) == pytest.approx(np.hypot(*before), abs=0.05)


@pytest.mark.parametrize("percent", [1.0, 4.0])
def test_a_zoom_moves_away_from_the_middle_by_its_share(percent: float) -> None:
    middle = np.array([199 / 2, 159 / 2])
    before, after = (
        moments(image)[0] - middle for image in (blob(), perturbed(blob(), "zoom", percent, rng()))
    )
    np.testing.assert_allclose(abs(after / before - 1), percent / 100, atol=0.0025)  # 0.05 px at 20


@pytest.mark.parametrize("sigma", [1.0, 3.0])
def test_a_blur_makes_a_step_the_integral_of_a_gaussian(sigma: float) -> None:
    step = np.where(COLUMNS < 100, 40, 240).astype(np.uint8)
    step[0, 0] = 41  # a third level, so that no threshold is behind it
    found = perturbed(step, "focus", sigma, rng())[80]
    want = 40 + 200 * norm.cdf((np.arange(200) - 99.5) / sigma)
    np.testing.assert_allclose(found, want, atol=3)  # sums over pixels are not quite integrals


def test_focus_is_before_the_threshold_and_softening_after_it() -> None:
    image = discs()
    assert set(np.unique(perturbed(image, "focus", 2, rng()))) == {0, 255}
    soft = perturbed(image, "softening", 1, rng())
    want = cv2.GaussianBlur(image.astype(np.float64), (0, 0), 1, borderType=cv2.BORDER_REPLICATE)
    np.testing.assert_allclose(soft, want, atol=1)


@pytest.mark.parametrize("px", [0.5, 1.0, 2.0])
@pytest.mark.cases(1)
def test_marker_width_moves_the_outline_of_a_disc_by_its_size(px: float) -> None:
    """The radius that gives the discs' area; pixels are whole, so that it is known to a third of one."""
    radii = {
        float(np.sqrt(np.mean(perturbed(discs(), "marker width", px, rng(seed)) > 0) * 1600 / np.pi))
        for seed in range(6)
    }
    assert len(radii) == 2
    thin, thick = sorted(radii)
    assert thin == pytest.approx(6 - px, abs=0.33)
    assert thick == pytest.approx(6 + px, abs=0.33)


def test_colour_exchanges_red_and_blue_and_greys_get_another_gamma() -> None:
    image = coloured()
    np.testing.assert_array_equal(perturbed(image, "colour", 1, rng()), image[..., ::-1])
    half = perturbed(image, "colour", 0.5, rng())
    np.testing.assert_array_equal(half[..., 0], half[..., 2])
    np.testing.assert_array_equal(half[..., 1], image[..., 1])
    ramp = np.arange(256, dtype=np.uint8)[None].repeat(4, axis=0)
    gammas = {round(float(np.log(perturbed(ramp, "colour", 1, rng(s))[0, 64] / 255) / np.log(64 / 255)), 1)
              for s in range(6)}  # fmt: skip
    assert gammas == {0.5, 2.0}


def test_dust_covers_its_share_and_no_more_than_a_speck_besides() -> None:
    ramp = np.tile(np.linspace(50, 200, 200).astype(np.uint8), (160, 1))
    for percent in (0.5, 2.0):
        share = 100 * np.mean(perturbed(ramp, "dust", percent, rng()) != ramp)
        # A speck of 2 px radius is 13 pixels of 32,000; where it is as bright as the ramp, it does not show.
        assert percent - 0.05 <= share <= percent + 0.05


def test_other_kinds_and_sizes_are_refused() -> None:
    with refused("unknown-kind", InputError):
        perturbed(blob(), "rust", 1, rng())
    for size in (-1.0, np.inf, np.nan):
        with refused("size-range", RangeError):
            perturbed(blob(), "shift", size, rng())
