"""A virtual TacTip against taps of a real one, another laboratory's: a stand-in, with 331 pins."""

import numpy as np
import pytest

from palpate.sensors.tactip.taps.tap_folder import fit_folder, upright_places

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def fitted(real_data):
    folder = real_data / "tactip-surface"
    if not folder.is_dir():
        pytest.skip(f"no taps of a TacTip at {folder}")
    return fit_folder(folder / "train", folder / "val", taps=150)


def test_pins_of_most_taps_are_named(fitted) -> None:
    _, _, (known, new) = fitted
    assert len(known.poses) > 0.85 * (len(known.poses) + known.lost)
    assert len(new.poses) > 0.8 * (len(new.poses) + new.lost)
    assert np.isfinite(known.places_px).all(axis=2).mean() > 0.99


def test_the_twin_leaves_little_more_than_the_taps_own_scatter(fitted) -> None:
    _, judged, _ = fitted
    print(judged.residual_px, judged.floor_px, judged.motion_px)
    assert judged.residual_px < 1.6 * judged.floor_px
    assert judged.residual_px < 0.3 * judged.motion_px


def test_upright_the_twin_moves_as_the_taps_do(fitted) -> None:
    fit, _, (known, _) = fitted
    depths, smooth, twin = upright_places(fit, known)
    moved = smooth - fit.tip.rest_px
    for depth, told, seen in zip(depths[1:], (twin - smooth)[1:], moved[1:], strict=True):
        print(depth, np.sqrt((told**2).sum(1).mean()), np.sqrt((seen**2).sum(1).mean()))
        assert (told**2).sum() < 0.3**2 * (seen**2).sum()
