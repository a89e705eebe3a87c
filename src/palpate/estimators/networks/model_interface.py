"""The small interface every model keeps: fit on rows, predict values, become ONNX."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import onnx

from palpate.core import Float, Indices, InputError, Progress, Shaped, Tensor, Values, silent


@dataclass(frozen=True)
class TrainingData:
    """Data that a model learns from: inputs fetched by row, values, and which rows belong together.

    Attributes:
        shape: (channels, height, width) of an input.
        values: ``[n t]``, in the targets' own units; NaN where a row is held out. Read-only, as `groups`.
        groups: ``[n]`` label of each row's group; rows of one group never stand on both sides.
        fetch: rows -> inputs ``[n c h w]``, grey levels 0 to 255, or their difference from a reference.
        names: of the targets, as quantity_unit; empty where no model asks.
    """

    shape: tuple[int, int, int]
    values: Values
    groups: Shaped[np.ndarray, " n"]
    fetch: Callable[[Indices], Tensor]
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self.values.flags.writeable = self.groups.flags.writeable = False  # scores are of these very labels

    def batches(self, rows: Indices, size: int = 256) -> Iterator[tuple[Indices, Tensor]]:
        """Rows and their inputs, `size` at a time, in the order given."""
        for start in range(0, len(rows), size):
            part = rows[start : start + size]
            yield part, self.fetch(part)

    def sample(self, rows: Indices, most: int, rng: np.random.Generator) -> Tensor:
        """Inputs of at most `most` of the rows, drawn without replacement."""
        chosen = rows if len(rows) <= most else np.sort(rng.choice(rows, most, replace=False))
        return np.concatenate([inputs for _, inputs in self.batches(chosen)])

    def inner_validation(
        self, rows: Indices, share: float, rng: np.random.Generator
    ) -> tuple[Indices, Indices]:
        """Part whole groups from `rows`, to decide by them when to stop.

        Returns:
            Rows to learn from and rows to watch; the second is empty where there are fewer than two groups.
        """
        names = np.unique(self.groups[rows])
        count = min(round(share * len(names)) or 1, len(names) - 1)
        validation = np.isin(self.groups[rows], rng.choice(names, count, replace=False))
        return rows[~validation], rows[validation]


@runtime_checkable
class Fitted(Protocol):
    """A model that has learnt."""

    def predict(self, inputs: Tensor) -> Values:
        """Estimates ``[n t]`` in the targets' units, for inputs ``[n c h w]``."""

    def to_onnx(self) -> onnx.ModelProto:
        """The same map as ONNX, from ``image [n c h w]`` to ``value [n t]``, both float32."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One way of learning that a model tried on inner folds.

    Attributes:
        name: what was tried.
        error: root mean square error on rows of groups not learnt from, in units of each target's spread, as
            the geometric mean over the targets: about 1 is what the mean gives. None where it was not tried.
        seconds: time it took [s].
        note: why it was not tried, or how far it came.
    """

    name: str
    error: float | None
    seconds: float
    note: str = ""


@dataclass(frozen=True, slots=True)
class ModelChoice:
    """Choice that a model made by its inner folds, and what each way gave.

    Attributes:
        chosen: name of one of the trials, with what was decided after it.
        trials: in the order in which they were tried.
    """

    chosen: str
    trials: tuple[Trial, ...]


@runtime_checkable
class Chooses(Protocol):
    """A fitted model that says what it has chosen among; for the card."""

    choice: ModelChoice


@dataclass(frozen=True, slots=True)
class TrainingRecord:
    """How long a network has learnt.

    Attributes:
        steps: of its optimiser.
        epochs: passes over the rows learnt from, the last one perhaps in part.
        batch: rows a step, at most.
        best_step: after which the weights that are kept were reached; 0 where no rows were watched, and those
            after the last step are kept.
        stopped: whether it ended since watched rows gained no more, not since its steps were used up.
    """

    steps: int
    epochs: int
    batch: int
    best_step: int = 0
    stopped: bool = False


@runtime_checkable
class LearnsInSteps(Protocol):
    """A fitted model that says how long it has learnt; for the card."""

    training: TrainingRecord


@runtime_checkable
class TimeBoxed(Protocol):
    """A model that is given a time for all fits of a calibration together."""

    def shared_among(self, fits: int) -> Model:
        """The same model, for one of so many fits."""


def typical_error(errors: Float[np.ndarray, " t"]) -> float:
    """Geometric mean of the targets' errors: one per cent counts alike in a good target and in a poor one."""
    return float(np.exp(np.log(np.maximum(errors, MIN_ERROR)).mean()))


MIN_ERROR = 1e-9  # in units of the spread, below which errors are alike


@runtime_checkable
class Model(Protocol):
    """A recipe that learns."""

    def fit(
        self,
        data: TrainingData,
        rows: Indices,
        *,
        seed: int,
        progress: Progress = silent,
        checkpoint: Path | None = None,
    ) -> Fitted:
        """Learn from `rows` of `data`.

        Args:
            data: inputs and values.
            rows: the rows that may be learnt from.
            seed: of everything random.
            progress: called with how far the work is.
            checkpoint: a file the model may keep its progress in, to go on from after an interruption.
        """


def predict_rows(fitted: Fitted, data: TrainingData, rows: Indices) -> Values:
    """Predict many rows a batch at a time."""
    parts = [fitted.predict(inputs) for _, inputs in data.batches(rows)]
    return np.concatenate(parts) if parts else np.empty((0, data.values.shape[1]))


def refuse_unfit(estimates: Values, shape: tuple[int, int], whose: str) -> None:
    """Refuse, with an InputError, estimates that are not one finite number for each row and target."""
    fit = np.isfinite(estimates).all(axis=1) if estimates.shape == shape else np.zeros(shape[0], bool)
    if not fit.all():
        raise InputError(
            f"model {whose}: predict gave {list(estimates.shape)} for {list(shape)}, of which "
            f"{np.sum(~fit)} of {shape[0]} rows are no finite numbers; every row is scored, so mend the model"
        )


@dataclass(frozen=True, slots=True)
class Scaler:
    """Values to zero mean and unit spread, and back."""

    mean: Float[np.ndarray, " t"]
    scale: Float[np.ndarray, " t"]

    @classmethod
    def of(cls, values: Values) -> Scaler:
        """The scaler of these values; a constant column keeps its size."""
        spread = values.std(axis=0)
        return cls(values.mean(axis=0), np.where(spread > 0, spread, 1.0))

    def scaled(self, values: Values) -> Values:
        """Into units of the spread."""
        return (values - self.mean) / self.scale

    def restored(self, scaled: Values) -> Values:
        """Back into the targets' units."""
        return scaled * self.scale + self.mean


def scaled_errors(fitted: Fitted, scaler: Scaler, data: TrainingData, rows: Indices) -> Values:
    """Errors of estimates of rows ``[n t]``, in units of the spread."""
    return scaler.scaled(predict_rows(fitted, data, rows)) - scaler.scaled(data.values[rows])
