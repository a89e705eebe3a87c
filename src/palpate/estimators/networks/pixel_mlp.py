"""A multilayer perceptron on flattened pixels (scikit-learn), stopped when watched groups stop gaining."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
from onnx import helper
from sklearn.neural_network import MLPRegressor

from palpate.core import Float, Indices, Tensor, Values
from palpate.estimators.networks.model_interface import (
    Progress,
    Scaler,
    TrainingData,
    inner_validation,
    silent,
)
from palpate.estimators.networks.onnx_graph import image_to_value

Layers = list[tuple[Float[np.ndarray, "_ _"], Float[np.ndarray, " _"]]]


@dataclass(frozen=True, slots=True)
class FittedPerceptron:
    """Scaled pixels through dense layers with rectifiers between them, then scaled back."""

    shape: tuple[int, int, int]
    level: float
    contrast: float
    layers: Layers
    scaler: Scaler

    def predict(self, inputs: Tensor) -> Values:
        x = (inputs.reshape(len(inputs), -1) - self.level) / self.contrast
        for weights, bias in self.layers[:-1]:
            x = np.maximum(x @ weights + bias, 0.0)
        weights, bias = self.layers[-1]
        return self.scaler.restored((x @ weights + bias).astype(np.float64))

    def to_onnx(self) -> onnx.ModelProto:
        nodes = [helper.make_node("Flatten", ["image"], ["flat"])]
        nodes += [helper.make_node("Sub", ["flat", "level"], ["centred"])]
        nodes += [helper.make_node("Div", ["centred", "contrast"], ["x0"])]
        constants = {
            "level": np.array([self.level], np.float32),
            "contrast": np.array([self.contrast], np.float32),
            "scale": self.scaler.scale.astype(np.float32)[None, :],
            "mean": self.scaler.mean.astype(np.float32)[None, :],
        }
        last = len(self.layers) - 1
        for i, (weights, bias) in enumerate(self.layers):
            constants |= {f"w{i}": weights.astype(np.float32), f"b{i}": bias.astype(np.float32)}
            nodes += [helper.make_node("Gemm", [f"x{i}", f"w{i}", f"b{i}"], [f"y{i}"])]
            if i < last:
                nodes += [helper.make_node("Relu", [f"y{i}"], [f"x{i + 1}"])]
        nodes += [helper.make_node("Mul", [f"y{last}", "scale"], ["spread"])]
        nodes += [helper.make_node("Add", ["spread", "mean"], ["value"])]
        return image_to_value(nodes, constants, self.shape, len(self.scaler.mean))


@dataclass(frozen=True, slots=True)
class PixelMlp:
    """scikit-learn's MLPRegressor, fed a batch at a time so that no set is too large.

    Attributes:
        hidden: width of each hidden layer.
        epochs: passes over the rows, at most.
        patience: passes without gain on the watched groups before it stops.
        watched: share of the groups kept out of learning, to decide when to stop.
        batch: rows a step.
        learning_rate: Adam's step.
        penalty: L2 penalty on the weights.
    """

    hidden: tuple[int, ...] = (128,)
    epochs: int = 150
    patience: int = 12
    watched: float = 0.1
    batch: int = 64
    learning_rate: float = 5e-4
    penalty: float = 1e-2

    def fit(
        self,
        data: TrainingData,
        rows: Indices,
        *,
        seed: int,
        progress: Progress = silent,
        checkpoint: Path | None = None,
    ) -> FittedPerceptron:
        rng = np.random.default_rng(seed)
        learn, watch = inner_validation(data, rows, self.watched, rng)
        first = data.sample(learn, 1000, rng)
        level, contrast = float(first.mean()), float(first.std()) or 1.0
        scaler = Scaler.of(data.values[learn])
        network = MLPRegressor(
            hidden_layer_sizes=self.hidden,
            alpha=self.penalty,
            learning_rate_init=self.learning_rate,
            random_state=seed,
        )
        best, best_error, since = None, np.inf, 0
        for epoch in range(self.epochs):
            self._pass(network, data, rng.permutation(learn), level, contrast, scaler)
            progress("learning", epoch + 1, self.epochs)
            now = FittedPerceptron(data.shape, level, contrast, _layers(network), scaler)
            error = self._error(now, data, watch) if len(watch) else float(network.loss_)
            if error < best_error:
                best, best_error, since = now, error, 0
            else:
                since += 1
            if since >= self.patience:
                break
        progress("learning", self.epochs, self.epochs)
        assert best is not None
        return best

    def _pass(
        self,
        network: MLPRegressor,
        data: TrainingData,
        rows: Indices,
        level: float,
        contrast: float,
        scaler: Scaler,
    ) -> None:
        for part, inputs in data.batches(rows, 16 * self.batch):
            pixels = (inputs.reshape(len(part), -1) - level) / contrast
            targets = scaler.scaled(data.values[part]).astype(np.float32)
            network.set_params(batch_size=min(self.batch, len(part)))
            network.partial_fit(pixels, targets[:, 0] if targets.shape[1] == 1 else targets)

    def _error(self, fitted: FittedPerceptron, data: TrainingData, rows: Indices) -> float:
        errors = [
            fitted.scaler.scaled(fitted.predict(inputs)) - fitted.scaler.scaled(data.values[part])
            for part, inputs in data.batches(rows)
        ]
        return float(np.mean(np.concatenate(errors) ** 2))


def _layers(network: MLPRegressor) -> Layers:
    return [(w.copy(), b.copy()) for w, b in zip(network.coefs_, network.intercepts_, strict=True)]
