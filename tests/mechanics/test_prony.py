import math

import numpy as np
import pytest
from scipy.integrate import quad

from palpate.core import RangeError
from palpate.mechanics.viscoelastic import Prony

SKIN = Prony(0.2e6, (0.1e6, 0.05e6, 0.3e6), (0.5, 3.0, 0.01))


def test_the_modulus_falls_from_its_instantaneous_to_its_equilibrium_value():
    assert float(SKIN.relaxation(0.0)) == pytest.approx(SKIN.instantaneous_pa)
    assert SKIN.instantaneous_pa == pytest.approx(0.65e6)
    assert float(SKIN.relaxation(1e3)) == pytest.approx(SKIN.equilibrium_pa)
    assert np.all(np.diff(SKIN.relaxation(np.linspace(0, 10, 100))) < 0)


def test_the_recursion_is_the_hereditary_integral():
    t = np.linspace(0, 2, 4001)
    strain = np.sin(3 * t) ** 2
    stress = SKIN.stress(t, strain)
    for n in (700, 2331, 4000):
        whole = quad(
            lambda s, n=n: float(SKIN.relaxation(t[n] - s)) * 3 * np.sin(6 * s),
            0,
            t[n],
            limit=400,
            points=[t[n] - 0.02],
            epsrel=1e-10,
        )[0]
        # straight pieces between samples leave (3 dt)^2 / 6 = 4e-7 of the strain
        assert stress[n] == pytest.approx(whole, abs=1e-6 * stress.max())


def test_creep_undoes_relaxation():
    # the Laplace transforms of E and J multiply to 1/p^2: int E(t - s) J(s) ds = t
    for t in (0.005, 0.4, 6.0):
        whole = quad(
            lambda s, t=t: float(SKIN.relaxation(t - s)) * float(SKIN.compliance(s)),
            0,
            t,
            points=[t * 0.9, min(0.02, t / 2)],
            limit=200,
        )[0]
        assert whole == pytest.approx(t, rel=1e-7)
    assert float(SKIN.compliance(0.0)) == pytest.approx(1 / SKIN.instantaneous_pa, rel=1e-12)
    assert float(SKIN.compliance(1e6)) == pytest.approx(1 / SKIN.equilibrium_pa, rel=1e-12)


def test_the_energy_lost_in_a_cycle_is_pi_times_the_loss_modulus_times_the_square_of_the_strain():
    omega, amplitude = 2.0, 0.1
    period = 2 * math.pi / omega
    t = np.linspace(0, 12 * period, 12 * 1000 + 1)  # 12 periods: the slowest branch has settled to e^-12
    strain = amplitude * np.sin(omega * t)
    stress = SKIN.stress(t, strain)
    loop = np.trapezoid(stress[-1001:], strain[-1001:])
    # 1000 steps a period leave (2 pi / 1000)^2 = 4e-5
    assert loop == pytest.approx(SKIN.loss_per_cycle(omega, amplitude), rel=1e-4)
    assert SKIN.loss_per_cycle(omega, amplitude) == pytest.approx(math.pi * SKIN.loss(omega) * amplitude**2)


def test_storage_and_loss_are_the_transform_of_relaxation():
    omega = 2.0
    for part, found in (("sin", SKIN.storage(omega) - SKIN.equilibrium_pa), ("cos", SKIN.loss(omega))):
        wave = quad(
            lambda t: float(SKIN.relaxation(t)) - SKIN.equilibrium_pa,
            0,
            np.inf,
            weight=part,
            wvar=omega,
            limlst=200,
        )[0]
        assert omega * wave == pytest.approx(found, rel=1e-6)


@pytest.mark.parametrize(
    "bad",
    [
        (0.0, (), ()),
        (math.nan, (), ()),
        (1e5, (1e5,), ()),
        (1e5, (1e5,), (0.0,)),
        (1e5, (math.inf,), (1.0,)),
    ],
)
def test_a_series_that_is_no_skin_is_refused(bad):
    with pytest.raises(RangeError):
        Prony(*bad)


def test_a_history_that_is_none_is_refused():
    t = np.array([0.0, 1.0, 2.0])
    for times, strain in (
        (t[::-1].copy(), t),
        (np.zeros(3), t),
        (t, np.array([0.0, math.nan, 1.0])),
        (t[:1], t[:1]),
        (t, t + 0.1),
    ):
        with pytest.raises(RangeError):
            SKIN.stress(times, strain)
    for ask in (
        lambda: SKIN.relaxation(-1.0),
        lambda: SKIN.compliance(math.nan),
        lambda: SKIN.loss(0.0),
        lambda: SKIN.loss_per_cycle(1.0, -0.1),
    ):
        with pytest.raises(RangeError):
            ask()
