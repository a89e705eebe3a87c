import math

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError, Pose, Probe, RangeError
from palpate.sensors import palm
from palpate.sensors.palm.palm_press import CELL_M
from palpate.sensors.palm.probe_shapes import gap_of, parts_of, points_probe, reaches_of, silhouette

SPEC = palm.palm()
X = np.linspace(-10e-3, 10e-3, 81)


def pressed(words, depth_m=0.8e-3, x_m=0.0, y_m=0.0):
    return palm.press(SPEC, Pose(x_m, y_m, depth_m), palm.parse_probe(words))


def centre_of(contact):
    p = contact.pressure_pa
    return (p * contact.x_m).sum() / p.sum(), (p * contact.y_m[:, None]).sum() / p.sum()


def test_words_are_points_and_leaning_probes():
    assert palm.parse_probe("points:8:-7,0;7,3,0.2").places_m == ((-7e-3, 0.0, 0.0), (7e-3, 3e-3, 2e-4))
    leaning = palm.parse_probe("punch:6@5:90")
    assert (leaning.tilt_rad, leaning.turn_rad) == (math.radians(5), math.radians(90))
    assert palm.parse_probe("edge:8:30@-4") == Probe("edge", 0.0, 8e-3, math.radians(30), math.radians(-4))
    assert len({leaning, palm.parse_probe("points:8:0,0"), palm.parse_probe("points:8:0,1")}) == 3, "hashable"


@pytest.mark.parametrize(
    "words",
    [
        "punch:6@",
        "punch:6@five",
        "punch:6@5:10:3",
        "edge:8:30@4:90",
        "points:8",
        "points:8:1",
        "points:8:1,2,3,4",
        "points:8:a,b",
    ],
)
def test_words_that_are_no_probe_are_answered_with_those_that_are(words):
    with pytest.raises(InputError, match=r"points:DIAMETER_MM:X_MM,Y_MM.*@TILT_DEG"):
        palm.parse_probe(words)


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("punch:6@31", "tilt-range"),
        ("punch:6@nan", "tilt-range"),
        ("points:0:1,1", "not-positive"),
        ("points:8:inf,1", "not-finite"),
        ("points:8:1,1;1,1,0.5", "sphere-positions"),
    ],
)
def test_sizes_and_angles_out_of_range_are_refused(words, code):
    with refused(code, InputError):
        palm.parse_probe(words)


def test_a_ball_is_unchanged_by_a_tilt():
    assert palm.parse_probe("sphere:10@7:45") == palm.parse_probe("sphere:10")
    leaning = Probe("sphere", 3e-3, tilt_rad=0.1, turn_rad=1.0)
    np.testing.assert_array_equal(
        gap_of(leaning, X, X, (0.0, 0.0)), gap_of(Probe("sphere", 3e-3), X, X, (0.0, 0.0))
    )
    own = Probe("sphere", SPEC.indenter_radius_m, tilt_rad=0.1)
    assert palm.press(SPEC, Pose(0.0, 0.0, 3e-3), own).force_n > 0, "and is still the table's"


@pytest.mark.parametrize("towards_deg", [0, 90, 225])
def test_a_leaning_punch_presses_hardest_on_its_lower_side(towards_deg):
    towards = math.radians(towards_deg)
    x, y = centre_of(pressed(f"punch:6@4:{towards_deg}"))
    along, aside = (
        x * math.cos(towards) + y * math.sin(towards),
        y * math.cos(towards) - x * math.sin(towards),
    )
    assert along > 0.3e-3
    assert abs(aside) < 0.02 * along  # a square grid is not alike in all directions


def test_what_leans_the_other_way_is_its_mirror_image():
    one, other = (pressed(f"punch:6@4:{towards}") for towards in (0, 180))
    np.testing.assert_allclose(
        one.pressure_pa, other.pressure_pa[:, ::-1], atol=1e-4 * one.pressure_pa.max()
    )  # the solver stops at 1e-5 of the sinking
    assert one.force_n == pytest.approx(other.force_n, rel=1e-4)


@pytest.mark.parametrize("words", ["punch:6", "edge:10:20", "cylinder:6:10:20", "two-points:5:8"])
def test_the_more_a_probe_leans_the_less_of_it_presses(words):
    forces = [pressed(f"{words}@{tilt}").force_n for tilt in (0, 2, 5)]
    assert forces[0] > forces[1] > forces[2] > 0
    assert pressed(words).force_n == pytest.approx(forces[0])


def test_two_points_are_two_of_any_number():
    two, any_two = pressed("two-points:5:8"), pressed("points:5:-4,0;4,0")
    assert two.force_n == pytest.approx(any_two.force_n, rel=1e-9)
    np.testing.assert_allclose(two.pressure_pa, any_two.pressure_pa)


def test_two_points_lean_as_balls_of_which_one_is_higher():
    angle = math.radians(3)
    along, up = 4e-3 * math.cos(angle), 8e-3 * math.sin(angle)
    leaning = parts_of(palm.parse_probe("two-points:5:8@3"))
    np.testing.assert_allclose([place for _, place in leaning], [(-along, 0, up), (along, 0, 0)], atol=1e-12)


def test_balls_far_apart_press_as_each_would_alone():
    contact = pressed("points:10:-12,0;12,0,0.4", 1.2e-3)
    left = float(contact.pressure_pa[:, contact.x_m < 0].sum() * (contact.x_m[1] - contact.x_m[0]) ** 2)
    for found, depth in ((left, 1.2e-3), (contact.force_n - left, 0.8e-3)):
        alone = palm.press(SPEC, Pose(0.0, 0.0, depth), palm.parse_probe("points:10:0,0")).force_n
        # 1 % is measured: each stands on the bulge around the other, and cells are of 0.15 mm
        assert found == pytest.approx(alone, rel=0.02)


def test_wide_probes_keep_fine_cells():
    contact = pressed("points:10:-18,0;18,0", 1.0e-3)
    assert contact.x_m[1] - contact.x_m[0] <= CELL_M * (1 + 1e-9)
    assert len(contact.y_m) < len(contact.x_m), "and no more of them than it takes"


def test_a_probe_reaches_as_far_as_its_outermost_ball():
    assert reaches_of(palm.parse_probe("points:8:-7,0;2,-3")) == pytest.approx((11e-3, 7e-3))


def test_each_ball_is_seen_where_it_is_and_as_high_as_it_is():
    probe = palm.parse_probe("points:4:-5,1;5,0,1")
    z = np.array([-0.2e-3, 0.3e-3])
    seen = silhouette(probe, 0.5e-3, np.array([-5e-3, 0.0, 5e-3]), z) > 0
    np.testing.assert_array_equal(seen, [[True, False, False], [True, False, False]])
    higher = silhouette(probe, 0.5e-3, np.array([5e-3]), np.array([-0.6e-3])) > 0
    assert higher.all(), "the other's lowest point is half a millimetre above the rest surface"


def test_points_that_are_none_are_refused():
    with refused("sphere-positions", InputError):
        points_probe(1e-3, [])
    with refused("tilt-range", RangeError):
        gap_of(Probe("punch", 3e-3, tilt_rad=0.6), X, X, (0.0, 0.0))
