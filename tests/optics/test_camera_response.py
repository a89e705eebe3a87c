import numpy as np
import pytest

from palpate.core import InputError, RangeError
from palpate.optics import CameraResponse, assumed_camera, develop, encode_srgb, raw_codes

SENSITIVITY = assumed_camera().sensitivity
QUIET = CameraResponse(
    full_well_e=1e9, read_noise_e=0.0
)  # so many electrons that their noise is below a code


def patch(value, side=100):
    return np.full((side, side, 3), value)


def test_developing_gives_back_the_colour_of_the_light():
    light = patch(1.0) * [0.2, 0.5, 0.8]
    codes = raw_codes(light, SENSITIVITY, QUIET, np.random.default_rng(0))
    # a 12-bit step of the dimmest channel is up to two 8-bit steps near black and less than one here
    assert abs(develop(codes, SENSITIVITY, QUIET).astype(int) - encode_srgb(light)).max() <= 1


def test_twice_the_exposure_is_twice_the_code_until_it_clips():
    def mean(exposure):
        camera = CameraResponse(exposure=exposure)
        return raw_codes(patch(0.5), np.ones(3), camera, np.random.default_rng(0)).mean()

    assert mean(0.8) == pytest.approx(2 * mean(0.4), rel=1e-3)
    assert mean(4.0) == 4095


def test_noise_of_the_codes_is_the_electrons():
    camera = CameraResponse()
    codes = raw_codes(patch(0.5, 300), np.ones(3), camera, np.random.default_rng(1))
    per_code = camera.full_well_e / 4095
    expected = np.sqrt(0.5 * camera.exposure * camera.full_well_e + camera.read_noise_e**2 + per_code**2 / 12)
    assert codes.std() * per_code == pytest.approx(expected, rel=0.01)  # 5 standard errors of 270,000 values


def test_light_that_is_no_light_is_refused():
    for bad in (np.nan, -0.1, np.inf):
        with pytest.raises(InputError, match="light"):
            raw_codes(patch(bad), SENSITIVITY, QUIET, np.random.default_rng(0))


@pytest.mark.parametrize(
    "change", [{"full_well_e": 0.0}, {"read_noise_e": -1.0}, {"bits": 17}, {"exposure": np.nan}]
)
def test_cameras_that_cannot_be_are_refused(change):
    with pytest.raises(RangeError):
        CameraResponse(**change)
