"""Sessions: what a calibration promises of another day, how that is tested, and how it is mended."""

from palpate.calibration.sessions.evaluation_record import EvaluationRecord, keep_evaluation, read_evaluations
from palpate.calibration.sessions.interval_reset import reset_intervals

__all__ = ["EvaluationRecord", "keep_evaluation", "read_evaluations", "reset_intervals"]
