"""Estimation without a network: image moments, quadratic ridge regression, and extremely randomized trees.

Position is a quadratic function of ten moments of the mirror's difference. Depth and force come from trees
(Geurts, Ernst & Wehenkel, Machine Learning 63:3 (2006), doi:10.1007/s10994-006-6226-1) on these moments, the
fringes' own, and the fringe intensities in order of size.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import onnx
from onnx import TensorProto, helper
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.linear_model import RidgeCV
from sklearn.model_selection import GroupKFold

from palpate.core import Float, Float32, Indices, InputError, Progress, Shaped, Tensor, Values, silent
from palpate.estimators.networks.model_interface import Scaler, TrainingData
from palpate.estimators.networks.onnx_graph import OnnxGraph
from palpate.sensors.palm.networks import PLACE
from palpate.sensors.palm.networks.palm_training import DEPTH, columns_of, half_width

FAINT = 4.0  # threshold of the fringe difference [grey levels]
DIM, BRIGHT = 6.0, 8.0  # thresholds of the mirror's difference, either sign and brighter [grey levels]
MOMENTS = 5  # moments of a map: centroid, spread, log sum
QUANTILES = 96  # quantiles of the fringe intensities
GREY = (0.299, 0.587, 0.114)  # weights of red, green, and blue (ITU-R BT.601)
RIDGES = tuple(float(p) for p in np.logspace(-4, 3, 15))
INNER_FOLDS = 4

Features = Float[np.ndarray, "n f"]


def _grid(height: int, width: int) -> Float[np.ndarray, "p 5"]:
    """1, x, y, x², and y² of every pixel, x and y from -1 to 1."""
    down, across = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    x, y = across.ravel(), down.ravel()
    return np.stack([np.ones_like(x), x, y, x**2, y**2], axis=1)


def _moments(weights: Float32[np.ndarray, "n h w"]) -> Features:
    """Centroid, spread, and log sum of maps ``[n 5]``."""
    sums = weights.reshape(len(weights), -1).astype(np.float64) @ _grid(*weights.shape[1:])
    total = sums[:, :1] + 1.0  # one grey level of one pixel centers an empty map
    centre, square = sums[:, 1:3] / total, sums[:, 3:] / total
    spread = np.sqrt(np.maximum(square - centre**2, 0.0))
    return np.concatenate([centre, spread, np.log(total)], axis=1)


def mirror_moments(mirror: Float32[np.ndarray, "n h w"]) -> Features:
    """Return ten moments of the mirror's difference: of all changes, and of brighter pixels."""
    return np.concatenate(
        [_moments(np.maximum(np.abs(mirror) - DIM, 0)), _moments(np.maximum(mirror - BRIGHT, 0))], axis=1
    )


def fringe_features(fringe: Float32[np.ndarray, "n h w"]) -> Features:
    """Return five moments of the fringes' difference, and its sorted grey levels."""
    ordered = -np.sort(-fringe.reshape(len(fringe), -1), axis=1)
    return np.concatenate(
        [_moments(np.maximum(np.abs(fringe) - FAINT, 0)), ordered[:, _picked(ordered.shape[1])]], axis=1
    )


def _picked(pixels: int) -> Indices:
    return np.linspace(0, pixels - 1, min(QUANTILES, pixels)).round().astype(np.int64)


def _pairs(count: int) -> tuple[Indices, Indices]:
    first, second = np.triu_indices(count)
    return first.astype(np.int64), second.astype(np.int64)


