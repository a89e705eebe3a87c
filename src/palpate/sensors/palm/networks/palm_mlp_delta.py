"""Perceptron on the pixels of the fringe difference: the baseline that shows the value of convolution."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import onnx
from onnx import helper, numpy_helper

from palpate.core import Indices, InputError, Progress, Tensor, Values, silent
from palpate.estimators.networks.model_interface import TrainingData, TrainingRecord
from palpate.estimators.networks.onnx_graph import image_to_value
from palpate.estimators.networks.pixel_mlp import FittedPerceptron, PixelMlp
from palpate.sensors.palm.networks import FORCES
from palpate.sensors.palm.networks.palm_training import columns_of, half_width

MAX_BATCH = 200


@dataclass(frozen=True, slots=True)
class FittedPalmMlp:
    """A perceptron on the left half of the image."""

    perceptron: FittedPerceptron
    shape: tuple[int, int, int]

    @property
    def training(self) -> TrainingRecord:
        return self.perceptron.training

    def predict(self, inputs: Tensor) -> Values:
        return self.perceptron.predict(np.ascontiguousarray(inputs[..., : half_width(self.shape)]))

    def to_onnx(self) -> onnx.ModelProto:
        inner = self.perceptron.to_onnx().graph
        nodes = list(inner.node)
        nodes[0].input[0] = "fringe"
        cut = helper.make_node("Slice", ["image", "first", "end", "axis"], ["fringe"])
        bounds = {"first": 0, "end": half_width(self.shape), "axis": 3}
        constants = {part.name: numpy_helper.to_array(part) for part in inner.initializer}
        constants |= {name: np.array([at], np.int64) for name, at in bounds.items()}
        return image_to_value([cut, *nodes], constants, self.shape, len(self.perceptron.scaler.mean))


@dataclass(frozen=True, slots=True)
class PalmMlpDelta:
    """Multilayer perceptron for differential grey crops; options as in `PixelMlp`.

    Unspecified hyperparameters are scikit-learn's defaults. As in `PixelMlp`, early stopping watches whole
    groups and targets are standardised.
    """

    hidden: tuple[int, ...] = (100,)
    epochs: int = 2000
    patience: int = 20
    watched: float = 0.1
    learning_rate: float = 1e-3
    penalty: float = 1e-4
    steps: int = 0

    targets: ClassVar[tuple[str, ...]] = FORCES

    def __post_init__(self) -> None:
        if min(self.epochs, self.patience, self.steps + 1) < 1:
            raise InputError(
                f"epochs {self.epochs}, patience {self.patience}, steps {self.steps}: epochs and patience "
                "are 1 or more, steps 0 (none stated) or more"
            )

    def fit(
        self,
        data: TrainingData,
        rows: Indices,
        *,
        seed: int,
        progress: Progress = silent,
        checkpoint: Path | None = None,
    ) -> FittedPalmMlp:
        columns_of(self.targets, data.names, type(self).__name__)
        half = half_width(data.shape)

        def fringes(chosen: Indices) -> Tensor:
            return np.ascontiguousarray(data.fetch(chosen)[..., :half])

        seen = replace(data, shape=(*data.shape[:2], half), fetch=fringes)
        perceptron = PixelMlp(**asdict(self), batch=min(MAX_BATCH, len(rows)))
        return FittedPalmMlp(perceptron.fit(seen, rows, seed=seed, progress=progress), data.shape)
