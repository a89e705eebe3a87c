"""Laws of a lens's calibration: the known lens comes back within its errors, and bad views do not count."""

from dataclasses import replace

import numpy as np
import pytest
from tests.calibration.lens.board_scenes import BOARD, FISHEYE, PINHOLE, corner_views

from palpate.calibration.lens import Board, BoardView, fit_lens
from palpate.core import InputError

BOTH = [(FISHEYE, "fisheye"), (PINHOLE, "pinhole")]


def numbers_of(lens):
    return np.array([*lens.focal_px, *lens.centre_px, *lens.distortion])


@pytest.mark.slow
@pytest.mark.parametrize(("lens", "model"), BOTH, ids=["fisheye", "pinhole"])
def test_without_noise_the_lens_comes_back_exactly(lens, model):
    """1e-4 px and 1e-5 of coefficients: least squares stops there."""
    fit = fit_lens(corner_views(lens, 12, noise_px=0.0), BOARD, model)
    np.testing.assert_allclose(numbers_of(fit.lens)[:4], numbers_of(lens)[:4], atol=1e-4)
    np.testing.assert_allclose(fit.lens.distortion, lens.distortion, atol=1e-5)
    assert fit.mean_px < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(("lens", "model"), BOTH, ids=["fisheye", "pinhole"])
def test_with_noise_the_lens_comes_back_within_its_stated_errors(lens, model):
    """0.1 px an axis: 4 standard errors of 8 or 9 numbers; the error of a corner is 0.1 sqrt(pi / 2) px."""
    fit = fit_lens(corner_views(lens, 20), BOARD, model)
    errors = np.array(list(fit.standard_errors.values()))
    assert (np.abs(numbers_of(fit.lens) - numbers_of(lens)) < 4 * errors).all()
    assert fit.mean_px == pytest.approx(0.1 * np.sqrt(np.pi / 2), rel=0.08)
    assert fit.scale_px == pytest.approx(0.1, rel=0.1)
    assert len(fit.views) == 20
    assert fit.held_out_px == pytest.approx(0.1 * np.sqrt(2), rel=0.1)
    by_views = np.array(list(fit.standard_errors_by_views.values()))
    assert ((by_views > errors / 2.5) & (by_views < 2.5 * errors)).all()


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say():
    """95 % intervals of 8 numbers in 40 calibrations: 304 of 320, give or take 5 %."""
    held, by_views = [], []
    for seed in range(40):
        fit = fit_lens(corner_views(FISHEYE, 16, seed=seed), BOARD, "fisheye")
        off = np.abs(numbers_of(fit.lens) - numbers_of(FISHEYE))
        held.append(off < 1.96 * np.array(list(fit.standard_errors.values())))
        by_views.append(off < 1.96 * np.array(list(fit.standard_errors_by_views.values())))
    assert np.mean(held) == pytest.approx(0.95, abs=0.05)
    assert np.mean(by_views) > 0.82  # 16 views: a resampling of few is known to be narrow
    assert np.mean(held) < 1


@pytest.mark.slow
def test_a_pinhole_on_fisheye_views_scores_worse_and_is_told():
    views = corner_views(FISHEYE, 20)
    fit, right = fit_lens(views, BOARD, "pinhole"), fit_lens(views, BOARD)
    assert right.lens.model == "kannala-brandt"
    assert right.other_held_out_px > 3 * right.held_out_px
    assert any("--model fisheye" in warning for warning in fit.warnings)
    assert not any("--model" in warning for warning in right.warnings)


def test_a_pinhole_is_chosen_for_a_pinhole():
    """The tangential terms are beyond a fisheye's polynomial."""
    lens = replace(PINHOLE, distortion=(-0.18, 0.06, 6e-3, -4e-3, -0.01))
    assert fit_lens(corner_views(lens, 9), BOARD).lens.model == "pinhole"


def shifted(view, change):
    return BoardView(view.name, view.corners_m, change(view.places_px.copy()), view.size_px)


@pytest.mark.slow
def test_a_view_that_does_not_fit_is_left_out_and_named():
    """A board with a wave of 4 px in it, and one whose rows are numbered from the second on."""
    views = corner_views(FISHEYE, 16)

    def bend(places):
        places[:, 1] += 4 * np.sin(places[:, 0] / 12)
        return places

    def slip(places):
        return np.roll(places.reshape(6, 9, 2), -1, axis=0).reshape(-1, 2)

    spoilt = [*views[:2], shifted(views[2], bend), *views[3:6], shifted(views[6], slip), *views[7:]]
    fit = fit_lens(spoilt, BOARD, "fisheye")
    assert {view.name for view in fit.rejected} == {"002.png", "006.png"}
    assert all("corners" in view.reason for view in fit.rejected)
    clean = fit_lens([view for i, view in enumerate(views) if i not in (2, 6)], BOARD, "fisheye")
    np.testing.assert_allclose(numbers_of(fit.lens), numbers_of(clean.lens), rtol=1e-4, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("where", "message"),
    [
        ({"tilt": 0.0}, "parallel"),
        ({"spread": 0.02, "near": 2.5}, "cover"),
        ({"count": 5}, "6 or more"),
    ],
)
def test_views_that_cannot_tell_the_lens_are_refused(where, message):
    with pytest.raises(InputError, match=message):
        fit_lens(corner_views(FISHEYE, **({"count": 14} | where)), BOARD, "fisheye")


def test_mixed_sizes_are_refused():
    views = corner_views(FISHEYE, 8)
    other = BoardView("o.png", views[0].corners_m, views[0].places_px, (960, 1280))
    with pytest.raises(InputError, match="several image sizes"):
        fit_lens([*views, other], BOARD)


@pytest.mark.parametrize(
    ("board", "message"),
    [
        ((2, 6), "inner corners"),
        ((9, 6, -0.01), "above 0 mm"),
        ((9, 6, 0.02, "4X4_5"), "4X4_50"),
        ((30, 20, 0.02, "4X4_50"), "larger one"),
    ],
)
def test_a_board_that_cannot_be_is_refused(board, message):
    with pytest.raises(InputError, match=message):
        Board(*board)
