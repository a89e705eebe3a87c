import math

import numpy as np
import pytest
from tests.oracles import twisted_sphere
from tests.refusals import refused

from palpate.core import InputError, RangeError
from palpate.mechanics.layers import contact_solver
from palpate.mechanics.layers.contact_solver import press_stack
from palpate.mechanics.layers.stack import ElasticLayer, Stack
from palpate.mechanics.layers.stack_friction import shear_stack

R, E, DEPTH, MU = 5e-3, 0.3e6, 5e-4, 0.6
A = math.sqrt(R * DEPTH)
X = np.linspace(-1.2 * A, 1.2 * A, 64)


def pressed(stack):
    return press_stack(stack, contact_solver.paraboloid(X, X, R), X, X, depth_m=DEPTH)


def on_half_space(nu):
    return pressed(Stack((ElasticLayer(math.inf, E, nu),), "half-space"))


@pytest.mark.parametrize(("nu", "tolerance"), [(0.0, 1e-3), (0.49, 4e-3)])
@pytest.mark.parametrize("part", [0.2, 0.9])
def test_a_sphere_sheared_on_a_half_space_slips_as_cattaneo_and_mindlin_say(nu, tolerance, part):
    # at nu = 0 theirs is exact; else they neglect traction across the shift, which costs up to 0.3 %
    contact = on_half_space(nu)
    greatest = MU * contact.force_n
    found = shear_stack(contact, MU, force_n=(part * greatest, 0.0))
    G = E / (2 * (1 + nu))
    shift = 3 * greatest * (2 - nu) / (16 * A * G) * (1 - (1 - part) ** (2 / 3))
    assert found.shift_m[0] == pytest.approx(shift, rel=tolerance)
    sticking = math.sqrt(found.sticking.sum() / contact.touching.sum())
    assert sticking == pytest.approx((1 - part) ** (1 / 3), abs=0.01)  # counted in cells of A/27


def test_no_traction_exceeds_friction_and_sticking_skin_goes_with_the_probe():
    contact = pressed(Stack((ElasticLayer(0.5e-3, 2 * E, 0.49), ElasticLayer(3e-3, E, 0.3))))
    found = shear_stack(contact, MU, shift_m=(4e-5, -2e-5))
    limit = MU * contact.pressure_pa
    assert np.all(np.hypot(*found.shear_pa) <= limit * (1 + 1e-12))
    lag = np.array([4e-5, -2e-5])[:, None, None] - found.displacement_m
    assert found.sticking.any()
    assert np.hypot(*lag)[found.sticking].max() < 2e-4 * np.hypot(4e-5, 2e-5)
    slipping = contact.touching & ~found.sticking
    pulling = (lag * found.shear_pa).sum(axis=0)[slipping]
    assert np.all(pulling >= 0.0)  # friction drags the skin after the probe


@pytest.mark.parametrize("nu", [0.0, 0.49])
def test_a_contact_that_sticks_twists_as_reissner_and_sagoci_say(nu):
    contact = on_half_space(nu)
    found = shear_stack(contact, 1e4, turn_rad=1e-6)
    # the traction rises without end to the rim, which lies in cells of A/27: 0.6 % is measured at nu = 0.49
    assert found.moment_nm == pytest.approx(1e-6 * twisted_sphere.twisting_stiffness(A, E, nu), rel=0.01)
    assert np.abs(found.force_n).max() < 1e-6 * found.moment_nm / A


@pytest.mark.parametrize(("nu", "turn"), [(0.0, 0.3), (0.49, 0.1)])
def test_a_twisted_sphere_slips_as_lubkin_says(nu, turn):
    contact = on_half_space(nu)
    found = shear_stack(contact, MU, turn_rad=turn)
    moment, stick = twisted_sphere.twisting_moment(turn, contact.force_n, MU, A, E, nu)
    assert found.moment_nm == pytest.approx(moment, rel=1e-3)  # 4e-4 is measured
    sticking = math.sqrt(found.sticking.sum() / contact.touching.sum())
    assert sticking == pytest.approx(stick / A, abs=0.01)  # counted in cells of A/27


def test_force_and_moment_together_convert_back_to_shift_and_turn():
    contact = on_half_space(0.49)
    by_motion = shear_stack(contact, MU, shift_m=(6e-5, -4e-5), turn_rad=0.04)
    by_load = shear_stack(
        contact, MU, force_n=tuple(map(float, by_motion.force_n)), moment_nm=by_motion.moment_nm
    )
    np.testing.assert_allclose(by_load.shift_m, by_motion.shift_m, rtol=5e-3)
    assert by_load.turn_rad == pytest.approx(by_motion.turn_rad, rel=5e-3)
    assert np.all(np.hypot(*by_load.shear_pa) <= MU * contact.pressure_pa * (1 + 1e-12))


def test_what_cannot_be_sheared_is_refused():
    contact = on_half_space(0.3)
    greatest = MU * contact.force_n
    with refused("sliding", RangeError):
        shear_stack(contact, MU, force_n=(greatest, 0.1 * greatest))
    for friction in (0.0, -0.1, math.nan, math.inf):
        with refused("not-positive", RangeError):
            shear_stack(contact, friction, shift_m=(1e-5, 0.0))
    with pytest.raises(InputError, match="exactly one"):
        shear_stack(contact, MU)
    with pytest.raises(InputError, match="finite"):
        shear_stack(contact, MU, shift_m=(math.nan, 0.0))
    with pytest.raises(InputError, match="exactly one"):
        shear_stack(contact, MU, turn_rad=0.1, moment_nm=1e-4)
    with pytest.raises(InputError, match="finite"):
        shear_stack(contact, MU, moment_nm=math.inf)
    with refused("twisting-slip", RangeError):
        shear_stack(contact, MU, moment_nm=1.0)
    nothing = press_stack(contact.stack, contact_solver.paraboloid(X, X, R), X, X, depth_m=0.0)
    with refused("no-normal-force", RangeError):
        shear_stack(nothing, MU, shift_m=(1e-5, 0.0))


@pytest.mark.parametrize("part", [0.02, 0.95])
@pytest.mark.parametrize("way", [0.0, 0.7])
def test_every_pull_below_friction_is_found_under_a_punch_and_under_a_blunt_edge(part, way):
    """Secants through motions that the tolerance does not tell apart lead away; then 0.95 is refused."""
    layer, x = Stack((ElasticLayer(10e-3, E, 0.49),)), np.linspace(-7e-3, 7e-3, 80)
    punch = contact_solver.flat_punch(x, x, 4e-3, 0.4e-3)
    edge = np.where(np.abs(x[None, :]) < 6e-3, np.tan(math.radians(30)) * np.abs(x[:, None]), np.inf)
    for gap, depth in ((punch, 0.5e-3), (edge, 0.8e-3)):
        contact = press_stack(layer, gap, x, x, depth_m=depth)
        pull = part * MU * contact.force_n
        asked = pull * math.cos(way), pull * math.sin(way)
        found = shear_stack(contact, MU, force_n=asked)
        np.testing.assert_allclose(found.force_n, asked, atol=2e-4 * pull)
        assert found.force_n @ found.shift_m > 0.0
