import math
from dataclasses import replace

import numpy as np
import pytest

from palpate.core import Contact, InputError, Pose, Probe
from palpate.mechanics.probe_contact import Resultant, resultant_of

X = np.linspace(4e-3, 6e-3, 41)
Y = np.linspace(-4e-3, -2e-3, 41)
CELL = (5e-5) ** 2


def contact(pressure, shear=None):
    nothing = np.zeros_like(pressure)
    probe, pose = Probe("sphere", 1e-3), Pose(5e-3, -3e-3, 1e-4)
    return Contact(X, Y, pressure, nothing, pressure > 0, 1.0, 1e-3, probe, pose, "none", shear_pa=shear)


@pytest.fixture
def loaded(rng):
    return contact(rng.uniform(0, 1e4, (41, 41)), rng.normal(0, 1e3, (2, 41, 41)))


def test_a_small_contact_s_moment_is_r_cross_f():
    one = np.zeros((41, 41))
    one[20, 20] = 1.0 / CELL  # at (5, -3) mm
    found = resultant_of(contact(one, np.stack([0.2 * one, -0.1 * one])))
    force = np.array([0.2, -0.1, 1.0])
    np.testing.assert_allclose(found[:3], force, rtol=1e-12)
    np.testing.assert_allclose(found[3:], np.cross([5e-3, -3e-3, 0.0], force), rtol=1e-9)


def test_moments_about_another_point_differ_by_r_cross_f(loaded):
    here, there = resultant_of(loaded), resultant_of(loaded, (5e-3, -3e-3))
    np.testing.assert_allclose(here[:3], there[:3])
    moved = np.cross([5e-3, -3e-3, 0.0], here[:3])
    np.testing.assert_allclose(np.array(here[3:]), np.array(there[3:]) + moved, rtol=1e-9)


def test_what_has_no_moment_is_refused(loaded):
    with pytest.raises(InputError, match="finite"):
        resultant_of(loaded, (math.nan, 0.0))
    with pytest.raises(InputError, match="regular grid"):
        resultant_of(replace(loaded, x_m=np.sort(np.append(X[1:], 5.01e-3))))
    assert isinstance(resultant_of(loaded), Resultant)
