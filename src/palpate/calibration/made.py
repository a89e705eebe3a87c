"""What a calibration has made, before it is written down."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.calibration.data import Untouched
from palpate.calibration.leakage import LeakageAudit
from palpate.calibration.plan import CalibrationPlan
from palpate.core.shapes import Indices, Values
from palpate.estimators.networks.model_interface import Fitted, TrainingData
from palpate.estimators.novelty import NoveltyDetector
from palpate.recordings.packed_set import PackedSet
from palpate.recordings.run_reader import Run
from palpate.recordings.splits import Split


@dataclass(frozen=True)
class Calibrated:
    """Everything a certificate is written from.

    Attributes:
        run, plan: what was asked.
        packed, data: the rows learnt from; of the untouched sensor's only where that was asked for.
        untouched: those frames.
        split, audit: how rows were held out.
        held_out: predictions of rows by a model that had not seen their group; NaN for rows not scored.
        fitted, guard: what was learnt from all of them.
        seconds: time it took [s].
    """

    run: Run
    plan: CalibrationPlan
    packed: PackedSet
    data: TrainingData
    split: Split
    audit: LeakageAudit
    untouched: Untouched
    held_out: Values
    fitted: Fitted
    guard: NoveltyDetector
    seconds: float = 0.0

    @property
    def scored(self) -> Indices:
        """Rows that were held out once, and predicted."""
        return np.flatnonzero(~np.isnan(self.held_out).any(axis=1))

    @property
    def one_fold(self) -> bool:
        """Whether only one fold was held out, and the kept model has not seen it."""
        return any(np.array_equal(self.scored, np.sort(rows)) for rows in self.split.folds)
