"""Every model learns what a linear map of the image can tell, and leaves as the same map."""

import numpy as np
import onnxruntime
import pytest
from tests.refusals import refused
from tests.slow_params import mostly_slow

from palpate.core.errors import InputError
from palpate.estimators.networks import MODELS, make_model
from palpate.estimators.networks.model_interface import Scaler, TrainingData, predict_rows

SHAPE = (1, 32, 32)
# Those of fixed targets are tested beside this file, with the images and names that they ask for.
ANY_TARGETS = [name for name, kind in MODELS.items() if not kind.targets]
LEARN = [name for name in ANY_TARGETS if name != "mean"]
QUICK = {"pixel-mlp": {"epochs": 25}, "compact-cnn": {"epochs": 6, "widths": (8, 16, 16), "shift_px": 1}}


def blobs(n: int, rng: np.random.Generator, channels: int = 1) -> TrainingData:
    """A bright spot whose place and brightness are the values."""
    rows, columns = np.mgrid[0:32, 0:32]
    place, level = rng.uniform(8, 24, n), rng.uniform(60, 200, n)
    spots = level[:, None, None] * np.exp(-((columns - place[:, None, None]) ** 2 + (rows - 16) ** 2) / 18)
    images = (spots + rng.normal(0, 2, spots.shape)).astype(np.float32)[:, None]
    images = np.repeat(images, channels, axis=1)
    values = np.stack([place, level], axis=1)
    return TrainingData((channels, 32, 32), values, np.arange(n), lambda chosen: images[chosen])


def needs_torch(name: str) -> None:
    if name == "compact-cnn":
        pytest.importorskip("torch", reason="the extra `train` is not installed")


@pytest.mark.parametrize("name", ANY_TARGETS)
def test_the_exported_model_is_the_trained_one(name: str, rng: np.random.Generator) -> None:
    needs_torch(name)
    data = blobs(80, rng, 3)
    fitted = make_model(name, QUICK.get(name, {})).fit(data, np.arange(60), seed=1)
    inputs = data.fetch(np.arange(60, 80))
    session = onnxruntime.InferenceSession(
        fitted.to_onnx().SerializeToString(), providers=["CPUExecutionProvider"]
    )
    (exported,) = session.run(["value"], {"image": inputs})
    span = np.ptp(data.values, axis=0)
    assert np.max(np.abs(exported - fitted.predict(inputs)) / span) < 1e-4
    (one,) = session.run(["value"], {"image": inputs[:1]})
    np.testing.assert_allclose(one, exported[:1], rtol=1e-5)


@pytest.mark.parametrize("name", mostly_slow(LEARN, lambda i: LEARN[i] not in ("compact-cnn", "auto")))
def test_a_model_beats_the_mean_on_rows_it_has_not_seen(name: str, rng: np.random.Generator) -> None:
    needs_torch(name)
    data = blobs(400, rng)
    learn, held = np.arange(320), np.arange(320, 400)
    options = QUICK.get(name, {}) | ({"epochs": 30} if name == "compact-cnn" else {})
    fitted = make_model(name, options).fit(data, learn, seed=0)
    error = np.abs(predict_rows(fitted, data, held) - data.values[held]).mean(axis=0)
    by_mean = np.abs(data.values[learn].mean(axis=0) - data.values[held]).mean(axis=0)
    # A spot's place and level are written plainly into the image: four times better is a low bar.
    assert (error < by_mean / 4).all()


@pytest.mark.parametrize("name", ANY_TARGETS)
def test_the_same_seed_gives_the_same_model(name: str, rng: np.random.Generator) -> None:
    needs_torch(name)
    data = blobs(64, rng)
    first, again = (
        make_model(name, QUICK.get(name, {}))
        .fit(data, np.arange(64), seed=3)
        .predict(data.fetch(np.arange(8)))
        for _ in range(2)
    )
    np.testing.assert_array_equal(first, again)


