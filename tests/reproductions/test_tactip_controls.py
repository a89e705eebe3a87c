"""What the pins' divergence tells of softness, what the frames' count does, and equation (3) itself."""

import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from palpate.sensors.tactip import TacTipSpec, fitted_tactip
from palpate_reproductions.tactip.tactip_conditions import (
    FROM_N,
    KAPPA_N_M,
    TO_N,
    compared,
    head_on,
    order,
    true_divergence,
)

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "reproductions" / "studies"))

from tactip_model_errors import press_truth


@pytest.fixture(scope="module")
def spec():
    return TacTipSpec()


@pytest.fixture(scope="module")
def fine(spec):
    """True divergence from 1 to 4 N in steps so many that their number does not matter, by specimen."""
    force = np.linspace(FROM_N, TO_N, 200)
    return [true_divergence(spec, head_on(spec, kappa).press, force) for kappa in KAPPA_N_M.values()]


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


@pytest.mark.slow
def test_equal_frames_leave_equation_12_without_its_order_in_the_contact() -> None:
    rows = {
        (r.condition, r.region): r
        for r in compared(("as assumed", "20 frames each"), range(3))
        if r.source == "flow" and r.way == "paper"
    }
    assert rows["as assumed", "contact"].concordance > 0.7
    assert rows["20 frames each", "contact"].concordance < 0
