"""A real wide-angle lens: 24 photographs of a board of 15x9 corners that break naive calibrations."""

import pytest

from palpate.calibration.lens import Board, calibrate_lens
from palpate.core import InputError


@pytest.mark.slow
def test_a_real_fisheye_is_calibrated_to_half_a_pixel(real_data):
    folder = real_data / "fisheye-board"
    fit = calibrate_lens(folder, Board(15, 9, 0.04))
    assert fit.lens.model == "kannala-brandt"
    assert len(fit.views) >= 18
    assert len(fit.views) + len(fit.rejected) == 24
    assert fit.mean_px <= 0.5
    assert fit.held_out_px <= 0.5
    assert fit.other_held_out_px > 1.5 * fit.held_out_px
    assert all(view.name.endswith(".JPG") and view.reason for view in fit.rejected)


@pytest.mark.slow
def test_part_of_the_real_board_is_not_taken_for_a_whole_one(real_data):
    with pytest.raises(InputError, match="--board 15x9"):
        calibrate_lens(real_data / "fisheye-board", Board(9, 6))
