"""Sessions: what a calibration promises of another day, how that is tested, and how it is mended."""

from palpate.calibration.sessions.interval_reset import reset_intervals
from palpate.calibration.sessions.session_findings import EvaluationRecord, keep_evaluation, read_evaluations

__all__ = ["EvaluationRecord", "keep_evaluation", "read_evaluations", "reset_intervals"]
