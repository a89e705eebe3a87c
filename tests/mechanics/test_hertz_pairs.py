"""Hertz pairs: the report's four objects, and what one cue cannot tell."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.testing import assert_allclose

from palpate.core.errors import RangeError
from palpate.mechanics.half_space.hertz import Body, alike_to_the_arm, alike_to_the_skin

FINGER = Body(1e5, 15e-3)
A, C = Body(1e6, 2.5e-3), Body(2e5, 30e-3)
FORCES = np.array([0.2, 1.0, 3.0])
MODULI = st.floats(1e4, 1e6)
RADII = st.floats(2e-3, 50e-3)


@pytest.mark.parametrize(
    ("finger_pa", "b_mm", "d_mm"),
    [(7e3, 2.74, 15.68), (20e3, 3.21, 8.68), (33e3, 3.73, 6.22), (1e5, 7.3199, 3.0)],
)
def test_the_reports_pairs_have_the_partners_that_their_finger_gives_them(finger_pa, b_mm, d_mm) -> None:
    finger = Body(finger_pa, 15e-3)
    assert_allclose(1e3 * alike_to_the_arm(A, finger, 1.5e5).radius_m, b_mm, atol=6e-3)
    assert_allclose(1e3 * alike_to_the_skin(C, finger, 2e4).radius_m, d_mm, atol=6e-3)


@given(MODULI, RADII, MODULI)
def test_what_is_alike_to_one_cue_is_alike_to_that_cue(E1, R1, E2) -> None:
    one = Body(E1, R1)
    for alike, cue in ((alike_to_the_arm, "approach_m"), (alike_to_the_skin, "area_m2")):
        try:
            other = alike(one, FINGER, E2)
        except RangeError:
            continue
        told = [getattr(body.against(FINGER), cue)(FORCES) for body in (one, other)]
        assert_allclose(*told, rtol=1e-9)


def test_a_partner_that_would_be_hollow_is_refused() -> None:
    with pytest.raises(RangeError, match="hollow"):
        alike_to_the_arm(Body(1e5, math.inf), FINGER, 1e4)
    with pytest.raises(RangeError, match="above 0"):
        Body(-1.0, 1.0)
