"""What the pins' divergence tells of softness, what the frames' count does, and equation (3) itself."""

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.sensors.tactip import PINS_331, TacTipSpec, fitted_tactip
from palpate.sensors.tactip.tactip_press import modulus_pa
from palpate_reproductions.tactip.tactip_conditions import (
    AS_IS,
    CONDITIONS,
    FROM_N,
    KAPPA_N_M,
    TO_N,
    compared,
    concordance,
    conditions_of,
    cues,
    head_on,
    order,
    recorded,
    true_divergence,
)

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "reproductions" / "studies"))

from energy_contour import STEP_N, contour, contour_rad, contours
from tactip_model_errors import (
    areas_by_friction,
    divergence_shares,
    equation_12,
    linear_error,
    peak_motion,
    press_truth,
    sensitivity,
)

S1, S3 = KAPPA_N_M["S1"], KAPPA_N_M["S3"]


@pytest.fixture(scope="module")
def spec():
    return TacTipSpec()


@pytest.fixture(scope="module")
def fine(spec):
    """True divergence from 1 to 4 N in steps so many that their number does not matter, by specimen."""
    force = np.linspace(FROM_N, TO_N, 200)
    return [true_divergence(spec, head_on(spec, kappa).press, force) for kappa in KAPPA_N_M.values()]


def test_the_specimens_have_the_moduli_of_a_cylinder_under_its_own_stiffness(spec) -> None:
    moduli = [modulus_pa(spec.table, kappa) for kappa in KAPPA_N_M.values()]
    assert_allclose(moduli, [0.2419e6, 0.1687e6, 0.0987e6, 0.0350e6], rtol=2e-3)  # as printed, 3 to 4 digits


@pytest.mark.parametrize(
    ("values", "said"), [([1, 2, 3, 4], "right"), ([4, 3, 2, 1], "reversed"), ([1, 3, 2, 4], "mixed")]
)
def test_values_that_grow_with_softness_are_right(values, said) -> None:
    assert order(values) == said
    assert order([math.nan] * 4) == "mixed"


def test_concordance_is_1_for_values_apart_and_0_for_equal_ones() -> None:
    apart = [np.array([i + 0.1, i + 0.2]) for i in range(4)]
    assert concordance(apart) == 1
    assert concordance(apart[::-1]) == -1
    assert concordance([np.ones(2)] * 4) == 0


def test_true_contact_area_ranks_and_flattening_ranks_in_reverse(spec) -> None:
    found = [press_truth(spec, kappa) for kappa in KAPPA_N_M.values()]
    for i in range(5):
        assert order([t.area_m2[i] for t in found]) == "right"
        assert order([t.casr_m2_n[i] for t in found]) == "right"
        assert order([t.approach_m[i] for t in found]) == "right"
        assert order([t.flattening_m[i] for t in found]) == "reversed"


def test_the_middle_spreads_less_on_softer_specimens(fine) -> None:
    assert order([D["middle"].sum() for D in fine]) == "reversed"


def test_over_the_contact_the_softest_spreads_least_and_the_others_alike(fine) -> None:
    s1, new, s2, s3 = (float(D["contact"].sum()) for D in fine)
    assert s3 < 0.9 * min(s1, new, s2)
    assert max(s1, new, s2) < 1.02 * min(s1, new, s2)  # no order to be found


def test_with_a_real_tips_lever_contact_and_middle_are_reversed_and_the_disc_ranks() -> None:
    tip, force = fitted_tactip(), np.linspace(FROM_N, TO_N, 200)
    fine = [true_divergence(tip, head_on(tip, kappa).press, force) for kappa in KAPPA_N_M.values()]
    orders = {region: order([D[region].sum() for D in fine]) for region in ("contact", "middle", "disc")}
    assert orders == {"contact": "reversed", "middle": "reversed", "disc": "right"}
    assert_allclose(fine[-1]["contact"].sum() / fine[0]["contact"].sum(), 0.83, atol=0.01)


def test_the_ring_is_at_the_contacts_edge_unless_the_lever_is_short_and_the_specimen_soft(spec) -> None:
    long, short = (
        peak_motion(tip, kappa, (1.0, 2.0, 3.0)) for tip, kappa in ((spec, S3), (fitted_tactip(), S1))
    )
    assert (long.peak_rad < long.edge_rad).all()
    assert_allclose(short.peak_rad, short.edge_rad, atol=np.deg2rad(0.6))
    lost = peak_motion(fitted_tactip(), S3, (5.0,))
    assert lost.peak_rad[0] > lost.edge_rad[0] + np.deg2rad(8)


def test_conditions_change_the_sensor_that_they_are_given() -> None:
    tip = fitted_tactip()
    changed = conditions_of(tip)
    assert changed[AS_IS].spec == tip
    assert changed["half the speed"].spec == replace(tip, speed_m_s=tip.speed_m_s / 2)
    assert changed["tight crop"].spec.pins == tip.pins


def test_divergence_hardly_depends_on_how_many_steps_there_are(spec) -> None:
    press = head_on(spec, S1).press
    coarse, many = (
        true_divergence(spec, press, np.linspace(FROM_N, TO_N, n))["contact"].sum() for n in (20, 400)
    )
    assert_allclose(coarse, many, rtol=0.02)


@pytest.mark.parametrize(("kappa", "steps"), [(7600.0, 2), (3100.0, 6), (1100.0, 18)])
def test_equation_12_of_one_and_the_same_area_is_20_60_and_180(kappa, steps) -> None:
    assert_allclose(equation_12(kappa), 10 * steps)


