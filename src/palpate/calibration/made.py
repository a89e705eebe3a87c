"""What a calibration has made, before it is written down."""

from __future__ import annotations

from dataclasses import dataclass

from palpate.calibration.data import Untouched
from palpate.calibration.leakage import LeakageAudit
from palpate.calibration.plan import Plan
from palpate.core.axes import Values
from palpate.estimators.guard import Guard
from palpate.estimators.networks.base import Fitted, TrainingData
from palpate.recordings.pack import PackedSet
from palpate.recordings.reader import Run
from palpate.recordings.splits import Split


@dataclass(frozen=True)
class Calibrated:
    """Everything a certificate is written from."""

    run: Run
    plan: Plan
    packed: PackedSet
    data: TrainingData
    split: Split
    audit: LeakageAudit
    untouched: Untouched
    held_out: Values
    fitted: Fitted
    guard: Guard
    seconds: float
