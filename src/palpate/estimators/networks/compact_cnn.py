"""Compact convolutional network that trains on a laptop and runs in milliseconds.

Blocks of convolution, batch normalization, rectifier, and pooling keep the layout up to a dense head. Trained
with AdamW on a cosine schedule; running average of the weights (Polyak & Juditsky, SIAM J. Control Optim.
30:838 (1992), doi:10.1137/0330046); mean of several members.
"""

from __future__ import annotations

import math
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import onnx

from palpate.core import Indices, InputError, Progress, Tensor, Values
from palpate.core.array_files import read_arrays
from palpate.core.optional_imports import optional_imports
from palpate.core.parsing import parser
from palpate.estimators.networks.augmentation import CameraVariation, RotationalSymmetry
from palpate.estimators.networks.model_interface import BuiltInModel, Scaler, TrainingData, scaled_errors
from palpate.estimators.networks.torch_export import TorchGraph

with optional_imports("A network"):
    import torch
    from torch import nn
    from torch.nn import functional
    from torch.optim.swa_utils import AveragedModel


class Network(nn.Module):  # type: ignore[misc]  # torch is seen as Any, so that checking needs no torch
    """Network from gray levels to values in the targets' units, with both scalings."""

    def __init__(
        self, shape: tuple[int, int, int], widths: tuple[int, ...], hidden: int, scaler: Scaler
    ) -> None:
        super().__init__()
        channels, height, width = shape
        blocks: list[nn.Module] = []
        for i, features in enumerate(widths):
            blocks += _block(channels, features) if i else _stem(channels, features)
            channels = features
        self.blocks = nn.Sequential(*blocks)
        with torch.no_grad():
            flat = self.blocks(torch.zeros(1, shape[0], height, width)).numel()
        self.head = nn.Sequential(
            nn.Flatten(), nn.Linear(flat, hidden), nn.ReLU(), nn.Linear(hidden, len(scaler.mean))
        )
        self.register_buffer("level", torch.zeros(()))
        self.register_buffer("contrast", torch.ones(()))
        self.register_buffer("mean", torch.tensor(scaler.mean, dtype=torch.float32))
        self.register_buffer("scale", torch.tensor(scaler.scale, dtype=torch.float32))

    def scaled(self, image: torch.Tensor) -> torch.Tensor:
        """Values in units of their spread in the training set, for the loss."""
        return self.head(self.blocks((image - self.level) / self.contrast))

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        return self.scaled(image).float() * self.scale + self.mean


def _stem(channels: int, features: int) -> list[nn.Module]:
    """Convolution that reduces the side to a quarter."""
    wide = nn.Conv2d(channels, features, 7, stride=4, padding=3, bias=False)
    return [wide, nn.BatchNorm2d(features), nn.ReLU()]


def _block(channels: int, features: int) -> list[nn.Module]:
    """Convolution block that halves the side."""
    grow = nn.Conv2d(channels, features, 3, padding=1, bias=False)
    return [grow, nn.BatchNorm2d(features), nn.ReLU(), nn.MaxPool2d(2)]


@dataclass(frozen=True)
class FittedNetwork:
    """Mean of trained networks."""

    members: tuple[Network, ...]
    shape: tuple[int, int, int]

    def predict(self, inputs: Tensor) -> Values:
        images = torch.from_numpy(inputs)
        with torch.no_grad():
            return np.mean([member(images).numpy().astype(np.float64) for member in self.members], axis=0)

    def to_onnx(self) -> onnx.ModelProto:
        graph = TorchGraph()
        answers = [_add_network(graph, member) for member in self.members]
        graph.add("Mean", answers, output="value")
        return graph.model(self.shape, len(self.members[0].mean))


def _add_network(graph: TorchGraph, network: Network) -> str:
    at = graph.centred("image", network.level, network.contrast)
    at = graph.add_chain((*network.blocks, *network.head), at)
    return graph.restored(at, network.scale, network.mean)


