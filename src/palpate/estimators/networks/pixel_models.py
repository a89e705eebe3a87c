"""Models of the plain pixels: the mean, ridge regression on principal components, and a perceptron."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import onnx
from scipy.linalg import eigh
from sklearn.linear_model import Ridge
from sklearn.model_selection import GroupKFold
from sklearn.neural_network import MLPRegressor

from palpate.core import Float, Float32, Indices, InputError, Progress, Tensor, Values
from palpate.estimators.networks.model_interface import (
    BuiltInModel,
    Scaler,
    TrainingData,
    TrainingRecord,
    scaled_errors,
)
from palpate.estimators.networks.onnx_graph import OnnxGraph


@dataclass(frozen=True, slots=True)
class FittedLinear:
    """value = (image - centre) · weights + offset."""

    shape: tuple[int, int, int]
    centre: Float32[np.ndarray, " k"]
    weights: Float32[np.ndarray, "k t"]
    offset: Float[np.ndarray, " t"]

    def predict(self, inputs: Tensor) -> Values:
        flat = inputs.reshape(len(inputs), -1) - self.centre
        return (flat @ self.weights).astype(np.float64) + self.offset

    def to_onnx(self) -> onnx.ModelProto:
        graph = OnnxGraph()
        flat = graph.add("Flatten", ["image"])
        difference = graph.add("Sub", [flat], {"centre": self.centre[None, :]})
        weights = {"weights": self.weights, "offset": self.offset.astype(np.float32)}
        graph.add("Gemm", [difference], weights, output="value")
        return graph.model(self.shape, len(self.offset))


@dataclass(frozen=True, slots=True)
class MeanBaseline(BuiltInModel):
    """Mean of the training set, the baseline of every model."""

    def _fit(
        self, data: TrainingData, rows: Indices, seed: int, progress: Progress, checkpoint: Path | None
    ) -> FittedLinear:
        pixels, mean = math.prod(data.shape), data.values[rows].mean(axis=0)
        nothing = np.zeros((pixels, len(mean) + 1), np.float32)
        return FittedLinear(data.shape, nothing[:, 0], nothing[:, 1:], mean)


def principal_axes(centred: Float32[np.ndarray, "n p"], most: int) -> Float32[np.ndarray, "p k"]:
    """Return the principal axes of centered rows; a common scale gives the first unit variance.

    Computed from the smaller product matrix. Axes with less than a millionth of the first variance are
    omitted. Axes are not whitened, because with as many axes as rows all rows would be equally far apart.
    """
    n, p = centred.shape
    products = centred @ centred.T if n <= p else centred.T @ centred
    size = len(products)
    squares, vectors = eigh(
        products.astype(np.float64), subset_by_index=[max(0, size - min(most, n - 1)), size - 1]
    )
    kept = squares > 1e-6 * squares[-1]
    squares, vectors = squares[kept][::-1], vectors[:, kept][:, ::-1].astype(np.float32)
    axes = centred.T @ vectors / np.sqrt(squares) if n <= p else vectors
    return (axes * np.sqrt((n - 1) / squares[0])).astype(np.float32)


@dataclass(frozen=True, slots=True)
class PcaRidge(BuiltInModel):
    """PCA, then ridge regression with a penalty chosen by inner folds of whole groups.

    Attributes:
        components: Greatest number of principal components.
        basis_frames: Greatest number of frames that they are computed from.
        penalties: Ridge penalties, where the first component has unit variance.
    """

    components: int = 300
    basis_frames: int = 2000
    penalties: tuple[float, ...] = tuple(float(p) for p in np.logspace(-4, 4, 17))

    def __post_init__(self) -> None:
        if self.components < 1 or self.basis_frames < 2 or not min(self.penalties, default=0) > 0:
            raise InputError(
                f"pca-ridge: components {self.components}, basis_frames {self.basis_frames}; allowed: 1, 2 "
                "or more, penalties above 0"
            )

    def _fit(
        self, data: TrainingData, rows: Indices, seed: int, progress: Progress, checkpoint: Path | None
    ) -> FittedLinear:
        rng = np.random.default_rng(seed)
        basis = data.sample(rows, self.basis_frames, rng).reshape(-1, math.prod(data.shape))
        centre = basis.mean(axis=0)
        axes = principal_axes(basis - centre, self.components)
        scores = self._scores(centre, axes, data, rows, progress)
        scaler = Scaler.of(data.values[rows])
        targets = scaler.scaled(data.values[rows])
        penalty = self._penalty(scores, targets, data.groups[rows])
        ridge = Ridge(alpha=penalty).fit(scores, targets)
        weights = axes @ (ridge.coef_.reshape(len(scaler.scale), -1).T * scaler.scale)
        return FittedLinear(
            data.shape,
            centre,
            weights.astype(np.float32),
            scaler.restored(np.atleast_2d(ridge.intercept_))[0],
        )

    def _scores(
        self,
        centre: Float32[np.ndarray, " p"],
        axes: Float32[np.ndarray, "p k"],
        data: TrainingData,
        rows: Indices,
        progress: Progress,
    ) -> Float[np.ndarray, "n k"]:
        parts = []
        for part, inputs in data.batches(rows):
            parts.append(((inputs.reshape(len(part), -1) - centre) @ axes).astype(np.float64))
            progress("projecting", sum(map(len, parts)), len(rows))
        return np.concatenate(parts)

    def _penalty(self, scores: Float[np.ndarray, "n k"], targets: Values, groups: np.ndarray) -> float:
        folds = min(4, len(np.unique(groups)))
        if folds < 2:
            return float(np.median(self.penalties))
        errors = np.zeros(len(self.penalties))
        for learn, watch in GroupKFold(folds).split(scores, groups=groups):
            centre, mean = scores[learn].mean(axis=0), targets[learn].mean(axis=0)
            # One decomposition serves all penalties: weights are V s / (s^2 + penalty) U^T y.
            left, s, right = np.linalg.svd(scores[learn] - centre, full_matrices=False)
            told = left.T @ (targets[learn] - mean)
            ways = (scores[watch] - centre) @ right.T
            for i, penalty in enumerate(self.penalties):
                guess = mean + (ways * (s / (s**2 + penalty))) @ told
                errors[i] += float(np.sum((guess - targets[watch]) ** 2))
        return self.penalties[int(np.argmin(errors))]


NOT_TRAINED = TrainingRecord(0, 0, 0)


@dataclass(frozen=True, slots=True)
class FittedPerceptron:
    """Scaled pixels (x - level) / contrast through dense layers with rectifiers, then scaled back."""

    shape: tuple[int, int, int]
    level: float
    contrast: float
    scaler: Scaler
    layers: tuple[tuple[Float[np.ndarray, "_ _"], Float[np.ndarray, " _"]], ...] = ()
    training: TrainingRecord = NOT_TRAINED

    def pixels(self, inputs: Tensor) -> Float[np.ndarray, "n k"]:
        return (inputs.reshape(len(inputs), -1) - self.level) / self.contrast

    def predict(self, inputs: Tensor) -> Values:
        x = self.pixels(inputs)
        for weights, bias in self.layers[:-1]:
            x = np.maximum(x @ weights + bias, 0.0)
        weights, bias = self.layers[-1]
        return self.scaler.restored((x @ weights + bias).astype(np.float64))

    def to_onnx(self) -> onnx.ModelProto:
        graph = OnnxGraph()
        at = graph.centred(graph.add("Flatten", ["image"]), self.level, self.contrast)
        for i, (weights, bias) in enumerate(self.layers):
            at = graph.add("Relu", [at]) if i else at
            at = graph.add("Gemm", [at], {"w": weights.astype(np.float32), "b": bias.astype(np.float32)})
        graph.restored(at, self.scaler.scale, self.scaler.mean, output="value")
        return graph.model(self.shape, len(self.scaler.mean))


@dataclass(frozen=True, slots=True)
class PixelMlp(BuiltInModel):
    """scikit-learn's MLPRegressor, trained batch by batch.

    Attributes:
        hidden: Width of each hidden layer.
        epochs: Greatest number of passes.
        patience: Passes without gain on the watched groups before it stops.
        watched: Ratio of the groups watched.
        penalty: L2 penalty on the weights.
        steps: Adam steps in place of `epochs` and `patience`; 0 for none.
    """

    hidden: tuple[int, ...] = (128,)
    epochs: int = 150
    patience: int = 12
    watched: float = 0.1
    batch: int = 64
    learning_rate: float = 5e-4
    penalty: float = 1e-2
    steps: int = 0

    def __post_init__(self) -> None:
        whole = (self.epochs, self.patience, self.batch, *self.hidden)
        positive = min(whole) >= 1 and self.learning_rate > 0
        if not (positive and 0 < self.watched < 1 and self.penalty >= 0 and self.steps >= 0):
            raise InputError(
                f"{self}: epochs, patience, batch, hidden 1 or more, watched 0 to 1, learning rate above 0, "
                "penalty and steps 0 or more"
            )

    def _fit(
        self, data: TrainingData, rows: Indices, seed: int, progress: Progress, checkpoint: Path | None
    ) -> FittedPerceptron:
        rng = np.random.default_rng(seed)
        learn, watch = data.inner_validation(rows, self.watched, rng)
        first = data.sample(learn, 1000, rng)
        contrast, scaler = float(first.std()) or 1.0, Scaler.of(data.values[learn])
        untrained = FittedPerceptron(data.shape, float(first.mean()), contrast, scaler)
        network = MLPRegressor(
            hidden_layer_sizes=self.hidden,
            alpha=self.penalty,
            learning_rate_init=self.learning_rate,
            random_state=seed,
        )
        best, best_error, since, each = None, np.inf, 0, -(-len(learn) // self.batch)
        epochs = -(-self.steps // each) or self.epochs
        patience = epochs if self.steps else self.patience
        for epoch in range(epochs):
            self._pass(network, untrained, data, rng.permutation(learn))
            progress("learning", epoch + 1, epochs)
            layers = zip(network.coefs_, network.intercepts_, strict=True)
            now = replace(untrained, layers=tuple((w.copy(), b.copy()) for w, b in layers))
            watched = scaled_errors(now, scaler, data, watch)
            error = float(np.mean(watched**2)) if len(watch) else float(network.loss_)
            if error < best_error:
                best, best_error, since, best_epoch = now, error, 0, epoch + 1
            else:
                since += 1
            if since >= patience:
                break
        progress("learning", epochs, epochs)
        assert best is not None
        record = TrainingRecord(
            each * (epoch + 1), epoch + 1, self.batch, each * best_epoch, since >= patience
        )
        return replace(best, training=record)

    def _pass(
        self, network: MLPRegressor, scales: FittedPerceptron, data: TrainingData, rows: Indices
    ) -> None:
        for part, inputs in data.batches(rows, 16 * self.batch):
            targets = scales.scaler.scaled(data.values[part]).astype(np.float32)
            network.set_params(batch_size=min(self.batch, len(part)))
            network.partial_fit(scales.pixels(inputs), targets[:, 0] if targets.shape[1] == 1 else targets)
