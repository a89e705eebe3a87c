"""Dark lines looked for where tiles are: beside the same in the whole frame, which takes more time."""

import cv2
import numpy as np
import pytest

import palpate
from palpate.core import Pose
from palpate.core.sensor import for_live
from palpate.estimators.fringe_light import brightest_channel
from palpate.estimators.lattice import find_checkerboard
from palpate.estimators.shear.skin_marks import AROUND, DARK, MIN_GAP, SMOOTH_PX, TILE_REACH, TileCentres

SENSOR = for_live(palpate.sensor("nusense"))
LINES = {
    "none": ((0, 0), (0, 0)),
    "too short": ((300, 240), (322, 240)),
    "long enough": ((300, 240), (326, 240)),
    "long": ((280, 220), (370, 250)),
    "beyond the tiles": ((150, 100), (330, 240)),
}


def picture(line):
    rng = np.random.default_rng(0)
    contact = SENSOR.press(SENSOR.probe("round"), Pose(3e-3, 2e-3, 1.4e-3 * (line == "long")))
    image = SENSOR.render(contact, rng).image.copy()
    start, end = LINES[line]
    if start != end:
        cv2.line(image, start, end, (8, 8, 8), 2)
    x, y = (rng.integers(a, b, 25) for a, b in ((170, 470), (120, 360)))
    image[y, x] = 5  # specks
    return image


@pytest.fixture(scope="module")
def tiles():
    image = SENSOR.render(
        SENSOR.press(SENSOR.probe("round"), Pose(0.0, 0.0, 0.0)), np.random.default_rng(1)
    ).image
    found = find_checkerboard(image, 24.0)
    return TileCentres(found.points, image.shape, found.pitch)


def longest_gap_of_the_whole_frame(tiles, image, bare):
    bright = cv2.GaussianBlur(brightest_channel(image), (0, 0), SMOOTH_PX)
    side = 2 * round(AROUND * tiles._pitch) + 1
    dark = np.uint8(bright < DARK * cv2.dilate(bright, np.ones((side, side), np.uint8))) & tiles._within
    for x, y in tiles._places[bare].tolist():
        cv2.circle(dark, (x, y), round(TILE_REACH * tiles._pitch), 0, -1)
    stats = cv2.connectedComponentsWithStats(dark)[2]
    sizes = np.hypot(*stats[1:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].T)
    length = float(sizes.max(initial=0.0)) / tiles._pitch
    return length if length >= MIN_GAP else 0.0


@pytest.mark.parametrize("line", LINES)
def test_the_longest_dark_line_is_that_of_the_whole_frame(tiles, line):
    image = picture(line)
    bare = tiles.bare(image)
    lengths = [tiles.longest_gap(image, off) for off in (bare, np.arange(len(bare)) % 40 == 7)]
    assert lengths[0] == longest_gap_of_the_whole_frame(tiles, image, bare)
    assert (max(lengths) > 0) == (line not in ("none", "too short")), lengths


def test_a_tile_that_has_come_off_is_bare_and_no_other(tiles):
    image = picture("none")
    x, y = tiles._places[100]
    image[y - 3 : y + 4, x - 3 : x + 4] = 6
    assert np.nonzero(tiles.bare(image))[0].tolist() == [100]
    assert np.nonzero(tiles.bare(brightest_channel(image)))[0].tolist() == [100]