@dataclass(frozen=True, slots=True)
class MirrorPlace:
    """Position ``[n 2]`` as a quadratic function of the mirror's moments, clipped to the trained range.

    (x, y) = [z, zᵢ zⱼ] · weights + offset, with z = (moments - mean) / spread.
    """

    low: Float[np.ndarray, " m"]
    high: Float[np.ndarray, " m"]
    scaler: Scaler
    weights: Float[np.ndarray, "q t"]
    offset: Float[np.ndarray, " t"]

    @classmethod
    def fit(cls, moments: Features, places: Values, groups: Shaped[np.ndarray, " n"]) -> MirrorPlace:
        """Fit a ridge on moments and their products, with the penalty from grouped inner folds."""
        scaler = Scaler.of(moments)
        terms = _quadratic(scaler.scaled(moments))
        its = Scaler.of(terms)
        count = min(INNER_FOLDS, len(np.unique(groups)))
        folds = list(GroupKFold(count).split(terms, groups=groups)) if count > 1 else None
        ridge = RidgeCV(RIDGES, cv=folds).fit(its.scaled(terms), places)
        weights = ridge.coef_.T / its.scale[:, None]
        low, high = moments.min(axis=0), moments.max(axis=0)
        return cls(low, high, scaler, weights, ridge.intercept_ - its.mean @ weights)

    def of_moments(self, moments: Features) -> Values:
        known = np.clip(moments, self.low, self.high)
        return np.asarray(_quadratic(self.scaler.scaled(known)) @ self.weights + self.offset)

    def predict(self, inputs: Tensor) -> Values:
        """Positions of inputs ``[n c h w]`` with the mirror in the right half."""
        return self.of_moments(mirror_moments(_grey(inputs)[..., inputs.shape[3] // 2 :]))

    def add_to(self, graph: OnnxGraph, moments: str) -> str:
        """Add the map to a graph from the moments; returns the position's name."""
        known = graph.add("Max", [moments], {"low": self.low[None]})
        known = graph.add("Min", [known], {"high": self.high[None]})
        centred = graph.add("Sub", [known], {"mean": self.scaler.mean[None]})
        z = graph.add("Div", [centred], {"spread": self.scaler.scale[None]})
        first, second = (graph.add("Gather", [z], {"i": i}, axis=1) for i in _pairs(len(self.scaler.mean)))
        both = graph.add("Concat", [z, graph.add("Mul", [first, second])], axis=1)
        sums = graph.add("MatMul", [both], {"weights": self.weights})
        return graph.add(
            "Cast", [graph.add("Add", [sums], {"offset": self.offset[None]})], to=TensorProto.FLOAT
        )

    def add_to_image(self, graph: OnnxGraph, shape: tuple[int, int, int]) -> str:
        """Add `predict` to a graph."""
        _, mirror = view_nodes(graph, shape)
        return self.add_to(graph, _mirror_nodes(graph, mirror, (shape[1], shape[2] // 2)))


def _quadratic(z: Features) -> Float[np.ndarray, "n q"]:
    first, second = _pairs(z.shape[1])
    return np.concatenate([z, z[:, first] * z[:, second]], axis=1)


@dataclass(frozen=True, slots=True)
class FittedMoments:
    """Fitted position map and trees.

    Attributes:
        shape: (channels, height, width) of an input.
        order: Index of each requested target among x, y, depth, and force.
        scaler: Scaling of depth and force.
    """

    shape: tuple[int, int, int]
    order: Indices
    place: MirrorPlace
    trees: ExtraTreesRegressor
    scaler: Scaler

    def predict(self, inputs: Tensor) -> Values:
        mirror, every = features_of(inputs)
        pressed = self.scaler.restored(self.trees.predict(every.astype(np.float32)))
        return np.concatenate([self.place.of_moments(mirror), pressed], axis=1)[:, self.order]

    def to_onnx(self) -> onnx.ModelProto:
        graph, size = OnnxGraph(), (self.shape[1], self.shape[2] // 2)
        fringe, mirror = view_nodes(graph, self.shape)
        moments = _mirror_nodes(graph, mirror, size)
        fringes = _moment_nodes(graph, _above(graph, graph.add("Abs", [fringe]), FAINT), size)
        narrow = [graph.add("Cast", [one], to=TensorProto.FLOAT) for one in (moments, fringes)]
        every = graph.add("Concat", [*narrow, _ordered_nodes(graph, fringe, size[0] * size[1])], axis=1)
        pressed = graph.restored(graph.add_trees(self.trees, every), self.scaler.scale, self.scaler.mean)
        together = graph.add("Concat", [self.place.add_to(graph, moments), pressed], axis=1)
        graph.add("Gather", [together], {"order": self.order}, output="value", axis=1)
        return graph.model(self.shape, len(self.order))


def features_of(inputs: Tensor) -> tuple[Features, Float[np.ndarray, "n g"]]:
    """Return the mirror's moments and all features of inputs ``[n c h w]``."""
    views, half = _grey(inputs), inputs.shape[3] // 2
    mirror = mirror_moments(views[..., half:])
    return mirror, np.concatenate([mirror, fringe_features(views[..., :half])], axis=1)


def _grey(inputs: Tensor) -> Float32[np.ndarray, "n h w"]:
    if inputs.shape[1] == 1:
        return inputs[:, 0]
    return np.tensordot(inputs, np.array(GREY, np.float32), axes=(1, 0))


def view_nodes(graph: OnnxGraph, shape: tuple[int, int, int]) -> tuple[str, str]:
    """Return both views of ``image``, grey and flat ``[n p]``."""
    half, at = half_width(shape), "image"
    if shape[0] > 1:
        at = graph.add("Conv", [at], {"grey": np.array(GREY, np.float32)[None, :, None, None]})
    cuts = []
    for first in (0, half):
        bounds = {"first": first, "end": first + half, "axis": 3}
        cut = graph.add("Slice", [at], {name: np.array([place]) for name, place in bounds.items()})
        cuts.append(graph.add("Flatten", [cut]))
    return cuts[0], cuts[1]


def _mirror_nodes(graph: OnnxGraph, mirror: str, size: tuple[int, int]) -> str:
    changed = _moment_nodes(graph, _above(graph, graph.add("Abs", [mirror]), DIM), size)
    brighter = _moment_nodes(graph, _above(graph, mirror, BRIGHT), size)
    return graph.add("Concat", [changed, brighter], axis=1)


def _above(graph: OnnxGraph, at: str, level: float) -> str:
    return graph.add("Relu", [graph.add("Sub", [at], {"level": np.array([level], np.float32)})])


def _moment_nodes(graph: OnnxGraph, weights: str, size: tuple[int, int]) -> str:
    """`_moments` in float64, since a spread is a small difference of two sums."""
    wide = graph.add("Cast", [weights], to=TensorProto.DOUBLE)
    sums = graph.add("MatMul", [wide], {"grid": _grid(*size)})

    def part(*columns: int) -> str:
        return graph.add("Gather", [sums], {"part": np.array(columns)}, axis=1)

    total = graph.add("Add", [part(0)], {"one": np.array([1.0])})
    centre, square = (graph.add("Div", [part(*columns), total]) for columns in ((1, 2), (3, 4)))
    variance = graph.add("Sub", [square, graph.add("Mul", [centre, centre])])
    spread = graph.add("Sqrt", [graph.add("Max", [variance], {"zero": np.array([0.0])})])
    return graph.add("Concat", [centre, spread, graph.add("Log", [total])], axis=1)


def _ordered_nodes(graph: OnnxGraph, view: str, pixels: int) -> str:
    """Grey levels, largest first."""
    name = f"ordered{len(graph.nodes)}"
    constant = f"all{len(graph.nodes)}"
    graph.constants[constant] = np.array([pixels], np.int64)
    graph.nodes.append(helper.make_node("TopK", [view, constant], [name, f"{name}-places"], axis=1))
    return graph.add("Gather", [name], {"picked": _picked(pixels)}, axis=1)


@dataclass(frozen=True, slots=True)
class PalmMoments:
    """Settings of moments and trees, for differential crops."""

    trees: int = 150
    leaf_rows: int = 1

    targets: ClassVar[tuple[str, ...]] = (*PLACE, DEPTH, "force_N")

    def __post_init__(self) -> None:
        if min(self.trees, self.leaf_rows) < 1:
            raise InputError(
                f"trees {self.trees}, leaf_rows {self.leaf_rows}: both are 1 or more", code="tree-count"
            )

    def fit(
        self,
        data: TrainingData,
        rows: Indices,
        *,
        seed: int,
        progress: Progress = silent,
        checkpoint: Path | None = None,
    ) -> FittedMoments:
        columns = columns_of(self.targets, data.names, type(self).__name__)
        half_width(data.shape)
        mirror, every = _features_of_rows(data, rows, progress)
        values = data.values[np.ix_(rows, columns)]
        scaler = Scaler.of(values[:, 2:])
        trees = ExtraTreesRegressor(self.trees, min_samples_leaf=self.leaf_rows, random_state=seed)
        trees.fit(every.astype(np.float32), scaler.scaled(values[:, 2:]))
        place = MirrorPlace.fit(mirror, values[:, :2], data.groups[rows])
        return FittedMoments(data.shape, np.argsort(columns), place, trees, scaler)


def _features_of_rows(
    data: TrainingData, rows: Indices, progress: Progress
) -> tuple[Features, Float[np.ndarray, "n g"]]:
    found, done = [], 0
    for part, inputs in data.batches(rows):
        found.append(features_of(inputs))
        done += len(part)
        progress("computing moments", done, len(rows))
    mirror, every = zip(*found, strict=True)
    return np.concatenate(mirror), np.concatenate(every)
