import sys
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from palpate.core import InputError
from palpate.optics import (
    circular_amplitude,
    march,
    march_colour,
    march_spectral,
    plane_amplitude,
    through,
)
from palpate.optics.march import march_even

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools"))

from tests.refusals import refused

WAVELENGTHS = np.array([630e-9, 535e-9, 465e-9])
HALF_PHASE = np.pi * 3e-9 / WAVELENGTHS
# single precision rounds each of s slices by 6e-8: about 6e-8 sqrt(s), ten times as much to be safe
ROUNDING = 1e-5


def slices(rng, count=24, shape=(150,), half_phase=0.3):
    """Random slices whose half phases at the middle wavelength have the size given."""
    size = half_phase / HALF_PHASE[1]
    return tuple((size * rng.normal(size=(2, count, *shape))).astype(np.float32))


@pytest.mark.parametrize("even", [False, True])
@pytest.mark.parametrize("half_phase", [1e-4, 0.3, 1.3, 20.0])
def test_the_compiled_march_is_the_plain_march(rng, half_phase, even):
    u, v = slices(rng, half_phase=half_phase)
    law = march_even if even else march
    amplitude = circular_amplitude(WAVELENGTHS, polariser_rad=0.2)
    fast = march_spectral(u, v, HALF_PHASE, amplitude, even)
    rounded = HALF_PHASE.astype(np.float32).astype(float)  # at 20 rad a slice even these eight digits matter
    plain = [
        through(law(u.astype(float), v.astype(float), float(c)), a)
        for c, a in zip(rounded, amplitude, strict=True)
    ]
    np.testing.assert_allclose(fast, plain, atol=ROUNDING)


@pytest.mark.parametrize("rays", [1, 63, 64, 65, 10_000])
def test_every_ray_is_marched_whatever_the_tiles_and_threads(rng, rays):
    u, v = slices(rng, count=3, shape=(rays,))
    amplitude = plane_amplitude(0.3, 3)
    one = march_spectral(u, v, HALF_PHASE, amplitude, threads=1)
    np.testing.assert_array_equal(one, march_spectral(u, v, HALF_PHASE, amplitude, threads=3))
    last = march_spectral(u[:, -1:], v[:, -1:], HALF_PHASE, amplitude)
    # the remainder of a tile may round differently from a vector of it
    np.testing.assert_allclose(one[:, -1:], last, atol=1e-6)


def test_no_stress_is_dark_and_the_light_field_is_its_complement(rng):
    u, v = slices(rng)
    nothing = np.zeros_like(u)
    for law in (
        plane_amplitude,
        lambda psi, k, light_field=False: circular_amplitude(
            WAVELENGTHS, polariser_rad=psi, light_field=light_field
        ),
    ):
        dark, light = law(0.7, 3), law(0.7, 3, light_field=True)
        assert march_spectral(nothing, nothing, HALF_PHASE, dark).max() < 1e-12
        both = march_spectral(u, v, HALF_PHASE, dark) + march_spectral(u, v, HALF_PHASE, light)
        np.testing.assert_allclose(both, 1.0, atol=ROUNDING)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e30])
def test_a_stress_that_is_no_number_is_refused_and_not_drawn(rng, bad):
    u, v = slices(rng)
    u[3, 70] = bad
    with pytest.raises(InputError, match="finite"):
        march_spectral(u, v, HALF_PHASE, plane_amplitude(0.3, 3))


def test_shapes_and_bands_that_do_not_fit_are_refused(rng):
    u, v = slices(rng)
    amplitude = plane_amplitude(0.3, 3)
    with refused("shape", InputError):
        march_spectral(u[:0], v[:0], HALF_PHASE, amplitude)
    with pytest.raises((InputError, TypeCheckError)):  # in tests the shapes are checked first
        march_colour(u, v, HALF_PHASE, np.ones((2, 3)), amplitude)
    with pytest.raises(InputError, match="finite"):
        march_spectral(u, v, HALF_PHASE * np.nan, amplitude)
    with pytest.raises(InputError, match="threads"):
        march_spectral(u, v, HALF_PHASE, amplitude, threads=0)
