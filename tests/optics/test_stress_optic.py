import numpy as np
import pytest

from palpate.core import RangeError
from palpate.optics import StressOpticLaw, frozen_stress

WAVELENGTHS = np.array([400e-9, 550e-9, 700e-9])


def test_half_a_phase_of_pi_is_a_whole_order():
    law = StressOpticLaw(3e-9)
    one_order = WAVELENGTHS / 3e-9  # Pa m
    np.testing.assert_allclose(law.half_phase(WAVELENGTHS) * one_order, np.pi)


@pytest.mark.parametrize("axis", [0.0, 0.3, -1.2])
def test_a_frozen_stress_makes_the_birefringence_it_stands_for(axis):
    law = StressOpticLaw(2e-9)
    u, v = frozen_stress(1e-6, axis, law)
    assert law.coefficient_per_pa * np.hypot(u, v) == pytest.approx(1e-6)
    assert np.arctan2(v, u) / 2 == pytest.approx(axis)


def test_laws_that_cannot_be_are_refused():
    for bad in ({"dispersion_m2": np.nan}, {"reference_wavelength_m": 0.0}, {"coefficient_per_pa": np.inf}):
        with pytest.raises(RangeError):
            StressOpticLaw(**({"coefficient_per_pa": 1e-9} | bad))
    with pytest.raises(RangeError, match="wavelength"):
        StressOpticLaw(1e-9).half_phase(np.array([0.0]))
    with pytest.raises(RangeError, match="dispersion"):
        StressOpticLaw(1e-9, dispersion_m2=-1e-12).half_phase(WAVELENGTHS)
    with pytest.raises(RangeError, match="finite"):
        frozen_stress(np.nan, 0.0, StressOpticLaw(1e-9))
