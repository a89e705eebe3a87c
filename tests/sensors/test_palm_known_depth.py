"""How deep a palm says that a probe may be pressed: what `press` takes, and no deeper."""

from dataclasses import replace

import pytest

from palpate.core import Pose, PressHistory, RangeError
from palpate.sensors import palm
from palpate.sensors.palm.membrane_faults import UnevenGel, thickness_at, thickness_range
from palpate.sensors.palm.palm_press import LINEAR_DEPTH_M
from palpate.sensors.palm.palm_sensor import Palm

SPEC = palm.preset("debug")
TABLED = "sphere:10", "punch:8", "cylinder:6:12:30", "two-points:5:8", "edge:12", "points:5:0,-4;0,4"
LINEAR = "sphere:6", "punch:7", "punch:8@5", "cylinder:6:13", "points:5:-4,0;4,0.5"
UNEVEN = UnevenGel(0.05, 0.02, seed=2)
MEMBRANES = {
    "nominal": SPEC,
    "uneven modulus": replace(SPEC, gel=UnevenGel(0.05, 0.0, seed=2)),
    "uneven": replace(SPEC, gel=UNEVEN),
    "thinner": replace(SPEC, thickness_m=9.3e-3),
    "thin": replace(SPEC, thickness_m=8e-3),
    "with friction": replace(SPEC, friction=0.5),
}
PLACES = (0.0, 0.0), (-9e-3, 4e-3), (8e-3, -6e-3)
SIDEWAYS = PressHistory(lateral_n=(0.01, 0.0))
STEP_M = 0.1e-3


@pytest.mark.parametrize("words", TABLED + LINEAR)
@pytest.mark.parametrize("membrane", MEMBRANES)
@pytest.mark.cases(6)
def test_a_press_at_the_known_depth_is_taken_and_a_deeper_one_is_refused(membrane, words):
    sensor, probe = Palm(MEMBRANES[membrane]), palm.parse_probe(words)
    known_m = sensor.known_depth_m(probe)
    for x, y in PLACES if "uneven" in membrane else PLACES[:1]:
        if known_m:
            assert sensor.press(probe, Pose(x, y, known_m)).force_n > 0.0
        with pytest.raises(RangeError, match=r"deep|depth|thick"):
            sensor.press(probe, Pose(x, y, known_m + STEP_M))


@pytest.mark.parametrize("words", ["sphere:10", "punch:8"])
@pytest.mark.parametrize("membrane", ["nominal", "uneven"])
def test_so_it_is_under_a_lateral_load(membrane, words):
    sensor, probe = Palm(MEMBRANES[membrane]), palm.parse_probe(words)
    known_m = sensor.known_depth_m(probe, lateral=True)
    assert sensor.press(probe, Pose(0.0, 0.0, known_m), history=SIDEWAYS).lateral_n == (0.01, 0.0)
    with pytest.raises(RangeError, match="mm"):
        sensor.press(probe, Pose(0.0, 0.0, known_m + STEP_M), history=SIDEWAYS)


@pytest.mark.parametrize("words", ["punch:8"])
def test_an_uneven_thickness_leaves_the_tables_of_other_probes_out(words):
    """The table's depth, which the even membrane has, would be refused at each of these places."""
    even, uneven = (Palm(MEMBRANES[name]) for name in ("uneven modulus", "uneven"))
    probe = palm.parse_probe(words)
    assert even.known_depth_m(probe) == pytest.approx(even.force_law(probe).greatest_m)
    assert even.known_depth_m(probe) > LINEAR_DEPTH_M
    assert uneven.known_depth_m(probe) == uneven.force_law(probe).greatest_m == LINEAR_DEPTH_M
    for x, y in PLACES[1:]:
        with pytest.raises(RangeError, match=r"1\.5 mm"):
            uneven.press(probe, Pose(x, y, even.known_depth_m(probe)))


def test_the_range_of_thickness_holds_that_of_every_place():
    spec = MEMBRANES["uneven"]
    thinnest, thickest = thickness_range(spec)
    there = [thickness_at(spec, 1e-3 * x, 1e-3 * y) for x in range(-20, 21, 2) for y in range(-20, 21, 2)]
    assert thinnest <= min(there) < 0.99 * SPEC.thickness_m
    assert thickest >= max(there) > 1.005 * SPEC.thickness_m
    assert thickness_range(SPEC) == (SPEC.thickness_m, SPEC.thickness_m)


def test_a_ball_without_a_table_at_some_place_is_not_known_at_all():
    spec = replace(SPEC, gel=UnevenGel(0.0, 0.1, seed=3))
    assert Palm(spec).known_depth_m(palm.parse_probe("sphere:10")) == 0.0
    assert Palm(spec).known_depth_m(palm.parse_probe("edge:12")) == LINEAR_DEPTH_M
