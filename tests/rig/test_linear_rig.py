"""Laws of a support that a motor drives under proportional and derivative control, against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp

from palpate.core.errors import InputError
from palpate.rig.virtual.linear_rig import LINEAR_RIG, RIGS, LinearDrive, LinearRig, rig_named, rig_record

SMOOTH = replace(LINEAR_RIG, encoder_bits=None)  # an encoder without steps
BARE = replace(SMOOTH, coulomb_n=0.0, breakaway_n=0.0)  # and no friction but damping
TICK_S = 1e-3
DEPTH = np.linspace(0.0, 12e-3, 121)
FORCE = 3e3 * DEPTH * np.sqrt(DEPTH / 6e-3)
"""A load that stiffens, as a tip does: 5 N at 4.6 mm."""


def ramp(speed_m_s: float, ticks: int = 2000, start_m: float = 0.0) -> np.ndarray:
    return start_m + speed_m_s * TICK_S * np.arange(ticks)


def spring(stiffness_n_m: float) -> tuple[np.ndarray, np.ndarray]:
    return np.array([0.0, 1.0]), np.array([0.0, stiffness_n_m])


def test_gains_friction_and_inertia_are_those_of_the_parts_through_the_gears() -> None:
    rig = LinearRig(encoder_bits=12, gain_p=0.04, stall_n_m=1e-3, gear=35.0, efficiency=0.5, lead_m=0.02)
    # 1 mN m of 35 gears at half is 17.5 mN m over 20 mm a revolution
    assert_allclose(rig.greatest_n, 17.5e-3 * 2 * math.pi / 0.02)
    # 0.04 % a tick are 2621.44 % a revolution
    assert_allclose(rig.stiffness_n_m * 0.02, 26.2144 * rig.greatest_n)
    assert_allclose(rig.derivative_n_m / rig.stiffness_n_m, 0.002 / 0.04)
    # at its no-load speed the motor's whole push is eaten by its back-EMF
    free_m_s = rig.no_load_rad_s / 35.0 * rig.radius_m
    assert_allclose((rig.damping_n_s_m - rig.viscous_n_s_m) * free_m_s, rig.greatest_n)
    # the rotor's energy at 1 m/s
    spin = 35.0 / rig.radius_m
    assert_allclose((rig.mass_kg - rig.moving_kg) / 2, rig.rotor_kg_m2 * spin**2 / 2)


def test_without_load_and_friction_it_comes_to_the_command() -> None:
    drive = LinearDrive(BARE, 0.0)
    assert abs(drive.follow(np.full(1000, 0.3e-3))[-1] - 0.3e-3) < 1e-12
    # with friction at rest it may stand anywhere within breakaway / Kp of it
    stuck = LinearDrive(SMOOTH, 0.0)
    within_m = SMOOTH.breakaway_n / SMOOTH.stiffness_n_m
    assert_array_equal(stuck.follow(np.full(100, 0.99 * within_m)), 0.0)
    assert stuck.follow(np.full(100, 1.01 * within_m))[-1] > 0


@pytest.mark.parametrize("load_n_m", [1.1e3, 7.6e3])
def test_under_a_load_it_droops_by_the_force_over_the_gain(load_n_m) -> None:
    asked, Kp = 0.6e-3, BARE.stiffness_n_m
    place = LinearDrive(BARE, 0.0).follow(np.full(2000, asked), *spring(load_n_m))[-1]
    force = load_n_m * place
    assert_allclose(asked - place, BARE.droop_m(force), rtol=1e-9)
    assert_allclose(force, asked / (1 / load_n_m + 1 / Kp), rtol=1e-9)  # two springs in series


@pytest.mark.parametrize("gain_d", [0.002, 2.0])
@pytest.mark.parametrize("speed_m_s", [5e-3, -5e-3, 20e-3])
def test_along_a_ramp_it_lags_by_friction_damping_and_derivative_over_the_gain(speed_m_s, gain_d) -> None:
    rig = replace(SMOOTH, gain_d=gain_d)
    asked = ramp(speed_m_s)
    behind = asked[1:] - LinearDrive(rig, 0.0).follow(asked)[:-1]  # as the control sees it, at a tick
    drag = rig.damping_n_s_m + rig.derivative_n_m * TICK_S
    friction = math.copysign(rig.coulomb_n, speed_m_s)
    assert_allclose(behind[-1], (drag * speed_m_s + friction) / rig.stiffness_n_m, rtol=1e-8)
    assert_allclose(behind[-1], rig.lag_m(speed_m_s), rtol=1e-8)


def test_the_motor_pushes_no_harder_than_it_can() -> None:
    wall = spring(1e6)
    place = LinearDrive(BARE, 0.0).follow(np.full(2000, 5e-3), *wall)[-1]
    assert_allclose(1e6 * place, BARE.greatest_n, rtol=1e-9)
    # what is asked for would take five times as much
    assert BARE.stiffness_n_m * 5e-3 > 5 * BARE.greatest_n


def energies(rig: LinearRig, place_m: float, ticks: int, load_n_m: float = 0.0) -> np.ndarray:
    """Of motion, load and the control's spring while 0 is asked for [J]."""
    drive, energy = LinearDrive(rig, place_m), []
    for _ in range(ticks):
        z, v = drive.place_m, drive.speed_m_s
        energy.append((rig.mass_kg * v**2 + rig.stiffness_n_m * z**2 + load_n_m * max(z, 0.0) ** 2) / 2)
        drive.follow(np.zeros(1), *spring(load_n_m))
    return np.array(energy)


