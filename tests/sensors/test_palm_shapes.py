import math

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError, Pose, Probe, RangeError
from palpate.sensors import palm
from palpate.sensors.palm.probe_shapes import gap_of, points_probe, silhouette

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
        "punch:6@five",
        "punch:6@5:10:3",
        "edge:8:30@4:90",
        "points:8",
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


@pytest.mark.parametrize("towards_deg", [225])
def test_a_leaning_punch_presses_hardest_on_its_lower_side(towards_deg):
    towards = math.radians(towards_deg)
    x, y = centre_of(pressed(f"punch:6@4:{towards_deg}"))
    along, aside = (
        x * math.cos(towards) + y * math.sin(towards),
        y * math.cos(towards) - x * math.sin(towards),
    )
    assert along > 0.3e-3
    assert abs(aside) < 0.02 * along  # a square grid is not alike in all directions


def test_balls_far_apart_press_as_each_would_alone():
    contact = pressed("points:10:-12,0;12,0,0.4", 1.2e-3)
    left = float(contact.pressure_pa[:, contact.x_m < 0].sum() * (contact.x_m[1] - contact.x_m[0]) ** 2)
    for found, depth in ((left, 1.2e-3), (contact.force_n - left, 0.8e-3)):
        alone = palm.press(SPEC, Pose(0.0, 0.0, depth), palm.parse_probe("points:10:0,0")).force_n
        # 1 % is measured: each stands on the bulge around the other, and cells are of 0.15 mm
        assert found == pytest.approx(alone, rel=0.02)


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
