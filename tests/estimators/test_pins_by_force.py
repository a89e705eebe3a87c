"""Motion over force: read alike whatever the frames were, laid on the pins that were calibrated."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from tests.refusals import refused

from palpate.core.errors import InputError, RangeError
from palpate.estimators.compliance.pin_press import PinPress, at_forces, motion_on_layout

LEVELS = np.arange(1.0, 4.51, 0.5)


def motion(force_n: np.ndarray) -> np.ndarray:
    """Smooth in the cube root of force, three values a frame."""
    x = np.cbrt(force_n)[:, None]
    return x * [1.0, -2.0, 0.5] + x**2 * [0.3, 0.1, -0.4] + 0.1 * x**4 * [1.0, 0.0, 2.0]


def test_values_at_fixed_forces_do_not_depend_on_how_many_frames_were_taken_when() -> None:
    for frames, power in ((7, 1.0), (400, 1.0), (25, 2.0), (25, 0.4)):
        force = 0.5 + 4.6 * np.linspace(0, 1, frames) ** power
        assert_allclose(at_forces(force, motion(force), LEVELS), motion(LEVELS), rtol=1e-9)


@pytest.mark.parametrize(("low", "high"), [(0.5, 4.3), (1.2, 5.0)])
def test_forces_that_were_not_reached_are_refused(low, high) -> None:
    force = np.linspace(low, high, 30)
    with refused("force-not-reached", RangeError):
        at_forces(force, motion(force), LEVELS)


@pytest.fixture
def layout() -> np.ndarray:
    """A hexagon of pins, 12 px apart."""
    i, j = np.meshgrid(np.arange(-5, 6), np.arange(-5, 6))
    at = np.stack([12 * (i + j / 2), 12 * np.sqrt(0.75) * j], axis=-1).reshape(-1, 2)
    return at[np.abs(i + j).ravel() <= 5] + 150.0


def press(untouched: np.ndarray, moved: np.ndarray) -> PinPress:
    frames = len(moved)
    return PinPress(np.arange(frames), np.linspace(0.5, 5, frames), untouched, moved, None, np.nan, ())


@pytest.fixture
def moved(layout, rng) -> np.ndarray:
    return rng.standard_normal((6, len(layout), 2))


def test_a_shift_and_the_order_of_the_pins_do_not_matter(layout, moved, rng) -> None:
    for shift in ((0.0, 0.0), (2.5, -1.5), (-40.0, 25.0)):
        order = rng.permutation(len(layout))
        found = motion_on_layout(press(layout[order] + shift, moved[:, order]), layout)
        assert_allclose(found, moved)


def test_pins_lost_in_one_frame_or_never_found_are_nan_and_the_others_stay(layout, moved) -> None:
    kept, there = np.arange(len(layout)) % 10 != 0, np.arange(len(layout)) % 20 != 5
    moved[3, ~there] = np.nan
    found = motion_on_layout(press(layout[kept] + 2.0, moved[:, kept]), layout)
    assert np.isnan(found[:, ~kept | ~there]).all()
    assert_allclose(found[:, kept & there], moved[:, kept & there])


@pytest.mark.parametrize("other", ["larger", "turned", "denser", "fewer"])
def test_another_layout_is_refused(layout, moved, other) -> None:
    middle = layout.mean(axis=0)
    c, s = np.cos(0.4), np.sin(0.4)
    at = {
        "larger": middle + 1.3 * (layout - middle),
        "turned": middle + (layout - middle) @ np.array([[c, s], [-s, c]]),
        "denser": np.concatenate([layout, layout + np.array([6.0, 0.0])]),
        "fewer": layout[: len(layout) // 2],
    }[other]
    with refused("layout-differs", InputError):
        motion_on_layout(press(at, np.ones((6, len(at), 2))), layout)


def test_a_press_without_pins_is_refused(layout, moved) -> None:
    with refused("pins-lost", InputError):
        motion_on_layout(press(layout, np.full_like(moved, np.nan)), layout)
