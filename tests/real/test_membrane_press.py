"""One press of a speckled, air-filled membrane, divergence against force: a stand-in, not one of our sensors.

The camera looks at the membrane from the side, so that what is pressed moves across the image: divergence is
positive behind it, where the speckle opens, negative before it, and over the whole membrane the two cancel.
So a region is needed, and it is fixed before the press is looked at: of the speckle in the untouched frame,
the third farthest back along the mean motion in the first frame whose force says contact. There the skin must
open as it is pushed away, before it must close, and a rotation must follow force less than the opening does.
No frame of a greater force has a part in the choice. It is no area of contact.

Force is the length of the force vector less its mean over the first ten frames, since the sensor's axes are
not the press's.

Horn-Schunck sees small steps only (r = 0.76
from the first frame), and dense inverse search drifts as its steps are summed (0.70).
"""

import cv2
import numpy as np
import pytest

from palpate.estimators.flow.horn_schunck import (
    along,
    dis,
    divergence,
    flow,
)
from palpate.recordings.exchange.frame_sequences import open_sequence
from palpate.recordings.exchange.press_table import read_press_table

STILL = 10  # frames before the press that set force to zero
SPECKLE_PX = 15.0  # over which brightness varies on the speckle
CONTACT_N = 1.5  # above what the force drifts before the press
FIRST, SUMMED = "from the first frame", "summed from frame to frame"
METHODS = [  # and what each can: small steps, or large ones
    pytest.param((flow, (SUMMED,)), id="horn-schunck"),
    pytest.param((dis, (FIRST,)), id="dis", marks=pytest.mark.slow),
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


def parts_of(first, force, on):
    """The third of the speckle farthest back along the first motion, and the half before its middle."""
    y, x = np.mgrid[: on.shape[0], : on.shape[1]]
    touched = first[int(np.argmax(force > CONTACT_N))]
    forth = x * touched[0][on].mean() + y * touched[1][on].mean()
    back, middle = np.quantile(forth[on], [1 / 3, 1 / 2])
    return on & (forth < back), on & (forth > middle)


def rotation(field):
    """Curl [1/frame] of a flow (u, v) in px."""
    return np.gradient(field[1], axis=1) - np.gradient(field[0], axis=0)


@pytest.fixture(scope="module", params=METHODS)
def flows(press, request):
    """From the first frame to each, from each to the next, and which of the two to expect of the method."""
    frames, force = press
    method, ways = request.param
    first, step = (list(along(frames, method, from_first=way, threads=1)) for way in (True, False))
    return force, first, step, speckled(frames[0]), ways


def mean_over(fields, region, of=divergence):
    return np.array([of(field)[region].mean(dtype=np.float64) for field in fields])


def alike(values, force) -> float:
    return float(np.corrcoef(values, force)[0, 1])


@pytest.mark.slow
def test_the_skin_opens_behind_what_is_pressed_as_force_grows(flows) -> None:
    force, first, step, on, ways = flows
    F, during = force[1:], slice(*_press(force))
    behind, before = parts_of(first, F, on)
    opens = {FIRST: mean_over(first, behind), SUMMED: np.cumsum(mean_over(step, behind))}
    turned, closing = mean_over(first, behind, rotation), mean_over(first, before)
    for way, values in opens.items():
        print(
            f"{way}: r {alike(values, F):.3f}, during the press {alike(values[during], F[during]):.3f}, "
            f"greatest {values.max():.4f}, at the end {values[-1]:.4f}"
        )
    whole = [alike(mean_over(first, where), F) for where in (np.ones_like(on), on)]
    print(
        f"region {behind.mean():.1%} of the image; controls: rotation {alike(turned, F):.3f}, divergence "
        f"before it {alike(closing, F):.3f}; without a region {whole[0]:.2f}, on the speckle {whole[1]:.2f}"
    )
    for values in (opens[way] for way in ways):
        assert alike(values, F) >= 0.95
        assert alike(values[during], F[during]) >= 0.95
        # What has been pressed and let go has opened and closed: a fifth of the greatest for drift.
        assert abs(values[-1]) < 0.2 * values.max()
        assert alike(-values, F) < 0  # converging, it would fall as force grows
    # In the same region rotation must fail; before what is pressed the skin closes instead.
    assert abs(alike(turned, F)) < 0.9
    assert alike(closing, F) < -0.8


def _press(force) -> tuple[int, int]:
    """First and last step of the press: ten frames before force rises to ten after it falls."""
    touched = np.flatnonzero(force > CONTACT_N)
    return max(int(touched[0]) - 10, 0), min(int(touched[-1]) + 10, len(force) - 1)
