"""Laws of a lens: OpenCV's own numbers, there and back, and no answer beyond the field."""

import json
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import ExistsError, ImageError, InputError, Lens

FISHEYE = Lens(
    "kannala-brandt", (231.0, 233.5), (318.2, 241.7), (-0.03, 0.012, -0.006, 0.0011), (480, 640), 1.5
)
PINHOLE = Lens("pinhole", (520.0, 515.0), (322.0, 238.0), (-0.21, 0.07, 8e-4, -5e-4, -0.01), (480, 640))


def directions(count, widest_rad, seed=0):
    """Points at all distances within an angle of the axis, the axis itself first [m]."""
    rng = np.random.default_rng(seed)
    theta, around = rng.uniform(0, widest_rad, count), rng.uniform(-math.pi, math.pi, count)
    theta[0] = 0.0
    unit = np.stack([np.sin(theta) * np.cos(around), np.sin(theta) * np.sin(around), np.cos(theta)], axis=1)
    return unit * rng.uniform(0.01, 3.0, (count, 1))


def test_a_fisheye_places_points_where_opencv_does():
    """1e-9 px: rounding of both ways of writing it."""
    points = directions(500, 1.49)
    theirs, _ = cv2.fisheye.projectPoints(
        points[:, None], np.zeros(3), np.zeros(3), FISHEYE.matrix, np.array(FISHEYE.distortion)
    )
    np.testing.assert_allclose(FISHEYE.project(points), theirs[:, 0], atol=1e-9, rtol=0)


def test_a_pinhole_places_points_where_opencv_does():
    points = directions(500, PINHOLE.field_rad * 0.99)
    theirs, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), PINHOLE.matrix, np.array(PINHOLE.distortion)
    )
    np.testing.assert_allclose(PINHOLE.project(points), theirs[:, 0], atol=1e-9, rtol=0)


@pytest.mark.parametrize("lens", [FISHEYE, PINHOLE], ids=lambda lens: lens.model)
def test_rays_and_project_are_inverse_both_ways(lens):
    """1e-9 px and 1e-9 rad, up to the last hundredth of the field, where the slope still stands off zero."""
    points = directions(2000, 0.99 * lens.field_rad)
    unit = points / np.linalg.norm(points, axis=1, keepdims=True)
    places = lens.project(points)
    np.testing.assert_allclose(lens.rays(places), unit, atol=1e-9, rtol=0)
    np.testing.assert_allclose(lens.project(lens.rays(places)), places, atol=1e-9, rtol=0)


def test_a_fisheye_sees_behind_its_own_plane():
    """At 100 degrees from the axis: an equidistant lens (all k zero) places it at theta focal lengths."""
    lens = Lens("kannala-brandt", (100.0, 100.0), (200.0, 200.0), (0, 0, 0, 0), (401, 401))
    theta = math.radians(100)
    behind = np.array([[math.sin(theta), 0.0, math.cos(theta)]])
    assert lens.project(behind)[0] == pytest.approx((200 + 100 * theta, 200), abs=1e-9)
    np.testing.assert_allclose(lens.rays(lens.project(behind)), behind, atol=1e-9)


@pytest.mark.parametrize("lens", [FISHEYE, PINHOLE], ids=lambda lens: lens.model)
def test_beyond_the_field_there_is_no_number(lens):
    field = lens.field_rad
    for angle in (field + 1e-6, field + 0.1, math.pi / 2 + field / 2, math.pi):
        point = np.array([[math.sin(angle), 0.0, math.cos(angle)]])
        assert np.isnan(lens.project(point)).all(), angle
    assert np.isnan(lens.project(np.zeros((1, 3)))).all()
    assert np.isnan(lens.rays(np.array([[1e6, 0.0], [np.nan, 3.0], [np.inf, 3.0]]))).all()


def test_where_the_polynomial_turns_back_the_field_ends():
    """theta (1 - theta² / 3) grows to theta = 1, where it is 2/3; r (1 - r² / 3) alike, at 45 degrees."""
    fisheye = Lens("kannala-brandt", (300.0, 300.0), (0.0, 0.0), (-1 / 3, 0, 0, 0), (10, 10))
    pinhole = Lens("pinhole", (300.0, 300.0), (0.0, 0.0), (-1 / 3, 0, 0, 0, 0), (10, 10))
    assert fisheye.field_rad == pytest.approx(1.0, abs=1e-9)
    assert pinhole.field_rad == pytest.approx(math.pi / 4, abs=1e-9)
    for lens in (fisheye, pinhole):
        assert np.isfinite(lens.rays(np.array([[199.9, 0.0]]))).all()
        assert np.isnan(lens.rays(np.array([[200.1, 0.0]]))).all()
    # OpenCV gives the second direction the place of a first one: the reason for the refusal.
    theirs, _ = cv2.fisheye.projectPoints(
        np.array([[[math.sin(1.3), 0, math.cos(1.3)]]]),
        np.zeros(3),
        np.zeros(3),
        fisheye.matrix,
        np.array(fisheye.distortion),
    )
    assert theirs[0, 0, 0] < 200


