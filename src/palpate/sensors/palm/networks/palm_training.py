"""Common parts of the palm's networks. An image holds both views: fringes left, mirror right."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import ClassVar

import numpy as np
import onnx

from palpate.core import Indices, InputError, Progress, Tensor, Values, silent
from palpate.core.optional_imports import optional_imports
from palpate.estimators.networks.augmentation import CameraVariation
from palpate.estimators.networks.compact_cnn import seeded
from palpate.estimators.networks.model_interface import Scaler, TrainingData, TrainingRecord
from palpate.estimators.networks.resnet import ResNet18, check_weights
from palpate.estimators.networks.torch_export import TorchGraph
from palpate.estimators.networks.training_loop import TrainingLoop, TrainingTask, Vary

with optional_imports("A network of the palm"):
    import torch
    from torch import nn

MAGNITUDE = "force_magnitude_N"
DEPTH = "depth_mm"

SEEN_FOR_SCALE = 500


def half_width(shape: tuple[int, int, int]) -> int:
    """Return the columns of each view in an image of (channels, height, width)."""
    if shape[2] % 2:
        raise InputError(
            f"an image {shape[2]} px wide is not two views side by side, the fringes left and the mirror "
            "right; give an even width, as in a size of 128 x 256 px"
        )
    return shape[2] // 2


def columns_of(targets: Sequence[str], asked: Sequence[str], model: str) -> Indices:
    """Return the index of each of a model's targets among the requested ones."""
    if sorted(targets) != sorted(asked):
        raise InputError(
            f"{model} estimates {', '.join(targets)}, no fewer and no others; asked for were "
            f"{', '.join(asked) or 'targets without names'}; ask for all of those, in any order",
            code="targets-differ",
        )
    return np.array([list(asked).index(name) for name in targets])


MAX_VARIATION = 2.0
SIDE_PX = 64  # side of a view for which pixel sizes are stated


def two_view_variation(strength: float, side_px: int) -> Vary | None:
    """Return random camera changes for inputs with two views side by side; None for strength 0.

    Both views change alike, each about its own middle. In differences this is a camera that had changed
    before the reference was taken.

    Args:
        strength: Scale of shift, rotation, zoom, blur, brightness, and noise, 0 to 2.
        side_px: Side of a view [px].
    """
    if not 0 <= strength <= MAX_VARIATION:
        raise InputError(f"variation {strength}: from 0, none, to {MAX_VARIATION:g}, twice the usual sizes")
    if strength == 0:
        return None
    px = side_px / SIDE_PX
    camera = CameraVariation(
        shift_px=strength * px, turn_deg=0.5, zoom_percent=0.5, blur_px=0.6 * px, width_px=0.0,
        gain_percent=10.0, noise=2.0, below_quality_100=0.0,
    ).scaled(strength)  # fmt: skip

    def vary(image: Tensor, seed: tuple[int, ...]) -> Tensor:
        views = np.split(image, 2, axis=3)
        drawn = [camera.drawn(np.ascontiguousarray(view), np.random.default_rng(seed)) for view in views]
        return np.concatenate(drawn, axis=3)

    return vary


@dataclass(frozen=True)
class Scales:
    """Scaling of grey levels and targets.

    Attributes:
        half: Columns of each view.
        level, contrast: Mean and standard deviation of each view [grey levels], common to all channels.
        targets: Scaler in the model's order.
        order: Index of each requested target in the model's order.
    """

    half: int
    level: tuple[float, float]
    contrast: tuple[float, float]
    targets: Scaler
    order: tuple[int, ...]

    @classmethod
    def of(
        cls,
        data: TrainingData,
        rows: Indices,
        columns: Indices,
        standardised: bool,
        rng: np.random.Generator,
    ) -> Scales:
        """Return the scaling of training rows.

        Args:
            data: Images and values.
            rows: Training rows.
            columns: Columns of `TrainingData.values` in the model's order.
            standardised: Whether targets are scaled to zero mean and unit variance.
            rng: Source of the sampled images.
        """
        half = half_width(data.shape)
        seen = data.sample(rows, SEEN_FOR_SCALE, rng)
        views = seen[..., :half], seen[..., half:]
        values = data.values[np.ix_(rows, columns)]
        plain = Scaler(np.zeros(len(columns)), np.ones(len(columns)))
        return cls(
            half,
            (float(views[0].mean()), float(views[1].mean())),
            (float(views[0].std()) or 1.0, float(views[1].std()) or 1.0),
            Scaler.of(values) if standardised else plain,
            tuple(int(i) for i in np.argsort(columns)),
        )


AT_ONCE = 64


