"""Recordings to certified estimators and their scores; virtual and real data are treated alike."""

from palpate.calibration.adapt import adapt
from palpate.calibration.evaluate import evaluate
from palpate.calibration.fit import calibrate
from palpate.calibration.leakage import LeakageAudit, audit
from palpate.calibration.plan import Plan, Reference

__all__ = ["LeakageAudit", "Plan", "Reference", "adapt", "audit", "calibrate", "evaluate"]
