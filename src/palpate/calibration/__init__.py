"""Recordings to certified estimators and their scores; virtual and real data are treated alike."""

from typing import Any
from warnings import warn

from palpate.calibration.adaptation import adapt
from palpate.calibration.calibration_plan import CalibrationPlan, ReferenceRule
from palpate.calibration.evaluation import evaluate
from palpate.calibration.fitting import calibrate
from palpate.calibration.leakage import LeakageAudit, audit
from palpate.calibration.model_check import check_model

__all__ = [
    "CalibrationPlan", "LeakageAudit", "ReferenceRule", "adapt", "audit", "calibrate", "check_model",
    "evaluate",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name == "Plan":
        warn("calibration.Plan is now called CalibrationPlan", DeprecationWarning, stacklevel=2)
        return CalibrationPlan
    raise AttributeError(f"palpate.calibration has no {name!r}; it has {', '.join(__all__)}")
