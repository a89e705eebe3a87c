"""A small network for the photoelastic palm, which learns from the rendered membrane as well.

A palm is calibrated at a few dozen places. Between them a network has to guess, and that is where larger ones
fail. So this one also sees thousands of presses anywhere on the virtual membrane, with the frames of the rig
it is calibrated on, and has two parts that suit the two views: the fringes' branch keeps the map's layout up
to a dense layer, and the mirror's branch also tells where its maps weigh most (a soft maximum), which is
where the probe is. On a virtual rig the rendered presses obey the very laws of the recorded ones; on a real
palm they are a model of it, and how much they help there is not known.
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
SEEN_AT = 2  # blocks after which the mirror's maps are asked where they weigh most
MAPS = 16
FEATURES = 128
BEND = 0.05  # of the Huber loss, in spreads of the targets
DEPTHS_EACH = 12  # frames of a rendered press
OFTEN = 2  # times in an epoch that a recorded frame is seen


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
    """Each halves the map's side; the first looks wider."""
    made, before = [], channels
    for i, width in enumerate(WIDTHS):
        size = 5 if i == 0 else 3
        convolution = nn.Conv2d(before, width, size, stride=2, padding=size // 2, bias=False)
        made.append(nn.Sequential(convolution, nn.BatchNorm2d(width), nn.ReLU()))
        before = width
    return made


def _grid(side: int) -> torch.Tensor:
    """Places ``[side side, 2]`` across and down, -1 to 1."""
    along = torch.linspace(-1, 1, side)
    down, across = torch.meshgrid(along, along, indexing="ij")
    return torch.stack([across.flatten(), down.flatten()], dim=1)


@dataclass(frozen=True)
class FittedCompact(FittedPalm):
    """A trained network, and the rendered presses it has learnt from, for the novelty detector to know.

    Attributes:
        place: tells x and y in the network's stead; None where the network does.
        at: which of the targets x and y are.
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
    """Settings of the network and its training.

    Attributes:
        rendered: frames of rendered presses that are learnt from besides the recorded ones; 0 for none, and
            then any targets may be asked for.
        palm: the preset that they are rendered of.
        epochs: passes over all of them.
        batch: rows a step.
        learning_rate: Adam's at its greatest; it falls along a cosine.
        precision: see `TrainingLoop`.
        patience: epochs without gain on watched groups of recorded frames before it stops; 0 trains to the
            end on all rows.
        watched: share of the groups watched, where `patience` is not 0.
        falls, steps, cosine: see `TrainingLoop`.
        moments: whether x and y, where both are asked for, are told by ten moments of the mirror's difference
            instead of by the network, see `MirrorPlace`; for differential crops.
        processes: how many render, on this machine; what they render does not depend on it. 1 under torchrun.
        variation: strength of what a camera does from day to day, drawn into training images, see
            `two_view_variation`; 0 draws none.
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
        """The training loop these options ask for."""
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
        """What tells the place in the network's stead, and which of the targets that is."""
        if not self.moments or not set(PLACE) <= set(data.names):
            return None, np.arange(0)
        at = np.array([data.names.index(name) for name in PLACE])
        moments = np.concatenate([features_of(inputs)[0] for _, inputs in data.batches(rows)])
        return MirrorPlace.fit(moments, data.values[np.ix_(rows, at)], data.groups[rows]), at

    def _columns(self, asked: Sequence[str]) -> Indices:
        """Rendered presses have labels of four kinds; without them anything may be asked."""
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
        """Rendered presses, and what goes on as the source of chance after them."""
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
"""Presses drawn last, and the source of chance as they left it: a study trains on the same ones again."""


def _seen(drawn: Presses, channels: int) -> RenderedImages:
    """Thumbnails of all that was drawn, the skin with the probe over it as well."""
    images = (_in_channels(image, channels) for part in (drawn.images, drawn.hanging) for image in part)
    groups = np.concatenate([drawn.press, np.arange(len(drawn.hanging))])
    return RenderedImages(np.round(thumbnails(images)).astype(np.uint8), groups)


def _in_channels(image: np.ndarray, channels: int) -> np.ndarray:
    return cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[..., None] if channels == 1 else image


def _loss(answer: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    loss: torch.Tensor = functional.smooth_l1_loss(answer, wanted, beta=BEND)
    return loss


class _Union:
    """Recorded rows and, numbered on after them, rendered ones."""

    def __init__(self, data: TrainingData, drawn: Presses | None) -> None:
        self._data, self._drawn, self._first = data, drawn, len(data.values)
        self.drawn_rows = self._first + np.arange(len(drawn.values) if drawn else 0)

    def fetch(self, rows: Indices) -> Tensor:
        """Inputs ``[n c h w]``, in the order asked for."""
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
