import numpy as np
import pytest

from palpate.core import InputError, RangeError
from palpate.optics import (
    circular_amplitude,
    circular_dark_field,
    dark_field,
    linear_retarder,
    march,
    plane_amplitude,
    through,
)
from palpate.optics.polariscope import jones, mueller

GREEN = np.array([550e-9])


@pytest.fixture
def ray(rng):
    """Rays through slices that turn: all four parts of the quaternion are at work."""
    return march(*rng.normal(size=(2, 9, 60)), 0.6)


@pytest.mark.parametrize("axis", [0.0, 0.4, np.pi / 4, 1.3, 2.8])
def test_a_circular_dark_field_is_blind_to_the_axis(axis):
    order = np.linspace(0, 3, 40)
    plate = linear_retarder(order, axis)
    exact = np.sin(np.pi * order) ** 2
    np.testing.assert_allclose(circular_dark_field(plate), exact, atol=1e-14)
    np.testing.assert_allclose(through(plate, circular_amplitude(GREEN)[0]), exact, atol=1e-14)


@pytest.mark.parametrize("polariser", [0.0, 0.3, np.pi / 4])
def test_the_four_numbers_are_the_polariscope(ray, polariser):
    plane = plane_amplitude(polariser, 1)[0]
    np.testing.assert_allclose(through(ray, plane), dark_field(ray, polariser), atol=1e-14)
    circular = circular_amplitude(GREEN, polariser_rad=polariser)[0]
    np.testing.assert_allclose(through(ray, circular), circular_dark_field(ray), atol=1e-14)


@pytest.mark.parametrize("wavelength", [400e-9, 550e-9, 700e-9])
def test_light_and_dark_field_are_all_the_light(ray, wavelength):
    at = np.array([wavelength])
    dark, light = circular_amplitude(at)[0], circular_amplitude(at, light_field=True)[0]
    np.testing.assert_allclose(through(ray, dark) + through(ray, light), 1.0)
    dark, light = plane_amplitude(0.3, 1)[0], plane_amplitude(0.3, 1, light_field=True)[0]
    np.testing.assert_allclose(through(ray, dark) + through(ray, light), 1.0)


def test_crossed_plates_cancel_at_every_wavelength_and_a_turned_one_leaks():
    wavelengths = np.linspace(400e-9, 700e-9, 7)
    bare = linear_retarder(np.zeros(1), 0.0)
    dark = [through(bare, a) for a in circular_amplitude(wavelengths)]
    np.testing.assert_allclose(dark, 0.0, atol=1e-30)
    turned = [through(bare, a) for a in circular_amplitude(wavelengths, axis_error_rad=0.02)]
    assert min(turned) > 1e-5


def test_plates_of_the_wrong_wavelength_let_the_axis_back_in():
    """To first order a plate error e turns the dark field of a half-wave sample by at most sin^2 e.

    With plates for 550 nm seen at 450 nm, e = (pi/2)(550/450 - 1) = 0.35 rad.
    """
    axes = np.linspace(0, np.pi, 50)
    half_wave = linear_retarder(0.5, axes)
    light = through(half_wave, circular_amplitude(np.array([450e-9]))[0])
    error = np.pi / 2 * (550 / 450 - 1)
    assert np.ptp(light) == pytest.approx(np.sin(error) ** 2, rel=0.02)


def test_a_quarter_wave_plate_gives_the_sign_of_v():
    """Larger index along x, light along the diagonal x = z: x is a quarter period ahead in exp(i phase).

    So E_x* E_z is -i / 2, and V, twice its imaginary part, is -1; along the other diagonal it is +1.
    """
    plate = mueller(linear_retarder(0.25, 0.0))
    np.testing.assert_allclose(plate @ [1, 0, 1, 0], [1, 0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(plate @ [1, 0, -1, 0], [1, 0, 0, 1], atol=1e-15)


def test_any_light_has_the_stokes_vector_of_its_amplitudes(ray, rng):
    """V > 0 being Im(E_x* E_z) > 0, before the retarder and behind it."""

    def stokes(E):
        x, z = E
        both = 2 * x.conj() * z
        return [abs(x) ** 2 + abs(z) ** 2, abs(x) ** 2 - abs(z) ** 2, both.real, both.imag]

    E = rng.normal(size=2) + 1j * rng.normal(size=2)
    for J, M in zip(jones(ray), mueller(ray), strict=True):
        np.testing.assert_allclose(M @ stokes(E), stokes(J @ E), atol=1e-13)


def test_angles_and_wavelengths_that_are_no_numbers_are_refused():
    with pytest.raises(InputError, match="bands"):
        plane_amplitude(0.0, 0)
    with pytest.raises(InputError, match="finite"):
        plane_amplitude(np.nan, 3)
    with pytest.raises(RangeError, match="wavelengths"):
        circular_amplitude(np.array([0.0]))
    with pytest.raises(RangeError, match="angles"):
        circular_amplitude(GREEN, axis_error_rad=np.inf)
