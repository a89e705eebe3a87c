"""A multilayer perceptron on flattened pixels (scikit-learn), stopped when watched groups stop gaining."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import onnx
from sklearn.neural_network import MLPRegressor

from palpate.core import Float, Indices, InputError, Progress, Tensor, Values
from palpate.estimators.networks.model_interface import (
    BuiltInModel,
    Scaler,
    TrainingData,
    TrainingRecord,
    scaled_errors,
)
from palpate.estimators.networks.onnx_graph import OnnxGraph

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
