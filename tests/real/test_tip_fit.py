"""A virtual TacTip against taps of a real one, another laboratory's: a stand-in, with 331 pins."""

import numpy as np
import pytest

from palpate.sensors.tactip.taps.tap_folder import fit_folder

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def found(real_data):
    folder = real_data / "tactip-surface"
    if not folder.is_dir():
        pytest.skip(f"no taps of a TacTip at {folder}")
    return fit_folder(folder / "train", folder / "val", taps=400)


def test_pins_of_most_taps_are_named_without_their_poses(found) -> None:
    known, new = found.known, found.new
    assert len(known.poses) > 0.9 * (len(known.poses) + known.lost)
    assert len(new.poses) > 0.9 * (len(new.poses) + new.lost)
    assert np.isfinite(known.places_px).all(axis=2).mean() > 0.99


def test_the_twin_leaves_little_more_than_the_taps_own_scatter(found) -> None:
    judged = found.judged
    print(judged.residual_px, found.learnt_px, judged.floor_px, judged.motion_px)
    assert judged.residual_px < 1.7 * judged.floor_px
    assert found.learnt_px < 1.2 * judged.floor_px
    assert judged.residual_px < 0.3 * judged.motion_px


def test_poses_are_read_from_images_of_taps_after_a_few_known_ones(found) -> None:
    off = np.abs(found.readings.poses - found.new.poses)
    print(off.mean(axis=0), (off <= found.readings.half_widths).mean(axis=0))
    assert off.mean(axis=0)[0] < 0.2
    assert (off.mean(axis=0)[1:3] < 1.7).all()
