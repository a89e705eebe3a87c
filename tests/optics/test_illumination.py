import numpy as np
import pytest

from palpate.core import RangeError
from palpate.optics import LedStrip, strip_light

X, Z = np.linspace(-28e-3, 28e-3, 113), np.linspace(-2e-3, 12e-3, 29)


def test_one_led_falls_by_lambert_s_law():
    lamp = LedStrip(count=1, distance_m=10e-3, evened=0.0, height_m=5e-3)
    light = strip_light(lamp, np.array([0.0, 10e-3]), np.array([5e-3]))
    # at 45 degrees: cos^4 = 1/4
    np.testing.assert_allclose(light, [[1.0, 0.25]])


def test_an_even_strip_is_even_and_a_sloped_one_brighter_on_its_side():
    light = strip_light(LedStrip(), X, Z)
    np.testing.assert_allclose(light, light[:, ::-1])
    sloped = strip_light(LedStrip(slope_per_m=5.0), X, Z)
    assert sloped[:, -1].mean() > 1.05 * sloped[:, 0].mean()


@pytest.mark.parametrize(
    "change",
    [{"pitch_m": 0.0}, {"count": 0}, {"distance_m": np.nan}, {"evened": 1.2}, {"slope_per_m": -40.0}],
)
def test_strips_that_cannot_be_are_refused(change):
    with pytest.raises(RangeError):
        LedStrip(**change)
