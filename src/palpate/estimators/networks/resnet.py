"""ResNet-18 without its last layer, with torchvision's parameter names.

Reference: He, Zhang, Ren & Sun, Deep residual learning for image recognition, CVPR (2016), table 1,
doi:10.1109/CVPR.2016.90.

A multilayer perceptron on flattened pixels (scikit-learn), stopped when watched groups stop gaining.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import onnx
from sklearn.neural_network import MLPRegressor

from palpate.core import Float, Indices, InputError, Progress, Tensor, Values, silent
from palpate.core.optional_imports import optional_imports, require
from palpate.estimators.networks.model_interface import Scaler, TrainingData, TrainingRecord, scaled_errors
from palpate.estimators.networks.onnx_graph import OnnxGraph

with optional_imports("A network"):
    import torch
    from torch import nn

FEATURES = 512


class BasicBlock(nn.Module):  # type: ignore[misc]  # torch is seen as Any, so that checking needs no torch
    """Two 3 x 3 convolutions and a shortcut."""

    def __init__(self, channels: int, features: int, stride: int = 1) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, features, 3, stride=stride, padding=1, bias=False)
        self.bn1 = nn.BatchNorm2d(features)
        self.relu = nn.ReLU(inplace=True)
        self.conv2 = nn.Conv2d(features, features, 3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(features)
        self.downsample: nn.Sequential | None = None
        if stride != 1 or channels != features:
            narrow = nn.Conv2d(channels, features, 1, stride=stride, bias=False)
            self.downsample = nn.Sequential(narrow, nn.BatchNorm2d(features))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        around = x if self.downsample is None else self.downsample(x)
        through = self.bn2(self.conv2(self.relu(self.bn1(self.conv1(x)))))
        return self.relu(through + around)


class ResNet18(nn.Module):  # type: ignore[misc]
    """Map of images ``[n c h w]`` to features ``[n 512]``, initialized after He et al. (2015)."""

    def __init__(self, channels: int = 3) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels, 64, 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.relu = nn.ReLU(inplace=True)
        self.maxpool = nn.MaxPool2d(3, stride=2, padding=1)
        self.layer1 = nn.Sequential(BasicBlock(64, 64), BasicBlock(64, 64))
        self.layer2 = nn.Sequential(BasicBlock(64, 128, 2), BasicBlock(128, 128))
        self.layer3 = nn.Sequential(BasicBlock(128, 256, 2), BasicBlock(256, 256))
        self.layer4 = nn.Sequential(BasicBlock(256, FEATURES, 2), BasicBlock(FEATURES, FEATURES))
        self.avgpool = nn.AdaptiveAvgPool2d(1)
        self.flatten = nn.Flatten()
        for part in self.modules():
            if isinstance(part, nn.Conv2d):
                nn.init.kaiming_normal_(part.weight, mode="fan_out", nonlinearity="relu")

    def chain(self) -> Iterator[nn.Module]:
        yield from (self.conv1, self.bn1, self.relu, self.maxpool)
        yield from (self.layer1, self.layer2, self.layer3, self.layer4)
        yield from (self.avgpool, self.flatten)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        for part in self.chain():
            image = part(image)
        return image

    def load_weights(self, path: Path) -> None:
        """Take weights from a file with torchvision's names; see `take`."""
        self.take(read_weights(path), str(path))

    def take(self, weights: Mapping[str, torch.Tensor], source: str) -> None:
        """Take weights of a color ResNet-18 except the last layer, summed over colors for gray images."""
        mine = self.state_dict()
        trunk = {k: v for k, v in weights.items() if not k.startswith("fc.")}
        # Files written by older versions of torch do not count batches, and nothing here reads the count.
        needed = {k for k in mine if not k.endswith("num_batches_tracked")}
        missing, extra = sorted(needed - set(trunk)), sorted(set(trunk) - set(mine))
        if missing or extra:
            raise InputError(
                f"{source} does not fit ResNet-18: missing {_listed(missing)}; extra {_listed(extra)}",
                code="weights-names",
            )
        if mine["conv1.weight"].shape[1] == 1:
            trunk["conv1.weight"] = trunk["conv1.weight"].float().sum(dim=1, keepdim=True)
        unlike = [
            f"{k} {list(v.shape)}, not {list(mine[k].shape)}"
            for k, v in trunk.items()
            if v.shape != mine[k].shape
        ]
        if unlike:
            raise InputError(f"{source} has other shapes: {_listed(unlike)}", code="weights-shape")
        self.load_state_dict(mine | trunk)


def check_weights(path: Path) -> None:
    """Refuse a path from which no weights can be read."""
    if path.suffix != ".safetensors":
        raise InputError(
            f"weights {path}: only .safetensors files are read, as others can run code; convert the file",
            code="weights-kind",
        )
    if not path.is_file():
        raise InputError(f"weights {path}: there is no such file", code="file-missing")


def read_weights(path: Path) -> dict[str, torch.Tensor]:
    """Return all arrays of a `.safetensors` file by name."""
    check_weights(path)
    load = require("safetensors.torch", f"A file of weights such as {path}").load_file
    try:
        return dict(load(path))
    except Exception as e:  # the package's own error, which cannot be named where it is not installed
        raise InputError(f"weights {path} cannot be read: {e}", code="weights-unreadable") from e


def _listed(names: list[str]) -> str:
    """First few names, and the number of others."""
    first, more = ", ".join(names[:8]) or "none", len(names) - 8
    return f"{first} and {more} more" if more > 0 else first


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
class PixelMlp:
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
