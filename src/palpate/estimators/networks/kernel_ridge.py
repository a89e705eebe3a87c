"""Kernel ridge regression on principal components of image features, without torch.

Matérn kernel with a linear part, regression with it, and a learned metric.

k = (1 + r + r²/3) e⁻ʳ + s z·z′ with r = √5 |z - z′| / l (Rasmussen & Williams, Gaussian Processes for Machine
Learning, MIT Press 2006, ch. 4). The metric is the mean outer product of a first fit's gradients
(Radhakrishnan et al., Science 383:1461 (2024), doi:10.1126/science.adi5639).
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from sklearn.model_selection import GroupKFold

from palpate.core import Float, Float32, Indices, InputError, Progress, Tensor, Values, silent
from palpate.estimators.networks.image_features import BlurredPixels, ImageFeatures, pin_moments
from palpate.estimators.networks.model_interface import (
    MIN_ERROR,
    BuiltInModel,
    ModelChoice,
    Scaler,
    TrainingData,
    Trial,
    typical_error,
)
from palpate.estimators.networks.onnx_graph import OnnxGraph
from palpate.estimators.networks.pixel_models import principal_axes

Scores = Float[np.ndarray, "n k"]

MIN_METRIC = 1e-4  # least weight of every component in a learned metric
JITTER = 1e-9  # of the kernel's diagonal, below which its rows are alike


@dataclass(frozen=True, slots=True)
class Kernel:
    """Matérn kernel of smoothness 5/2 with a length in units of the scores, plus a linear kernel."""

    length: float
    slope: float = 0.0

    @classmethod
    def over(cls, scores: Scores, width: float, linear: float) -> Kernel:
        """Return the kernel scaled by the rows' RMS distance and mean square."""
        square = float(scores.var(axis=0).sum()) or 1.0
        return cls(width * math.sqrt(2 * square), linear / square)

    def reach(self, a: Scores, b: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "n m"]:
        squares = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
        return np.sqrt(np.maximum(squares, 0) * (5 / self.length**2))

    def of(self, a: Scores, b: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "n m"]:
        r = self.reach(a, b)
        linear = self.slope * (a @ b.T) if self.slope else 0.0
        return (1 + r + r**2 / 3) * np.exp(-r) + linear

    def gradients(self, a: Scores, dual: Float[np.ndarray, " n"]) -> Scores:
        """Return gradients of Σ dual k(·, aᵢ) at the rows a themselves."""
        r = self.reach(a, a)
        pull = (1 + r) * np.exp(-r) * (5 / (3 * self.length**2)) * dual
        return pull @ a - pull.sum(axis=1)[:, None] * a + self.slope * (dual @ a)


@dataclass(frozen=True, slots=True)
class KernelShape:
    """Shape of the kernel, as inner folds choose it.

    Attributes:
        width: Length in RMS distances between rows.
        linear: Variance of the linear part relative to Matérn's.
        metric: Whether distances use a learned metric.
    """

    width: float = 1.0
    linear: float = 0.0
    metric: bool = False

    def __str__(self) -> str:
        line = f", linear share {self.linear:g}" if self.linear else ""
        return f"width {self.width:g}{line}{', learnt metric' if self.metric else ''}"


def solve(
    kernel: Kernel,
    scores: Scores,
    targets: Values,
    near: np.ndarray,
    penalties: Float[np.ndarray, " t"],
    progress: Progress = silent,
    batch: int = 2048,
) -> Float[np.ndarray, "m t"]:
    """Return the weights of the centers `near` for the penalty of each target.

    With all rows as centers (K + λ)⁻¹ y, else Nyström: ridge regression on L⁻¹ k, L Lᵀ the kernel among the
    centers (Rasmussen & Williams, ch. 8).
    """
    between = kernel.of(scores[near], scores[near])
    between[np.diag_indices_from(between)] += JITTER * len(near)
    if len(near) == len(scores):
        return _ridge(between, targets, penalties)
    lower = np.linalg.cholesky(between)
    products, sums = np.zeros_like(between), np.zeros((len(near), targets.shape[1]))
    for start in range(0, len(scores), batch):
        part = slice(start, start + batch)
        white = solve_triangular(lower, kernel.of(scores[near], scores[part]), lower=True)
        products += white @ white.T
        sums += white @ targets[part]
        progress("solving", min(start + batch, len(scores)), len(scores))
    return np.asarray(solve_triangular(lower.T, _ridge(products, sums, penalties)))


