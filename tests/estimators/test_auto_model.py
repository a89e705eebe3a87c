"""Choosing a model within a time: by whole groups, no longer than given, the same for the same seed."""

import re
from dataclasses import dataclass

import numpy as np
import pytest

from palpate.core import InputError
from palpate.estimators.networks import Kind, TrainingData, auto_model, make_model
from palpate.estimators.networks.auto_model import AutoModel
from palpate.estimators.networks.model_interface import predict_rows

WITHOUT_NETWORK = ("mean", "pca-ridge", "kernel-ridge")


def spots(n: int, rng: np.random.Generator, *, side: int = 24, groups: int | None = None) -> TrainingData:
    """A spot that moves by far more than its width, which no linear map follows."""
    ys, xs = np.mgrid[0:side, 0:side]
    values = rng.uniform(0.25 * side, 0.75 * side, (n, 1))
    images = 200 * np.exp(-((xs - values[:, :, None]) ** 2 + (ys - side / 2) ** 2) / 8)
    images = (images + rng.normal(0, 2, images.shape)).astype(np.float32)[:, None]
    names = np.arange(n) if groups is None else np.arange(n) % groups
    return TrainingData((1, side, side), values, names, lambda rows: images[rows], ("x_mm",))


@pytest.fixture
def no_network(monkeypatch) -> None:
    monkeypatch.setattr(auto_model, "CANDIDATES", WITHOUT_NETWORK)


class Clock:
    """A clock that only those who work move on."""

    now = 0.0

    @classmethod
    def monotonic(cls) -> float:
        return cls.now


@dataclass(frozen=True)
class Slow:
    """Ten seconds a fit, and better than the mean since it knows the labels' law."""

    kind = Kind(side_px=24)

    def fit(self, data, rows, *, seed, progress=None, checkpoint=None):
        Clock.now += 10
        return _Places()


class _Places:
    def predict(self, inputs: np.ndarray) -> np.ndarray:
        return inputs.sum(axis=(1, 2)).argmax(axis=1).astype(float)[:, None]

    def to_onnx(self):
        raise NotImplementedError


def test_what_was_best_on_inner_folds_is_kept_and_each_is_told(no_network, rng) -> None:
    data, told = spots(150, rng), []
    fitted = AutoModel().fit(data, np.arange(120), seed=0, progress=lambda what, *_: told.append(what))
    errors = {trial.name: trial.error for trial in fitted.choice.trials}
    assert errors["mean"] == pytest.approx(1, abs=0.1)
    assert errors["kernel-ridge"] < errors["pca-ridge"] < errors["mean"]
    assert fitted.choice.chosen.startswith("kernel-ridge; ")
    assert any(f"{errors['kernel-ridge']:.3f}" in one for one in told)
    alone = make_model("kernel-ridge", {}).fit(data, np.arange(120), seed=0)
    watch = np.arange(120, 150)
    np.testing.assert_array_equal(predict_rows(fitted, data, watch), predict_rows(alone, data, watch))


def test_labels_without_a_law_are_chosen_for_no_better_than_the_mean(no_network, rng) -> None:
    data = spots(120, rng)
    shuffled = TrainingData(data.shape, rng.permutation(data.values), data.groups, data.fetch)
    fitted = AutoModel().fit(shuffled, np.arange(120), seed=0)
    assert min(trial.error for trial in fitted.choice.trials) > 0.93


def test_time_is_kept_to_a_candidates_step(monkeypatch, rng) -> None:
    slow = f"{__name__}:Slow"
    monkeypatch.setattr(auto_model, "CANDIDATES", ("mean", slow, "pca-ridge"))
    monkeypatch.setattr(auto_model, "time", Clock)
    data = spots(60, rng)
    for seconds, folds in ((25.0, 1), (40.0, 3), (100.0, 3)):
        Clock.now = 0.0
        fitted = AutoModel(minutes=seconds / 60).fit(data, np.arange(60), seed=0)
        mean, tried, last = fitted.choice.trials
        assert seconds == 100 or fitted.choice.chosen == slow
        assert tried.seconds == 10 * folds
        assert Clock.now <= seconds + 10
        assert (last.error is None) == (seconds < 100)
        assert ("no time" in last.note) == (seconds < 100)
        assert (f"1 of {auto_model.INNER_FOLDS}" in tried.note) == (folds == 1)
        assert mean.error is not None


def test_a_network_is_tried_where_the_time_allows(monkeypatch, rng) -> None:
    pytest.importorskip("torch", reason="the extra `train` is not installed")
    for name, value in (("MIN_EPOCHS", 2), ("MAX_EPOCHS", 2), ("MAX_MEMBERS", 1)):
        monkeypatch.setattr(auto_model, name, value)
    monkeypatch.setattr(auto_model, "CANDIDATES", ("mean", "compact-cnn"))
    data = spots(60, rng, side=64)
    tried = AutoModel(minutes=30.0).fit(data, np.arange(60), seed=0).choice.trials[1]
    assert tried.error is not None
    assert re.findall(r"\d+", tried.note) == ["2", "1"]  # epochs, members
    left = AutoModel(minutes=1e-3).fit(data, np.arange(60), seed=0).choice.trials[1]
    assert left.error is None
    assert left.note


def test_one_group_is_learnt_from_without_a_choice(no_network, rng) -> None:
    fitted = AutoModel().fit(spots(30, rng, groups=1), np.arange(30), seed=0)
    assert "one group" in fitted.choice.trials[0].note


def test_a_time_that_is_none_is_refused() -> None:
    for minutes in (0.0, float("inf"), float("nan")):
        with pytest.raises(InputError, match="minutes"):
            make_model("auto", {"minutes": minutes})
