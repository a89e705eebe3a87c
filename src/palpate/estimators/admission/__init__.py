"""Admission of ONNX models: what a model may contain, decided from its bytes before a runtime sees them."""

from palpate.estimators.admission.model_admission import admit_model
from palpate.estimators.admission.operators import OPERATORS

__all__ = ["OPERATORS", "admit_model"]
