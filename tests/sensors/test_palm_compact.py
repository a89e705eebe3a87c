"""The small network of the palm, and the presses that it is shown besides the recorded ones."""

from __future__ import annotations

from functools import partial

import numpy as np
import onnxruntime
import pytest

from palpate.core.errors import InputError
from palpate.estimators.guard import thumbnail
from palpate.estimators.networks.model_interface import TrainingData
from palpate.sensors import palm
from palpate.sensors.palm import random_presses
from palpate.sensors.palm.palm_variation import PressLaw
from palpate.sensors.palm.random_presses import TARGETS, draw_presses

torch = pytest.importorskip("torch", reason="the network trains with torch")

from palpate.sensors.palm.networks import palm_compact  # noqa: E402
from palpate.sensors.palm.networks.palm_compact import PalmCompact  # noqa: E402
from palpate.sensors.palm.networks.palm_training import two_view_variation  # noqa: E402

SIDE = 32
SPEC = palm.cropped(palm.palm(), SIDE, "test")
ONE, NONE = (1.0, 1.0), (0.0, 0.0)
ONE_PALM = PressLaw(
    copies=1, modulus=ONE, coefficient=ONE, thickness=ONE, polariser_deg=NONE, elevation_deg=NONE, mired=NONE,
    blur_px=NONE, shift_px=NONE, turn_deg=NONE, residual=NONE, frozen=NONE, ambient=NONE, corner_loss=NONE,
    specks=(0, 0), texture=NONE, spots=(0, 0), stops=NONE, lamp=(0.98, 1.02),
)  # fmt: skip
"""What a recording has: one palm, whose lamp varies a little."""


UNSTRAINED = PressLaw(copies=3, residual=NONE, frozen=NONE)
"""Palms that differ in all but what is frozen into them, which takes eight pictures of a depth for one."""


@pytest.fixture(scope="module", autouse=True)
def few_pictures():
    """Fewer depths for some hundred presses to share, none with residual birefringence."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(random_presses, "DEPTHS", 6)
        patched.setattr(palm_compact, "draw_presses", partial(draw_presses, law=UNSTRAINED))
        yield


@pytest.fixture(scope="module")
def recorded():
    return draw_presses(SPEC, 24, 4, np.random.default_rng(5), law=ONE_PALM)


@pytest.fixture(scope="module")
def data(recorded):
    """Presses of one palm as a recording's: differences, by press."""

    def fetch(rows):
        difference = recorded.images[rows].astype(np.float32) - recorded.hanging[recorded.press[rows]]
        return np.ascontiguousarray(difference.transpose(0, 3, 1, 2))

    shape = (3, SIDE, 2 * SIDE)
    return TrainingData(shape, recorded.values.astype(float), recorded.press, fetch, TARGETS)


@pytest.fixture(scope="module")
def fitted(data):
    recipe = PalmCompact(rendered=24, epochs=7, batch=12)
    return recipe.fit(data, np.arange(64), seed=0)


def test_it_tells_the_guard_of_the_presses_that_it_was_shown(fitted, data):
    also = fitted.rendered_images
    assert len(also.thumbs) == len(also.groups) == 24 + 2
    assert len(np.unique(also.groups)) == 2
    # Of the size of recorded inputs, and as light as a palm: dark fringes, a brighter mirror.
    assert also.thumbs.shape[1:] == thumbnail(np.zeros((SIDE, 2 * SIDE, 3), np.uint8)).shape
    half = also.thumbs.shape[2] // 2
    assert also.thumbs[24:, :, :half].mean() < also.thumbs[24:, :, half:].mean()


def test_it_learns_what_it_is_shown(fitted, data):
    rows = np.arange(64, 96)
    error = np.abs(fitted.predict(data.fetch(rows)) - data.values[rows]).mean(axis=0)
    guess = np.abs(data.values[:64].mean(axis=0) - data.values[rows]).mean(axis=0)
    assert (error < 0.7 * guess).all(), error / guess


def test_the_exported_network_answers_as_the_trained_one(fitted, data):
    session = onnxruntime.InferenceSession(fitted.to_onnx().SerializeToString())
    inputs = data.fetch(np.arange(20))
    (exported,) = session.run(["value"], {"image": inputs})
    span = np.ptp(data.values, axis=0)
    assert (np.abs(exported - fitted.predict(inputs)) / span).max() < 1e-4


def test_the_place_is_told_by_moments_unless_the_network_shall_and_the_rest_by_the_network(data):
    inputs, recipe = data.fetch(np.arange(64, 88)), {"rendered": 0, "epochs": 1, "batch": 16}
    by_moments, by_network = (
        PalmCompact(**recipe, moments=moments).fit(data, np.arange(64), seed=0) for moments in (True, False)
    )
    ours, theirs = by_moments.predict(inputs), by_network.predict(inputs)
    place = [TARGETS.index(name) for name in ("x_mm", "y_mm")]
    rest = [TARGETS.index(name) for name in ("depth_mm", "force_N")]
    np.testing.assert_array_equal(ours[:, rest], theirs[:, rest])
    np.testing.assert_array_equal(ours[:, place], by_moments.place.predict(inputs))
    assert np.abs(ours - theirs)[:, place].min() > 1e-3
    for fitted, expected in ((by_moments, ours), (by_network, theirs)):
        session = onnxruntime.InferenceSession(fitted.to_onnx().SerializeToString())
        (exported,) = session.run(["value"], {"image": inputs})
        np.testing.assert_allclose(exported, expected, rtol=1e-4, atol=1e-3)


def test_watched_presses_end_its_learning_and_their_frames_are_not_learnt_from(data):
    recipe = PalmCompact(rendered=0, epochs=60, batch=16, patience=1, watched=0.25, cosine=False)
    fitted = recipe.fit(data, np.arange(64), seed=0)
    assert fitted.training.stopped
    assert 0 < fitted.training.best_step < fitted.training.steps
    assert fitted.training.steps == 3 * fitted.training.epochs  # 12 of 16 presses, 48 frames
    assert PalmCompact(rendered=0, steps=7).fit(data, np.arange(64), seed=0).training.steps == 7


def test_one_camera_moves_both_views_alike_and_nothing_from_one_into_the_other(data) -> None:
    vary = two_view_variation(1.0, SIDE)
    left, changed = data.fetch(np.array([30]))[..., :SIDE], []
    for seed in range(12):
        twice = vary(np.concatenate([left, left], axis=3), (0, seed))
        np.testing.assert_array_equal(twice[..., :SIDE], twice[..., SIDE:])
        changed.append(not np.array_equal(twice[..., :SIDE], left))
        apart = vary(np.concatenate([left - 500, left + 500], axis=3), (0, seed))
        assert apart[..., :SIDE].max() < 0 < apart[..., SIDE:].min()
    assert sum(changed) >= 8, "half of the images have none of each change"
    again = [vary(np.concatenate([left, left], axis=3), (0, 3)) for _ in range(2)]
    np.testing.assert_array_equal(*again)


@pytest.mark.parametrize("options", [{"rendered": -1}, {"palm": "hand"}, {"variation": 3.0}])
def test_settings_that_cannot_be_are_refused(options):
    with pytest.raises(InputError):
        PalmCompact(**options)


@pytest.mark.parametrize("shape", [(3, 32, 96), (3, 40, 80)])
def test_an_input_that_is_not_two_fitting_squares_is_refused(data, shape):
    odd = TrainingData(shape, data.values, data.groups, data.fetch, TARGETS)
    with pytest.raises(InputError, match="two squares"):
        PalmCompact(rendered=0).fit(odd, np.arange(20), seed=0)
