"""The small interface every model keeps: fit on rows, predict values, become ONNX."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import onnx

from palpate.core import Float, Indices, InputError, Progress, Shaped, Tensor, Values, silent


@dataclass(frozen=True)
class TrainingData:
    """Training data: inputs fetched by row, values, and groups.

    Attributes:
        shape: Channels, height, and width of an input.
        values: Values ``[n t]`` in the targets' units; NaN if held out. Read-only, as `groups`.
        groups: Group of each row ``[n]``; rows of one group are never on both sides of a split.
        fetch: Function from rows to inputs ``[n c h w]``: gray levels 0 to 255, or differences from a
            reference.
        names: Target names, quantity_unit.
    """

    shape: tuple[int, int, int]
    values: Values
    groups: Shaped[np.ndarray, " n"]
    fetch: Callable[[Indices], Tensor]
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self.values.flags.writeable = self.groups.flags.writeable = False  # scores are of these very labels

    def batches(self, rows: Indices, size: int = 256) -> Iterator[tuple[Indices, Tensor]]:
        """Yield rows and their inputs, `size` at a time, in the given order."""
        for start in range(0, len(rows), size):
            part = rows[start : start + size]
            yield part, self.fetch(part)

    def sample(self, rows: Indices, most: int, rng: np.random.Generator) -> Tensor:
        """Return inputs of at most `most` rows, drawn without replacement."""
        chosen = rows if len(rows) <= most else np.sort(rng.choice(rows, most, replace=False))
        return np.concatenate([inputs for _, inputs in self.batches(chosen)])

    def inner_validation(
        self, rows: Indices, share: float, rng: np.random.Generator
    ) -> tuple[Indices, Indices]:
        """Return rows to train on and rows to watch (none for fewer than two groups), by whole groups."""
        names = np.unique(self.groups[rows])
        count = min(round(share * len(names)) or 1, len(names) - 1)
        validation = np.isin(self.groups[rows], rng.choice(names, count, replace=False))
        return rows[~validation], rows[validation]


@runtime_checkable
class Fitted(Protocol):
    """Trained model."""

    def predict(self, inputs: Tensor) -> Values:
        """Return estimates ``[n t]`` in the targets' units for inputs ``[n c h w]``."""

    def to_onnx(self) -> onnx.ModelProto:
        """Return the map as ONNX, from ``image [n c h w]`` to ``value [n t]``, both float32."""


@dataclass(frozen=True, slots=True)
class Trial:
    """Variant that a model tried on inner folds.

    Attributes:
        error: RMS error on held-out groups in units of each target's spread, geometric mean over targets (1
            is the mean's); None if not tried.
        seconds: Duration [s].
        note: Why it was not tried, or how far it came.
    """

    name: str
    error: float | None
    seconds: float
    note: str = ""


@dataclass(frozen=True, slots=True)
class ModelChoice:
    """Choice that a model made by its inner folds, and the trials in order."""

    chosen: str
    trials: tuple[Trial, ...]


@runtime_checkable
class Chooses(Protocol):
    """Fitted model with a choice, for the card."""

    choice: ModelChoice


@dataclass(frozen=True, slots=True)
class TrainingRecord:
    """How long a network was trained.

    Attributes:
        steps: Optimizer steps.
        epochs: Passes over the training rows, the last perhaps partial.
        batch: Rows a step.
        best_step: Step of the kept weights; 0 for the last one if no rows were watched.
        stopped: Whether it stopped early.
    """

    steps: int
    epochs: int
    batch: int
    best_step: int = 0
    stopped: bool = False


@runtime_checkable
class LearnsInSteps(Protocol):
    """Fitted model with a training record, for the card."""

    training: TrainingRecord


def typical_error(errors: Float[np.ndarray, " t"]) -> float:
    """Return the geometric mean of the targets' errors."""
    return float(np.exp(np.log(np.maximum(errors, MIN_ERROR)).mean()))


MIN_ERROR = 1e-9  # in units of the spread, below which errors are alike


@runtime_checkable
class Model(Protocol):
    """Model that can be trained."""

    def fit(
        self,
        data: TrainingData,
        rows: Indices,
        *,
        seed: int,
        progress: Progress = silent,
        checkpoint: Path | None = None,
    ) -> Fitted:
        """Train on `rows` of `data`.

        Args:
            data: Inputs and values.
            rows: Training rows.
            seed: Random seed.
            progress: Progress callback.
            checkpoint: File to resume from after an interruption.
        """


class BuiltInModel:
    """Model of the package: `fit` as of `Model`, whose defaults stand here once."""

    __slots__ = ()

    def fit(
        self,
        data: TrainingData,
        rows: Indices,
        *,
        seed: int,
        progress: Progress = silent,
        checkpoint: Path | None = None,
    ) -> Any:
        return self._fit(data, rows, seed, progress, checkpoint)

    def _fit(
        self, data: TrainingData, rows: Indices, seed: int, progress: Progress, checkpoint: Path | None
    ) -> Fitted:
        raise NotImplementedError


def predict_rows(fitted: Fitted, data: TrainingData, rows: Indices) -> Values:
    """Predict rows in batches."""
    parts = [fitted.predict(inputs) for _, inputs in data.batches(rows)]
    return np.concatenate(parts) if parts else np.empty((0, data.values.shape[1]))


def refuse_unfit(estimates: Values, shape: tuple[int, int], whose: str) -> None:
    """Refuse estimates that are not one finite number for each row and target (InputError)."""
    fit = np.isfinite(estimates).all(axis=1) if estimates.shape == shape else np.zeros(shape[0], bool)
    if not fit.all():
        raise InputError(
            f"model {whose}: predict gave {list(estimates.shape)} for {list(shape)}, {np.sum(~fit)} of "
            f"{shape[0]} rows not finite"
        )


@dataclass(frozen=True, slots=True)
class Scaler:
    """Standardization of values."""

    mean: Float[np.ndarray, " t"]
    scale: Float[np.ndarray, " t"]

    @classmethod
    def of(cls, values: Values) -> Scaler:
        spread = values.std(axis=0)
        return cls(values.mean(axis=0), np.where(spread > 0, spread, 1.0))

    def scaled(self, values: Values) -> Values:
        return (values - self.mean) / self.scale

    def restored(self, scaled: Values) -> Values:
        return scaled * self.scale + self.mean


def scaled_errors(fitted: Fitted, scaler: Scaler, data: TrainingData, rows: Indices) -> Values:
    """Return errors of estimates ``[n t]`` in units of the spread."""
    return scaler.scaled(predict_rows(fitted, data, rows)) - scaler.scaled(data.values[rows])