@pytest.mark.parametrize("load_n_m", [0.0, 3e3])
def test_energy_never_grows_at_a_command_of_zero(load_n_m) -> None:
    energy = energies(BARE, 0.5e-3, 400, load_n_m)
    assert np.diff(energy).max() <= 1e-12 * energy[0]
    assert energy[-1] < 1e-9 * energy[0]
    # a control too slow for its gain, Kp T / 2 > b, does make energy
    slow = energies(replace(BARE, control_hz=20.0, steps=1000), 0.5e-3, 20, load_n_m)
    assert slow.max() > 2 * slow[0]


def test_slow_ramps_stick_and_slip_and_the_reports_speed_does_not() -> None:
    def stuck(rig: LinearRig, speed_m_s: float) -> float:
        places = LinearDrive(rig, 0.0).follow(ramp(speed_m_s, 3000))
        return float(np.mean(np.diff(places)[500:] == 0))

    assert stuck(SMOOTH, 0.5e-3) > 0.1
    assert stuck(SMOOTH, 5e-3) == 0
    assert stuck(replace(SMOOTH, breakaway_n=SMOOTH.coulomb_n), 0.5e-3) == 0  # friction does not fall
    assert stuck(LINEAR_RIG, 0.2e-3) > 0.2


def integrated(rig: LinearRig, asked: np.ndarray, start: tuple[float, float]) -> np.ndarray:
    """Places after every tick by an adaptive method of eighth order; the support never turns round."""
    state, before, places = np.array(start), start[0] - start[1] * TICK_S, []
    for c in asked:
        u = rig.stiffness_n_m * (c - state[0]) + rig.derivative_n_m * (before - state[0])
        before = state[0]

        def slope(_t, y, u=u):
            f = rig.coulomb_n + (rig.breakaway_n - rig.coulomb_n) * math.exp(-((y[1] / rig.creep_m_s) ** 2))
            load = np.interp(y[0], DEPTH, FORCE, left=0.0)
            return y[1], (u - rig.damping_n_s_m * y[1] - f - load) / rig.mass_kg

        state = solve_ivp(slope, (0, TICK_S), state, "DOP853", rtol=1e-9, atol=1e-14).y[:, -1]
        places.append(state[0])
    return np.array(places)


def test_an_independent_integration_of_the_same_equations_agrees() -> None:
    start, asked = (-0.2e-3, 5e-3), ramp(5e-3, 400, -0.2e-3 + SMOOTH.lag_m(5e-3))
    ours = LinearDrive(SMOOTH, *start).follow(asked, DEPTH, FORCE)
    theirs = integrated(SMOOTH, asked, start)
    assert np.diff(theirs).min() > 0
    assert np.abs(ours - theirs).max() < 0.05e-6
    finer = LinearDrive(replace(SMOOTH, steps=400), *start).follow(asked, DEPTH, FORCE)
    assert np.abs(finer - theirs).max() < 0.0025e-6  # a twentieth of the step


def test_a_course_goes_on_where_it_was() -> None:
    asked = ramp(5e-3, 600, -1e-3)
    whole = LinearDrive(LINEAR_RIG, -1e-3).follow(asked, DEPTH, FORCE)
    drive = LinearDrive(LINEAR_RIG, -1e-3)
    parts = [drive.follow(part, DEPTH, FORCE) for part in np.split(asked, [7, 350])]
    assert_array_equal(np.concatenate(parts), whole)
    # a surface elsewhere is the same course elsewhere, by whole steps of the encoder
    by = 100 * LINEAR_RIG.quantum_m
    moved = LinearDrive(LINEAR_RIG, -1e-3 + by).follow(asked + by, DEPTH, FORCE, by)
    assert_allclose(moved - by, whole, atol=1e-9)


def test_the_compiled_steps_are_those_of_plain_python(monkeypatch) -> None:
    from palpate.rig.virtual import linear_rig

    compiled = LinearDrive(LINEAR_RIG, 0.0).follow(ramp(5e-3, 100), DEPTH, FORCE)
    monkeypatch.setattr(linear_rig, "advanced", linear_rig.advanced.py_func)
    plain = LinearDrive(LINEAR_RIG, 0.0).follow(ramp(5e-3, 100), DEPTH, FORCE)
    assert_allclose(plain, compiled, atol=1e-12)


def test_a_rig_says_what_it_cannot_be() -> None:
    for wrong in ({"lead_m": 0.0}, {"viscous_n_s_m": -1.0}, {"breakaway_n": 0.1}, {"gain_p": math.nan}):
        with pytest.raises(InputError, match="rig 'linear'"):
            replace(LINEAR_RIG, **wrong)
    assert LINEAR_RIG.ticks_in(200.0) == 5
    for rate_hz in (300.0, 2000.0):
        with pytest.raises(InputError, match="whole number"):
            LINEAR_RIG.ticks_in(rate_hz)
    assert rig_named("linear") is LINEAR_RIG
    assert rig_named("ideal") is None
    with pytest.raises(InputError, match="ideal, linear"):
        rig_named("belt")
    assert rig_record(RIGS["ideal"]) == {"name": "ideal"}
    assert rig_record(LINEAR_RIG)["stiffness_n_m"] == LINEAR_RIG.stiffness_n_m