def _ridge(square: Float[np.ndarray, "m m"], right: Values, penalties: Float[np.ndarray, " t"]) -> Values:
    """(square + λ)⁻¹ right, each column with its own λ."""
    answer = np.empty_like(right)
    for penalty in np.unique(penalties):
        its = penalties == penalty
        factor = cho_factor(square + penalty * np.eye(len(square)), lower=True, overwrite_a=True)
        answer[:, its] = cho_solve(factor, right[:, its])
    return answer


def learnt_metric(
    scores: Scores, targets: Values, shape: KernelShape, penalties: Float[np.ndarray, " t"]
) -> Float[np.ndarray, "k k"]:
    """Return the map of scores after which distances count what the targets change by.

    Args:
        scores: Scores of the training rows.
        targets: Values of zero mean and unit spread.
        shape: Kernel of the first fit.
        penalties: Penalties of the first fit by target.
    """
    kernel = Kernel.over(scores, shape.width, shape.linear)
    dual = _ridge(kernel.of(scores, scores) + JITTER * np.eye(len(scores)), targets, penalties)
    outer = np.zeros((scores.shape[1],) * 2)
    for weights in dual.T:
        gradients = kernel.gradients(scores, weights)
        outer += gradients.T @ gradients
    size = float(np.trace(outer))
    if not size > 0:
        return np.eye(len(outer))
    squares, axes = np.linalg.eigh(outer / size + MIN_METRIC / len(outer) * np.eye(len(outer)))
    return np.asarray(axes * np.sqrt(np.maximum(squares, 0)))


Folds = list[tuple[np.ndarray, np.ndarray]]

INNER_FOLDS = 4


@dataclass(frozen=True)
class KernelMap:
    """value = k(scores, centres) · dual + scores · slopes + offset; scores = (features - centre) · axes."""

    columns: Indices
    features: ImageFeatures
    centre: Float32[np.ndarray, " f"]
    axes: Float32[np.ndarray, "f k"]
    centres: Float[np.ndarray, "m k"]
    length: float
    dual: Float[np.ndarray, "m t"]
    slopes: Float[np.ndarray, "k t"]
    offset: Float[np.ndarray, " t"]

    def predict(self, inputs: Tensor) -> Values:
        scores = ((self.features.compute(inputs) - self.centre) @ self.axes).astype(np.float64)
        near = Kernel(self.length).of(scores, self.centres)
        return np.asarray(near @ self.dual + scores @ self.slopes + self.offset)

    def add_to(self, graph: OnnxGraph) -> str:
        """Add the map to a graph, in float64 from the scores on because large weights cancel."""
        centred = graph.add("Sub", [self.features.add_to(graph)], {"centre": self.centre[None]})
        narrow = graph.add("MatMul", [centred], {"axes": self.axes})
        scores = graph.add("Cast", [narrow], to=TensorProto.DOUBLE)
        r = self._add_reach(graph, scores)
        linear = graph.add("Add", [r], {"one": np.array([1.0])})
        square = graph.add("Mul", [graph.add("Mul", [r, r])], {"third": np.array([1 / 3])})
        fall = graph.add("Exp", [graph.add("Neg", [r])])
        near = graph.add("Mul", [graph.add("Add", [linear, square]), fall])
        by_kernel = graph.add("MatMul", [near], {"dual": self.dual})
        by_line = graph.add("MatMul", [scores], {"slopes": self.slopes})
        return graph.add("Add", [graph.add("Add", [by_kernel, by_line])], {"offset": self.offset[None]})

    def _add_reach(self, graph: OnnxGraph, scores: str) -> str:
        size = graph.add("ReduceSum", [graph.add("Mul", [scores, scores])], {"along": np.array([1])})
        product = graph.add("MatMul", [scores], {"centres": -2 * self.centres.T})
        sizes = {"sizes": (self.centres**2).sum(axis=1)[None]}
        squares = graph.add("Add", [graph.add("Add", [product, size])], sizes)
        positive = graph.add("Max", [squares], {"zero": np.array([0.0])})
        return graph.add("Sqrt", [graph.add("Mul", [positive], {"scale": np.array([5 / self.length**2])})])


