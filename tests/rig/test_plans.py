"""Plans: which places, presses, shots and frames they ask for, and in which order."""

import math
from pathlib import Path

import pytest
from hypothesis import given, strategies as st
from tests.refusals import refused

from palpate.core.errors import InputError
from palpate.core.sensor import for_rig, sensor
from palpate.rig.plans import PLANS, Grid, Scattered, StepHold, plan_from, plan_of, plan_of_sensor, size_of
from palpate.rig.plans.plan_files import Dwell, Lateral
from palpate.rig.plans.recording_plan import Aside, Burst, Depth, Over, Seek, Step, TareStep


@pytest.mark.parametrize(("pitch_mm", "points"), [(7.0, 37), (6.5, 45), (7.5, 29)])
def test_the_candidate_grid_is_clipped_by_membrane_and_probe(pitch_mm: float, points: int) -> None:
    places = Grid(pitch_mm=pitch_mm).places()
    assert len(places) == points
    assert len({place.name for place in places}) == points
    assert all(math.hypot(p.x_mm, p.y_mm) + 5 <= 57 / 2 + 1e-9 for p in places)


@pytest.mark.parametrize("name", PLANS)
def test_every_shot_of_a_plan_has_a_key_of_its_own(name: str) -> None:
    plan = PLANS[name]
    keys = [shot.key for press in plan.presses() for shot, _ in plan.shots(press)]
    assert len(keys) == len(set(keys))


@pytest.mark.parametrize("order", ["cycles", "rounds", "shuffled"])
def test_an_order_changes_when_a_press_is_done_and_not_which(order: str) -> None:
    plain, other = StepHold(), StepHold(order=order, seed=3)
    assert sorted(map(str, plain.presses())) == sorted(map(str, other.presses()))
    assert list(other.presses()) == list(StepHold(order=order, seed=3).presses())
    if order == "shuffled":
        assert list(other.presses()) != list(StepHold(order=order, seed=4).presses())


def test_a_press_tares_in_the_air_finds_contact_and_then_goes_down_step_by_step() -> None:
    plan = StepHold(depth_mm=0.3, cycles=1, frames=2, reference_frames=1)
    steps = list(plan.steps(next(plan.presses()), {}))
    kinds: list[type[Step]] = [type(step) for step in steps]
    assert kinds == [Over, TareStep, Burst, Seek, *[Depth, Burst] * 3]
    assert [step.depth_m for step in steps if isinstance(step, Depth)] == pytest.approx([1e-4, 2e-4, 3e-4])


@given(done=st.lists(st.tuples(st.integers(0, 5), st.integers(0, 2)), max_size=20), unloading=st.booleans())
def test_a_resumed_press_records_what_is_missing_and_nothing_else(done, unloading):
    plan = StepHold(depth_mm=0.3, cycles=1, frames=3, reference_frames=2, unloading=unloading)
    press = next(plan.presses())
    shots = plan.shots(press)
    held: dict[str, frozenset[int]] = {}
    for i, k in done:
        shot, _ = shots[i % len(shots)]
        held[shot.key] = held.get(shot.key, frozenset()) | {k}
    recorded = [
        (step.shot.key, k)
        for step in plan.steps(press, held)
        if isinstance(step, Burst)
        for k in step.missing
    ]
    wanted = {(s.key, k) for s, n in shots for k in range(n)} - {(key, k) for key in held for k in held[key]}
    assert len(recorded) == len(set(recorded))
    assert set(recorded) == wanted


def test_a_lateral_load_returns_to_the_middle_before_each_direction_and_at_the_end() -> None:
    lateral = Lateral(depths_mm=(0.2,), to_mm=((0.1, 0.0), (0.0, 0.1)), steps=2)
    plan = StepHold(depth_mm=0.2, cycles=1, frames=1, reference_frames=0, lateral=lateral)
    shifts = [
        (step.x_m * 1e3, step.y_m * 1e3)
        for step in plan.steps(next(plan.presses()), {})
        if isinstance(step, Aside)
    ]
    wanted = [(0.05, 0), (0.1, 0), (0, 0), (0, 0.05), (0, 0.1), (0, 0)]
    assert shifts == [pytest.approx(shift) for shift in wanted]


def test_a_dwell_spreads_its_frames_over_its_time() -> None:
    plan = StepHold(
        depth_mm=0.2,
        cycles=1,
        frames=1,
        reference_frames=0,
        dwell=Dwell(depths_mm=(0.2,), seconds=30, frames=10),
    )
    [held] = [
        step
        for step in plan.steps(next(plan.presses()), {})
        if isinstance(step, Burst) and step.shot.phase == "hold"
    ]
    assert held.every_s == 3.0
    assert len(held.missing) == 10


def test_scattered_places_repeat_with_their_seed_and_keep_apart() -> None:
    one, same, other = (
        Scattered(kind="scattered", count=20, apart_mm=3, seed=seed).places() for seed in (1, 1, 2)
    )
    assert one == same != other
    assert all(math.dist(a[1:], b[1:]) >= 3 for a in one for b in one if a is not b)


