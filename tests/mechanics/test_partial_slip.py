import math

import pytest

from palpate.core import RangeError
from palpate.mechanics.half_space.hertz import tangential_stiffness

A, E = 2e-3, 0.3e6


def test_a_stuck_contact_has_mindlins_stiffness():
    G = E / (2 * 1.49)
    assert tangential_stiffness(A, E, 0.49) == pytest.approx(8 * A * G / (2 - 0.49), rel=1e-12)


@pytest.mark.parametrize(
    "bad", [(A, 0.0, 0.3), (A, math.nan, 0.3), (0.0, E, 0.3), (math.nan, E, 0.3), (A, E, 0.6)]
)
def test_what_lies_outside_is_refused(bad):
    with pytest.raises(RangeError):
        tangential_stiffness(*bad)
