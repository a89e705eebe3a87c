"""Touch seen without a calibration, on real gels: where the object is, and nothing where none is.

The gel is a gripper's wedge of clear elastomer lit from its sides, the skin is dotted silicone under dead
weights; neither is a sensor of a preset.
"""

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

from palpate.sensing.untouched_view import UntouchedView

REFERENCE = 6  # frames of each grasp, at its beginning
GEL = (130, 110, 270, 240)  # inside of the lamps, px


def grasp(real_data: Path, name: str) -> tuple[list[np.ndarray], np.ndarray]:
    """Frames of a grasp, RGB, and force [N]."""
    folder = real_data / "grasp-modulus"
    if not folder.is_dir():
        pytest.skip(f"no recordings of grasps at {folder}")
    capture, frames = cv2.VideoCapture(str(folder / f"{name}.avi")), []
    while (read := capture.read())[0]:
        frames.append(cv2.cvtColor(read[1], cv2.COLOR_BGR2RGB))
    return frames, pd.read_csv(folder / f"{name}.csv")["force_N"].to_numpy()


def object_middle(frame: np.ndarray, untouched: np.ndarray) -> np.ndarray:
    """Where the print is, by another way: Otsu's level of the difference's size, and its largest part."""
    x, y, width, height = GEL
    cut = np.s_[y : y + height, x : x + width]
    apart = np.abs(frame[cut].astype(np.float64) - untouched[cut]).sum(axis=2)
    level = cv2.normalize(cv2.GaussianBlur(apart, (0, 0), 8), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    _, mask = cv2.threshold(level, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    _, _, boxes, middles = cv2.connectedComponentsWithStats(mask)
    return middles[1 + boxes[1:, cv2.CC_STAT_AREA].argmax()] + [x, y]


@pytest.mark.parametrize("name", ["golf_ball_1", "golf_ball_2", "golf_ball_3"])
def test_the_region_of_a_golf_ball_is_where_its_print_is(real_data: Path, name: str) -> None:
    frames, force = grasp(real_data, name)
    view = UntouchedView(frames[:REFERENCE], region=GEL)
    light = np.flatnonzero((force > 0.3) & (force < 3) & (np.arange(len(force)) < force.argmax()))
    assert len(light) >= 3
    untouched = np.mean(frames[:REFERENCE], axis=0)
    for i in light:
        seen = view.seen(frames[i])
        assert seen.verdict == "touched", i
        assert seen.region is not None
        away = np.array(seen.region.centre_px) - object_middle(frames[i], untouched)
        assert np.hypot(*away) < 15, i  # the print is about 120 px wide
        assert 1500 < seen.region.area_px < 20000


@pytest.mark.parametrize("name", ["golf_ball_1", "golf_ball_2", "purple_ball_hardest_2"])
def test_an_untouched_gel_is_untouched_until_the_ball_comes(real_data: Path, name: str) -> None:
    """Frames of a compressed video after those of the reference, in which noise is not that of a camera."""
    frames, force = grasp(real_data, name)
    view = UntouchedView(frames[:REFERENCE], region=GEL)
    assert (np.abs(force[REFERENCE : REFERENCE + 2]) < 0.1).all()
    assert {view.seen(frame).verdict for frame in frames[: REFERENCE + 2]} == {"untouched"}
