"""Recordings to certified estimators and their scores; virtual and real data are treated alike."""

from typing import TYPE_CHECKING

from palpate.core.plugins import names_at_first_use

if TYPE_CHECKING:
    from palpate.calibration.adaptation import adapt
    from palpate.calibration.calibration_plan import CalibrationPlan, ReferenceRule
    from palpate.calibration.evaluation import evaluate
    from palpate.calibration.fitting import calibrate
    from palpate.calibration.leakage import LeakageAudit, audit
    from palpate.calibration.model_check import check_model

# what loads tables and fits, which the reading of a calibration does not need: imported when first used
_MODULES = {
    "CalibrationPlan": "calibration_plan",
    "LeakageAudit": "leakage",
    "ReferenceRule": "calibration_plan",
    "adapt": "adaptation",
    "audit": "leakage",
    "calibrate": "fitting",
    "check_model": "model_check",
    "evaluate": "evaluation",
}

__all__ = [
    "CalibrationPlan", "LeakageAudit", "ReferenceRule", "adapt", "audit", "calibrate", "check_model",
    "evaluate",
]  # fmt: skip

if not TYPE_CHECKING:  # mypy accepts only the names imported above
    __getattr__, __dir__ = names_at_first_use(__name__, _MODULES, __all__)