def test_a_network_interrupted_goes_on_to_the_same_weights(rng, tmp_path) -> None:
    pytest.importorskip("torch", reason="the extra `train` is not installed")
    data, rows = blobs(64, rng), np.arange(64)
    model = make_model("compact-cnn", {"epochs": 4, "members": 2, "widths": (8, 8)})
    whole = model.fit(data, rows, seed=5).predict(data.fetch(rows))

    class Interrupted(Exception):
        pass

    def stop(what: str, done: int, total: int) -> None:
        if done == 6:
            raise Interrupted

    kept = tmp_path / "fold.npz"
    with pytest.raises(Interrupted):
        model.fit(data, rows, seed=5, progress=stop, checkpoint=kept)
    resumed = model.fit(data, rows, seed=5, checkpoint=kept).predict(data.fetch(rows))
    np.testing.assert_array_equal(whole, resumed)


def test_early_stopping_keeps_the_best_and_ends_before_the_last_epoch(rng) -> None:
    pytest.importorskip("torch", reason="the extra `train` is not installed")
    data, seen = blobs(60, rng), []
    noise = TrainingData(data.shape, rng.normal(size=data.values.shape), data.groups, data.fetch)
    model = make_model("compact-cnn", {"epochs": 40, "members": 1, "widths": (8, 8), "patience": 3})
    model.fit(noise, np.arange(60), seed=0, progress=lambda what, done, total: seen.append(done))
    # Noise cannot be learnt, so the watched error soon stops falling; the last call says it is done.
    assert len(seen) < 30
    assert seen[-1] == 40


def test_an_input_too_small_for_the_network_is_refused(rng) -> None:
    pytest.importorskip("torch", reason="the extra `train` is not installed")
    with refused("input-size", InputError):
        make_model("compact-cnn", {}).fit(blobs(40, rng), np.arange(40), seed=0)


def test_a_damaged_checkpoint_is_not_trusted(rng, tmp_path) -> None:
    pytest.importorskip("torch", reason="the extra `train` is not installed")
    data, rows = blobs(64, rng), np.arange(64)
    model = make_model("compact-cnn", {"epochs": 2, "widths": (8, 8)})
    kept = tmp_path / "fold.npz"
    (tmp_path / "fold-0.npz").write_bytes(b"PK not a checkpoint")
    begun_anew = model.fit(data, rows, seed=5, checkpoint=kept)
    np.testing.assert_array_equal(
        begun_anew.predict(data.fetch(rows)), model.fit(data, rows, seed=5).predict(data.fetch(rows))
    )


def test_early_stopping_watches_whole_groups(rng: np.random.Generator) -> None:
    data = blobs(60, rng)
    grouped = TrainingData(data.shape, data.values, np.repeat(np.arange(12), 5), data.fetch)
    learn, watch = grouped.inner_validation(np.arange(60), 0.25, rng)
    assert len(watch) == 15
    assert not set(grouped.groups[learn]) & set(grouped.groups[watch])
    assert sorted([*learn, *watch]) == list(range(60))
    alone = TrainingData(data.shape, data.values, np.zeros(60), data.fetch)
    learn, watch = alone.inner_validation(np.arange(60), 0.1, rng)
    assert (len(learn), len(watch)) == (60, 0)


def test_a_scaler_undoes_itself(rng: np.random.Generator) -> None:
    values = rng.normal(3, 5, (50, 2))
    scaler = Scaler.of(values)
    np.testing.assert_allclose(scaler.restored(scaler.scaled(values)), values)
    np.testing.assert_allclose(scaler.scaled(values).std(axis=0), 1.0)


@pytest.mark.parametrize(
    ("name", "options", "code"),
    [("resnet", {}, "unknown-name"), ("pca-ridge", {"componets": 3}, "option-unknown")],
)
def test_a_wrong_name_is_answered_with_the_right_ones(name: str, options: dict, code: str) -> None:
    with refused(code, InputError):
        make_model(name, options)
