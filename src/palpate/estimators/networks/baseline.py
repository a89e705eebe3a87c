"""The mean of the training set: what any other model must beat."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.core import Indices
from palpate.estimators.networks.model_interface import Progress, TrainingData, silent
from palpate.estimators.networks.pca_ridge import FittedLinear


@dataclass(frozen=True, slots=True)
class MeanBaseline:
    """Learns nothing but the mean."""

    def fit(
        self,
        data: TrainingData,
        rows: Indices,
        *,
        seed: int,
        progress: Progress = silent,
        checkpoint: Path | None = None,
    ) -> FittedLinear:
        pixels, mean = math.prod(data.shape), data.values[rows].mean(axis=0)
        nothing = np.zeros((pixels, len(mean) + 1), np.float32)
        return FittedLinear(data.shape, nothing[:, 0], nothing[:, 1:], mean)