class PalmNetwork(nn.Module, ABC):  # type: ignore[misc]  # torch is seen as Any
    """Two views in grey levels to scaled values; subclasses define `answer` and the same as ONNX, `draw`."""

    def __init__(self, scales: Scales) -> None:
        super().__init__()
        self.half, self.order = scales.half, list(scales.order)
        self.level: torch.Tensor
        self.contrast: torch.Tensor
        self.mean: torch.Tensor
        self.scale: torch.Tensor
        self.register_buffer("level", torch.tensor(scales.level))
        self.register_buffer("contrast", torch.tensor(scales.contrast))
        self.register_buffer("mean", torch.tensor(scales.targets.mean, dtype=torch.float32))
        self.register_buffer("scale", torch.tensor(scales.targets.scale, dtype=torch.float32))

    @abstractmethod
    def answer(self, fringe: torch.Tensor, mirror: torch.Tensor) -> torch.Tensor:
        """Scaled values ``[n t]`` in the model's order from two scaled views ``[n c h w]``."""

    @abstractmethod
    def draw(self, graph: TorchGraph, fringe: str, mirror: str) -> str:
        """`answer` as ONNX; returns the node of the scaled values."""

    def trunks(self) -> list[ResNet18]:
        return [part for part in self.children() if isinstance(part, ResNet18)]

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """Scaled values in the model's order, for the loss."""
        fringe = (image[..., : self.half] - self.level[0]) / self.contrast[0]
        mirror = (image[..., self.half :] - self.level[1]) / self.contrast[1]
        return self.answer(fringe, mirror)

    def values(self, image: torch.Tensor) -> torch.Tensor:
        """Values in the targets' units and requested order."""
        return (self(image) * self.scale + self.mean)[:, self.order]

    def to_onnx(self, shape: tuple[int, int, int]) -> onnx.ModelProto:
        graph = TorchGraph()
        self.value_nodes(graph, "value")
        return graph.model(shape, len(self.order))

    def value_nodes(self, graph: TorchGraph, output: str = "") -> str:
        """Add `values` to a graph."""
        edges = (0, self.half, 2 * self.half)
        views = [
            graph.centred(graph.columns("image", edges[i], edges[i + 1]), self.level[i], self.contrast[i])
            for i in range(2)
        ]
        own = self.draw(graph, *views)
        asked = graph.picked(own, self.order)
        return graph.restored(asked, self.scale[self.order], self.mean[self.order], output=output)


class TwoTrunks(PalmNetwork):
    """A residual network for each view, with joined features z = [phi_F, phi_L]."""

    def __init__(self, channels: int, scales: Scales) -> None:
        super().__init__(scales)
        self.fringe, self.mirror = ResNet18(channels), ResNet18(channels)

    def joint(self, fringe: torch.Tensor, mirror: torch.Tensor) -> torch.Tensor:
        """Features ``[n 1024]`` of both views."""
        return torch.cat([self.fringe(fringe), self.mirror(mirror)], dim=1)

    def draw_joint(self, graph: TorchGraph, fringe: str, mirror: str) -> str:
        return graph.joined(graph.add_layer(self.fringe, fringe), graph.add_layer(self.mirror, mirror))


def dense(widths: Sequence[int]) -> nn.Sequential:
    """Return dense layers of these widths with rectifiers between them."""
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers += [nn.Linear(before, after), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


@dataclass(frozen=True)
class FittedPalm:
    """A trained network of the palm."""

    network: PalmNetwork
    shape: tuple[int, int, int]
    training: TrainingRecord

    def predict(self, inputs: Tensor) -> Values:
        with torch.no_grad():
            parts = [self.network.values(part) for part in torch.from_numpy(inputs).split(AT_ONCE)]
        return torch.cat(parts).numpy().astype(np.float64)

    def to_onnx(self) -> onnx.ModelProto:
        return self.network.to_onnx(self.shape)


@dataclass(frozen=True)
class PalmModel(ABC):
    """Settings of a network and its training with Adam; see `TrainingLoop` for those not listed.

    Attributes:
        learning_rate: None for 1e-3 from scratch and 1e-4 from given weights.
        weights: A `.safetensors` file of a ResNet-18 that initializes every trunk; empty for random.
        standardised: Whether the loss uses standardised targets instead of newtons and millimetres.
        patience: Epochs without gain on watched groups before it stops; 0 trains to the end on all rows.
        watched: Fraction of groups watched with `patience`.
        variation: Strength of `two_view_variation`; 0 for none.
    """

    epochs: int = 30
    batch: int = 32
    learning_rate: float | None = None
    weights: str = ""
    standardised: bool = True
    precision: str = "auto"
    patience: int = 0
    watched: float = 0.1
    variation: float = 0.0
    falls: int = 0
    steps: int = 0
    cosine: bool = False

    targets: ClassVar[tuple[str, ...]] = ()
    network: ClassVar[Callable[[int, Scales], PalmNetwork]]

    def __post_init__(self) -> None:
        two_view_variation(self.variation, SIDE_PX)
        if self.weights:
            check_weights(Path(self.weights))
        self.descent()

    @abstractmethod
    def loss(self, answer: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        """Loss of scaled values ``[n t]`` in the model's order."""

    def descent(self) -> TrainingLoop:
        rate = self.learning_rate if self.learning_rate is not None else 1e-4 if self.weights else 1e-3
        return TrainingLoop(
            self.epochs, self.batch, rate, self.patience, self.precision,
            cosine=self.cosine, falls=self.falls, steps=self.steps,
        )  # fmt: skip

    def fit(
        self,
        data: TrainingData,
        rows: Indices,
        *,
        seed: int,
        progress: Progress = silent,
        checkpoint: Path | None = None,
    ) -> FittedPalm:
        columns = columns_of(self.targets, data.names, type(self).__name__)
        half_width(data.shape)
        rng = np.random.default_rng(seed)
        learn, watch = data.inner_validation(rows, self.watched, rng) if self.patience else (rows, rows[:0])
        scales = Scales.of(data, learn, columns, self.standardised, rng)
        wanted = scales.targets.scaled(data.values[:, columns]).astype(np.float32)
        vary = two_view_variation(self.variation, data.shape[1])
        lesson = TrainingTask(data.fetch, wanted, self.loss, learn, watch, vary)
        with seeded(seed):
            network = type(self).network(data.shape[0], scales)
        for trunk in network.trunks() if self.weights else []:
            trunk.load_weights(Path(self.weights))
        begun = f"from {Path(self.weights).name}" if self.weights else "from scratch"

        def report(what: str, done: int, total: int) -> None:
            progress(f"{what} {begun}", done, total)

        run = self.descent().run(network, lesson, seed=seed, progress=report, checkpoint=checkpoint)
        return FittedPalm(run.kept(), data.shape, run.record)
