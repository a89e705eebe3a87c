"""The bench's physics against closed forms: flow, gas, contact, energy."""

import math
from dataclasses import astuple

import pytest
from tests.refusals import refused

from palpate.core import DeviceError, ManualClock
from palpate.softness.control.servos import FlowServo, SpeedTracker
from palpate.softness.display_parts import (
    ANR_DENSITY_KG_M3,
    ATMOSPHERE_PA,
    ArmMechanics,
    Chamber,
    FingerMechanics,
    FingerPresses,
    ProportionalValve,
)
from palpate.softness.virtual import bench_kernel as k
from palpate.softness.virtual.rendering_bench import STEP_S, BenchParts, RenderingBench

NOBODY = FingerPresses(0.0, gap_m=5e-3)


def bench_of(parts: BenchParts | None = None, presses: FingerPresses = NOBODY) -> RenderingBench:
    return RenderingBench(ManualClock(), presses, parts)


def run(bench: RenderingBench, seconds: float) -> None:
    bench.clock.sleep(seconds)
    bench.follow()


def test_choked_flow_is_c_times_density_times_upstream_pressure() -> None:
    assert k.mass_flow(4e-9, 1.185, 3e5, 1e5, 0.4) == pytest.approx(4e-9 * 1.185 * 3e5)


def test_flow_below_choking_falls_along_iso_6358_s_ellipse() -> None:
    b, r = 0.3, 0.8
    share = k.mass_flow(1.0, 1.0, 1.0, r, b)
    assert share**2 + ((r - b) / (1 - b)) ** 2 == pytest.approx(1.0)


def test_the_nominal_flow_of_the_cited_valve_is_a_hundred_litres_a_minute() -> None:
    """From 6 to 5 bar of gauge pressure, the maker's 100 l/min of air at its reference."""
    valve = ProportionalValve()
    flow = k.mass_flow(valve.conductance, ANR_DENSITY_KG_M3, 7e5, 6e5, valve.critical_ratio)
    assert flow / ANR_DENSITY_KG_M3 * 60e3 == pytest.approx(100.0, rel=0.01)


@pytest.mark.slow
def test_a_closed_chamber_keeps_p_v_to_the_n_while_it_is_pushed_in() -> None:
    parts = BenchParts(
        chamber=Chamber(leak=0.0, polytropic=1.3), valve=ProportionalValve(overlap=0.9),
        arm=ArmMechanics(reach_m=1e-9),
    )  # fmt: skip
    bench = bench_of(parts)
    bench.opening = 0.0
    bench.state[k.PRESSURE] = ATMOSPHERE_PA + 20e3
    volume = parts.chamber.dead_m3 + parts.shape.volume_m3(0.0)
    before = bench.state[k.PRESSURE] * float(volume) ** 1.3
    bench.state[k.FINGER], bench.state[k.FINGER_SPEED] = 0.0, 0.0
    bench.presses = FingerPresses(12e-3, frequency_hz=1.0, gap_m=0.0, starts_s=0.0)
    run(bench, 0.5)
    volume = parts.chamber.dead_m3 + parts.shape.volume_m3(bench.truth().pushed_m)
    assert bench.truth().pushed_m > 3e-3
    assert bench.state[k.PRESSURE] * float(volume) ** 1.3 == pytest.approx(before, rel=2e-3)


def test_a_finger_that_rests_feels_the_pressure_times_the_area() -> None:
    parts = BenchParts(
        chamber=Chamber(sleeve_n_m=0.0, friction_n=0.0, leak=0.0), finger=FingerMechanics(tremor_m=0.0),
        arm=ArmMechanics(reach_m=1e-9),
    )  # fmt: skip
    bench = bench_of(parts, FingerPresses(8e-3, frequency_hz=0.05, starts_s=0.0))
    bench.state[k.PRESSURE] = ATMOSPHERE_PA + 10e3
    bench.opening = 0.0
    run(bench, 10.0 - 5.0)
    run(bench, 4.9)
    truth = bench.truth()
    assert truth.area_m2 == pytest.approx(float(parts.shape.area_m2(truth.pushed_m)), rel=1e-3)
    assert truth.force_n == pytest.approx(truth.pressure_pa * truth.area_m2, rel=0.01)


def test_the_bench_does_not_depend_on_how_often_it_is_asked() -> None:
    one, often = (bench_of(presses=FingerPresses(6e-3, 2.0)) for _ in range(2))
    run(one, 0.4)
    for _ in range(400):
        run(often, 1e-3)
    assert astuple(one.truth()) == pytest.approx(astuple(often.truth()), rel=1e-9)


def test_a_display_that_nobody_tells_anything_vents_when_its_watchdog_is_due() -> None:
    bench = bench_of()
    for _ in range(300):
        bench.display.set_pressure(60e3)
        run(bench, 1e-3)
    assert bench.truth().pressure_pa == pytest.approx(60e3, rel=0.03)
    run(bench, 3.9e-3 - 1e-3)
    assert bench.opening != -1.0
    run(bench, 1.2e-3)
    assert bench.opening == -1.0
    with refused("display-vented", DeviceError):
        bench.display.set_pressure(60e3)
    run(bench, 0.1)
    assert bench.truth().pressure_pa < 500.0


def test_a_ramp_is_followed_without_error_of_speed() -> None:
    tracker = SpeedTracker()
    speeds = [tracker.speed(0.03 * i * 1e-3, 1e-3) for i in range(100)]
    assert speeds[-1] == pytest.approx(0.03, rel=1e-6)
    assert speeds[1] < 0.03


def test_the_flow_servo_finds_the_opening_that_lets_a_flow_through() -> None:
    servo, valve = FlowServo(), ProportionalValve()
    figures = bench_of()._figures
    for flow in (-2e-5, -1e-7, 1e-7, 5e-5):
        opening = servo.opening_for(flow, ATMOSPHERE_PA + 15e3)
        assert k.valve_flow(opening, ATMOSPHERE_PA + 15e3, figures) == pytest.approx(flow, rel=0.02)
    assert servo.opening_for(1.0, ATMOSPHERE_PA) == 1.0
    assert abs(servo.opening_for(1e-12, ATMOSPHERE_PA)) > valve.overlap


def coasting(friction_n: float, mass_kg: float, creep_m_s: float) -> float:
    """Speed of a body that friction alone slows, after 2 s of the bench's steps [m/s]."""
    speed = 0.01
    for _ in range(round(2.0 / STEP_S)):
        speed -= STEP_S * friction_n / mass_kg * math.tanh(speed / creep_m_s)
    return abs(speed)


@pytest.mark.parametrize("friction_n", [0.005, 0.02, 0.1, 0.5, 5.0])
def test_friction_brings_a_body_to_rest_however_light_it_is(friction_n: float) -> None:
    mass_kg = Chamber().tip_kg
    assert coasting(friction_n, mass_kg, k.creep(friction_n, mass_kg, STEP_S)) < 1e-9
    if friction_n > 0.05:  # one speed for all would leave it going to and fro
        assert coasting(friction_n, mass_kg, k.CREEP) > 1e-4
    assert k.creep(0.02, mass_kg, STEP_S) == k.CREEP
