import numpy as np
import pytest

from palpate.core import InputError
from palpate.optics import assumed_camera, encode_srgb, spectral_to_linear


def crossed(retardance_m, spectrum):
    """A retarder at 45 degrees."""
    return np.sin(np.pi * np.asarray(retardance_m) / spectrum.wavelength_m[:, None]) ** 2


def test_the_bare_lamp_is_white_and_no_light_is_black():
    spectrum = assumed_camera()
    np.testing.assert_allclose(spectral_to_linear(np.ones((31, 2)), spectrum), 1.0)
    np.testing.assert_array_equal(spectral_to_linear(np.zeros((31, 2)), spectrum), 0.0)


def test_interference_colours_come_in_their_order():
    red, green, blue = spectral_to_linear(
        crossed([100e-9, 275e-9, 430e-9, 520e-9, 640e-9], s := assumed_camera()), s
    ).T
    assert blue[0] > green[0] > red[0], "grey with a blue tinge"
    assert min(red[1], green[1], blue[1]) > 0.8, "white"
    assert red[2] > green[2] > 3 * blue[2], "yellow to orange"
    assert min(red[3], blue[3]) > 1.3 * green[3], "purple, near one order of green"
    assert blue[4] > green[4] > red[4], "blue"


def test_thirty_one_bands_are_as_good_as_three_hundred():
    retardance = np.linspace(0, 2.2e-6, 200)  # four orders of green
    few, many = assumed_camera(31), assumed_camera(300)
    error = spectral_to_linear(crossed(retardance, few), few) - spectral_to_linear(
        crossed(retardance, many), many
    )
    assert abs(error).max() < 0.006


def test_too_few_bands_are_refused():
    with pytest.raises(InputError, match="31"):
        assumed_camera(bands=3)


def test_srgb_rises_and_ends_where_the_standard_says():
    codes = encode_srgb(np.linspace(0, 1, 1001))
    assert (np.diff(codes.astype(int)) >= 0).all()
    assert encode_srgb(np.array([0.0, 0.0031308, 0.2158605, 1.0])).tolist() == [0, 10, 128, 255]


def test_srgb_clips_what_lies_outside():
    assert encode_srgb(np.array([-0.5, 1.5])).tolist() == [0, 255]
