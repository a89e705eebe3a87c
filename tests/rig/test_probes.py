"""Other indenters and lateral loads on the virtual rig: felt, seen, and refused where no law reaches."""

from pathlib import Path

import numpy as np
import pytest
from tests.refusals import refused
from tests.rig.rigs import IDEAL, SPEC, near, quick, rig

from palpate.core import Pose
from palpate.core.errors import InputError, RecordingError
from palpate.devices.motion_limits import Tripped
from palpate.recordings.run_reader import Run
from palpate.rig import PLANS, State, record
from palpate.rig.locate_skin import SkinPlacement, locate_skin
from palpate.rig.plans import Around, Lateral, Listed, StepHold, plan_from
from palpate.rig.virtual import Variation
from palpate.sensors import palm
from palpate.sensors.palm.palm_press import LINEAR_DEPTH_M
from palpate.sensors.palm.palm_sensor import force_law_of

CENTRE = Listed(kind="listed", at_mm=((0.0, 0.0),))


def small(**kwargs: object) -> StepHold:
    return quick(**{"places": CENTRE, "depth_mm": 0.8, "step_mm": 0.4} | kwargs)


@pytest.mark.parametrize("words", ["punch:6", "cylinder:6:12", "two-points:4:8"])
def test_the_force_under_a_probe_is_that_of_pressing_it_once(words: str) -> None:
    probe = palm.parse_probe(words)
    law = force_law_of(SPEC, probe)
    for depth in (0.3e-3, 0.77e-3, 1.5e-3):
        alone = palm.press(SPEC, Pose(0.0, 0.0, depth), probe).force_n
        assert np.interp(depth, law.depth_m, law.force_n) == pytest.approx(alone, rel=0.02)


def test_linear_layers_and_the_table_agree_on_the_ball_where_both_hold() -> None:
    table, layers = (
        force_law_of(SPEC, palm.parse_probe("sphere:10")),
        force_law_of(SPEC, palm.parse_probe("sphere:9.99")),
    )
    depth = np.linspace(0.4e-3, LINEAR_DEPTH_M, 6)
    one, other = (np.interp(depth, law.depth_m, law.force_n) for law in (table, layers))
    assert other == pytest.approx(one, rel=0.05)
    one, other = (np.interp(depth, law.depth_m, law.radius_m) for law in (table, layers))
    assert other == pytest.approx(one, rel=0.1)


def test_each_indenter_of_a_plan_is_recorded_and_differs(tmp_path: Path) -> None:
    several = small(indenters=("sphere:10", "punch:6"))
    out = tmp_path / "run"
    assert record(near(), several, out).state is State.DONE
    labels = Run.open(out).labels.query("phase == 'down'")
    force = labels.groupby("indenter")["force_N"].max()
    assert set(force.index) == {"sphere:10", "punch:6"}
    # At the same depth a flat end of 6 mm carries twice what the ball does; seating varies by 0.02 mm.
    assert force["punch:6"] > 1.9 * force["sphere:10"]
    images = {i: Run.open(out).frame(int(rows.index[-1])).image for i, rows in labels.groupby("indenter")}
    assert np.abs(images["sphere:10"].astype(int) - images["punch:6"]).mean() > 0.5


@pytest.mark.slow
def test_a_lateral_load_is_felt_along_its_way_and_seen(tmp_path: Path) -> None:
    aside = small(lateral=Lateral(depths_mm=(0.8,), to_mm=((0.2, 0.0), (0.0, -0.2)), steps=1))
    out = tmp_path / "run"
    assert record(near(), aside, out).state is State.DONE
    run = Run.open(out)
    rows = run.labels.query("phase == 'lateral'")
    along_x, along_y = rows.iloc[0], rows.iloc[1]
    assert along_x["force_x_N"] > 0.1
    assert abs(along_x["force_y_N"]) < 0.03
    assert along_y["force_y_N"] < -0.1
    assert abs(along_y["force_x_N"]) < 0.03
    straight = run.labels.query("phase == 'down' and depth_mm > 0.7").index[0]
    one, other = (run.frame(int(i)).image.astype(int) for i in (straight, rows.index[0]))
    assert np.abs(one - other).mean() > 0.2


