"""The palm without a network: what its moments are, what they tell, and that they leave as they are."""

from __future__ import annotations

import numpy as np
import onnxruntime
import pytest
from sklearn.ensemble import ExtraTreesRegressor
from tests.refusals import refused

from palpate.core.errors import InputError
from palpate.estimators.networks import make_model
from palpate.estimators.networks.model_interface import TrainingData
from palpate.estimators.networks.onnx_graph import OnnxGraph
from palpate.sensors.palm.networks.palm_moments import (
    BRIGHT,
    PalmMoments,
    mirror_moments,
)

SIDE = 48
TARGETS = ("depth_mm", "x_mm", "y_mm", "force_N")


def blob(x: float, y: float, across: float, down: float, height: float = 100.0) -> np.ndarray:
    """A bright Gaussian in a view whose edges are at -1 and 1."""
    rows, columns = np.meshgrid(np.linspace(-1, 1, SIDE), np.linspace(-1, 1, SIDE), indexing="ij")
    bell = np.exp(-0.5 * ((columns - x) / across) ** 2 - 0.5 * ((rows - y) / down) ** 2)
    return (height * bell + BRIGHT * (bell > 1e-3)).astype(np.float32)


def presses(count: int, rng: np.random.Generator, channels: int = 1) -> TrainingData:
    """Left rings that brighten with depth, right a bright spot at the place."""
    x, y, depth = rng.uniform(-0.5, 0.5, count), rng.uniform(-0.5, 0.5, count), rng.uniform(0.5, 4, count)
    rings = [blob(0, 0.4, 0.3, 0.3, 40 * d) * (1 + np.cos(d * np.arange(SIDE)) / 2) for d in depth]
    spots = [blob(a, b, 0.12, 0.1) - 20 for a, b in zip(x, y, strict=True)]
    views = np.concatenate([rings, spots], axis=2) + rng.normal(0, 1, (count, SIDE, 2 * SIDE))
    images = np.repeat(views.astype(np.float32)[:, None], channels, axis=1)
    values = np.stack([depth, 20 * x, 20 * y, depth**1.5], axis=1)
    shape = (channels, SIDE, 2 * SIDE)
    return TrainingData(shape, values, np.arange(count) // 2, lambda rows: images[rows], TARGETS)


def test_moments_are_the_centre_and_the_spread_of_a_bell_across_and_down():
    found = mirror_moments(blob(0.2, -0.3, 0.15, 0.08)[None])[0, 5:]  # of what is brighter
    np.testing.assert_allclose(found[:4], (0.2, -0.3, 0.15, 0.08), atol=2e-3)
    twice = mirror_moments(2 * blob(0.2, -0.3, 0.15, 0.08)[None] - BRIGHT)[0, 5:]
    assert twice[4] - found[4] == pytest.approx(np.log(2), abs=0.01)


def test_it_reads_presses_it_has_not_seen_and_nothing_where_labels_are_shuffled(rng):
    data, learn, held = presses(120, rng), np.arange(90), np.arange(90, 120)
    error = np.abs(PalmMoments(15).fit(data, learn, seed=0).predict(data.fetch(held)) - data.values[held])
    by_mean = np.abs(data.values[learn].mean(axis=0) - data.values[held]).mean(axis=0)
    assert (error.mean(axis=0) < 0.1 * by_mean).all(), error.mean(axis=0) / by_mean
    mixed = TrainingData(data.shape, rng.permutation(data.values), data.groups, data.fetch, data.names)
    control = np.abs(PalmMoments(15).fit(mixed, learn, seed=0).predict(data.fetch(held)) - data.values[held])
    assert (control.mean(axis=0) > 0.8 * by_mean).all()


@pytest.mark.parametrize(("channels", "names"), [(1, TARGETS), (3, TARGETS[2:] + TARGETS[:2])])
def test_the_exported_model_is_the_fitted_one_in_the_order_asked_for(rng, channels, names):
    data = presses(40, rng, channels)
    order = [TARGETS.index(name) for name in names]
    data = TrainingData(data.shape, data.values[:, order], data.groups, data.fetch, names)
    fitted = make_model("palm-moments", {"trees": 10}).fit(data, np.arange(30), seed=1)
    inputs = np.concatenate([data.fetch(np.arange(40)), np.zeros((1, *data.shape), np.float32)])
    session = onnxruntime.InferenceSession(fitted.to_onnx().SerializeToString())
    (exported,) = session.run(["value"], {"image": inputs})
    span = np.ptp(data.values, axis=0)
    assert (np.abs(exported - fitted.predict(inputs)) / span).max() < 1e-5
    # Trees grown to the last row answer rows they have seen to within the spread of their neighbours.
    assert (np.abs(exported[:30] - data.values[:30]).mean(axis=0) < 0.1 * span).all()


def test_exported_trees_send_a_feature_on_a_threshold_to_the_side_that_the_forest_sends_it(rng):
    features = rng.integers(0, 8, (300, 3)).astype(np.float32) / np.float32(3)
    values = rng.normal(size=(300, 2))
    forest = ExtraTreesRegressor(12, random_state=0).fit(features, values)
    graph = OnnxGraph()
    flat = graph.add("Flatten", ["image"])
    graph.add("Identity", [graph.add_trees(forest, flat)], output="value")
    session = onnxruntime.InferenceSession(graph.model((1, 1, 3), 2).SerializeToString())
    thresholds = np.concatenate([one.tree_.threshold for one in forest.estimators_]).astype(np.float32)
    asked = np.concatenate([features, rng.choice(thresholds, (300, 3))]).astype(np.float32)
    (exported,) = session.run(["value"], {"image": asked.reshape(-1, 1, 1, 3)})
    np.testing.assert_allclose(exported, forest.predict(asked), atol=1e-5)


@pytest.mark.parametrize("wrong", [{"trees": 0}, {"leaf_rows": 0}])
def test_settings_that_cannot_be_are_refused(wrong):
    with refused("tree-count", InputError):
        PalmMoments(**wrong)
