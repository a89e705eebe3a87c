"""Kernel ridge regression: its formulas against independent ones, its choice by whole groups, its bounds."""

import numpy as np
import onnxruntime
import pytest
from sklearn.gaussian_process.kernels import Matern
from sklearn.kernel_ridge import KernelRidge as SklearnKernelRidge
from sklearn.model_selection import GroupKFold

from palpate.core import InputError
from palpate.estimators.networks import TrainingData, make_model
from palpate.estimators.networks.image_features import PinMoments, pin_moments
from palpate.estimators.networks.kernel_ridge import (
    Kernel,
    KernelRidge,
    KernelShape,
    learnt_metric,
    solve,
)
from palpate.estimators.networks.model_interface import predict_rows

SIDE = 48


def pin_images(moves: np.ndarray, *, level: float = 200.0, dark: bool = False) -> np.ndarray:
    """A square lattice of round pins whose middle ones are moved by so much [px], right and down."""
    ys, xs = np.mgrid[0:SIDE, 0:SIDE]
    places = np.stack(np.meshgrid(np.arange(6, 46, 9.0), np.arange(6, 46, 9.0)), -1).reshape(-1, 2)
    near = np.exp(-((places - 24) ** 2).sum(axis=1) / 400)
    images = []
    for move in moves:
        at = places + near[:, None] * move
        apart = np.hypot(xs[..., None] - at[:, 0], ys[..., None] - at[:, 1])
        spots = np.clip(3.0 - apart, 0, 1).sum(axis=-1)
        images.append(240 - level * spots if dark else 10 + level * spots)
    return np.array(images, np.float32)[:, None]


def pressed(n: int, rng: np.random.Generator, groups: int | None = None) -> TrainingData:
    """Pins that move by what is not linear in the targets."""
    values = rng.uniform(-1, 1, (n, 2))
    moves = 6 * np.stack([np.sin(1.4 * values[:, 0]), values[:, 1] * (1 + 0.5 * values[:, 0])], axis=1)
    images = pin_images(moves) + rng.normal(0, 3, (n, 1, SIDE, SIDE)).astype(np.float32)
    images = np.clip(np.round(images), 0, 255).astype(np.float32)
    names = np.arange(n) if groups is None else np.arange(n) % groups
    return TrainingData(images.shape[1:], values, names, lambda rows: images[rows], ("x_mm", "y_mm"))


def held_out_errors(name: str, data: TrainingData, options: dict | None = None) -> np.ndarray:
    """Root mean square errors on held-out groups in units of the spread."""
    rows, found = np.arange(len(data.values)), np.empty_like(data.values)
    for learn, watch in GroupKFold(3).split(rows, groups=data.groups):
        found[watch] = predict_rows(make_model(name, options or {}).fit(data, learn, seed=0), data, watch)
    return np.sqrt(((found - data.values) ** 2).mean(axis=0)) / data.values.std(axis=0)


def exported(fitted, inputs: np.ndarray) -> np.ndarray:
    session = onnxruntime.InferenceSession(
        fitted.to_onnx().SerializeToString(), providers=["CPUExecutionProvider"]
    )
    return session.run(["value"], {"image": inputs})[0]


def test_the_kernel_is_materns_with_a_linear_share(rng) -> None:
    a, b = rng.normal(size=(7, 3)), rng.normal(size=(5, 3))
    oracle = Matern(length_scale=1.7, nu=2.5)(a, b)
    np.testing.assert_allclose(Kernel(1.7).of(a, b), oracle, rtol=1e-9)
    np.testing.assert_allclose(Kernel(1.7, 0.3).of(a, b), oracle + 0.3 * a @ b.T, rtol=1e-9)


def test_gradients_are_those_of_finite_differences(rng) -> None:
    a, dual, kernel = rng.normal(size=(9, 3)), rng.normal(size=9), Kernel(1.3, 0.2)
    step = 1e-5
    for j in range(3):
        move = step * np.eye(3)[j]
        change = (kernel.of(a + move, a) @ dual - kernel.of(a - move, a) @ dual) / (2 * step)
        np.testing.assert_allclose(kernel.gradients(a, dual)[:, j], change, atol=1e-6)


def test_weights_are_scikit_learns_for_each_targets_own_penalty(rng) -> None:
    scores, targets, kernel = rng.normal(size=(40, 3)), rng.normal(size=(40, 2)), Kernel(1.5, 0.1)
    dual = solve(kernel, scores, targets, np.arange(40), np.array([0.1, 2.0]))
    for j, penalty in enumerate((0.1, 2.0)):
        oracle = SklearnKernelRidge(alpha=penalty, kernel="precomputed").fit(
            kernel.of(scores, scores), targets
        )
        np.testing.assert_allclose(dual[:, j], oracle.dual_coef_[:, j], rtol=1e-5, atol=1e-6)


def test_fewer_centres_that_span_all_rows_lose_nothing(rng) -> None:
    half, kernel, penalties = rng.normal(size=(50, 3)), Kernel(1.5), np.array([0.1, 1.0])
    twice, targets = np.concatenate([half, half]), rng.normal(size=(100, 2))
    exact = kernel.of(half, twice) @ solve(kernel, twice, targets, np.arange(100), penalties)
    fewer = kernel.of(half, half) @ solve(kernel, twice, targets, np.arange(50), penalties, batch=7)
    np.testing.assert_allclose(fewer, exact, atol=1e-5)