@pytest.mark.parametrize(
    "deep",
    [
        small(indenters=("punch:7",), depth_mm=1.6),
        small(indenters=("punch:6",), depth_mm=3.1),
        small(indenters=("punch:6",), depth_mm=1.6, lateral=Lateral(depths_mm=(1.6,), to_mm=((0.2, 0.0),))),
        small(depth_mm=5.9, step_mm=5.9),
    ],
)
def test_deeper_than_a_law_reaches_is_refused_before_anything_moves(tmp_path: Path, deep: StepHold) -> None:
    bench = near()
    before = bench.stage.position_m()
    with refused("plan", Tripped):
        record(bench, deep, tmp_path / "run")
    assert bench.stage.position_m() == before


def test_an_indenter_that_is_none_is_refused_before_anything_moves(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="banana"):
        record(near(), small(indenters=("banana:3",)), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_an_indenter_wider_than_the_places_allow_for_is_refused() -> None:
    with refused("probe-too-wide", InputError, match="10 mm"):
        plan_from({"indenters": ["sphere:12"]})


# Where a layer lies is found by touching it.

AROUND = PLANS["layer"].model_copy(update={"travel_mm_s": 50.0})
ZERO_MM = 0.12  # from first touch to where 0.05 N is passed, with half a step of the search


def found(tmp_path: Path, variation: Variation, askew_mm: tuple[float, float, float]) -> SkinPlacement:
    askew_m = tuple(1e-3 * d for d in askew_mm)
    out = tmp_path / "run"
    assert record(rig(variation=variation, askew_m=askew_m), AROUND, out).state is State.DONE
    return locate_skin(Run.open(out))


@pytest.mark.slow
@pytest.mark.parametrize("askew_mm", [(0.0, 0.0, 0.0), (0.8, -1.2, 0.4), (-1.5, 0.3, -0.6)])
def test_touching_finds_the_layers_place(tmp_path: Path, askew_mm: tuple[float, float, float]) -> None:
    layer = found(tmp_path, IDEAL, askew_mm)
    x, y, z = askew_mm
    assert layer.moved_mm[:2] == pytest.approx((x, y), abs=0.1)
    assert layer.moved_mm[2] == pytest.approx(z + ZERO_MM, abs=0.03)
    assert layer.diameter_mm == pytest.approx((2e3 * SPEC.radius_m,) * 2, abs=0.25)
    assert layer.tilt_mrad == pytest.approx((0, 0), abs=1.0)
    assert layer.origin_mm == pytest.approx(layer.moved_mm, abs=1e-4)


@pytest.mark.slow
def test_touching_finds_the_layers_tilt_through_the_spread_of_approaches(tmp_path: Path) -> None:
    layer = found(tmp_path, Variation(tilt_rad=(0.01, -0.006)), (0.0, 0.0, 0.0))
    # Seating varies by 0.02 mm, over 30 mm.
    assert layer.tilt_mrad == pytest.approx((10.0, -6.0), abs=1.5)
    assert layer.off_plane_mm < 0.06


def test_a_run_of_another_plan_says_nothing_of_the_layer(tmp_path: Path) -> None:
    record(near(), quick(depth_mm=0.4), tmp_path / "run")
    with pytest.raises(RecordingError, match="--plan layer"):
        locate_skin(Run.open(tmp_path / "run"))


@pytest.mark.parametrize(
    ("change", "said"), [({"inside_mm": 24.0}, "position-outside"), ({"beyond_mm": 5.0}, "rim-not-touched")]
)
def test_places_that_tell_nothing_are_refused(change: dict[str, float], said: str) -> None:
    with refused(said, InputError):
        Around(kind="around", **change).places()
