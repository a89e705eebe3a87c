import math

import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError, RangeError
from palpate.mechanics.layers.stack import ElasticLayer, Stack, climb, surface_compliance

E, H = 0.3e6, 10e-3
ENDLESS = math.inf
RATIOS = [0.3, 0.499]
TWO = Stack((ElasticLayer(2e-3, 3 * E, 0.3), ElasticLayer(5e-3, E, 0.49)))


def waves(least=1e-2, most=1e2):
    """k h from least to most."""
    return np.logspace(np.log10(least), np.log10(most), 201) / H


def burmister(s, nu):
    upper = (3 - 4 * nu) * np.sinh(2 * s) - 2 * s
    return upper / ((3 - 4 * nu) * np.cosh(2 * s) + 2 * s**2 + 5 - 12 * nu + 8 * nu**2)


def boussinesq_and_cerruti(k, nu):
    """Along, coupled, across and normal of a half-space."""
    mu = E / (2 * (1 + nu))
    return (1 - nu) / (mu * k), (1 - 2 * nu) / (2 * mu * k), 1 / (mu * k), (1 - nu) / (mu * k)


@pytest.mark.parametrize("nu", RATIOS)
def test_one_bonded_layer_is_burmisters_closed_form(nu):
    k = waves()
    closed = 2 * (1 - nu**2) / (E * k) * burmister(k * H, nu)
    found = surface_compliance(Stack((ElasticLayer(H, E, nu),)), k).normal
    np.testing.assert_allclose(found, closed, rtol=1e-10)  # the closed form itself rounds to about 1e-12


@pytest.mark.parametrize("nu", RATIOS)
def test_a_uniform_load_squeezes_and_shears_the_layers_in_series(nu):
    layers = (ElasticLayer(1e-3, E, nu), ElasticLayer(4e-3, 5 * E, 0.2))
    moduli = [layer.material for layer in layers]
    squeezed = sum(
        m.thickness_m * (1 - 2 * nu) / (2 * mu * (1 - nu)) for m, (mu, nu) in zip(layers, moduli, strict=True)
    )
    sheared = sum(m.thickness_m / mu for m, (mu, _) in zip(layers, moduli, strict=True))
    for order in (layers, layers[::-1]):
        found = surface_compliance(Stack(order), np.array([0.0]))
        assert found.normal[0] == pytest.approx(squeezed, rel=1e-10)
        assert found.along[0] == pytest.approx(sheared, rel=1e-10)
        assert found.across[0] == pytest.approx(sheared, rel=1e-10)
        assert abs(found.coupled[0]) < 1e-5 * sheared  # odd in k: first order in the k that stands for 0


@pytest.mark.parametrize("nu", RATIOS)
def test_a_layer_cut_into_identical_ones_is_the_same_layer(nu):
    whole = surface_compliance(Stack((ElasticLayer(H, E, nu),)), waves())
    for n in (2, 5):
        cut = surface_compliance(Stack((ElasticLayer(H / n, E, nu),) * n), waves())
        for part, same in zip(cut, whole, strict=True):
            # the 1-D compliance is a difference that nearly cancels as nu nears 1/2
            np.testing.assert_allclose(part, same, rtol=1e-9, atol=1e-13 * whole.along.max())


@pytest.mark.parametrize("nu", RATIOS)
def test_layers_on_a_half_space_of_their_material_are_the_half_space(nu):
    k = waves()
    found = surface_compliance(
        Stack((ElasticLayer(H / 3, E, nu),) * 3 + (ElasticLayer(ENDLESS, E, nu),), "half-space"), k
    )
    for part, closed in zip(found, boussinesq_and_cerruti(k, nu), strict=True):
        # the coupled part is a small difference as nu nears 1/2
        np.testing.assert_allclose(part, closed, rtol=1e-12, atol=1e-15 * found.along.max())


@pytest.mark.parametrize("kh", [0.05, 3.0])
def test_unlike_layers_agree_with_all_of_them_solved_at_once(kh, solved_at_once):
    k = kh / 7e-3
    U, W, T, S = solved_at_once(TWO.layers, k, 0.0)
    np.testing.assert_allclose((T, S), (0.0, -1.0), atol=1e-9)
    found = surface_compliance(TWO, np.array([k]))
    assert found.normal[0] == pytest.approx(W, rel=1e-9)
    assert found.coupled[0] == pytest.approx(U, rel=1e-8)


@pytest.mark.parametrize("base", ["bonded", "half-space"])
def test_the_compliance_is_positive_definite_and_its_halves_are_reciprocal(base):
    last = ENDLESS if base == "half-space" else 3e-3
    stack = Stack(
        (ElasticLayer(1e-3, 20 * E, 0.1), ElasticLayer(2e-3, E / 10, 0.499), ElasticLayer(last, E, 0.45)),
        base,
    )
    k = waves(1e-3, 1e3)
    in_plane, across = climb(stack.slabs, stack.below, k)
    C = in_plane[0].compliance
    np.testing.assert_allclose(C[:, 0, 1], C[:, 1, 0], rtol=1e-9, atol=1e-9 * abs(C).max())
    assert np.linalg.eigvalsh(C).min() > 0.0
    assert across[0].compliance.min() > 0.0


@pytest.mark.parametrize(
    "layer", [(0.0, E, 0.3), (math.nan, E, 0.3), (1e-3, -E, 0.3), (1e-3, math.inf, 0.3), (1e-3, E, 0.5)]
)
def test_a_layer_that_cannot_be_is_refused(layer):
    with pytest.raises(RangeError, match="give"):
        ElasticLayer(*layer)


def test_a_stack_whose_thicknesses_do_not_fit_its_base_is_refused():
    with refused("no-layers", InputError):
        Stack(())
    with refused("half-space-thickness", InputError):
        Stack((ElasticLayer(ENDLESS, E, 0.3),))
    with refused("half-space-thickness", InputError):
        Stack((ElasticLayer(1e-3, E, 0.3),), "half-space")
    with refused("half-space-thickness", InputError):
        Stack((ElasticLayer(ENDLESS, E, 0.3), ElasticLayer(ENDLESS, E, 0.3)), "half-space")


def test_wavenumbers_without_an_answer_are_refused():
    half_space = Stack((ElasticLayer(ENDLESS, E, 0.3),), "half-space")
    with refused("wavenumber", RangeError, match="1/m"):
        surface_compliance(half_space, np.array([0.0]))
    for k in (-1.0, math.nan, math.inf):
        with pytest.raises(RangeError, match="finite numbers"):
            surface_compliance(half_space, np.array([k]))