def test_a_learnt_metric_counts_only_what_the_targets_change_by(rng) -> None:
    scores = rng.normal(size=(200, 4))
    targets = np.sin(scores[:, :1])
    turn = learnt_metric(scores, targets / targets.std(), KernelShape(), np.array([1e-2]))
    squares = np.diag(turn @ turn.T)
    assert squares[0] > 10 * squares[1:].max()


@pytest.mark.parametrize(
    "options",
    [
        {"blurs_px": (2.0,), "pin_windows": (), "widths": (1.0,), "linear_shares": (1.0,)},
        {"blurs_px": (12.0,), "pin_windows": (0.3,), "widths": (1.0,)},
    ],
)
def test_the_exported_model_is_the_fitted_one_for_pixels_lines_and_pins(options, rng) -> None:
    data = pressed(80, rng)
    fitted = make_model("kernel-ridge", options).fit(data, np.arange(60), seed=0)
    inputs = data.fetch(np.arange(60, 80))
    apart = np.abs(exported(fitted, inputs) - fitted.predict(inputs)) / np.ptp(data.values, axis=0)
    assert apart.max() < 1e-5


def test_targets_of_other_features_keep_their_columns(rng) -> None:
    # What is left of the first target is in fine stripes, of the second in a broad wave.
    values, (ys, xs) = rng.uniform(-1, 1, (160, 2)), np.mgrid[0:SIDE, 0:SIDE]
    fine, broad = 20.0 * (-1) ** xs, 60 * np.cos(np.pi * ys / SIDE)
    images = 128 + values[:, :1, None, None] * fine + values[:, 1:, None, None] * broad
    images = (images + rng.normal(0, 40, (160, 1, SIDE, SIDE))).astype(np.float32)
    data = TrainingData((1, SIDE, SIDE), values, np.arange(160), lambda rows: images[rows])
    fitted = make_model("kernel-ridge", {"blurs_px": (0.0, 8.0)}).fit(data, np.arange(120), seed=0)
    assert len(fitted.maps) == 2
    watch = np.arange(120, 160)
    assert (np.abs(predict_rows(fitted, data, watch) - values[watch]).mean(axis=0) < 0.1).all()
    assert np.abs(exported(fitted, images[watch]) - fitted.predict(images[watch])).max() < 1e-4


def test_pressed_pins_are_read_better_than_by_the_mean_and_by_a_linear_map(rng) -> None:
    data = pressed(240, rng, groups=60)
    ours, linear, mean = (held_out_errors(name, data) for name in ("kernel-ridge", "pca-ridge", "mean"))
    assert (mean > 0.95).all()
    assert ours.mean() < 0.75 * linear.mean()
    assert (ours < 0.1).all()


def test_shuffled_labels_are_read_no_better_than_by_the_mean(rng) -> None:
    data = pressed(120, rng)
    shuffled = TrainingData(data.shape, rng.permutation(data.values), data.groups, data.fetch)
    ours, mean = (held_out_errors(name, shuffled) for name in ("kernel-ridge", "mean"))
    assert (ours > 0.97 * mean).all()


def test_the_choice_holds_out_whole_groups(rng) -> None:
    # Each group is one picture and one label by chance: a row's twin tells its label, another group nothing.
    one_each = pressed(40, rng)
    values, images = rng.normal(size=(40, 1)), one_each.fetch(np.arange(40))
    groups = np.repeat(np.arange(40), 4)
    data = TrainingData(one_each.shape, values[groups], groups, lambda rows: images[groups[rows]])
    errors = [trial.error for trial in KernelRidge().fit(data, np.arange(160), seed=0).choice.trials]
    assert min(errors) > 0.9


@pytest.mark.parametrize("dark", [False, True])
def test_centroids_follow_pins_right_and_down_and_no_lamp(dark: bool) -> None:
    rest, right, down = (pin_images(np.array([m]), dark=dark) for m in ((0, 0), (1.0, 0), (0, 1.0)))
    sample = pin_images(np.zeros((5, 2)), dark=dark)
    (moments,) = pin_moments(sample, (0.25,))
    assert isinstance(moments, PinMoments)
    middle = int(np.argmin((moments.columns - 24) ** 2 + (moments.rows - 24) ** 2))

    def centroid(images: np.ndarray) -> np.ndarray:
        return moments.compute(images).reshape(3, -1)[1:, middle] - still

    still = np.zeros(2)
    still = centroid(rest)
    (x, y), (u, v) = centroid(right), centroid(down)
    assert x > 0.1 > 5 * abs(y)
    assert v > 0.1 > 5 * abs(u)
    if not dark:
        dimmed = centroid(0.8 * right)
        assert abs(dimmed[0] - x) < 0.1 * x


def test_settings_out_of_range_are_refused() -> None:
    wrong = {"widths": (0.0,), "penalties": (), "blurs_px": (-1.0,), "components": 0, "pin_windows": (0.0,)}
    for name, value in wrong.items():
        with pytest.raises(InputError):
            make_model("kernel-ridge", {name: value})