@pytest.mark.parametrize(
    ("fields", "code", "named"),
    [
        ({"cycles": 0}, "plan-field", "cycles"),
        ({"deph_mm": 3}, "plan-field", "deph_mm"),
        ({"threshold_N": -0.1}, "plan-field", "threshold_N"),
        ({"depth_mm": math.nan}, "plan-field", "depth_mm"),
        ({"places": {"kind": "grid", "probe_mm": 60}}, "probe-too-wide", ""),
        ({"places": {"kind": "grid", "per_side": 2, "pitch_mm": 50}}, "no-positions", ""),
        ({"places": {"kind": "listed", "at_mm": [[24, 0]]}}, "position-outside", ""),
        ({"places": {"kind": "listed", "at_mm": [[math.nan, 0]]}}, "position-outside", ""),
        ({"places": {"kind": "scattered", "count": 100, "apart_mm": 10}}, "too-many-positions", ""),
        ({"places": {"kind": "circle"}}, "plan-field", "places"),
    ],
)
def test_a_plan_that_cannot_be_is_refused_by_name(fields: dict[str, object], code: str, named: str) -> None:
    with refused(code, InputError, match=named or None):
        plan_from(fields)


def test_a_plan_is_read_from_toml_and_says_which_file_is_wrong(tmp_path: Path) -> None:
    good, bad, broken = (tmp_path / name for name in ("good.toml", "bad.toml", "broken.toml"))
    good.write_text('name = "mine"\ncycles = 2\n[places]\nkind = "grid"\npitch_mm = 6.5\n')
    bad.write_text("cycles = -1\n")
    broken.write_text("cycles = = 1\n")
    assert size_of(plan_of(good)).presses == 90
    with pytest.raises(InputError, match=r"bad\.toml"):
        plan_of(bad)
    with pytest.raises(InputError, match="not TOML"):
        plan_of(broken)
    with pytest.raises(InputError, match="palm-reduced"):
        plan_of("no-such-plan")


def test_a_plan_is_laid_on_the_outline_and_probe_of_its_sensor() -> None:
    bare = plan_from({"places": {"kind": "listed", "at_mm": [[0.0, 0.0]]}}, sensor("tactip"))
    assert bare.indenters == ("rigid",)
    assert bare.places.sizes_mm() == (pytest.approx(1.396, abs=1e-3), 0.0)
    assert plan_from({}).places.sizes_mm() == (57.0, 10.0)


def test_places_on_a_rectangle_keep_the_probe_inside_it() -> None:
    corners = ((-20.0, -10.0), (20.0, -10.0), (20.0, 10.0), (-20.0, 10.0))
    grid = Grid(per_side=9, pitch_mm=5.0, layer_mm=45.0, probe_mm=10.0, corners_mm=corners)
    found = {(p.x_mm, p.y_mm) for p in grid.places()}
    assert found == {(x, y) for x in (-15, -10, -5, 0, 5, 10, 15) for y in (-5, 0, 5)}
    scattered = Scattered(
        kind="scattered", count=40, layer_mm=45.0, probe_mm=10.0, corners_mm=corners
    ).places()
    assert all(abs(p.x_mm) <= 15 and abs(p.y_mm) <= 5 for p in scattered)


def test_a_rigs_own_plan_is_that_of_its_sensor() -> None:
    for name in ("palm", "palm-small"):
        assert plan_of_sensor(for_rig(sensor(name))) == plan_of("palm", for_rig(sensor(name)))
    assert plan_of_sensor().hash == PLANS["palm"].hash
    assert plan_of_sensor("tactip") == PLANS["tactip"]
    assert plan_of_sensor(sensor("tactip-331")).indenters[1] == "S1=7.6"


@pytest.mark.parametrize(
    ("name", "begins"),
    [("palm", "e542eaa5067f"), ("layer", "551bc56c3b4e"), ("tactip-press", "b2828c4cf9cf")],
)
def test_a_plan_has_the_hash_that_runs_of_before_hold(name: str, begins: str) -> None:
    assert PLANS[name].hash.startswith(begins)


@pytest.mark.parametrize("second", ["S1=5", "S1=5@20", "S1=inf?"])
def test_one_name_for_two_specimens_is_refused_when_the_plan_is_read(second: str) -> None:
    fields = PLANS["tactip"].model_dump() | {"indenters": ["rigid", "S1=7.6", second]}
    with pytest.raises(InputError, match="two stiffnesses"):
        plan_from(fields, sensor("tactip"))


def test_one_specimen_may_be_pressed_at_several_tilts() -> None:
    words = ["S1=7.6", "S1=7.6@20", "S1=7.60@30", "rigid", "rigid@20"]
    plan = plan_from(PLANS["tactip"].model_dump() | {"indenters": words}, sensor("tactip"))
    keys = [shot.key for press in plan.presses() for shot, _ in plan.shots(press)]
    assert len(keys) == len(set(keys))
