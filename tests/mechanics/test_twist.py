import math

import pytest
from scipy.integrate import quad
from tests.oracles import twisted_sphere

from palpate.core import RangeError

P, MU, A, E, NU = 0.8, 0.6, 1.5e-3, 0.3e6, 0.49
G = E / (2 * (1 + NU))


def moment(turn_rad):
    return twisted_sphere.twisting_moment(turn_rad, P, MU, A, E, NU)[0]


def test_a_great_turn_meets_friction_everywhere():
    p0 = 1.5 * P / (math.pi * A**2)
    pressed = quad(lambda r: MU * p0 * math.sqrt(1 - (r / A) ** 2) * r * 2 * math.pi * r, 0, A)[0]
    assert twisted_sphere.greatest_moment(P, MU, A) == pytest.approx(pressed, rel=1e-9)
    assert moment(50.0) == pytest.approx(pressed, rel=1e-9)
    assert twisted_sphere.twisting_moment(50.0, P, MU, A, E, NU)[1] == 0.0


def test_the_traction_of_turned_discs_adds_up_to_friction_where_it_slips():
    # each disc of radius s gives 4 G B r / (pi sqrt(s^2 - r^2)) inside itself, by Reissner and Sagoci
    p0, r = 1.5 * P / (math.pi * A**2), 0.7 * A

    def turned(s):
        return MU * p0 / (2 * G) * twisted_sphere._difference(s / A)

    def rate(s):
        return (turned(s - 1e-9) - turned(s + 1e-9)) / 2e-9

    def share(t):  # s = r cosh t takes the root out
        return rate(r * math.cosh(t))

    found = 4 * G * r / math.pi * quad(share, 1e-4, math.acosh(A / r) - 1e-6, limit=200)[0]
    assert found == pytest.approx(MU * p0 * math.sqrt(1 - 0.49), rel=1e-3)


def test_the_work_of_a_turn_is_the_area_under_its_curve_of_moments():
    # dM/dturn = 16/3 G c^3: what is added turns the stick circle as a bonded disc
    turn = 0.05
    slope = (moment(turn * 1.0005) - moment(turn * 0.9995)) / (turn * 1e-3)
    stick = twisted_sphere.twisting_moment(turn, P, MU, A, E, NU)[1]
    assert slope == pytest.approx(16 / 3 * G * stick**3, rel=1e-5)


@pytest.mark.parametrize(
    "given", [{"turn_rad": -0.1}, {"turn_rad": math.nan}, {"force_n": 0.0}, {"friction": -1.0}]
)
def test_a_twist_that_cannot_be_is_refused(given):
    asked = {"turn_rad": 0.1, "force_n": P, "friction": MU} | given
    with pytest.raises(RangeError):
        twisted_sphere.twisting_moment(**asked, contact_radius_m=A, youngs_modulus_pa=E, poisson_ratio=NU)
