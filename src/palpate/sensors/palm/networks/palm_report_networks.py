"""The report's networks. Sizes that it does not state: heads with one hidden layer of 256 (ReLU).

Joint: z = [ResNet18(fringe), ResNet18(mirror)] of raw color crops; one head estimates the force, another the
position, with equal mean squared errors. Force-conditioned: on differences; the normal force from z, the
position from [z, sg(F_z)], where sg stops the gradient. Two-stage: d = ResNet18(fringe difference), (x, y) =
ResNet18(mirror difference), grey; then (F_x, F_y, F_z, |F|) = MLP(d, x, y) with two hidden layers of 64.
Huber losses with weights 1, trained jointly.

Perceptron on the pixels of the fringe difference: the baseline that shows the value of convolution.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import onnx
from onnx import helper, numpy_helper

from palpate.core import Indices, InputError, Progress, Tensor, Values, silent
from palpate.core.optional_imports import optional_imports
from palpate.estimators.networks.model_interface import TrainingData, TrainingRecord
from palpate.estimators.networks.onnx_graph import image_to_value
from palpate.estimators.networks.pixel_models import FittedPerceptron, PixelMlp
from palpate.estimators.networks.resnet import FEATURES, ResNet18
from palpate.estimators.networks.torch_export import TorchGraph
from palpate.sensors.palm.networks import FORCES, PLACE
from palpate.sensors.palm.networks.palm_training import (
    DEPTH,
    MAGNITUDE,
    PalmModel,
    PalmNetwork,
    Scales,
    TwoTrunks,
    columns_of,
    dense,
    half_width,
)

with optional_imports("A network of the palm"):
    import torch
    from torch import nn
    from torch.nn import functional

HIDDEN = 256


class JointNetwork(TwoTrunks):
    """F = h_F(z), (x, y) = h_L(z)."""

    def __init__(self, channels: int, scales: Scales) -> None:
        super().__init__(channels, scales)
        self.force = dense((2 * FEATURES, HIDDEN, len(FORCES)))
        self.place = dense((2 * FEATURES, HIDDEN, len(PLACE)))

    def answer(self, fringe: torch.Tensor, mirror: torch.Tensor) -> torch.Tensor:
        z = self.joint(fringe, mirror)
        return torch.cat([self.force(z), self.place(z)], dim=1)

    def draw(self, graph: TorchGraph, fringe: str, mirror: str) -> str:
        z = self.draw_joint(graph, fringe, mirror)
        return graph.joined(graph.add_layer(self.force, z), graph.add_layer(self.place, z))


@dataclass(frozen=True)
class PalmJointRaw(PalmModel):
    """The joint network for raw color crops."""

    targets: ClassVar[tuple[str, ...]] = (*FORCES, *PLACE)
    network: ClassVar[Callable[[int, Scales], PalmNetwork]] = JointNetwork

    def loss(self, answer: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        """MSE(F) + MSE((x, y))."""
        n = len(FORCES)
        return functional.mse_loss(answer[:, :n], wanted[:, :n]) + functional.mse_loss(
            answer[:, n:], wanted[:, n:]
        )


class ConditionedNetwork(TwoTrunks):
    """F_z = h_F(z), (x, y) = h_L([z, sg(F_z)])."""

    def __init__(self, channels: int, scales: Scales) -> None:
        super().__init__(channels, scales)
        self.force = dense((2 * FEATURES, HIDDEN, 1))
        self.place = dense((2 * FEATURES + 1, HIDDEN, len(PLACE)))

    def answer(self, fringe: torch.Tensor, mirror: torch.Tensor) -> torch.Tensor:
        z = self.joint(fringe, mirror)
        force = self.force(z)
        return torch.cat([force, self.place(torch.cat([z, force.detach()], dim=1))], dim=1)

    def draw(self, graph: TorchGraph, fringe: str, mirror: str) -> str:
        z = self.draw_joint(graph, fringe, mirror)
        force = graph.add_layer(self.force, z)
        return graph.joined(force, graph.add_layer(self.place, graph.joined(z, force)))


@dataclass(frozen=True)
class PalmForceConditioned(PalmModel):
    """The force-conditioned network for differential color crops."""

    targets: ClassVar[tuple[str, ...]] = (FORCES[-1], *PLACE)
    network: ClassVar[Callable[[int, Scales], PalmNetwork]] = ConditionedNetwork

    def loss(self, answer: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        """MSE(F_z) + MSE((x, y))."""
        return functional.mse_loss(answer[:, :1], wanted[:, :1]) + functional.mse_loss(
            answer[:, 1:], wanted[:, 1:]
        )


TWO_STAGE_HIDDEN = 64


class TwoStageNetwork(PalmNetwork):
    """d = f_d(fringe), (x, y) = f_l(mirror), F = f_F(d, x, y)."""

    def __init__(self, channels: int, scales: Scales) -> None:
        super().__init__(scales)
        self.fringe, self.mirror = ResNet18(channels), ResNet18(channels)
        self.depth, self.place = nn.Linear(FEATURES, 1), nn.Linear(FEATURES, len(PLACE))
        self.force = dense((1 + len(PLACE), TWO_STAGE_HIDDEN, TWO_STAGE_HIDDEN, len(FORCES) + 1))

    def answer(self, fringe: torch.Tensor, mirror: torch.Tensor) -> torch.Tensor:
        pose = torch.cat([self.depth(self.fringe(fringe)), self.place(self.mirror(mirror))], dim=1)
        return torch.cat([pose, self.force(pose)], dim=1)

    def draw(self, graph: TorchGraph, fringe: str, mirror: str) -> str:
        depth = graph.add_chain((self.fringe, self.depth), fringe)
        pose = graph.joined(depth, graph.add_chain((self.mirror, self.place), mirror))
        return graph.joined(pose, graph.add_layer(self.force, pose))


@dataclass(frozen=True)
class PalmTwoStage(PalmModel):
    """The two-stage network for differential grey crops.

    Attributes:
        depth_weight, place_weight, force_weight: Weights of the losses.
    """

    epochs: int = 50
    patience: int = 15
    depth_weight: float = 1.0
    place_weight: float = 1.0
    force_weight: float = 1.0

    targets: ClassVar[tuple[str, ...]] = (DEPTH, *PLACE, *FORCES, MAGNITUDE)
    network: ClassVar[Callable[[int, Scales], PalmNetwork]] = TwoStageNetwork

    def __post_init__(self) -> None:
        super().__post_init__()
        weights = (self.depth_weight, self.place_weight, self.force_weight)
        if not all(0 <= w < float("inf") for w in weights) or sum(weights) == 0:
            raise InputError(f"loss weights {weights}: give 0 or more, one positive", code="loss-weights")

    def loss(self, answer: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        """w_d l(d) + w_l l(x, y) + w_F l(F)."""
        huber = functional.smooth_l1_loss
        return (
            self.depth_weight * huber(answer[:, :1], wanted[:, :1])
            + self.place_weight * huber(answer[:, 1:3], wanted[:, 1:3])
            + self.force_weight * huber(answer[:, 3:], wanted[:, 3:])
        )


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