@dataclass(frozen=True)
class FittedKernelRidge:
    """One map for all targets, or one for each of two groups of them."""

    shape: tuple[int, int, int]
    maps: tuple[KernelMap, ...]
    choice: ModelChoice

    @property
    def _order(self) -> Indices:
        """Column of each target in the maps' outputs."""
        return np.argsort(np.concatenate([one.columns for one in self.maps]))

    def predict(self, inputs: Tensor) -> Values:
        return np.concatenate([one.predict(inputs) for one in self.maps], axis=1)[:, self._order]

    def to_onnx(self) -> onnx.ModelProto:
        graph = OnnxGraph()
        together = graph.add("Concat", [one.add_to(graph) for one in self.maps], axis=1)
        ordered = graph.add("Gather", [together], {"order": self._order}, axis=1)
        graph.add("Cast", [ordered], output="value", to=TensorProto.FLOAT)
        return graph.model(self.shape, len(self._order))


@dataclass(frozen=True, slots=True)
class _Way:
    """Features, kernel, and penalties for some of the targets."""

    columns: Indices
    features: ImageFeatures
    shape: KernelShape
    penalties: Float[np.ndarray, " t"]


@dataclass(frozen=True, slots=True)
class KernelRidge(BuiltInModel):
    """Kernel ridge regression whose features, kernel, and penalties are chosen by inner folds.

    Features, kernel width, linear part, and metric are chosen in turn, each with its penalty for each target;
    targets whose error falls by 1 % or more with other features use those. The final fit is exact up to
    `centres` rows and Nyström's approximation beyond.

    Attributes:
        blurs_px: Gaussian blurs of the pixels tried [px of the input].
        pin_windows: Windows about pins tried, in pin distances.
        widths: Kernel widths in RMS distances between rows; features are compared with the first.
        linear_shares: Ratios of the kernel's linear part.
        metric: Whether a learned metric is tried.
        penalties: Ridge penalties, where the kernel of a row with itself is 1.
        components: Greatest number of principal components.
        search_rows: Greatest number of rows for the choice.
        basis_frames: Greatest number of rows for the principal components.
        centres: Greatest number of rows that an estimate is compared with.
    """

    blurs_px: tuple[float, ...] = (0.0, 1.5, 3.0, 5.0)
    pin_windows: tuple[float, ...] = (0.3, 0.6)
    widths: tuple[float, ...] = (1.0, 0.6, 2.0, 4.0)
    linear_shares: tuple[float, ...] = (0.0, 1.0)
    metric: bool = True
    penalties: tuple[float, ...] = tuple(float(p) for p in np.logspace(1, -5, 13))
    components: int = 300
    search_rows: int = 800
    basis_frames: int = 2000
    centres: int = 3000

    def __post_init__(self) -> None:
        whole = (self.components, self.search_rows - 9, self.basis_frames - 1, self.centres - 9)
        positive = (*self.widths, *self.penalties)
        if not (self.blurs_px and self.widths and self.linear_shares and self.penalties):
            raise InputError(f"{self}: give one or more of blurs, widths, linear shares and penalties")
        if min(whole) < 1 or not min(positive) > 0 or min((*self.blurs_px, *self.linear_shares)) < 0:
            raise InputError(
                f"{self}: components 1, basis_frames 2, search_rows and centres 10 or more; widths and "
                "penalties above 0; blurs and linear shares 0 or more"
            )
        if min(self.pin_windows, default=1.0) <= 0:
            raise InputError(
                f"pin_windows are {self.pin_windows}; each is above 0, in distances between pins"
            )

    def _fit(
        self, data: TrainingData, rows: Indices, seed: int, progress: Progress, checkpoint: Path | None
    ) -> FittedKernelRidge:
        rng = np.random.default_rng(seed)
        few = rows if len(rows) <= self.search_rows else np.sort(rng.choice(rows, self.search_rows, False))
        search = _Search(self, data, few, progress)
        ways = search.ways()
        maps = tuple(self._learnt(data, rows, way, rng, progress) for way in ways)
        return FittedKernelRidge(data.shape, maps, search.choice())

    def _learnt(
        self, data: TrainingData, rows: Indices, way: _Way, rng: np.random.Generator, progress: Progress
    ) -> KernelMap:
        basis = (
            rows if len(rows) <= self.basis_frames else np.sort(rng.choice(rows, self.basis_frames, False))
        )
        centre, axes = components_of(features_of(data, basis, way.features), self.components)
        scores = features_of(data, rows, way.features, (centre, axes), progress).astype(np.float64)
        values = data.values[np.ix_(rows, way.columns)]
        scaler = Scaler.of(values)
        targets, near = scaler.scaled(values), np.arange(len(rows))
        if len(rows) > self.centres:
            near = np.sort(rng.choice(len(rows), self.centres, replace=False))
        if way.shape.metric:
            turn = learnt_metric(scores[near], targets[near], way.shape, way.penalties)
            axes, scores = (axes @ turn).astype(np.float32), scores @ turn
        kernel = Kernel.over(scores, way.shape.width, way.shape.linear)
        dual = solve(kernel, scores, targets, near, way.penalties, progress) * scaler.scale
        slopes = kernel.slope * (scores[near].T @ dual)
        return KernelMap(
            way.columns, way.features, centre, axes, scores[near], kernel.length, dual, slopes, scaler.mean
        )


