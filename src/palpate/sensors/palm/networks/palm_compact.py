"""A small network for the palm that is also trained on rendered presses.

Rendered presses cover positions between the few dozen calibrated ones. The fringe branch keeps the map's
layout up to a dense layer; the mirror branch also reports soft-argmax positions of its maps.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import cv2
import numpy as np
import onnx

from palpate.core import Indices, InputError, Progress, Tensor, Values, silent
from palpate.core.optional_imports import optional_imports
from palpate.estimators.guard import RenderedImages, thumbnails
from palpate.estimators.networks.compact_cnn import seeded
from palpate.estimators.networks.model_interface import Scaler, TrainingData
from palpate.estimators.networks.torch_export import TorchGraph
from palpate.estimators.networks.training_loop import TrainingLoop, TrainingTask
from palpate.sensors.palm.networks import PLACE
from palpate.sensors.palm.networks.palm_moments import MirrorPlace, features_of
from palpate.sensors.palm.networks.palm_training import (
    SIDE_PX,
    FittedPalm,
    PalmNetwork,
    Scales,
    columns_of,
    dense,
    half_width,
    two_view_variation,
)
from palpate.sensors.palm.palm_spec import cropped, preset
from palpate.sensors.palm.random_presses import TARGETS, Presses, draw_presses

with optional_imports("A network of the palm"):
    import torch
    from torch import nn
    from torch.nn import functional

WIDTHS = (24, 48, 64, 96)
SEEN_AT = 2  # mirror blocks before the soft-argmax
MAPS = 16
FEATURES = 128
BEND = 0.05  # Huber threshold in target standard deviations
DEPTHS_EACH = 12  # frames per rendered press
OFTEN = 2  # repetitions of a recorded frame per epoch


class CompactPalmNetwork(PalmNetwork):
    """Two small branches and a dense head."""

    def __init__(self, channels: int, side: int, scales: Scales) -> None:
        super().__init__(scales)
        last = WIDTHS[-1] * (side // 2 ** len(WIDTHS)) ** 2
        self.fringe = nn.ModuleList(_blocks(channels))
        self.mirror = nn.ModuleList(_blocks(channels))
        self.fringe_features = nn.Sequential(nn.Flatten(), nn.Linear(last, FEATURES), nn.ReLU())
        self.mirror_features = nn.Sequential(nn.Flatten(), nn.Linear(last, FEATURES), nn.ReLU())
        self.maps = nn.Conv2d(WIDTHS[SEEN_AT - 1], MAPS, 1)
        self.head = dense((2 * FEATURES + 2 * MAPS, FEATURES, len(scales.order)))
        self.grid: torch.Tensor
        self.register_buffer("grid", _grid(side // 2**SEEN_AT))

    def answer(self, fringe: torch.Tensor, mirror: torch.Tensor) -> torch.Tensor:
        for block in self.fringe:
            fringe = block(fringe)
        for block in self.mirror[:SEEN_AT]:
            mirror = block(mirror)
        weights = torch.softmax(self.maps(mirror).float().flatten(2), dim=2)
        where = (weights @ self.grid).flatten(1)
        for block in self.mirror[SEEN_AT:]:
            mirror = block(mirror)
        features = self.fringe_features(fringe), self.mirror_features(mirror)
        return self.head(torch.cat([*features, where.to(features[0].dtype)], dim=1))

    def draw(self, graph: TorchGraph, fringe: str, mirror: str) -> str:
        seen = graph.add_chain(self.mirror[:SEEN_AT], mirror)
        where = graph.centres(self.maps, self.grid, seen)
        features = (
            graph.add_chain([*self.fringe, self.fringe_features], fringe),
            graph.add_chain([*self.mirror[SEEN_AT:], self.mirror_features], seen),
        )
        return graph.add_layer(self.head, graph.joined(*features, where))


def _blocks(channels: int) -> list[nn.Sequential]:
    """Convolutions that halve the map's side; the first has a wider kernel."""
    made, before = [], channels
    for i, width in enumerate(WIDTHS):
        size = 5 if i == 0 else 3
        convolution = nn.Conv2d(before, width, size, stride=2, padding=size // 2, bias=False)
        made.append(nn.Sequential(convolution, nn.BatchNorm2d(width), nn.ReLU()))
        before = width
    return made


def _grid(side: int) -> torch.Tensor:
    """Positions ``[side side, 2]`` across and down, -1 to 1."""
    along = torch.linspace(-1, 1, side)
    down, across = torch.meshgrid(along, along, indexing="ij")
    return torch.stack([across.flatten(), down.flatten()], dim=1)


@dataclass(frozen=True)
class FittedCompact(FittedPalm):
    """A trained network with its rendered presses, which the novelty detector includes.

    Attributes:
        place: Estimator of x and y that replaces the network's; None if unused.
        at: Indices of x and y among the targets.
    """

    rendered_images: RenderedImages | None
    place: MirrorPlace | None
    at: Indices

    def predict(self, inputs: Tensor) -> Values:
        values = super().predict(inputs)
        if self.place is not None:
            values[:, self.at] = self.place.predict(inputs)
        return values

    def to_onnx(self) -> onnx.ModelProto:
        if self.place is None:
            return super().to_onnx()
        graph, count = TorchGraph(), len(self.network.order)
        own = self.network.value_nodes(graph)
        place = self.place.add_to_image(graph, self.shape)
        order = np.arange(count)
        order[self.at] = count + np.arange(len(self.at))
        graph.add("Gather", [graph.joined(own, place)], {"order": order}, output="value", axis=1)
        return graph.model(self.shape, count)


@dataclass(frozen=True)
class PalmCompact:
    """Settings of the network and its training; see `TrainingLoop` for those not listed.

    Attributes:
        rendered: Number of rendered frames; 0 for none, which allows any targets.
        palm: Preset of the rendered frames.
        patience: Epochs without gain on watched groups before it stops; 0 trains to the end on all rows.
        watched: Fraction of groups watched with `patience`.
        moments: Whether `MirrorPlace` estimates x and y, for differential crops.
        processes: Number of rendering processes; the result does not depend on it.
        variation: Strength of `two_view_variation`; 0 for none.
    """

    rendered: int = 16_000
    palm: str = "palm"
    epochs: int = 16
    batch: int = 64
    learning_rate: float = 2e-3
    precision: str = "auto"
    processes: int = 1
    variation: float = 0.0
    patience: int = 0
    watched: float = 0.1
    falls: int = 0
    steps: int = 0
    cosine: bool = True
    moments: bool = True

    targets: ClassVar[tuple[str, ...]] = TARGETS

    def __post_init__(self) -> None:
        if self.rendered < 0 or self.processes < 1:
            raise InputError(
                f"rendered is {self.rendered} and processes {self.processes}; give a number of frames, 0 for "
                "none, and one of processes, 1 or more"
            )
        preset(self.palm)
        two_view_variation(self.variation, SIDE_PX)
        self.descent()

    def descent(self) -> TrainingLoop:
        return TrainingLoop(
            self.epochs, self.batch, self.learning_rate, self.patience, self.precision,
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
    ) -> FittedCompact:
        columns = self._columns(data.names)
        side = self._side(data.shape)
        drawn, rng = self._drawn(side, seed, progress)
        own, watch = data.inner_validation(rows, self.watched, rng) if self.patience else (rows, rows[:0])
        scales = Scales.of(data, own, columns, True, rng)
        values = data.values[:, columns]
        if drawn is not None:
            values = np.concatenate([values, drawn.values.astype(np.float64)])
            learnt = np.concatenate([data.values[np.ix_(own, columns)], drawn.values])
            scales = replace(scales, targets=Scaler.of(learnt))
        union = _Union(data, drawn)
        learn = np.concatenate([np.tile(own, OFTEN if drawn else 1), union.drawn_rows])
        wanted = scales.targets.scaled(values).astype(np.float32)
        with seeded(seed):
            network = CompactPalmNetwork(data.shape[0], side, scales)
        vary = two_view_variation(self.variation, side)
        lesson = TrainingTask(union.fetch, wanted, _loss, learn, watch, vary)
        run = self.descent().run(network, lesson, seed=seed, progress=progress, checkpoint=checkpoint)
        also = None if drawn is None else _seen(drawn, data.shape[0])
        place, at = self._place(data, rows)
        return FittedCompact(run.kept(), data.shape, run.record, also, place, at)

    def _place(self, data: TrainingData, rows: Indices) -> tuple[MirrorPlace | None, Indices]:
        if not self.moments or not set(PLACE) <= set(data.names):
            return None, np.arange(0)
        at = np.array([data.names.index(name) for name in PLACE])
        moments = np.concatenate([features_of(inputs)[0] for _, inputs in data.batches(rows)])
        return MirrorPlace.fit(moments, data.values[np.ix_(rows, at)], data.groups[rows]), at

    def _columns(self, asked: Sequence[str]) -> Indices:
        """Rendered presses have four labels; without them any targets are allowed."""
        if self.rendered == 0:
            return np.arange(len(asked))
        return columns_of(self.targets, asked, type(self).__name__)

    def _side(self, shape: tuple[int, int, int]) -> int:
        side = half_width(shape)
        if side != shape[1] or side % 2 ** len(WIDTHS):
            raise InputError(
                f"an input of {shape[1]} x {shape[2]} px is not two squares whose side is a multiple of "
                f"{2 ** len(WIDTHS)} px; give --size 96x192, or 128x256"
            )
        return side

    def _drawn(self, side: int, seed: int, progress: Progress) -> tuple[Presses | None, np.random.Generator]:
        """Rendered presses, and the rng after them."""
        if self.rendered == 0:
            return None, np.random.default_rng(seed)
        count = max(1, round(self.rendered / DEPTHS_EACH))
        spec, key = cropped(preset(self.palm), side, "palm-rendered"), (self.palm, side, count, seed)
        if key not in _DRAWN:
            rng = np.random.default_rng(seed)

            def report(done: int, total: int) -> None:
                progress("rendering presses", done, total)

            drawn = draw_presses(spec, count, DEPTHS_EACH, rng, report, processes=self.processes)
            _DRAWN.clear()
            _DRAWN[key] = drawn, rng
        drawn, rng = _DRAWN[key]
        return drawn, deepcopy(rng)


_DRAWN: dict[tuple[str, int, int, int], tuple[Presses, np.random.Generator]] = {}
"""Last rendered presses and the rng after them, reused by studies."""


def _seen(drawn: Presses, channels: int) -> RenderedImages:
    """Thumbnails of all rendered frames."""
    images = (_in_channels(image, channels) for part in (drawn.images, drawn.hanging) for image in part)
    groups = np.concatenate([drawn.press, np.arange(len(drawn.hanging))])
    return RenderedImages(np.round(thumbnails(images)).astype(np.uint8), groups)


def _in_channels(image: np.ndarray, channels: int) -> np.ndarray:
    return cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[..., None] if channels == 1 else image


def _loss(answer: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    loss: torch.Tensor = functional.smooth_l1_loss(answer, wanted, beta=BEND)
    return loss


class _Union:
    """Recorded rows followed by rendered ones."""

    def __init__(self, data: TrainingData, drawn: Presses | None) -> None:
        self._data, self._drawn, self._first = data, drawn, len(data.values)
        self.drawn_rows = self._first + np.arange(len(drawn.values) if drawn else 0)

    def fetch(self, rows: Indices) -> Tensor:
        inputs = np.empty((len(rows), *self._data.shape), np.float32)
        recorded = rows < self._first
        if recorded.any():
            inputs[recorded] = self._data.fetch(rows[recorded])
        if self._drawn is not None and not recorded.all():
            inputs[~recorded] = self._differences(self._drawn, rows[~recorded] - self._first)
        return inputs

    def _differences(self, drawn: Presses, rows: Indices) -> Tensor:
        pairs = zip(drawn.images[rows], drawn.hanging[drawn.press[rows]], strict=True)
        return np.stack([self._as_input(image) - self._as_input(hanging) for image, hanging in pairs])

    def _as_input(self, image: np.ndarray) -> np.ndarray:
        return _in_channels(image, self._data.shape[0]).transpose(2, 0, 1).astype(np.float32)