def test_the_fitted_angle_bounds_both_ways():
    lens = Lens("kannala-brandt", (300.0, 300.0), (0.0, 0.0), (0, 0, 0, 0), (10, 10), max_angle_rad=0.5)
    assert lens.field_rad == 0.5
    places = np.array([[149.9, 0.0], [150.1, 0.0]])
    assert np.isnan(lens.rays(places)).all(axis=1).tolist() == [False, True]
    points = np.array([[math.tan(0.499), 0, 1.0], [math.tan(0.501), 0, 1.0]])
    assert np.isnan(lens.project(points)).all(axis=1).tolist() == [False, True]


def test_undistorted_places_are_those_of_opencv():
    """The default pinhole keeps matrix and size: OpenCV's P = K. Its solver stops at 1e-8; 1e-5 px."""
    places = FISHEYE.project(directions(300, 1.2))
    theirs = cv2.fisheye.undistortPoints(
        places[:, None], FISHEYE.matrix, np.array(FISHEYE.distortion), P=FISHEYE.matrix
    )
    np.testing.assert_allclose(FISHEYE.undistorted(places), theirs[:, 0], atol=1e-5, rtol=0)


def test_a_line_in_space_is_straight_when_undistorted():
    line = np.array([0.3, -0.2, 1.0]) + np.linspace(-1, 1, 50)[:, None] * np.array([0.5, 0.4, 0.1])
    flat = FISHEYE.undistorted(FISHEYE.project(line))
    along = flat[-1] - flat[0]
    off = ((flat - flat[0]) @ np.array([-along[1], along[0]])) / np.linalg.norm(along)
    assert np.abs(off).max() < 1e-8
    bent = FISHEYE.project(line)
    along = bent[-1] - bent[0]
    assert np.abs((bent - bent[0]) @ np.array([-along[1], along[0]])).max() / np.linalg.norm(along) > 5


def test_a_flat_image_of_half_the_size_keeps_the_frame_s_corners():
    """Pixel borders, not centres, scale: -0.5 stays -0.5, and 639.5 becomes 319.5."""
    half = FISHEYE.flat((FISHEYE.focal_px[0] / 2, FISHEYE.focal_px[1] / 2), (240, 320))
    places = np.array([[100.0, 80.0], [400.0, 300.0]])
    np.testing.assert_allclose(
        (FISHEYE.undistorted(places, half) + 0.5) * 2 - 0.5, FISHEYE.undistorted(places), atol=1e-9
    )


def test_the_shape_of_what_is_given_is_kept():
    points = directions(12, 1.0).reshape(3, 4, 3)
    assert FISHEYE.project(points).shape == (3, 4, 2)
    assert FISHEYE.rays(FISHEYE.project(points)).shape == (3, 4, 3)
    np.testing.assert_array_equal(FISHEYE.project(points)[1, 2], FISHEYE.project(points[1, 2]))
    with refused("shape", InputError, match=r"3\]"):
        FISHEYE.project(np.zeros((4, 2)))


def test_the_same_numbers_have_the_same_id_and_a_name_is_none_of_them():
    twin = Lens.from_card(json.loads(json.dumps(FISHEYE.card())))
    named, moved = replace(FISHEYE, name="a"), replace(FISHEYE, centre_px=(318.2, 241.7 + 1e-12))
    assert twin == FISHEYE
    assert hash(twin) == hash(FISHEYE)
    assert twin.id == FISHEYE.id == named.id == "8e6d5dcc212d07e7"
    assert moved.id != FISHEYE.id


def test_a_lens_file_is_read_as_it_was_written_and_not_overwritten(tmp_path):
    path = tmp_path / "lens.json"
    PINHOLE.write(path)
    assert Lens.read(path) == PINHOLE
    with pytest.raises(ExistsError):
        FISHEYE.write(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": "palpate-lens/9"}, "schema"),
        ({"focal_px": [1.0, 2.0]}, "lens-id"),
        ({"focal_px": [0.0, 2.0]}, "lens-numbers"),
        ({"focal_px": [math.nan, 2.0]}, "lens-numbers"),
        ({"model": "thin"}, "lens-numbers"),
        ({"distortion": [0.0]}, "lens-numbers"),
        ({"size_px": [0, 3]}, "lens-numbers"),
        ({"max_angle_rad": 4.0}, "lens-numbers"),
        ({"centre_px": None}, "lens-numbers"),
    ],
)
def test_a_damaged_lens_file_is_refused(tmp_path, change, message):
    path = tmp_path / "lens.json"
    path.write_text(json.dumps({**FISHEYE.card(), **change}))
    with refused(message, InputError):
        Lens.read(path)


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"schema": "palpate-lens/1"}'])
def test_what_is_no_lens_file_is_refused(tmp_path, text):
    path = tmp_path / "lens.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"lens\.json"):
        Lens.read(path)
    with pytest.raises(InputError, match="none"):
        Lens.read(tmp_path / "none.json")


def test_a_frame_of_another_size_is_refused():
    FISHEYE.check_size((480, 640))
    with refused("image-size", ImageError, match="480x640"):
        FISHEYE.check_size((640, 480))
