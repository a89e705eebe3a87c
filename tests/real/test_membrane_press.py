"""One press of a speckled, air-filled membrane, divergence against force: a stand-in, not one of our sensors.

The camera looks at the membrane from the side, so that what is pressed moves across the image: divergence is
positive behind it, where the speckle opens, negative before it, and over the whole membrane the two cancel.
So a region is needed, and the rule is: in the frame of the greatest mean motion from the first, the pixels on
the speckle whose divergence, smoothed over 8 px, is half the greatest or more. It is no area of contact.

What follows shows that flow runs on a real press, and no more: the region is chosen at the peak of the same
press, and curl (r = 0.991) and convergence (0.993) follow force there as closely as divergence does.

Force is the length of the force vector less its mean over the first ten frames, since the sensor's axes are
not the press's.

From coarse to fine, the weight of smoothness is 0.1 here. At its default of 0.03 the greatest divergence is
noise at the speckle's dim edge, the rule's region falls there, and its mean follows force with r = 0.74 only
(0.99 in the region that dense inverse search finds).
"""

from functools import partial

import cv2
import numpy as np
import pytest

from palpate.estimators.compliance.press_force import loading
from palpate.estimators.compliance.spread_rate import area_m2, spread
from palpate.estimators.flow.flow_sequence import along, dis
from palpate.estimators.flow.horn_schunck import CoarseToFine, HornSchunck, coarse_to_fine, divergence, flow
from palpate.recordings.exchange.frame_sequences import open_sequence
from palpate.recordings.exchange.press_table import read_press_table

STILL = 10  # frames before the press that set force to zero
SMOOTH_PX = 8.0
SPECKLE_PX = 15.0  # over which brightness varies on the speckle
CONTACT_N = 1.5  # above what the force drifts before the press
SMOOTHER = CoarseToFine(HornSchunck(alpha=0.1, iterations=40))
METHODS = [
    pytest.param(flow, id="horn-schunck"),
    pytest.param(dis, id="dis", marks=pytest.mark.slow),
    pytest.param(partial(coarse_to_fine, settings=SMOOTHER), id="coarse-to-fine", marks=pytest.mark.slow),
]


@pytest.fixture(scope="module")
def press(real_data):
    """The frames, and the force of each [N]."""
    folder = real_data / "membrane-press"
    if not folder.is_dir():
        pytest.skip(f"no press of a membrane at {folder}")
    with open_sequence(folder / "press.tif") as pages:
        frames = list(pages)
    axes = [
        read_press_table(folder / "force.csv", len(frames), force_column=name)
        for name in ("Fx_N", "Fy_N", "Fz_N")
    ]
    force = np.stack([axis.force_n[axis.frame_sample] for axis in axes])
    return frames, np.linalg.norm(force - force[:, :STILL].mean(axis=1, keepdims=True), axis=0)


def speckled(image):
    """Where brightness varies, by Otsu's threshold."""
    level = image.astype(np.float32)
    mean, square = (cv2.GaussianBlur(x, (0, 0), SPECKLE_PX) for x in (level, level**2))
    varies = np.sqrt(np.maximum(square - mean**2, 0))
    whole = np.round(255 * varies / varies.max()).astype(np.uint8)
    return cv2.threshold(whole, 0, 255, cv2.THRESH_OTSU)[1] > 0


def opening(field, on):
    """The pixels whose smoothed divergence is half the greatest or more."""
    smooth = np.where(on, cv2.GaussianBlur(divergence(field), (0, 0), SMOOTH_PX), 0)
    return smooth >= smooth.max() / 2


@pytest.fixture(scope="module", params=METHODS)
def flows(press, request):
    """From the first frame to each, and from each to the next."""
    frames, force = press
    first, step = (list(along(frames, request.param, from_first=way, threads=1)) for way in (True, False))
    return force, first, step, speckled(frames[0])


def mean_divergence(fields, region):
    return np.array([divergence(field)[region].mean(dtype=np.float64) for field in fields])


def region_of(first, on):
    motion = [np.hypot(*field)[on].mean() for field in first]
    return opening(first[int(np.argmax(motion))], on)


def alike(values, force) -> float:
    return float(np.corrcoef(values, force)[0, 1])


def test_divergence_follows_force_where_the_speckle_opens(flows) -> None:
    force, first, step, on = flows
    region = region_of(first, on)
    at_once = mean_divergence(first, region)
    summed = np.cumsum(mean_divergence(step, region))
    during = slice(*_press(force))
    whole = [alike(mean_divergence(first, where), force[1:]) for where in (np.ones_like(on), on)]
    print(
        f"region {region.mean():.2%} of the image; r from the first frame "
        f"{alike(at_once, force[1:]):.3f} (during the press "
        f"{alike(at_once[during], force[1:][during]):.3f}), summed from frame to frame "
        f"{alike(summed, force[1:]):.3f} ({alike(summed[during], force[1:][during]):.3f}); greatest "
        f"{at_once.max():.3f} and {summed.max():.3f}, at the end {at_once[-1]:.3f} and {summed[-1]:.3f}; "
        f"without a region {whole[0]:.2f}, on all the speckle {whole[1]:.2f}"
    )
    assert alike(at_once, force[1:]) >= 0.95
    assert alike(summed, force[1:]) >= 0.95
    assert alike(at_once[during], force[1:][during]) >= 0.95
    assert alike(summed[during], force[1:][during]) >= 0.95
    # What has been pressed and let go has opened and closed: a fifth of the greatest for drift.
    assert abs(summed[-1]) < 0.2 * summed.max()


def test_the_area_by_summed_divergence_follows_force(flows) -> None:
    force, first, step, on = flows
    region = region_of(first, on)
    area = area_m2(1.0, mean_divergence(step, region))  # of the region, its first area as the unit
    part = loading(force[1:], CONTACT_N)
    i = slice(part.first, part.last + 1)
    rate = spread(force[1:][i], area[i]).rate_m2_n
    print(
        f"r of the area {alike(area, force[1:]):.3f}, while loading "
        f"{alike(area[i], force[1:][i]):.3f}; it grows by {area.max() - 1:.1%}, {rate:.2%} a newton"
    )
    assert alike(area, force[1:]) >= 0.95
    assert rate > 0


def _press(force) -> tuple[int, int]:
    """First and last step of the press: ten frames before force rises to ten after it falls."""
    touched = np.flatnonzero(force > CONTACT_N)
    return max(int(touched[0]) - 10, 0), min(int(touched[-1]) + 10, len(force) - 1)
