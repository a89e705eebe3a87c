"""Recordings to certified estimators and their scores; virtual and real data are treated alike."""

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