def features_of(
    data: TrainingData,
    rows: Indices,
    features: ImageFeatures,
    onto: tuple[Float32[np.ndarray, " f"], Float32[np.ndarray, "f k"]] | None = None,
    progress: Progress = silent,
) -> Float32[np.ndarray, "n _"]:
    """Return features of rows, or their scores along axes, in batches."""
    parts: list[np.ndarray] = []
    for _, inputs in data.batches(rows):
        found = features.compute(inputs)
        parts.append(found if onto is None else (found - onto[0]) @ onto[1])
        progress("projecting", sum(map(len, parts)), len(rows))
    return np.concatenate(parts)


def components_of(
    found: Float32[np.ndarray, "n f"], most: int
) -> tuple[Float32[np.ndarray, " f"], Float32[np.ndarray, "f k"]]:
    """Return mean and principal axes of rows of features; a zero axis if all are equal."""
    centre = found.mean(axis=0)
    centred = found - centre
    if not np.abs(centred).max() > 1e-6 * np.abs(found).max():
        return centre, np.zeros((found.shape[1], 1), np.float32)
    return centre, principal_axes(centred, most)


MIN_GAIN = 0.01  # relative gain for which a target gets other features than the rest


@dataclass
class _Search:
    """Choice of features, kernel, and penalties on some of the rows, with at most `count` trials."""

    model: KernelRidge
    data: TrainingData
    rows: Indices
    progress: Progress
    trials: list[Trial] = field(default_factory=list)
    chosen: str = ""
    count: int = 0

    def ways(self) -> list[_Way]:
        """Best variant for all targets, or two, each for some of them."""
        model, candidates, folds = self.model, self._candidates(), self._folds()
        shape = KernelShape(model.widths[0], model.linear_shares[0])
        everything = np.arange(self.data.values.shape[1])
        if not folds:
            penalty = float(np.exp(np.log(model.penalties).mean()))
            self.chosen = (
                f"{candidates[0].name}; {shape}; one group, so that nothing was chosen by holding out"
            )
            return [_Way(everything, candidates[0], shape, np.full(len(everything), penalty))]
        changes = self._changes()
        self.count = len(candidates) + 2 * len(changes)
        scores = [self._scores(one) for one in candidates]
        errors = [
            self._tried(one.name, found, shape, everything, folds)
            for one, found in zip(candidates, scores, strict=True)
        ]
        parts = _parted(np.array([one.min(axis=0) for one in errors]))
        ways = []
        for i, columns in parts:
            its = errors[i][:, columns]
            plain = _Way(columns, candidates[i], shape, self._penalties(its))
            ways.append(self._shaped(plain, scores[i], its, folds))
        self.progress("choosing", self.count, self.count)
        self.chosen = "; and ".join(
            (f"{self._names(way.columns)}: " if len(ways) > 1 else "") + f"{way.features.name}; {way.shape}"
            for way in ways
        )
        return ways

    def choice(self) -> ModelChoice:
        return ModelChoice(self.chosen, tuple(self.trials))

    def _names(self, columns: Indices) -> str:
        return ", ".join(self.data.names[j] if self.data.names else str(j) for j in columns)

    def _candidates(self) -> list[ImageFeatures]:
        channels, height, width = self.data.shape
        most = min(height, width) / 4  # a blur of more leaves next to nothing of an image
        blurs = [blur for blur in self.model.blurs_px if blur <= most] or [0.0]
        sample = self.data.sample(self.rows, 64, np.random.default_rng(0))
        pins = pin_moments(sample, self.model.pin_windows) if self.model.pin_windows else []
        return [*(BlurredPixels(channels, blur) for blur in blurs), *pins]

    def _changes(self) -> list[dict[str, Any]]:
        """Changes of the kernel's shape, tried in turn."""
        model = self.model
        return [
            *({"width": width} for width in model.widths[1:]),
            *({"linear": share} for share in model.linear_shares[1:]),
            *([{"metric": True}] if model.metric else []),
        ]

    def _folds(self) -> Folds:
        groups = self.data.groups[self.rows]
        count = min(INNER_FOLDS, len(np.unique(groups)))
        return list(GroupKFold(count).split(self.rows, groups=groups)) if count > 1 else []

    def _scores(self, features: ImageFeatures) -> Scores:
        found = features_of(self.data, self.rows, features)
        centre, axes = components_of(found, self.model.components)
        return ((found - centre) @ axes).astype(np.float64)

    def _shaped(self, way: _Way, scores: Scores, errors: Float[np.ndarray, "l t"], folds: Folds) -> _Way:
        """Variant with the best kernel shape and its penalties."""
        shape = way.shape
        for change in self._changes():
            another = replace(shape, **change)
            name = f"{way.features.name}; {another}"
            found = self._tried(name, scores, another, way.columns, folds, self._penalties(errors))
            if typical_error(found.min(axis=0)) < typical_error(errors.min(axis=0)):
                shape, errors = another, found
        return replace(way, shape=shape, penalties=self._penalties(errors))

    def _penalties(self, errors: Float[np.ndarray, "l t"]) -> Float[np.ndarray, " t"]:
        return np.array(self.model.penalties)[errors.argmin(axis=0)]

    def _tried(
        self,
        name: str,
        scores: Scores,
        shape: KernelShape,
        columns: Indices,
        folds: Folds,
        penalties: Float[np.ndarray, " t"] | None = None,
    ) -> Float[np.ndarray, "l t"]:
        """Errors of a variant on the inner folds, recorded as a trial."""
        started = time.monotonic()
        errors = self._held_out(scores, shape, columns, folds, penalties)
        seconds = time.monotonic() - started
        whose = f"of {self._names(columns)}" if len(columns) < self.data.values.shape[1] else ""
        self.trials.append(Trial(name, typical_error(errors.min(axis=0)), seconds, whose))
        self.progress("choosing", len(self.trials), self.count)
        return errors

    def _held_out(
        self,
        scores: Scores,
        shape: KernelShape,
        columns: Indices,
        folds: Folds,
        penalties: Float[np.ndarray, " t"] | None,
    ) -> Float[np.ndarray, "l t"]:
        """RMS errors on held-out rows in units of the spread, by penalty and target."""
        values = self.data.values[np.ix_(self.rows, columns)]
        targets = Scaler.of(values).scaled(values)
        squares = np.zeros((len(self.model.penalties), len(columns)))
        for learn, watch in folds:
            mean = targets[learn].mean(axis=0)
            ours, theirs, wanted = scores[learn], scores[watch], targets[learn] - mean
            if shape.metric and penalties is not None:
                turn = learnt_metric(ours, wanted, shape, penalties)
                ours, theirs = ours @ turn, theirs @ turn
            kernel = Kernel.over(ours, shape.width, shape.linear)
            spectrum, axes = np.linalg.eigh(kernel.of(ours, ours))
            seen, across = axes.T @ wanted, kernel.of(theirs, ours) @ axes
            for i, penalty in enumerate(self.model.penalties):
                guess = across @ (seen / (np.maximum(spectrum, 0)[:, None] + penalty)) + mean
                squares[i] += ((guess - targets[watch]) ** 2).sum(axis=0)
        return np.sqrt(squares / len(self.rows))


def _parted(errors: Float[np.ndarray, "c t"]) -> list[tuple[int, Indices]]:
    """Candidates and the targets each is best for; a second one only if it gains enough."""
    first = int(np.argmin([typical_error(row) for row in errors]))
    gains = np.log(np.maximum(errors[first], MIN_ERROR) / np.maximum(errors, MIN_ERROR))
    worth = np.where(gains > -np.log1p(-MIN_GAIN), gains, 0.0)
    second = int(np.argmax(worth.sum(axis=1)))
    moved = worth[second] > 0
    parts = [(first, np.flatnonzero(~moved)), (second, np.flatnonzero(moved))]
    return [(i, columns) for i, columns in parts if len(columns)]