def test_half_the_speed_doubles_equation_12_and_hardly_changes_the_secant(spec) -> None:
    way = ("flow", "disc")
    fast = cues(spec, S1, 0)
    slow = cues(CONDITIONS["half the speed"].spec, S1, 0)
    assert_allclose(slow.steps / fast.steps, 2, rtol=0.08)  # a frame more or less of 18
    assert 1.8 < slow.values[(*way, "paper")] / fast.values[(*way, "paper")] < 2.6
    assert_allclose(slow.values[(*way, "secant")], fast.values[(*way, "secant")], rtol=0.12)


def test_slowness_swaps_specimens_in_equation_12() -> None:
    """The stiffest, pressed at half the speed, comes out softer than the softest at twice the speed."""
    way = ("flow", "disc", "paper")
    stiff = cues(CONDITIONS["half the speed"].spec, S1, 0)
    soft = cues(CONDITIONS["twice the speed"].spec, S3, 0)
    assert stiff.values[way] > 1.5 * soft.values[way]


def test_equal_steps_are_as_many_as_asked_for_and_even(spec) -> None:
    made, force = recorded(spec, S1, 1, 20)
    assert len(force) == 21
    step = np.diff(made.true_approach_m[made.frame_sample])
    assert np.ptp(step) <= 2 * spec.speed_m_s / spec.force.rate_hz + 1e-9  # a sample
    assert force[0] >= 0.5
    assert force[-1] <= 5.0


@pytest.mark.parametrize("pins", [TacTipSpec().pins, PINS_331])
def test_horn_schunck_sees_a_part_of_the_motion_and_pins_nearly_all(spec, pins) -> None:
    found = divergence_shares(replace(spec, pins=pins), S1, (0,), ("horn-schunck", "tracked"))
    by = {(s.method, s.region): s.mean for s in found}
    assert 0.1 < by["horn-schunck", "disc"] < 0.6
    assert 0.3 < by["horn-schunck", "contact"] < 0.9
    # a line through pins a pitch apart rounds off the ring at the contact's edge
    assert_allclose([by["tracked", "disc"], by["tracked", "contact"]], 1, atol=0.15)


def test_an_inner_contour_at_half_the_wall_tracks_the_contact_but_does_not_go_with_the_skin(spec) -> None:
    half = [contour(spec, kappa, "half", "inner") for kappa in KAPPA_N_M.values()]
    for i in range(5):
        assert order([c.area_m2[i] for c in half]) == "right"
    for c in half:
        assert (np.abs(c.carried) < 0.1).all()


def test_the_contact_edge_rolls_over_the_skin(spec) -> None:
    skin, image = (contour(spec, S1, "contact", "inner", view) for view in ("skin", "image"))
    assert (skin.carried < 0.15).all()
    assert (image.carried < 0.6).all()
    # across the axis the circle of the skin's inside, within the outside's edge, grows nearly as the contact
    assert_allclose(skin.growth_m2_n, skin.casr_m2_n, rtol=0.1)


def test_outer_contours_know_the_force_and_not_the_specimen(spec) -> None:
    outer = [one for one in contours(spec, (2.0,), (300.0,)) if one.flank == "outer"]
    areas, contacts = (np.concatenate([getattr(c, of) for c in outer]) for of in ("area_m2", "contact_m2"))
    assert len(areas) == 4
    assert_allclose(areas, np.mean(areas), rtol=5e-3)
    assert np.ptp(contacts) > 0.2 * min(contacts)


def test_a_growing_contour_is_flux_and_its_own_going_over_the_skin(spec) -> None:
    """The kinematics of (3): with dphi_L/dF by differences, both parts add up to the growth."""
    press, at = head_on(spec, S3).press, np.array([3.0])
    c = contour(spec, S3, "half", "inner", "skin", (3.0,))
    later, before = (contour_rad(press, "half", "inner", at + step) for step in (STEP_N, -STEP_N))
    inside = press.at("inside_m", at)[0]
    here = contour_rad(press, "half", "inner", at)
    r, slope = np.interp(here, press.polar_rad, inside[:, 0]), np.gradient(inside[:, 0], press.polar_rad)
    over = 2 * np.pi * r * np.interp(here, press.polar_rad, slope) * (later - before) / (2 * STEP_N)
    assert_allclose(c.flux_m2_n + over, c.growth_m2_n, rtol=0.02)  # differences over half a newton


@pytest.mark.slow
def test_in_all_tips_the_middle_is_reversed() -> None:
    rows = [row for row in sensitivity() if row.region == "middle"]
    assert len(rows) == 24
    assert {row.order for row in rows} == {"reversed"}


@pytest.mark.slow
def test_equal_frames_leave_equation_12_without_its_order_in_the_contact() -> None:
    rows = {
        (r.condition, r.region): r
        for r in compared(("as assumed", "20 frames each"), range(3))
        if r.source == "flow" and r.way == "paper"
    }
    assert rows["as assumed", "contact"].concordance > 0.7
    assert rows["20 frames each", "contact"].concordance < 0


@pytest.mark.slow
def test_the_linear_model_is_wrong_by_what_the_decision_says() -> None:
    base = linear_error("base", math.inf)
    assert -0.3 < base.area[-1] < -0.2
    assert -0.1 < base.approach[-1] < 0.0


@pytest.mark.slow
def test_friction_changes_inclined_areas_but_not_their_order() -> None:
    found = areas_by_friction(np.deg2rad(30.0), (0.0, 1.0))
    assert {order(areas) for areas in found.values()} == {"right"}