@dataclass(frozen=True, slots=True)
class CompactCnn(BuiltInModel):
    """Architecture and training schedule of the network.

    Attributes:
        widths: Features after the stem (side over 4) and after each block (side over 2).
        members: Number of networks with different seeds.
        hidden: Width of the dense layer.
        epochs: Passes over the rows.
        learning_rate: Peak learning rate.
        shift_px: Greatest random shift of training images [px of the input].
        variation: Multiple of the sizes of `CameraVariation`; 0 for none.
        turns: Order of the sensor's rotational symmetry, by which images and labels are rotated; 1 for none.
        averaging: Greatest decay of the running average.
        patience: Passes without gain on watched groups before it stops; 0 trains to the end on all rows.
        watched: Ratio of the groups watched.
    """

    widths: tuple[int, ...] = (32, 64, 96, 128, 160)
    members: int = 3
    hidden: int = 256
    epochs: int = 40
    batch: int = 32
    learning_rate: float = 2e-3
    weight_decay: float = 1e-2
    shift_px: int = 3
    variation: float = 1.0
    turns: int = 1
    averaging: float = 0.998
    patience: int = 0
    watched: float = 0.1

    def __post_init__(self) -> None:
        if min(self.epochs, self.members, self.batch - 1) < 1 or self.learning_rate <= 0:
            raise InputError(
                f"epochs {self.epochs}, members {self.members}, batch {self.batch}, learning_rate "
                f"{self.learning_rate}; allowed: 1, 1, 2 or more, and above 0"
            )
        if not 0 <= self.variation <= 2:
            raise InputError(f"variation {self.variation}: from 0, none, to 2, twice the usual sizes")

    def _fit(
        self, data: TrainingData, rows: Indices, seed: int, progress: Progress, checkpoint: Path | None
    ) -> FittedNetwork:
        plan = self if len(rows) >= self.batch else replace(self, batch=max(2, len(rows) // 2))
        side = min(data.shape[1:])
        if side < 4 * 2 ** (len(self.widths) - 1):
            raise InputError(
                f"an input of {side} px a side is too small; {4 * 2 ** (len(self.widths) - 1)} px are "
                f"needed for {len(self.widths)} widths",
                code="input-size",
            )
        # Which epoch was best is not kept, so a network that stops early starts anew.
        resumed = None if self.patience else checkpoint
        members = []
        for m in range(self.members):

            def report(what: str, done: int, total: int, before: int = m * self.epochs) -> None:
                progress(what, before + done, self.members * total)

            own = resumed and resumed.with_name(f"{resumed.stem}-{m}.npz")
            members.append(plan._member(data, rows, seed * self.members + m, report, own))
        return FittedNetwork(tuple(members), data.shape)

    def _member(
        self, data: TrainingData, rows: Indices, seed: int, progress: Progress, checkpoint: Path | None
    ) -> Network:
        rng = np.random.default_rng(seed)
        learn, watch = data.inner_validation(rows, self.watched, rng) if self.patience else (rows, rows[:0])
        with seeded(seed):
            training = _Training(self, data, learn, seed, rng)
        if checkpoint is not None and checkpoint.exists():
            training.load(checkpoint)
        best, best_error, since = None, math.inf, 0
        while training.epoch < self.epochs:
            training.one_epoch()
            if checkpoint is not None:
                training.save(checkpoint)
            progress("learning", training.epoch, self.epochs)
            if not len(watch):
                continue
            error = training.error(watch)
            best, best_error, since = (
                (training.kept(), error, 0) if error < best_error else (best, best_error, since + 1)
            )
            if since >= self.patience:
                progress("learning", self.epochs, self.epochs)
                break
        return best or training.kept()


class _Training:
    """Network in training, its average, its optimizer, and its position in the schedule."""

    def __init__(
        self, plan: CompactCnn, data: TrainingData, rows: Indices, seed: int, rng: np.random.Generator
    ) -> None:
        self.plan, self.data, self.rows, self.seed, self.epoch = plan, data, rows, seed, 0
        self.scaler = Scaler.of(data.values[rows])
        self.network = Network(data.shape, plan.widths, plan.hidden, self.scaler)
        first = data.sample(rows, 500, rng)
        self.network.level.fill_(float(first.mean()))
        self.network.contrast.fill_(float(first.std()) or 1.0)
        self.turns = RotationalSymmetry.find(plan.turns, first, data.names) if plan.turns != 1 else None
        self.network = self.network.to(memory_format=torch.channels_last)
        self.average = AveragedModel(self.network, avg_fn=_running(plan.averaging), use_buffers=True)
        self.optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=plan.learning_rate, weight_decay=plan.weight_decay
        )

    @property
    def steps(self) -> int:
        return max(1, len(self.rows) // self.plan.batch)

    def one_epoch(self) -> None:
        # Everything random in an epoch follows from its number, so that a resumed run repeats it.
        rng = np.random.default_rng([self.seed, self.epoch])
        order = rng.permutation(self.rows)
        self.network.train()
        for step in range(self.steps):
            part = order[step * self.plan.batch : (step + 1) * self.plan.batch]
            self._step(part, self.epoch * self.steps + step, rng)
        self.epoch += 1

    def _step(self, part: Indices, number: int, rng: np.random.Generator) -> None:
        for group in self.optimiser.param_groups:
            group["lr"] = self._rate(number)
        images, values = self.data.fetch(part), self.data.values[part]
        if self.turns:
            images, values = self.turns.turned(images, values, rng)
        image = self._varied(images, rng)
        targets = torch.from_numpy(self.scaler.scaled(values).astype(np.float32))
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=fast_bfloat16()):
            guess = self.network.scaled(image.contiguous(memory_format=torch.channels_last))
        loss = functional.smooth_l1_loss(guess.float(), targets, beta=0.1)
        self.optimiser.zero_grad()
        loss.backward()
        self.optimiser.step()
        self.average.update_parameters(self.network)

    def _varied(self, images: Tensor, rng: np.random.Generator) -> torch.Tensor:
        if not self.plan.variation:
            return _moved(torch.from_numpy(images), self.plan.shift_px, rng)
        camera = CameraVariation(shift_px=self.plan.shift_px).scaled(self.plan.variation)
        return torch.from_numpy(camera.drawn(images, rng))

    def _rate(self, number: int) -> float:
        """Linear warm-up over 200 steps (at most a tenth), then cosine decay."""
        total = self.steps * self.plan.epochs
        return cosine_rate(self.plan.learning_rate, number, total, min(200, max(1, total // 10)))

    def error(self, rows: Indices) -> float:
        fitted = FittedNetwork((self.kept(),), self.data.shape)
        return float(np.abs(scaled_errors(fitted, self.scaler, self.data, rows)).mean())

    def kept(self) -> Network:
        copy = Network(self.data.shape, self.plan.widths, self.plan.hidden, self.scaler)
        copy.load_state_dict(self.average.module.state_dict())
        return copy.eval()

    def save(self, path: Path) -> None:
        states = {"network": self.network.state_dict(), "average": self.average.state_dict()}
        write_checkpoint(path, {"epoch": self.epoch}, states, self.optimiser)

    def load(self, path: Path) -> None:
        """Load a checkpoint; a damaged file is renamed and the fold restarted."""
        try:
            arrays = read_checkpoint(path)
        except (OSError, ValueError, EOFError, zipfile.BadZipFile):
            path.unlink()
            return
        self.epoch = int(arrays["epoch"])
        self.network.load_state_dict(checkpoint_part(arrays, "network"))
        self.average.load_state_dict(checkpoint_part(arrays, "average"))
        states = optimiser_states(arrays)
        self.optimiser.load_state_dict(self.optimiser.state_dict() | {"state": states})


def cosine_rate(peak: float, number: int, total: int, rise: int) -> float:
    """Return the learning rate at a step: linear warm-up, then cosine decay."""
    return peak * min(1.0, (number + 1) / rise) * 0.5 * (1 + math.cos(math.pi * number / total))


def write_checkpoint(
    path: Path,
    numbers: dict[str, float],
    states: dict[str, dict[str, torch.Tensor]],
    optimiser: torch.optim.Optimizer,
) -> None:
    """Replace a checkpoint of numbers, named states, and an optimizer's state atomically."""
    arrays = {name: np.array(number) for name, number in numbers.items()}
    moments = {f"optimiser/{i}": state for i, state in optimiser.state_dict()["state"].items()}
    for name, state in (states | moments).items():
        arrays |= {f"{name}/{k}": v.numpy(force=True) for k, v in state.items()}
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".npz", delete=False) as file:
        try:
            np.savez(file, **arrays)  # type: ignore[arg-type]
        except BaseException:
            Path(file.name).unlink()
            raise
    Path(file.name).replace(path)


@parser("training checkpoint", InputError, max_bytes=1 << 30)
def read_checkpoint(path: Path) -> dict[str, torch.Tensor]:
    """Return all arrays of a checkpoint."""
    return {name: torch.from_numpy(value) for name, value in read_arrays(path, max_bytes=1 << 30).items()}


def checkpoint_part(arrays: dict[str, torch.Tensor], name: str) -> dict[str, torch.Tensor]:
    """Return arrays whose names begin with ``name/``, without it."""
    return {k[len(name) + 1 :]: v for k, v in arrays.items() if k.startswith(f"{name}/")}


def optimiser_states(arrays: dict[str, torch.Tensor]) -> dict[int, dict[str, torch.Tensor]]:
    """Return the optimizer's state of each weight from a checkpoint's arrays."""
    states: dict[int, dict[str, torch.Tensor]] = {}
    for key, value in checkpoint_part(arrays, "optimiser").items():
        i, _, field = key.partition("/")
        states.setdefault(int(i), {})[field] = value
    return states


def _moved(images: torch.Tensor, most_px: int, rng: np.random.Generator) -> torch.Tensor:
    """Images shifted by random whole pixels, with repeated edges."""
    if most_px == 0:
        return images
    height, width = images.shape[2:]
    wider = functional.pad(images, (most_px,) * 4, mode="replicate")
    corners = rng.integers(0, 2 * most_px + 1, (len(images), 2))
    return torch.stack(
        [image[:, y : y + height, x : x + width] for image, (y, x) in zip(wider, corners, strict=True)]
    )


def _running(most: float) -> Callable[[torch.Tensor, torch.Tensor, torch.Tensor | int], torch.Tensor]:
    """Running average with a short memory at first."""

    def average(mean: torch.Tensor, new: torch.Tensor, count: torch.Tensor | int) -> torch.Tensor:
        share = min(most, (1 + int(count)) / (10 + int(count)))
        return mean + (1 - share) * (new - mean) if mean.is_floating_point() else new

    return average


def fast_bfloat16() -> bool:
    """Return whether this processor multiplies bfloat16 natively."""
    return bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Seed torch in a context, and restore the caller's state."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        yield
