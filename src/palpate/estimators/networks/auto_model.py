"""A model that tries others for as long as it is given, and keeps what was best on inner folds."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from sklearn.model_selection import GroupKFold

from palpate.core import Float, Indices, InputError, MissingExtraError, Progress, Tensor, Values, silent
from palpate.estimators.networks.model_interface import (
    Chooses,
    Fitted,
    ModelChoice,
    Scaler,
    TrainingData,
    Trial,
    scaled_errors,
    typical_error,
)

CANDIDATES = ("mean", "pca-ridge", "kernel-ridge", "compact-cnn")
WITHOUT_FOLDS = "kernel-ridge"  # is taken where there is one group alone, and so nothing to choose by
INNER_FOLDS = 3
AGAIN = 1.6  # times as long as on an inner fold, at most, does a candidate take on all rows
MIN_EPOCHS, MAX_EPOCHS, MAX_MEMBERS = 10, 40, 3


@dataclass(frozen=True)
class FittedChoice:
    """Best candidate, trained on all rows."""

    fitted: Fitted
    choice: ModelChoice

    def predict(self, inputs: Tensor) -> Values:
        return self.fitted.predict(inputs)

    def to_onnx(self) -> onnx.ModelProto:
        return self.fitted.to_onnx()


@dataclass(frozen=True, slots=True)
class AutoModel:
    """Best of mean, pca-ridge, kernel-ridge and, if time allows, a network, by inner folds.

    The network needs torch and time for ten epochs, and is compared on one inner fold. A candidate starts
    only if time remains to refit the best so far on all rows. Results depend on the machine's speed only if
    time runs out.

    Attributes:
        minutes: Time for all fits of a calibration [min].
    """

    minutes: float = 10.0

    def __post_init__(self) -> None:
        if not 0 < self.minutes < math.inf:
            raise InputError(f"auto: {self.minutes} minutes; give more than 0, such as minutes=10")

    def shared_among(self, fits: int) -> AutoModel:
        return replace(self, minutes=self.minutes / fits)

    def fit(
        self,
        data: TrainingData,
        rows: Indices,
        *,
        seed: int,
        progress: Progress = silent,
        checkpoint: Path | None = None,
    ) -> FittedChoice:
        groups = data.groups[rows]
        count = min(INNER_FOLDS, len(np.unique(groups)))
        contest = _Contest(data, seed, progress, time.monotonic() + 60 * self.minutes)
        if count < 2:
            alone = Trial(WITHOUT_FOLDS, None, 0.0, "one group, so that nothing was chosen by holding out")
            return _learnt(_Entry(alone.name, {}), (alone,), data, rows, seed, progress)
        folds = [(rows[a], rows[b]) for a, b in GroupKFold(count).split(rows, groups=groups)]
        for name in CANDIDATES:
            contest.enter(name, folds)
        best, trials = contest.result()
        return _learnt(best, trials, data, rows, seed, progress)


@dataclass
class _Entry:
    """Candidate with RMS errors in units of the spread ``[fold target]`` and seconds by fold."""

    name: str
    options: Mapping[str, Any]
    errors: list[Float[np.ndarray, " t"]] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    note: str = ""

    def error(self, folds: int) -> float:
        """Error over the first folds."""
        return typical_error(np.sqrt(np.mean(np.square(self.errors[:folds]), axis=0)))

    @property
    def again_s(self) -> float:
        """Expected time to train it on all rows [s]."""
        return AGAIN * max(self.seconds, default=0.0)


@dataclass
class _Contest:
    """Candidates that are tried in turn until a time by the monotonic clock [s]."""

    data: TrainingData
    seed: int
    progress: Progress
    until: float
    entries: list[_Entry] = field(default_factory=list)

    def enter(self, name: str, folds: list[tuple[Indices, Indices]]) -> None:
        """Try a candidate on as many folds as time allows."""
        entry = _Entry(name, {})
        try:
            self._try(entry, folds)
        except (InputError, MissingExtraError) as e:  # too small an input, or no torch
            entry.errors, entry.note = [], str(e)
        self.entries.append(entry)
        gave = f"{entry.error(len(entry.errors)):.3f} of the spread" if entry.errors else "not tried"
        self.progress(f"{name}: {gave}", 1, 1)

    def _try(self, entry: _Entry, folds: list[tuple[Indices, Indices]]) -> None:
        from palpate.estimators.networks import model_kind

        done = [one for one in self.entries if one.errors]
        if done and self._left(done) <= 0:
            entry.note = "no time was left"
            return
        if model_kind(entry.name).costly:
            folds = folds[:1]
            entry.options = self._options(entry, folds[0][0], self._left(done))
            if not entry.options:
                return
        for k, (learn, watch) in enumerate(folds):
            started = time.monotonic()
            error = self._error(entry, learn, watch)
            entry.seconds.append(time.monotonic() - started)
            entry.errors.append(error)
            self.progress(f"trying {entry.name}", k + 1, len(folds))
            if self._left([*done, entry]) <= 0 and k + 1 < len(folds):
                entry.note = f"time for {k + 1} of {len(folds)} inner folds"
                return

    def _left(self, done: list[_Entry]) -> float:
        """Time left after training the best candidate on all rows [s]."""
        if not done:
            return self.until - time.monotonic()
        common = min(len(one.errors) for one in done)
        best = min(done, key=lambda one: one.error(common))
        return self.until - time.monotonic() - best.again_s

    def _options(self, entry: _Entry, learn: Indices, left_s: float) -> dict[str, Any]:
        """Epochs and members of a network that fit the time; none if too few do."""
        started = time.monotonic()
        self._fitted(entry.name, {"epochs": 1, "members": 1}, learn)
        epoch_s = time.monotonic() - started
        fitting = int((left_s - epoch_s) / ((1 + AGAIN) * epoch_s))
        if fitting < MIN_EPOCHS:
            minutes = (MIN_EPOCHS * (1 + AGAIN) + 1) * epoch_s / 60
            entry.note = f"{MIN_EPOCHS} epochs, twice, need about {minutes:.2g} min a fit"
            return {}
        members = min(MAX_MEMBERS, max(1, fitting // MAX_EPOCHS))
        entry.note = f"{min(MAX_EPOCHS, fitting)} epochs, members: {members}"
        return {"epochs": min(MAX_EPOCHS, fitting), "members": members}

    def _fitted(self, name: str, options: Mapping[str, Any], learn: Indices) -> Fitted:
        from palpate.estimators.networks import make_model

        def told(what: str, done: int, total: int) -> None:
            self.progress(f"trying {name}, {what}", done, total)

        return make_model(name, options).fit(self.data, learn, seed=self.seed, progress=told)

    def _error(self, entry: _Entry, learn: Indices, watch: Indices) -> Float[np.ndarray, " t"]:
        fitted = self._fitted(entry.name, entry.options, learn)
        errors = scaled_errors(fitted, Scaler.of(self.data.values[learn]), self.data, watch)
        return np.asarray(np.sqrt((errors**2).mean(axis=0)))

    def result(self) -> tuple[_Entry, tuple[Trial, ...]]:
        """Best candidate, and results on the inner folds that all have seen."""
        done = [one for one in self.entries if one.errors]
        common = min(len(one.errors) for one in done)
        best = min(done, key=lambda one: one.error(common))
        return best, tuple(self._trials(common))

    def _trials(self, common: int) -> Iterator[Trial]:
        for one in self.entries:
            error = one.error(common) if one.errors else None
            yield Trial(one.name, error, sum(one.seconds), one.note)


def _learnt(
    best: _Entry, trials: tuple[Trial, ...], data: TrainingData, rows: Indices, seed: int, progress: Progress
) -> FittedChoice:
    from palpate.estimators.networks import make_model

    fitted = make_model(best.name, best.options).fit(data, rows, seed=seed, progress=progress)
    within = f"; {fitted.choice.chosen}" if isinstance(fitted, Chooses) else ""
    return FittedChoice(fitted, ModelChoice(f"{best.name}{within}", trials))
