"""Both cues together: objects that one cue confuses are told apart, with intervals that hold."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core.errors import InputError
from palpate.estimators.compliance.hertz_inversion import (
    OF_MODULUS,
    OF_RADIUS,
    Finger,
    PressCurves,
    fit_finger,
    invert_hertz,
)
from palpate.mechanics.axisymmetric.tip_table import HeadOnPress, shipped_tips, tip_table
from palpate.mechanics.half_space.hertz import Body, alike_to_the_arm, alike_to_the_skin

FINGER = Body(1e5, 15e-3)
A = Body(1e6, 2.5e-3)
B = alike_to_the_arm(A, FINGER, 1.5e5)
C = Body(2e5, 30e-3)
D = alike_to_the_skin(C, FINGER, 2e4)
FORCE = np.linspace(0.5, 5, 60)


def press(thing: Body, rng=None, area=0.01, place_m=20e-6, offset_m=1e-3) -> PressCurves:
    """As a sensor would have it: noise of a sixteenth of a newton's step, of area, and of place."""
    both = thing.against(FINGER)
    d, a = both.approach_m(FORCE), both.area_m2(FORCE)
    if rng is None:
        return PressCurves(FORCE, d + offset_m, a)
    n = len(FORCE)
    return PressCurves(
        FORCE + 0.018 * rng.standard_normal(n),
        d + offset_m + place_m * rng.standard_normal(n),
        a * (1 + area * rng.standard_normal(n)),
    )


@pytest.mark.parametrize("thing", [B, C, D])
def test_without_noise_modulus_and_radius_come_back(rng, thing) -> None:
    found = invert_hertz([press(thing)], Finger(FINGER), rng)
    assert_allclose(found.modulus_pa[0], thing.modulus_pa, rtol=1e-6)
    assert_allclose(found.radius_m[0], thing.radius_m, rtol=1e-6)
    assert found.valid


def test_pairs_that_one_cue_confuses_are_told_apart(rng) -> None:
    for one, other in ((A, B), (C, D)):
        told = [invert_hertz([press(x, rng) for _ in range(5)], Finger(FINGER), rng) for x in (one, other)]
        soft, hard = sorted(told, key=lambda t: t.modulus_pa[0])
        assert soft.modulus_pa[2] < hard.modulus_pa[1]


def test_an_object_that_hardly_yields_is_marked(rng) -> None:
    found = invert_hertz([press(A, rng)], Finger(FINGER), rng)
    assert not found.valid
    assert "9%" in found.why


@pytest.mark.parametrize("presses", [1, 2])
def test_intervals_hold_as_often_as_they_say(rng, presses: int) -> None:
    """The scatter of two tells the spread badly: by normal draws their intervals would hold 75 %."""
    held = np.zeros(2)
    for _ in range(150):
        found = invert_hertz([press(D, rng) for _ in range(presses)], Finger(FINGER), rng)
        held += [
            found.modulus_pa[1] <= D.modulus_pa <= found.modulus_pa[2],
            found.radius_m[1] <= D.radius_m <= found.radius_m[2],
        ]
    if presses == 1:
        assert_allclose(held / 150, 0.9, atol=0.07)
    assert held.min() / 150 > 0.83


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda f, d, a: (f[:3], d[:3], a[:3]), "too-few-values"),
        (lambda f, d, a: (f, -d, a), "force-sign"),
        (lambda f, d, a: (f - 1, d, a), "not-positive"),
        (lambda f, d, a: (np.ones(9), np.ones(9), np.ones(9)), "not-loading"),
    ],
)
def test_what_is_no_press_is_refused(rng, change, code) -> None:
    good = press(C)
    with refused(code, InputError):
        bad = PressCurves(*change(good.force_n, good.approach_m, good.area_m2))
        invert_hertz([bad], Finger(FINGER), rng)
    with refused("no-presses", InputError):
        invert_hertz([], Finger(FINGER), rng)
    with pytest.raises(InputError, match="rigid plate"):
        fit_finger([])


def rigid(finger: Body, rng=None) -> PressCurves:
    """The finger alone: on a rigid plate the pair is the finger."""
    d, a = finger.approach_m(FORCE), finger.area_m2(FORCE)
    noise = np.zeros(len(FORCE)) if rng is None else rng.standard_normal(len(FORCE))
    return PressCurves(FORCE, d + 5e-6 * noise, a)


def test_a_hertz_finger_is_found_from_its_presses_on_a_rigid_plate(rng) -> None:
    found = fit_finger([rigid(FINGER), rigid(FINGER)])
    assert_allclose(found.body.modulus_pa, FINGER.modulus_pa, rtol=1e-6)
    assert_allclose(found.body.radius_m, FINGER.radius_m, rtol=1e-6)
    assert found.misfit < 1e-6
    assert found.modulus_spread < 1e-6
    noisy = fit_finger([rigid(FINGER, rng) for _ in range(5)])
    assert_allclose(noisy.body.modulus_pa, FINGER.modulus_pa, rtol=0.01)
    assert noisy.modulus_spread > 0


def test_a_finger_that_stiffens_says_by_how_much(rng) -> None:
    """P^(2/3) over approach bends: the upper half of the forces has the stiffer line."""
    alone = rigid(FINGER)
    bent = PressCurves(alone.force_n, 6e-3 * (1 - np.exp(-alone.approach_m / 6e-3)), alone.area_m2)
    found = fit_finger([bent])
    assert 0.1 < found.misfit < 1
    assert_allclose(found.modulus_spread, OF_MODULUS * found.misfit, rtol=0.3)
    assert_allclose(found.radius_spread, OF_RADIUS * found.misfit, rtol=0.3)
    wide, tight = (
        invert_hertz([press(D)], Finger(FINGER, spread, spread), rng)
        for spread in (found.modulus_spread, 0.0)
    )
    assert np.diff(wide.modulus_pa[1:]) > np.diff(tight.modulus_pa[1:])


def on_a_cylinder(table_press: HeadOnPress) -> PressCurves:
    """The truth of a tip's table from 1 to 5.2 N, by even steps of approach and without noise."""
    force = table_press.force_at(np.linspace(*table_press.at("approach_m", np.array([1.0, 5.2])), 20))
    return PressCurves(force, table_press.at("approach_m", force), table_press.at("area_m2", force))


def test_the_misfit_counts_as_much_as_tips_that_are_no_hertz_bodies_err(rng) -> None:
    """The error of the object's 1 / E over the finger's, root mean square over tips and specimens."""
    errors, misfits = [], []
    for tip in map(tip_table, shipped_tips()):
        finger = fit_finger([on_a_cylinder(tip.press(np.inf))])
        for kappa in (7600, 6500, 5300, 4000, 3100, 2000, 1500, 1100):
            modulus = kappa * tip.specimen_height_m / (np.pi * tip.specimen_radius_m**2)
            true = modulus / (1 - tip.poisson_ratio**2)
            found = invert_hertz([on_a_cylinder(tip.press(modulus))], finger, rng).modulus_pa[0]
            errors.append((1 / found - 1 / true) * finger.body.modulus_pa)
            misfits.append(finger.misfit)
    assert_allclose(np.sqrt(np.mean(np.square(errors)) / np.mean(np.square(misfits))), OF_MODULUS, atol=0.02)
