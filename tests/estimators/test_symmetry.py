"""A sensor that looks the same when turned gives turned touches for nothing."""

import cv2
import numpy as np
import pytest
from tests.refusals import refused

from palpate.core import InputError
from palpate.estimators.networks.augmentation import RotationalSymmetry, axis_of, in_plane

NAMES = ("depth_mm", "shear_x_mm", "shear_y_mm", "twist_deg")


def lattice(order: int, axis: tuple[float, float], side: int = 96) -> np.ndarray:
    """Blurred dots in rings about an axis, each ring repeating `order` times in a full turn."""
    image = np.zeros((side, side), np.float32)
    for ring, phase in ((12, 0.0), (20, 0.2), (28, 0.05), (35, 0.11)):
        for k in range(order):
            angle = 2 * np.pi * (k / order) + phase
            x, y = axis[0] + ring * np.cos(angle), axis[1] + ring * np.sin(angle)
            cv2.circle(image, (round(x * 16), round(y * 16)), 3 * 16, 255.0, -1, cv2.LINE_AA, 4)
    return cv2.GaussianBlur(image, (0, 0), 1.0)


@pytest.mark.parametrize("order", [2, 5])
def test_the_axis_is_found_to_a_pixel(order: int) -> None:
    found = axis_of(lattice(order, (50.0, 44.0)).astype(float), order)
    np.testing.assert_allclose(found, (50.0, 44.0), atol=1.0)


def test_a_sensor_without_the_symmetry_is_refused() -> None:
    with refused("not-symmetric", InputError):
        axis_of(lattice(5, (48.0, 48.0)).astype(float), 4)
    with refused("turn-count", InputError):
        axis_of(lattice(5, (48.0, 48.0)).astype(float), 1)
    with refused("not-symmetric", InputError):
        axis_of(np.zeros((32, 32)), 2)


def test_only_what_lies_in_the_plane_turns() -> None:
    assert in_plane(NAMES) == (((1, 2),), ())
    assert in_plane(("x_mm", "force_N")) == ((), (0,))
    turns = RotationalSymmetry(4, (0.0, 0.0), ((1, 2),))
    values = np.array([[1.0, 2.0, 0.0, 3.0]] * 4)
    turned = turns.turned_values(values, np.arange(4))
    np.testing.assert_allclose(turned[:, 1:3], [[2, 0], [0, 2], [-2, 0], [0, -2]], atol=1e-12)
    np.testing.assert_array_equal(turned[:, [0, 3]], values[:, [0, 3]])


def test_a_component_alone_turns_only_by_half_turns() -> None:
    images = np.stack([lattice(6, (47.5, 47.5))[None]] * 2)
    turns = RotationalSymmetry.find(2, images, ("x_mm",))
    np.testing.assert_array_equal(turns.turned_values(np.ones((2, 1)), np.array([0, 1])), [[1], [-1]])
    with pytest.raises(InputError, match="name both"):
        RotationalSymmetry.find(6, images, ("x_mm",))


def test_images_and_vectors_turn_the_same_way() -> None:
    side, axis = 64, (31.5, 31.5)
    rng = np.random.default_rng(0)
    places = rng.uniform(-18, 18, (20, 2))
    images = np.zeros((20, 1, side, side), np.float32)
    for image, (x, y) in zip(images, places, strict=True):
        cv2.circle(
            image[0], (round((axis[0] + x) * 16), round((axis[1] + y) * 16)), 48, 1.0, -1, cv2.LINE_AA, 4
        )
    turned, values = RotationalSymmetry(5, axis, ((0, 1),)).turned(images, places, rng)
    v, u = np.mgrid[:side, :side]
    mass = turned[:, 0].sum(axis=(1, 2))
    seen = np.stack([(turned[:, 0] * w).sum(axis=(1, 2)) / mass for w in (u - axis[0], v - axis[1])], axis=1)
    np.testing.assert_allclose(
        seen, values, atol=0.3
    )  # a dot is drawn and resampled to a fraction of a pixel
    assert np.abs(values - places).max() > 1
