"""The mean of the training set: what any other model must beat."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
from onnx import helper

from palpate.core import Float, Indices, Tensor, Values
from palpate.estimators.networks.model_interface import Progress, TrainingData, silent
from palpate.estimators.networks.onnx_graph import image_to_value


@dataclass(frozen=True, slots=True)
class FittedMeanBaseline:
    """The same values whatever the image."""

    shape: tuple[int, int, int]
    mean: Float[np.ndarray, " t"]

    def predict(self, inputs: Tensor) -> Values:
        return np.tile(self.mean, (len(inputs), 1))

    def to_onnx(self) -> onnx.ModelProto:
        # Averaging c and h leaves [n w]; w is averaged last and kept, so that [n 1] meets [1 t].
        nodes = [
            helper.make_node("ReduceMean", ["image", "axes"], ["rows"], keepdims=0),
            helper.make_node("ReduceMean", ["rows", "last"], ["level"], keepdims=1),
            helper.make_node("Mul", ["level", "zero"], ["nothing"]),
            helper.make_node("Add", ["nothing", "mean"], ["value"]),
        ]
        constants: dict[str, np.ndarray] = {
            "axes": np.array([1, 2], dtype=np.int64),
            "last": np.array([1], dtype=np.int64),
            "zero": np.zeros(1, dtype=np.float32),
            "mean": self.mean.astype(np.float32)[None, :],
        }
        return image_to_value(nodes, constants, self.shape, len(self.mean))


@dataclass(frozen=True, slots=True)
class MeanBaseline:
    """Learns nothing but the mean."""

    def fit(
        self,
        data: TrainingData,
        rows: Indices,
        *,
        seed: int,
        progress: Progress = silent,
        checkpoint: Path | None = None,
    ) -> FittedMeanBaseline:
        return FittedMeanBaseline(data.shape, data.values[rows].mean(axis=0))
